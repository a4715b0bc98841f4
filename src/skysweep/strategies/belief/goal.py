"""The candidate that the vehicle is on its way to, and from which side it is looked at."""

from __future__ import annotations

from dataclasses import dataclass

from skysweep.types import XY


@dataclass(slots=True)
class Goal:
    """One candidate, from one side after the other."""

    id: int
    height_m: float  # above it, from which it is looked at
    sides_m: list[XY]  # how far east and north of it: this one, then those left
    is_from_aside: bool = False  # other sides were due: from there it is looked at from the check's height
    looks_above: int = 0  # it, from this side
    looks_before: int | None = None  # that told something of it, when it was reached
    stops: bool = False  # there, instead of flying through

    def look_from(self, sides_m: list[XY]) -> None:
        """Begin anew from other sides; looks on the way there count."""
        self.sides_m, self.is_from_aside = sides_m, True
        self.looks_above, self.looks_before, self.stops = 0, None, False
