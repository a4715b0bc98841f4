"""Orders that a person gives on the page, checked before the mission gets them."""

from __future__ import annotations

from typing import Any

from skysweep.errors import UserError
from skysweep.mission.orders import CONTINUE, HOLD, LOOK, RETURN, TAKE_BACK, VERDICTS, Order

_STEERING = {
    HOLD: "The vehicle is asked to hold.",
    CONTINUE: "The mission is asked to go on.",
    RETURN: "The vehicle is asked to come home.",
    TAKE_BACK: "The mission is asked to take the vehicle back.",
}
_LARGEST_ID = 10**6
_FARTHEST_M = 1e5
_LONGEST_HOLDER = 2000


def checked_order(given: Any) -> tuple[Order, str]:
    """An order from the JSON that a page sent, and what to say to it. Raises UserError if it is none."""
    if not isinstance(given, dict):
        raise UserError("The order is no JSON object.")
    word = str(given.get("word"))
    if word in _STEERING:
        holder = _holder(given.get("holder")) if word == TAKE_BACK else None
        return Order(word, holder=holder), _STEERING[word]
    if word in VERDICTS:
        candidate = given.get("candidate")
        if type(candidate) is not int or not 0 <= candidate < _LARGEST_ID:
            raise UserError(f"candidate: write the number of the candidate to {word}.")
        return Order(word, candidate), f"The mission is asked to {word} candidate {candidate}."
    if word == LOOK:
        x, y = _place(given.get("position_enu_m"))
        return Order(word, None, (x, y)), f"The vehicle is asked to look at {x:.0f} m east, {y:.0f} m north."
    words = ", ".join((*_STEERING, *VERDICTS, LOOK))
    raise UserError(f"word: is not an order; write one of {words}.")


def _holder(given: Any) -> str:
    if isinstance(given, str) and 0 < len(given) <= _LONGEST_HOLDER:
        return given
    raise UserError("holder: write who flies the vehicle, as the journal says it; reload the page.")


def _place(given: Any) -> tuple[float, float]:
    is_pair = isinstance(given, list) and len(given) == 2
    if is_pair and all(type(v) in (int, float) and abs(v) < _FARTHEST_M for v in given):
        return float(given[0]), float(given[1])
    raise UserError("position_enu_m: write [east, north] in metres from the origin.")
