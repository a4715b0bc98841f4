"""What hills cost on a straight way that no profile was planned for: out to the search, on to it, and home.

The vehicle follows the ground ahead at a height above it, as its climb and descent allow. It waits where it
would come nearer to the ground than it should, and is too high or too low at the end of a way that falls or
rises faster than it does (``mission/loop.py`` flies it so).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skysweep.arrays import F64
from skysweep.planning.following import LOOK_AHEAD_S, STATION_M
from skysweep.scenarios.model import VehicleLimits
from skysweep.worlds.world import TerrainSurface, bilinear_at

_MOST_STATIONS = 256  # of one leg


def lost_over_hills_s(
    ways_xy_enu_m: F64,
    speeds_mps: F64,
    above_m: float,
    altitude_agl_m: float,
    keep_m: float,
    vehicle: VehicleLimits,
    terrain: TerrainSurface,
) -> F64:
    """Seconds (K,) that ways (K, N, 2) through N places take longer than over level ground.

    They are flown at these speeds (K,) over ground and at ``altitude_agl_m``, begin ``above_m`` over the
    ground, and end when the vehicle has that altitude again. ``keep_m`` is how near the ground may come.
    """
    if terrain.is_flat:
        return np.zeros(len(ways_xy_enu_m))
    climb_mps, sink_mps = vehicle.climb_speed_mps, vehicle.descent_speed_mps
    return np.asarray(
        _lost_s(
            terrain.heights_m,
            terrain.bounds_enu_m,
            np.asarray(ways_xy_enu_m, dtype=float),
            np.asarray(speeds_mps, dtype=float),
            (above_m, altitude_agl_m, min(keep_m, altitude_agl_m), climb_mps, sink_mps),
        )
    )


@njit(cache=True)
def _lost_s(
    grid: F64,
    bounds: tuple[float, float, float, float],
    ways: F64,
    speeds: F64,
    heights_rates: tuple[float, float, float, float, float],
) -> F64:
    above, altitude, keep, climb, sink = heights_rates
    lost = np.zeros(len(ways))
    for k in range(len(ways)):
        way, speed = ways[k], speeds[k]
        height = bilinear_at(grid, bounds, way[0, 0], way[0, 1]) + above
        for leg in range(len(way) - 1):
            x, y = way[leg]
            east, north = way[leg + 1, 0] - x, way[leg + 1, 1] - y
            length = math.hypot(east, north)
            stations = min(max(1, math.ceil(length / STATION_M)), _MOST_STATIONS)
            ahead = min(1.0, speed * LOOK_AHEAD_S / max(length, 1e-6))
            passing = length / stations / speed
            for s in range(1, stations + 1):
                share = s / stations
                here = bilinear_at(grid, bounds, x + share * east, y + share * north)
                share = min(1.0, share + ahead)
                there = bilinear_at(grid, bounds, x + share * east, y + share * north)
                wanted = max(here, there) + altitude
                height = min(max(wanted, height - sink * passing), height + climb * passing)
                if height < here + keep:
                    lost[k] += (here + keep - height) / climb
                    height = here + keep
        end = bilinear_at(grid, bounds, way[-1, 0], way[-1, 1]) + altitude
        lost[k] += (height - end) / sink if height > end else (end - height) / climb
    return lost
