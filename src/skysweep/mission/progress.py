"""Whether a vehicle approaches its goal, or climbs on its way there."""

from __future__ import annotations

import math

from skysweep.types import XY

_STEP_M = 1.0


class Progress:
    """The closest that the vehicle has come to a goal, how high it has been, and since when."""

    def __init__(self) -> None:
        self._best: tuple[XY, float, float, float] | None = None  # the goal, nearest, highest, since

    def restart(self) -> None:
        """Forget the past."""
        self._best = None

    def stuck_s(self, now_s: float, goal_xy: XY, distance_m: float, height_m: float = -math.inf) -> float:
        """Time since it last came a metre closer, or a metre higher than before; a new goal restarts it."""
        if self._best is None or math.dist(goal_xy, self._best[0]) > _STEP_M:
            self._best = (goal_xy, distance_m, height_m, now_s)
        _, nearest_m, highest_m, since_s = self._best
        if distance_m < nearest_m - _STEP_M or height_m > highest_m + _STEP_M:
            self._best = (goal_xy, min(distance_m, nearest_m), max(height_m, highest_m), now_s)
            return 0.0
        return now_s - since_s
