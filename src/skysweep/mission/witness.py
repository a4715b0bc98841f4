"""The true track of a simulated vehicle: its clearance from obstacles, and collisions."""

from __future__ import annotations

from typing import Any

import numpy as np

from skysweep.arrays import F64
from skysweep.types import Mode, Truth
from skysweep.worlds.obstacles import Obstacles, came_near


class Witness:
    """Records the vehicle's true position after every step. The mission itself never sees it."""

    def __init__(self, truth: Truth, obstacles: Obstacles) -> None:
        self._truth, self._obstacles = truth, obstacles
        self._track: list[F64] = []
        self._modes: list[Mode] = []

    def see(self, mode: Mode) -> None:
        """Record a step."""
        self._track.append(self._truth.true_position_enu_m)
        self._modes.append(mode)

    def saw(self) -> dict[str, Any]:
        """The journal's ``clearance`` fields."""
        return came_near(self._obstacles, np.array(self._track).reshape(-1, 3), self._modes)
