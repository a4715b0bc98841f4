"""The parts of the ground's picture that a view needs: nested squares, each wider than the one before.

A clipmap (Tanner, Migdal and Jones, 1998): what is held depends on the view, not on the picture's size.
Squares move in steps, so that a picture does not depend on earlier ones, and seldom.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from skysweep.arrays import U8
from skysweep.geometry.camera import CameraPose, Lens, rays_enu
from skysweep.worlds.ground_grid import HORIZON_M
from skysweep.worlds.rasters import GroundPicture

MOST_WINDOWS = 3
_LEAST_M = 64.0  # a side
_MOST_PX = 2048
_FINER = math.sqrt(2.0)  # ratio of the finest window's possible sides
_WIDER = 8  # times the window before
_STEPS = 16  # a side
_LEVEL = 0.05  # descent of a line of sight that hardly meets the ground
_HELD = 6


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """A square of the picture; its first row is the southern one. Alpha is 0 where there is no picture."""

    west_m: float
    south_m: float
    side_m: float
    rgba: U8  # (n, n, 4), n a power of two

    @property
    def pixel_m(self) -> float:
        return self.side_m / len(self.rgba)


class PictureWindows:
    """Reads the windows of views and keeps the newest."""

    def __init__(self, picture: GroundPicture) -> None:
        self._picture = picture
        self._held: OrderedDict[tuple[int, int, float, int], Window] = OrderedDict()

    def of(self, lens: Lens, pose: CameraPose, ground_m: float) -> tuple[Window, ...]:
        """The windows, at most ``MOST_WINDOWS``, of a view of ground at about ``ground_m``, finest first."""
        eye, forward = pose.position_enu_m, pose.R_camera_to_enu[:, 2]
        above_m = max(float(eye[2]) - ground_m, 1.0)
        reach_m = above_m / max(-float(forward[2]), 0.35)
        in_sight_m = 2.2 * reach_m * math.tan(lens.hfov_rad / 2)
        side_m = _LEAST_M * _FINER ** max(math.ceil(math.log(1.35 * in_sight_m / _LEAST_M, _FINER)), 0)
        found = []
        for _ in range(MOST_WINDOWS):
            ahead_m = min(reach_m, 0.4 * side_m)
            aim_m = eye[:2] + ahead_m * forward[:2]
            column, row = (round(v * _STEPS / side_m) for v in aim_m.tolist())
            found.append(self._window(column, row, side_m, window_px(lens)))
            if 0.4 * side_m > min(ground_reach_m(lens, pose, above_m), HORIZON_M):
                break
            side_m *= _WIDER
        return tuple(found)

    def _window(self, column: int, row: int, side_m: float, size_px: int) -> Window:
        key = (column, row, side_m, size_px)
        if key in self._held:
            self._held.move_to_end(key)
            return self._held[key]
        west, south = column * side_m / _STEPS - side_m / 2, row * side_m / _STEPS - side_m / 2
        rgba = self._picture.read(west, south, west + side_m, south + side_m, size_px, size_px)
        self._held[key] = Window(west, south, side_m, np.ascontiguousarray(rgba[::-1]))
        if len(self._held) > _HELD:
            self._held.popitem(last=False)
        return self._held[key]


def window_px(lens: Lens) -> int:
    """A side of the windows of a lens."""
    return min(1 << (2 * lens.width_px - 1).bit_length(), _MOST_PX)


def ground_reach_m(lens: Lens, pose: CameraPose, above_m: float) -> float:
    """How far away, level, a view from ``above_m`` over the ground sees it; far, if it sees the horizon."""
    corners = rays_enu(lens, pose, lens.corners_px)
    return above_m * float((np.hypot(*corners[:, :2].T) / np.maximum(-corners[:, 2], _LEVEL)).max())
