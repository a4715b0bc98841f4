"""The whole flight of a plan over its terrain: how high above the ground, where the radio reaches it.

Transects are flown as their profiles say, every other leg, also out and home, as ``relief.py`` predicts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.planning.coverage import CoveragePlan
from skysweep.planning.following import ground_along
from skysweep.planning.relief import heights_over
from skysweep.planning.sight import height_over_ground
from skysweep.scenarios.model import Scenario
from skysweep.types import XY
from skysweep.worlds.world import TerrainSurface

ANTENNA_M = 2.0  # above home, without a mast


class FlownPath(NamedTuple):
    """Stations (K,) from take-off to home."""

    along_m: F64
    xy_enu_m: F64  # (K, 2)
    ground_m: F64  # ENU, the highest between the stations before and after
    height_m: F64  # ENU
    search: slice  # the stations from the first waypoint to the last

    @property
    def agl_m(self) -> F64:
        """Heights (K,) above that ground: the vehicle is nowhere between two stations lower than at both."""
        return self.height_m - self.ground_m

    def stretches(self, marked: NDArray[np.bool_]) -> list[tuple[XY, float]]:
        """Middle and length of each stretch of marked stations (K,), the longest first."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(int)))
        found = []
        for begin, end in edges.reshape(-1, 2).tolist():
            x, y = self.xy_enu_m[(begin + end - 1) // 2].tolist()
            found.append(((x, y), float(self.along_m[end - 1] - self.along_m[begin])))
        return sorted(found, key=lambda stretch: -stretch[1])


def flown_path(
    plan: CoveragePlan, scenario: Scenario, altitude_agl_m: float, terrain: TerrainSurface
) -> FlownPath:
    """The path from home along the plan and back, straight from waypoint to waypoint."""
    home = np.array([scenario.home.position_enu_m], dtype=float)
    keep_m = scenario.safety.clearance_m
    corners = np.concatenate([home, plan.waypoints_xy_enu_m, home])
    profiles = {p.leg_xy_enu_m.tobytes(): p for p in plan.profiles}
    vehicle, scan_mps = scenario.vehicle, scenario.search.scan_speed_mps
    parts: list[tuple[F64, F64, F64]] = []
    counts = [0]
    height_m = float(terrain.height_m(home)[0]) + altitude_agl_m
    for k, leg in enumerate(np.stack([corners[:-1], corners[1:]], axis=1)):
        profile = profiles.get(np.ascontiguousarray(leg).tobytes())
        ground = ground_along(leg, terrain)
        share = np.linspace(0.0, 1.0, len(ground))[:, None]
        xy = leg[0] + share * (leg[1] - leg[0])
        if profile is not None:
            height = profile.height_m
        else:
            speed_mps = vehicle.cruise_speed_mps if k == len(corners) - 2 else scan_mps
            along = math.dist(*leg) * share[:, 0]
            height = heights_over(along, ground, height_m, speed_mps, altitude_agl_m, keep_m, vehicle)
        height_m = float(height[-1])
        parts.append((xy, ground, height))
        counts.append(counts[-1] + len(ground))
    xy, ground, height = (np.concatenate(part) for part in zip(*parts, strict=True))
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    return FlownPath(along, xy, ground, height, slice(counts[1], counts[-2]))


def mast_enu_m(scenario: Scenario, terrain: TerrainSurface) -> F64:
    """The radio's antenna (3,): that of ``safety.radio_mast_enu_m``, or ``ANTENNA_M`` above home."""
    mast = scenario.safety.radio_mast_enu_m
    x, y, above_m = (*scenario.home.position_enu_m, ANTENNA_M) if mast is None else mast
    return np.array([x, y, terrain.height_at_m(x, y) + above_m])


def hidden_from(mast: F64, path: FlownPath, terrain: TerrainSurface) -> NDArray[np.bool_]:
    """At which stations (K,) the ground is between the vehicle and an antenna (3,)."""
    if terrain.is_flat:
        return np.zeros(len(path.height_m), dtype=bool)
    places = np.column_stack([path.xy_enu_m, path.height_m])
    return _hidden(terrain.heights_m, terrain.bounds_enu_m, mast, places)


@njit(cache=True)
def _hidden(
    heights: F64, bounds: tuple[float, float, float, float], mast: F64, places: F64
) -> NDArray[np.bool_]:
    hidden = np.zeros(len(places), dtype=np.bool_)
    for k in range(len(places)):
        x, y, z = places[k]
        hidden[k] = height_over_ground(heights, bounds, mast, x, y, -math.inf, z) > z
    return hidden
