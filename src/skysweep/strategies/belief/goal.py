"""The candidate that the vehicle is on its way to, and from where it is looked at."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple


class View(NamedTuple):
    """From where a place is looked at, seen from there."""

    east_m: float
    north_m: float
    height_m: float


@dataclass(slots=True)
class Goal:
    """One candidate, from one view after the other."""

    id: int
    view: View
    tried: list[View] = field(default_factory=list)  # before
    looks_above: int = 0  # it, from this view
    looks_before: int | None = None  # that told something of it, when it was reached
    stops: bool = False  # there, instead of flying through

    def look_from(self, view: View) -> None:
        """Begin anew from another view; looks on the way there count."""
        self.tried.append(self.view)
        self.view = view
        self.looks_above, self.looks_before, self.stops = 0, None, False
