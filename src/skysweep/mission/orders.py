"""The words of the person who operates a mission."""

from __future__ import annotations

import math
import operator
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
        """The order as the journal gives it back: its place rounded to a tenth of a millimetre.

        What is no word, candidate, place or holder is none: nobody's program checks it before.
        """
        try:
            candidate_id = None if self.candidate_id is None else operator.index(self.candidate_id)
        except TypeError:
            candidate_id = None
        holder = None if self.holder is None else str(self.holder)
        return Order(str(self.word), candidate_id, _place(self.xy_enu_m), holder)

    @classmethod
    def of_line(cls, line: Mapping[str, Any]) -> Order:
        """The order of a line of the journal."""
        place = line.get("p")
        xy_enu_m = None if place is None else (place[0], place[1])
        return cls(line["word"], line.get("candidate"), xy_enu_m, line.get("holder"))


def _place(given: Any) -> XY | None:
    try:
        x, y = (round(float(v), 4) for v in given)
    except (TypeError, ValueError, OverflowError):
        return None
    return (x, y) if math.isfinite(x + y) and max(abs(x), abs(y)) < _FARTHEST_M else None


Operator: TypeAlias = Callable[[], Order | None]  # asked at every tick; None: nothing new
