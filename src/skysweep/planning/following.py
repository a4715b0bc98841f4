"""How high and how fast a vehicle flies along transects over hilly ground.

Along a transect it is at least as high above the ground as it scans from, and as high as it takes to see the
cells beside it that would be missed: up a slope a picture is narrower, and ridges hide. It climbs before it
has to and cannot sink faster than it does; where it would therefore fly much higher than it scans from, it
slows down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from skysweep.arrays import F64
from skysweep.planning.sight import GroundCells, View, foot_point, least_heights, nearest_transects
from skysweep.scenarios.model import Scenario, VehicleLimits
from skysweep.types import XY
from skysweep.worlds.world import TerrainSurface, bilinear_at

HIGHER = 1.25  # than it scans from: slower, or another transect, before it flies higher
STATION_M = 5.0  # along a leg
LOOK_AHEAD_S = 2.0  # of terrain, in flight
BESIDE_M = 10.0  # of a transect: farther away, its heights say nothing
_NEAR_M = 50.0  # from here a vehicle on its way to a transect's end flies onto it
_LONG_M = 250.0  # shorter ones over level ground are flown straight to their end
_RATE_SHARE = 0.8  # of the climb and descent speed that is planned with
_SLOWEST = 0.2  # of the scan speed
_SPEEDS = 8  # tried, from the scan speed to the slowest
_BRAKES_MPS2 = 2.0
_EPS_M = 1e-6


@dataclass(frozen=True, slots=True)
class LegProfile:
    """Heights and speeds along a straight leg, at K equally distant stations; linear in between."""

    leg_xy_enu_m: F64  # (2, 2)
    ground_m: F64  # (K,) the highest between the stations before and after, ENU
    height_m: F64  # (K,) ENU
    speed_mps: F64  # (K,)

    @property
    def length_m(self) -> float:
        """From its first station to its last."""
        return math.dist(*self.leg_xy_enu_m)

    @property
    def along_m(self) -> F64:
        """Ways (K,) from the first station."""
        return np.linspace(0.0, self.length_m, len(self.height_m))

    def xy_enu_m(self) -> F64:
        """The stations (K, 2)."""
        share = np.linspace(0.0, 1.0, len(self.height_m))[:, None]
        return np.asarray(self.leg_xy_enu_m[0] + share * (self.leg_xy_enu_m[1] - self.leg_xy_enu_m[0]))

    def lost_s(self, speed_mps: float) -> float:
        """Seconds that it takes longer than at this speed throughout."""
        slowness = 0.5 * (1.0 / self.speed_mps[1:] + 1.0 / self.speed_mps[:-1]) - 1.0 / speed_mps
        return float(slowness.sum() * self.length_m / max(len(slowness), 1))


class Planned(NamedTuple):
    """What a plan has for a place on the way to a waypoint."""

    height_m: float  # ENU
    ahead_height_m: float  # ENU, the highest of the way ahead
    speed_mps: float
    ahead_xy_enu_m: XY | None = None  # a place of the transect ahead, to fly to


class Following:
    """A plan's transects and their profiles, for a vehicle on its way along them.

    The vehicle flies to a place ahead on a transect (pure pursuit): wind and the turn before bow the straight
    way to a far end. Over level ground that is done for transects of ``_LONG_M`` or more.
    """

    def __init__(
        self, transects: Sequence[F64], profiles: Sequence[LegProfile], climb_speed_mps: float
    ) -> None:
        self._climb_mps = _RATE_SHARE * climb_speed_mps
        profile_of = {profile.leg_xy_enu_m.tobytes(): profile for profile in profiles}
        self._starts: dict[XY, LegProfile] = {}
        self._ends: dict[XY, list[tuple[F64, LegProfile | None]]] = {}
        for transect in transects:
            leg = np.ascontiguousarray(transect)
            (x, y), (to_x, to_y) = leg.tolist()
            profile = profile_of.get(leg.tobytes())
            if profile is not None:
                self._starts[x, y] = profile
            if profile is not None or math.dist((x, y), (to_x, to_y)) >= _LONG_M:
                self._ends.setdefault((to_x, to_y), []).append((leg, profile))

    def at(self, here: XY, to: XY, ahead_m: float) -> Planned | None:
        """On the way to a transect's end, or to its start; None elsewhere.

        ``ahead_m`` is the way in ``LOOK_AHEAD_S``. A start's height is climbed to no sooner than it takes:
        valleys may lie in between.
        The speed is that of half of the way ahead, for a vehicle that takes its time to slow down.
        """
        for leg, profile in self._ends.get(to, ()):
            x, y, share = foot_point(leg, *here)
            away_m = math.dist(here, (x, y))
            if away_m > _NEAR_M:
                continue
            if profile is None or away_m > BESIDE_M:
                return Planned(-math.inf, -math.inf, math.inf, _place_at(leg, share, ahead_m))
            stations = np.arange(len(profile.height_m))
            step_m = max(profile.length_m / stations[-1], 1e-9)
            at = np.minimum(share * stations[-1] + np.array([0.0, 0.5, 1.0]) * ahead_m / step_m, stations[-1])
            heights = np.interp(at, stations, profile.height_m)
            between = profile.height_m[math.ceil(at[0]) : math.floor(at[2]) + 1]
            highest_m = between.max(initial=heights.max())
            speed_mps = float(np.interp(at[1], stations, profile.speed_mps))
            ahead = _place_at(leg, share, min(ahead_m, LOOK_AHEAD_S * speed_mps))
            return Planned(float(heights[0]), float(highest_m), speed_mps, ahead)
        begun = self._starts.get(to)
        if begun is None:
            return None
        left_m = max(0.0, math.dist(here, to) - ahead_m)
        climb_m = self._climb_mps * LOOK_AHEAD_S * left_m / max(ahead_m, 1e-9)
        return Planned(-math.inf, float(begun.height_m[0]) - climb_m, math.inf)


def _place_at(leg: F64, share: float, ahead_m: float) -> XY:
    """The place of a leg (2, 2) so far ahead of a share of it; its end at the latest."""
    (x, y), (to_x, to_y) = leg.tolist()
    share += ahead_m / max(math.dist((x, y), (to_x, to_y)), 1e-9)
    return (to_x, to_y) if share >= 1.0 else (x + share * (to_x - x), y + share * (to_y - y))


def profiles_of(
    transects: Sequence[F64],
    heading_deg: float,
    scenario: Scenario,
    altitude_agl_m: float,
    terrain: TerrainSurface,
    to_see: GroundCells | None = None,
) -> tuple[LegProfile, ...]:
    """A profile for each transect (2, 2), from which each of the cells ``to_see`` is seen.

    It stays below ``safety.altitude_max_agl_m``, also where more would be needed.
    """
    vehicle, scan_mps = scenario.vehicle, scenario.search.scan_speed_mps
    grounds = [ground_along(leg, terrain) for leg in transects]
    needs = [ground + altitude_agl_m for ground in grounds]
    if to_see is not None:
        _raise_for_cells(needs, transects, heading_deg, scenario, altitude_agl_m, terrain, to_see)
    profiles = []
    for leg, ground, need in zip(transects, grounds, needs, strict=True):
        highest, allowed = ground + scenario.safety.altitude_max_agl_m, ground + HIGHER * altitude_agl_m
        speed, height = _speeds_and_heights(
            np.minimum(need, highest), np.minimum(allowed, highest), math.dist(*leg), scan_mps, vehicle
        )
        profiles.append(LegProfile(np.asarray(leg), ground, height, speed))
    return tuple(profiles)


def ground_along(leg_xy_enu_m: F64, terrain: TerrainSurface) -> F64:
    """The highest ground (K,) between a station of a leg (2, 2) and its neighbours, exactly."""
    pieces = max(1, math.ceil(math.dist(*leg_xy_enu_m) / STATION_M))
    highest = _highest_between(terrain.heights_m, terrain.bounds_enu_m, leg_xy_enu_m, pieces)
    return np.asarray(np.maximum(np.append(highest, highest[-1]), np.insert(highest, 0, highest[0])))


def _raise_for_cells(
    needs: list[F64],
    transects: Sequence[F64],
    heading_deg: float,
    scenario: Scenario,
    altitude_agl_m: float,
    terrain: TerrainSurface,
    cells: GroundCells,
) -> None:
    """Raise the heights so that every cell is seen from its foot point on the nearest transect."""
    lens, legs = scenario.camera.lens, np.array(transects)
    nearest = nearest_transects(cells, legs, math.hypot(*lens.footprint_m(altitude_agl_m)))
    near = np.flatnonzero(nearest >= 0)
    places, legs = cells.centres_enu_m[near], legs[nearest[near]]
    way = legs[:, 1] - legs[:, 0]
    share = ((places[:, :2] - legs[:, 0]) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-12)
    share = np.clip(share, 0.0, 1.0)
    feet = legs[:, 0] + share[:, None] * way
    least = least_heights(terrain, View.of(lens, heading_deg), places, feet)
    lengths = np.array([len(need) for need in needs])
    begins = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    at = begins[nearest[near]] + share * (lengths[nearest[near]] - 1)
    raised = np.concatenate(needs)
    np.maximum.at(raised, np.floor(at).astype(int), least)
    np.maximum.at(raised, np.ceil(at).astype(int), least)
    needs[:] = np.split(raised, begins[1:])


def _speeds_and_heights(
    need_m: F64, allowed_m: F64, length_m: float, scan_mps: float, vehicle: VehicleLimits
) -> tuple[F64, F64]:
    """Speeds (K,) and heights (K,): fast where that does not take it above what is allowed."""
    step_m = length_m / max(len(need_m) - 1, 1)
    rates = _RATE_SHARE * vehicle.climb_speed_mps, _RATE_SHARE * vehicle.descent_speed_mps
    speeds = np.full(len(need_m), scan_mps)
    ladder = scan_mps * np.geomspace(1.0, _SLOWEST, _SPEEDS)
    slowest = _envelope(need_m, np.full(len(need_m), ladder[-1]), step_m, *rates)
    limit_m = np.maximum(allowed_m, slowest) + _EPS_M
    for slower in ladder[1:]:
        too_high = _envelope(need_m, speeds, step_m, *rates) > limit_m
        if not too_high.any():
            break
        speeds[too_high] = slower
    for direction in (1, -1):
        _brake(speeds[::direction], step_m)
    return speeds, _envelope(need_m, speeds, step_m, *rates)


@njit(cache=True)
def _envelope(need: F64, speeds: F64, step: float, climb: float, sink: float) -> F64:
    """The lowest heights (K,) above ``need`` that climb and sink no faster."""
    height = need.copy()
    for k in range(len(need) - 2, -1, -1):
        height[k] = max(height[k], height[k + 1] - climb * step / max(speeds[k], speeds[k + 1]))
    for k in range(1, len(need)):
        height[k] = max(height[k], height[k - 1] - sink * step / max(speeds[k], speeds[k - 1]))
    return height


@njit(cache=True)
def _brake(speeds: F64, step: float) -> None:
    """Slow down before slow places."""
    for k in range(len(speeds) - 2, -1, -1):
        speeds[k] = min(speeds[k], math.sqrt(speeds[k + 1] ** 2 + 2.0 * _BRAKES_MPS2 * step))


@njit(cache=True)
def _highest_between(heights: F64, bounds: tuple[float, float, float, float], leg: F64, pieces: int) -> F64:
    """The highest ground (pieces,) of each piece of a leg (2, 2).

    Within a cell of the grid the ground along a line is a parabola, known from three of its points.
    """
    west, south, east, north = bounds
    rows, columns = heights.shape
    highest = np.full(pieces, -np.inf)
    c0 = (leg[0, 0] - west) / (east - west) * (columns - 1)
    r0 = (leg[0, 1] - south) / (north - south) * (rows - 1)
    dc = (leg[1, 0] - leg[0, 0]) / (east - west) * (columns - 1)
    dr = (leg[1, 1] - leg[0, 1]) / (north - south) * (rows - 1)
    share, piece = 0.0, 0
    while piece < pieces:
        end = (piece + 1) / pieces
        if abs(dc) > 1e-12:
            at = c0 + share * dc
            line = math.floor(at + 1e-9) + 1.0 if dc > 0.0 else math.ceil(at - 1e-9) - 1.0
            end = min(end, (line - c0) / dc)
        if abs(dr) > 1e-12:
            at = r0 + share * dr
            line = math.floor(at + 1e-9) + 1.0 if dr > 0.0 else math.ceil(at - 1e-9) - 1.0
            end = min(end, (line - r0) / dr)
        f0, fm, f1 = (0.0, 0.0, 0.0)
        for k in range(3):
            s = share + 0.5 * k * (end - share)
            x, y = leg[0, 0] + s * (leg[1, 0] - leg[0, 0]), leg[0, 1] + s * (leg[1, 1] - leg[0, 1])
            ground = bilinear_at(heights, bounds, x, y)
            if k == 0:
                f0 = ground
            elif k == 1:
                fm = ground
            else:
                f1 = ground
        top = max(f0, f1)
        bend = 2.0 * (f0 + f1) - 4.0 * fm  # of f0 + (f1 - f0 - bend) s + bend s^2
        if bend < 0.0:
            s = (bend - f1 + f0) / (2.0 * bend)
            if 0.0 < s < 1.0:
                top = max(top, f0 + (f1 - f0 - bend) * s + bend * s * s)
        highest[piece] = max(highest[piece], top)
        share = end
        if share >= (piece + 1) / pieces - 1e-12:
            piece += 1
    return highest
