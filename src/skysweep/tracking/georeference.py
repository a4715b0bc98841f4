"""From a pixel to a place on the ground, with the pose that the mission believes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from skysweep.arrays import F64
from skysweep.geometry.camera import CameraPose, Lens, rays_enu

GroundHeight = Callable[[F64], F64]

_MAX_RANGE_M = 2000.0
_STEPS_M = np.linspace(0.0, _MAX_RANGE_M, 2001)
_STEPS_AT_ONCE = 200  # most rays meet the ground within them
_REFINEMENTS = 25
_LEVEL_M = 1e-9  # ground that differs by less is level


def pixels_to_ground(lens: Lens, pose: CameraPose, pixels: ArrayLike, ground_height_m: GroundHeight) -> F64:
    """Where rays through ``pixels`` (N, 2) meet the terrain: (N, 3) ENU metres.

    Rows are NaN for rays that miss the ground within 2 km. March along the ray until it is below the
    terrain, then bisect; exact (one division) on flat ground.
    """
    origin = np.asarray(pose.position_enu_m, dtype=float)
    ground = float(ground_height_m(origin[None, :2])[0])
    directions = rays_enu(lens, pose, pixels)
    points = np.empty(directions.shape)
    if _meet_level(points, directions, origin, ground) and all(
        abs(height - ground) < _LEVEL_M for height in ground_height_m(points[:, :2]).tolist()
    ):
        return points
    return np.array([_march(origin, d, ground_height_m) for d in directions]).reshape(-1, 3)


@njit(cache=True)
def _meet_level(points: F64, directions: F64, origin: F64, ground: float) -> bool:
    """Write where rays (N, 3) meet a level ground into ``points`` (N, 3); False if one does not."""
    for k in range(len(directions)):
        drop = directions[k, 2]
        distance = (ground - origin[2]) / drop if drop < -1e-6 else np.inf
        if not 0.0 < distance < _MAX_RANGE_M:
            return False
        for i in range(3):
            points[k, i] = origin[i] + directions[k, i] * distance
    return True


def _march(origin: F64, direction: F64, ground_height_m: GroundHeight) -> F64:
    for start in range(0, len(_STEPS_M), _STEPS_AT_ONCE):
        s = _STEPS_M[start : start + _STEPS_AT_ONCE]
        points = origin + s[:, None] * direction
        below = points[:, 2] <= ground_height_m(points[:, :2])
        if below.any():
            break
    first = start + int(np.argmax(below))
    if not below.any() or first == 0:
        return np.full(3, np.nan)
    low, high = _STEPS_M[first - 1], _STEPS_M[first]
    for _ in range(_REFINEMENTS):
        middle = (low + high) / 2
        point = origin + middle * direction
        if point[2] <= ground_height_m(point[None, :2])[0]:
            high = middle
        else:
            low = middle
    return np.asarray(origin + high * direction)
