"""What hills cost on a way that no profile was planned for: out to the search, on to it, and home.

The vehicle follows the ground ahead at a height above it, climbs early for what rises beyond, and waits where
it would come nearer to the ground than it should. At the end of a way that falls or rises faster than it does
it is too high or too low (``mission/loop.py`` and ``mission/clearance.py`` fly it so).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from skysweep.arrays import F64
from skysweep.planning.following import LOOK_AHEAD_S, STATION_M
from skysweep.scenarios.model import VehicleLimits
from skysweep.worlds.world import TerrainSurface, bilinear_at

ROOM_M = 0.5  # extra distance from what is in the way, for control errors
BRAKING_S = 1.5  # to a stop, from any speed
CLIMB_SHARE = 0.5  # of the climb speed that is planned with for what is ahead
_MOST_STATIONS = 1024  # of one leg

_Bounds = tuple[float, float, float, float]
_Rules = tuple[float, float, float, float]  # altitude, nearest to the ground, climb and sink speed


class Hills(NamedTuple):
    """What they cost on ways (K,)."""

    lost_s: F64  # longer than over level ground
    up_m: F64  # climbed in all, from the first place to the last
    down_m: F64


def over_hills(
    ways_xy_enu_m: F64,
    speeds_mps: F64,
    above_m: float,
    altitude_agl_m: float,
    keep_m: float,
    vehicle: VehicleLimits,
    terrain: TerrainSurface,
) -> Hills:
    """Ways (K, N, 2) through N places, flown at speeds (K,) over ground and at ``altitude_agl_m``.

    They begin ``above_m`` over the ground, and end when the vehicle has that altitude again. ``keep_m`` is
    how near the ground may come.
    """
    n, climb_mps, sink_mps = len(ways_xy_enu_m), vehicle.climb_speed_mps, vehicle.descent_speed_mps
    ways, speeds = np.asarray(ways_xy_enu_m, dtype=float), np.asarray(speeds_mps, dtype=float)
    if terrain.is_flat:
        up_m, down_m = max(altitude_agl_m - above_m, 0.0), max(above_m - altitude_agl_m, 0.0)
        upright_s = up_m / climb_mps + down_m / sink_mps
        lasts_s = np.linalg.norm(np.diff(ways, axis=1), axis=2).sum(axis=1) / speeds
        return Hills(np.maximum(upright_s - lasts_s, 0.0), np.full(n, up_m), np.full(n, down_m))
    rules = _rules(altitude_agl_m, keep_m, vehicle)
    return Hills(*_over_hills(terrain.heights_m, terrain.bounds_enu_m, ways, above_m, speeds, rules))


def heights_over(
    along_m: F64,
    ground_m: F64,
    begin_m: float,
    speed_mps: float,
    altitude_agl_m: float,
    keep_m: float,
    vehicle: VehicleLimits,
) -> F64:
    """Heights (K,) over stations of a way with this ground (K,), from a height ``begin_m``, all ENU."""
    return _heights(along_m, ground_m, begin_m, speed_mps, _rules(altitude_agl_m, keep_m, vehicle))


def _rules(altitude_agl_m: float, keep_m: float, vehicle: VehicleLimits) -> _Rules:
    return altitude_agl_m, min(keep_m, altitude_agl_m), vehicle.climb_speed_mps, vehicle.descent_speed_mps


@njit(cache=True)
def _over_hills(
    grid: F64, bounds: _Bounds, ways: F64, above: float, speeds: F64, rules: _Rules
) -> tuple[F64, F64, F64]:
    lost, up, down = np.zeros(len(ways)), np.zeros(len(ways)), np.zeros(len(ways))
    for k in range(len(ways)):
        along, ground = _stations(grid, bounds, ways[k])
        lost[k], up[k], down[k] = _flown(along, ground, above, speeds[k], rules)
    return lost, up, down


@njit(cache=True)
def _stations(grid: F64, bounds: _Bounds, way: F64) -> tuple[F64, F64]:
    """How far stations (S,) lie along a way (N, 2), and how high the ground is there."""
    counts = np.empty(len(way) - 1, dtype=np.int64)
    for leg in range(len(counts)):
        length = math.hypot(way[leg + 1, 0] - way[leg, 0], way[leg + 1, 1] - way[leg, 1])
        counts[leg] = min(max(1, math.ceil(length / STATION_M)), _MOST_STATIONS)
    along, ground = np.zeros(counts.sum() + 1), np.empty(counts.sum() + 1)
    ground[0] = bilinear_at(grid, bounds, way[0, 0], way[0, 1])
    s = 0
    for leg in range(len(counts)):
        east, north = way[leg + 1] - way[leg]
        step = math.hypot(east, north) / counts[leg]
        for i in range(1, counts[leg] + 1):
            s, share = s + 1, i / counts[leg]
            along[s] = along[s - 1] + step
            x, y = way[leg, 0] + share * east, way[leg, 1] + share * north
            ground[s] = bilinear_at(grid, bounds, x, y)
    return along, ground


@njit(cache=True)
def _flown(along: F64, ground: F64, above: float, speed: float, rules: _Rules) -> tuple[float, float, float]:
    """Seconds lost, metres up and metres down over stations (S,)."""
    altitude, _, climb, sink = rules
    before, last = ground[0] + above, len(along) - 1
    lost, up, down = 0.0, 0.0, 0.0
    heights = _heights(along, ground, before, speed, rules)
    for s in range(last + 1):
        lasts = (along[s] - along[s - 1]) / speed if s > 0 else 0.0
        rise = heights[s] - before
        lost += max(rise / climb - lasts, 0.0)  # it climbs no faster: it waited
        up += max(rise, 0.0)
        down += max(-rise, 0.0)
        before = heights[s]
    off = ground[last] + altitude - heights[last]
    lost += off / climb if off > 0.0 else -off / sink
    return lost, up + max(off, 0.0), down + max(-off, 0.0)


@njit(cache=True)
def _heights(along: F64, ground: F64, begin: float, speed: float, rules: _Rules) -> F64:
    altitude, keep, climb, sink = rules
    slope = CLIMB_SHARE * climb / speed
    last = len(along) - 1
    rising = ground.copy()  # the height at which a climb for all that is ahead has begun
    for s in range(last - 1, -1, -1):
        rising[s] = max(ground[s], rising[s + 1] - slope * (along[s + 1] - along[s]))
    heights = np.empty(last + 1)
    height = begin
    near, ahead = 0, 0
    for s in range(last + 1):
        while near < last and along[near + 1] <= along[s] + BRAKING_S * speed:
            near += 1
        while ahead < last and along[ahead] < along[s] + LOOK_AHEAD_S * speed:
            ahead += 1
        least = ground[s : near + 1].max() + keep
        wanted = max(ground[s], ground[ahead]) + altitude
        if max(least, rising[near] + keep) > wanted:
            wanted = max(least, rising[near] + keep) + ROOM_M
        lasts = (along[s] - along[s - 1]) / speed if s > 0 else 0.0
        height = max(min(max(wanted, height - sink * lasts), height + climb * lasts), least)
        heights[s] = height
    return heights
