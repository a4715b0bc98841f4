"""Where a simulated vehicle really was: how near it came to obstacles, and which it touched."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skysweep.worlds.obstacles import Obstacles, came_near

F64 = NDArray[np.float64]


class Witness:
    """Sees the true position (3,) after every step of a mission. The mission itself learns nothing of it."""

    def __init__(self, position_enu_m: Callable[[], F64], obstacles: Obstacles) -> None:
        self._position_enu_m, self._obstacles = position_enu_m, obstacles
        self._track: list[F64] = []
        self._modes: list[str] = []

    def see(self, mode: str) -> None:
        """One step is over."""
        self._track.append(self._position_enu_m())
        self._modes.append(mode)

    def saw(self) -> dict[str, Any]:
        """What the journal says of it in the end."""
        return came_near(self._obstacles, np.array(self._track).reshape(-1, 3), self._modes)
