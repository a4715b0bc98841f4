"""Whether a vehicle approaches its goal."""

from __future__ import annotations

import math

from skysweep.types import XY

_STEP_M = 1.0


class Progress:
    """The closest that the vehicle has come to a goal, and since when."""

    def __init__(self) -> None:
        self._nearest: tuple[XY, float, float] | None = None  # the goal, metres, since

    def restart(self) -> None:
        """Forget the past."""
        self._nearest = None

    def stuck_s(self, now_s: float, goal_xy: XY, distance_m: float) -> float:
        """Time since it last came a metre closer; a new goal restarts it."""
        nearest = self._nearest
        if nearest is None or math.dist(goal_xy, nearest[0]) > _STEP_M or distance_m < nearest[1] - _STEP_M:
            self._nearest = (goal_xy, distance_m, now_s)
            return 0.0
        return now_s - nearest[2]
