"""The looks at one candidate since its probability was last told, and what they come to in words."""

from __future__ import annotations

from dataclasses import dataclass

MOVED = 1.5  # of the log odds since they were last told, to be told again: from 0.5 to 0.82, or to 0.18
CLEAR = 5.0  # log odds: nothing is told of what happens below 0.007 or above 0.993


@dataclass(slots=True)
class Account:
    """Heights are those of the camera above the candidate."""

    log_odds: float = 0.0  # as last told, within ``CLEAR``
    n_looks: int = 0  # since then
    n_found: int = 0
    confidence: float = 0.0  # best
    lowest_m: float = 0.0
    highest_m: float = 0.0

    def look(self, height_m: float, confidence: float | None) -> None:
        """Take in a look that found it with this confidence, or None: that missed it."""
        self.lowest_m = min(self.lowest_m, height_m) if self.n_looks else height_m
        self.highest_m = max(self.highest_m, height_m) if self.n_looks else height_m
        self.n_looks += 1
        if confidence is not None:
            self.n_found += 1
            self.confidence = max(self.confidence, confidence)

    def has_moved(self, log_odds: float) -> bool:
        """Whether these are to be told."""
        if abs(log_odds - self.log_odds) < MOVED:  # the usual case, in little time
            return False
        return abs(within_clear(log_odds) - self.log_odds) >= MOVED

    def words(self) -> str:
        """The looks in words; empty where there was none."""
        low, high = f"{self.lowest_m:.0f}", f"{self.highest_m:.0f}"
        heights = f"from {low} m" if low == high else f"from {low} to {high} m"
        if self.n_looks == 0:
            return ""
        if self.n_found == 0:
            return f"missed {heights}" if self.n_looks == 1 else f"missed in {self.n_looks} looks {heights}"
        if self.n_looks == 1:
            return f"found with {self.confidence:.2f} {heights}"
        return (
            f"found in {self.n_found} of {self.n_looks} looks {heights}, at best with {self.confidence:.2f}"
        )


def within_clear(log_odds: float) -> float:
    """The log odds, no further from even than ``CLEAR``."""
    return min(max(log_odds, -CLEAR), CLEAR)
