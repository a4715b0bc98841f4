"""Orders that a person gives on the page, checked before the mission gets them."""

from __future__ import annotations

from typing import Any, TypeAlias

from skysweep.errors import UserError

Told: TypeAlias = "tuple[str, int | None, tuple[float, float] | None]"  # fields of ``mission.orders.Order``

_STEERING = {
    "hold": "The vehicle is told to hold.",
    "continue": "The mission is told to go on.",
    "return": "The vehicle is told to come home.",
    "take back": "The vehicle is taken back.",
}
_VERDICTS = {"confirm": "confirmed", "reject": "rejected"}
_LARGEST_ID = 10**6
_FARTHEST_M = 1e5


def checked_order(given: Any) -> tuple[Told, str]:
    """An order from the JSON that a page sent, and what to say to it. Raises UserError if it is none."""
    if not isinstance(given, dict):
        raise UserError("The order is no JSON object.")
    word = str(given.get("word"))
    if word in _STEERING:
        return (word, None, None), _STEERING[word]
    if word in _VERDICTS:
        candidate = given.get("candidate")
        if type(candidate) is not int or not 0 <= candidate < _LARGEST_ID:
            raise UserError(f"candidate: write the number of the candidate to {word}.")
        return (word, candidate, None), f"Candidate {candidate} is to be {_VERDICTS[word]}."
    if word == "look":
        x, y = _place(given.get("position_enu_m"))
        return (word, None, (x, y)), f"The vehicle is asked to look at {x:.0f} m east, {y:.0f} m north."
    words = ", ".join((*_STEERING, *_VERDICTS, "look"))
    raise UserError(f"word: is not an order; write one of {words}.")


def _place(given: Any) -> tuple[float, float]:
    is_pair = isinstance(given, list) and len(given) == 2
    if is_pair and all(type(v) in (int, float) and abs(v) < _FARTHEST_M for v in given):
        return float(given[0]), float(given[1])
    raise UserError("position_enu_m: write [east, north] in metres from the origin.")
