"""Keeps a mission clear of known obstacles: legs go over them, checks look from beside them.

The vehicle climbs ahead of an obstacle and waits if the climb takes longer. A place it cannot descend to is
looked at from the nearest clear one, as low as possible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.mission.fence import ELSEWHERE_M, Fence
from skysweep.planning.relief import BRAKING_S, CLIMB_SHARE, ROOM_M
from skysweep.scenarios.model import Scenario
from skysweep.types import XY, Waypoint
from skysweep.worlds.obstacles import Obstacles, keep_m

_IN_PICTURE_M = 1.2  # from the picture's edges, for errors of hovering and position
_FINENESS = 12  # places tried per height of the vehicle
_LEVEL_M = 2.0  # between the heights tried
_TURNS_RAD = np.arange(16) * math.pi / 8.0
_ROUND = np.column_stack([np.cos(_TURNS_RAD), np.sin(_TURNS_RAD)])
_AROUND = np.concatenate([0.5 * _ROUND, _ROUND])  # places in a circle
_MOVED_M = 1.0  # a place that moves less keeps its lookout


class Clearance:
    """The obstacles of one mission and the view of its camera. Without obstacles it changes nothing."""

    def __init__(self, scenario: Scenario, obstacles: Obstacles, fence: Fence, yaw_rad: float) -> None:
        self._obstacles, self._fence, self._lens = obstacles, fence, scenario.camera.lens
        self._keep_m = keep_m(scenario)
        self._climb_mps = scenario.vehicle.climb_speed_mps
        self._highest_agl_m = scenario.search.scan_altitude_agl_m
        self._clear_above_m = obstacles.top_m() + self._keep_m if obstacles.exist else -math.inf
        self._R_camera_to_enu = rotation_camera_to_enu(yaw_rad, scenario.camera.gimbal.pitch_rad)
        self._held_xy: XY | None = None  # where it waits for a climb
        self._here: XY = (math.inf, math.inf)  # when it was asked last
        self._looked: tuple[Waypoint, Waypoint | None] | None = None  # the last request, and its answer

    def start_over(self) -> None:
        """The vehicle may be elsewhere: it climbs there, not where it waited for a climb before."""
        self._held_xy = None

    def over(
        self, here_enu_m: F64, way: Sequence[XY], ground_m: float, waypoint: Waypoint
    ) -> tuple[float, float, float]:
        """Where to fly now, ENU, on a way from place to place, at the waypoint's altitude above ``ground_m``.

        Obstacles raise it; if the next metres are not clear, it is straight up.
        """
        x, y, z = here_enu_m.tolist()
        if math.dist(self._here, (x, y)) > ELSEWHERE_M:
            self.start_over()
        self._here = x, y
        height_m = ground_m + waypoint.altitude_agl_m
        if min(z, height_m) < self._clear_above_m:
            aim_m, least_m, near_m = -math.inf, -math.inf, BRAKING_S * waypoint.speed_mps
            for begin, end in pairwise([(x, y), *way]):
                leg_aim_m, leg_least_m = self._obstacles.heights_along(
                    begin,
                    end,
                    self._keep_m,
                    min(self._keep_m, waypoint.altitude_agl_m),
                    near_m,
                    CLIMB_SHARE * self._climb_mps / waypoint.speed_mps,
                )
                aim_m, least_m = max(aim_m, leg_aim_m), max(least_m, leg_least_m)
                near_m -= math.dist(begin, end)
            if aim_m > height_m:
                height_m = aim_m + ROOM_M
            if z < least_m:
                self._held_xy = self._held_xy or (x, y)
                return (*self._held_xy, height_m)
        self._held_xy = None
        return (*way[0], height_m)

    def lookout(self, waypoint: Waypoint) -> Waypoint | None:
        """From where to see the waypoint's place: from there, else beside, else higher; None if nowhere.

        The place is then well inside the picture, and no known crown or building hides it. On a hillside it
        is as low as the ground beside it lets the vehicle come.
        """
        found = self._clear_of_solids(waypoint)
        return None if found is None else self._above_the_slope(found)

    def _above_the_slope(self, waypoint: Waypoint) -> Waypoint:
        """No lower than ``over`` lets the vehicle come where the ground beside the waypoint is higher."""
        terrain, altitude_m = self._obstacles.terrain, waypoint.altitude_agl_m
        if terrain.is_flat:
            return waypoint
        places = np.array(waypoint.xy_enu_m) + (self._keep_m + _MOVED_M) * _AROUND
        rises_m = float(terrain.height_m(places).max()) - terrain.height_at_m(*waypoint.xy_enu_m)
        if rises_m + min(self._keep_m, altitude_m) <= altitude_m:
            return waypoint
        return waypoint._replace(altitude_agl_m=rises_m + self._keep_m + ROOM_M)

    def _clear_of_solids(self, waypoint: Waypoint) -> Waypoint | None:
        if not len(self._obstacles.solids):
            return waypoint
        ground_m = self._obstacles.terrain.height_at_m(*waypoint.xy_enu_m)
        if self._is_clear(np.array([waypoint.xy_enu_m]), ground_m + waypoint.altitude_agl_m).all():
            return waypoint
        if self._looked is not None:
            asked, answer = self._looked
            near = math.dist(asked.xy_enu_m, waypoint.xy_enu_m) < _MOVED_M
            if near and asked.altitude_agl_m == waypoint.altitude_agl_m:
                return answer
        answer = self._nearest_lookout(waypoint, np.array([*waypoint.xy_enu_m, ground_m]))
        self._looked = waypoint, answer
        return answer

    def _nearest_lookout(self, waypoint: Waypoint, place_enu_m: F64) -> Waypoint | None:
        for above_m in np.arange(waypoint.altitude_agl_m, self._highest_agl_m, _LEVEL_M).tolist():
            height_m = place_enu_m[2] + above_m
            places = place_enu_m[:2] + self._offsets(above_m)
            agl_m = height_m - self._obstacles.terrain.height_m(places)
            fit = self._is_clear(places, height_m) & (agl_m >= min(self._keep_m, waypoint.altitude_agl_m))
            for xy, altitude_agl_m in zip(places[fit].tolist(), agl_m[fit].tolist(), strict=True):
                seen = not self._obstacles.hide(place_enu_m, np.array([*xy, height_m]))
                if seen and self._fence.allows((xy[0], xy[1])):
                    return waypoint._replace(xy_enu_m=(xy[0], xy[1]), altitude_agl_m=altitude_agl_m)
        return None

    def _offsets(self, above_m: float) -> F64:
        """Offsets (N, 2) from which a place ``above_m`` below is in the picture, nearest first."""
        steps = above_m / _FINENESS * np.arange(-2 * _FINENESS, 2 * _FINENESS + 1)
        grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        down = np.column_stack([-grid, np.full(len(grid), -above_m)]) @ self._R_camera_to_enu
        half = np.array([self._lens.width_px, self._lens.height_px]) / (2.0 * self._lens.focal_px)
        seen = (np.abs(down[:, :2]) <= half * down[:, 2:] - _IN_PICTURE_M).all(axis=1)
        offsets = grid[seen]
        return offsets[np.argsort(np.hypot(*offsets.T), kind="stable")]

    def _is_clear(self, places: F64, height_m: float) -> NDArray[np.bool_]:
        away_m = self._keep_m + ROOM_M
        return self._obstacles.top_within_m(places, away_m) + away_m <= height_m


def too_high(scenario: Scenario, obstacles: Obstacles) -> list[shapely.Polygon]:
    """Outlines, with clearance, of obstacles too high to fly over below the ceiling."""
    tops = obstacles.solids[:, 8] - obstacles.terrain.height_m(obstacles.solids[:, :2])
    least_m = keep_m(scenario) + ROOM_M
    high = tops + least_m > scenario.safety.altitude_max_agl_m
    return list(shapely.buffer(obstacles.outlines()[high], least_m)) if high.any() else []
