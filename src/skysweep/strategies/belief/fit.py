"""How targets look here, beside what the sensor model says of them.

A detector that was calibrated elsewhere may see these targets better or worse, or less steadily. Both are
learned from the candidates that are probably targets, with a prior that nothing differs (empirical Bayes).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from skysweep.arrays import F64

_SHIFT_STD = 0.3  # prior of the shift, in scores
_MOVED = 0.02  # in scores: a shift that moves less changes nothing
_HITS = 60.0  # weight of the prior that scores spread as the model says
_SURE = 2.5  # standard deviations: a shift that is less certain is taken for none
_WORTH = 0.2  # in scores: a shift that is less is not said
_UNSTEADY, _AFTER = 1.2, 40.0  # times as wide as the model says, and after so many hits


@dataclass(slots=True)
class Fit:
    """``shift`` is by how much targets score higher than the model says, ``widened`` how far they spread."""

    shift: float = 0.0
    weight: float = 0.0  # of what the shift was learned from: 1 / variance
    widened: float = 1.0
    n_hits: float = 0.0  # of targets
    squares: float = 0.0  # of their distances from what was expected, in standard deviations of the model

    def learn_shift(self, likely: F64, told: F64) -> bool:
        """From how likely each candidate is a target (N,), and what it tells (N, 2); whether it has moved."""
        total, weight = likely @ told
        self.weight = float(weight) + _SHIFT_STD**-2
        shift = float(total) / self.weight
        if abs(shift) * math.sqrt(self.weight) < _SURE:
            shift = 0.0
        if abs(shift - self.shift) < _MOVED:
            return False
        self.shift = shift
        return True

    def learn_spread(self, likely: float, surprise: float) -> None:
        """From a hit of a candidate that is a target with probability ``likely``."""
        self.n_hits += likely
        self.squares += likely * surprise * self.widened**2
        self.widened = math.sqrt(max((_HITS + self.squares) / (_HITS + self.n_hits), 1.0))

    def misfit(self) -> str:
        """In words, what differs from the model beyond doubt; empty where nothing does."""
        parts = []
        if abs(self.shift) >= _WORTH and abs(self.shift) * math.sqrt(self.weight) >= _SURE:
            better = "higher" if self.shift > 0.0 else "lower"
            parts.append(f"scores of targets are {abs(self.shift):.1f} {better} than the sensor model says")
        if self.widened >= _UNSTEADY and self.n_hits >= _AFTER:
            parts.append(f"scores of targets vary {self.widened:.1f} times as much as the sensor model says")
        return " and ".join(parts)
