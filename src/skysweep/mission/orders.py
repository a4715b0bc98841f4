"""The words of the person who operates a mission."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeAlias

from skysweep.types import XY, EventKind

HOLD, CONTINUE, RETURN = "hold", "continue", "return"
TAKE_BACK = "take back"  # from somebody else who flies the vehicle, then continue
CONFIRM, REJECT, LOOK = "confirm", "reject", "look"
STEERING = (HOLD, CONTINUE, RETURN, TAKE_BACK)
VERDICTS = {CONFIRM: EventKind.CONFIRMED, REJECT: EventKind.REJECTED}
ORDER = "operator"  # kind of the journal's lines with orders
MOST_WAITING = 50  # orders that are heard at once, before a take-off
_FARTHEST_M = 1e5  # a place farther away is none


class Order(NamedTuple):
    """One order. ``confirm`` and ``reject`` are of a candidate, ``look`` is of a place on the ground.

    ``take back`` is from the ``holder`` of whom the person has read: the words of
    ``VehicleState.taken_over``. None: from whoever has the vehicle now.
    """

    word: str
    candidate_id: int | None = None
    xy_enu_m: XY | None = None
    holder: str | None = None

    def as_recorded(self) -> Order:
        """The order as the journal gives it back: its place rounded to a tenth of a millimetre, or none."""
        if self.xy_enu_m is None:
            return self
        x, y = (round(float(v), 4) for v in self.xy_enu_m)
        is_place = math.isfinite(x + y) and max(abs(x), abs(y)) < _FARTHEST_M
        return self._replace(xy_enu_m=(x, y) if is_place else None)

    @classmethod
    def of_line(cls, line: Mapping[str, Any]) -> Order:
        """The order of a line of the journal."""
        place = line.get("p")
        xy_enu_m = None if place is None else (place[0], place[1])
        return cls(line["word"], line.get("candidate"), xy_enu_m, line.get("holder"))


Operator: TypeAlias = Callable[[], Order | None]  # asked at every tick; None: nothing new
