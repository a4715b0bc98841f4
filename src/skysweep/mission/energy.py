"""The energy to fly home from anywhere, directly or via a waypoint.

Times as in ``planning/flight_plan.py``; speed over ground is the air speed less the wind; power grows with
the thrust that drag demands (momentum theory: thrust to the power of 1.5).
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from skysweep.mission.fence import Fence
from skysweep.planning.flight_plan import DRAG_PER_S, GUSTS, LEG_LAG_S, hover_s_over, landing_time_s
from skysweep.planning.relief import over_hills
from skysweep.scenarios.model import Scenario
from skysweep.types import XY, VehicleState, Waypoint
from skysweep.worlds.obstacles import keep_m
from skysweep.worlds.world import TerrainSurface

_G = 9.81
_SLOWEST_MPS = 0.1  # over ground, to get home at all


class ReturnEnergy:
    """Energy in Wh to fly home over the ground and land."""

    def __init__(
        self,
        scenario: Scenario,
        fence: Fence,
        terrain: TerrainSurface,
        return_altitude_agl_m: float,
        look_s: float,
    ) -> None:
        self._vehicle, self._air_speed_max_mps = scenario.vehicle, scenario.safety.air_speed_max_mps
        self._home, self._fence, self._terrain = scenario.home.position_enu_m, fence, terrain
        self._keep_m = keep_m(scenario)
        self._altitude_agl_m = return_altitude_agl_m
        self._landing_s = landing_time_s(return_altitude_agl_m, scenario.vehicle.descent_speed_mps)
        self._look_s = look_s

    def home_wh(self, xy: XY, altitude_agl_m: float, wind_xy_mps: XY) -> float:
        """Climb to the return altitude, way home and landing; inf where the wind allows none.

        In a wind that is stronger than the mean by ``GUSTS``.
        """
        wind_xy_mps = (1.0 + GUSTS) * wind_xy_mps[0], (1.0 + GUSTS) * wind_xy_mps[1]
        climb_s = max(0.0, self._altitude_agl_m - altitude_agl_m) / self._vehicle.climb_speed_mps
        upright_wh = self.power_w(math.hypot(*wind_xy_mps)) * (climb_s + self._landing_s) / 3600.0
        begins_m = max(altitude_agl_m, self._altitude_agl_m)
        speed_mps = self._vehicle.cruise_speed_mps
        return upright_wh + self._way_wh(
            xy, self._home, speed_mps, wind_xy_mps, begins_m, self._altitude_agl_m
        )

    def landing_wh(self, altitude_agl_m: float, wind_xy_mps: XY) -> float:
        """Straight down from here."""
        landing_s = landing_time_s(max(0.0, altitude_agl_m), self._vehicle.descent_speed_mps)
        return self.power_w(math.hypot(*wind_xy_mps)) * landing_s / 3600.0

    def waypoint_wh(self, state: VehicleState, altitude_agl_m: float, waypoint: Waypoint) -> float:
        """To the waypoint, two looks there, and home."""
        x, y, _ = state.position_enu_m.tolist()
        wind = wind_xy(state)
        up_m = waypoint.altitude_agl_m - altitude_agl_m
        speed_mps = self._vehicle.climb_speed_mps if up_m > 0.0 else self._vehicle.descent_speed_mps
        upright_s = abs(up_m) / speed_mps + self._look_s
        above_m = waypoint.altitude_agl_m
        there_wh = self._way_wh((x, y), waypoint.xy_enu_m, waypoint.speed_mps, wind, above_m, above_m)
        there_wh += self.power_w(math.hypot(*wind)) * upright_s / 3600.0
        return there_wh + self.home_wh(waypoint.xy_enu_m, waypoint.altitude_agl_m, wind)

    def _way_wh(
        self, start: XY, end: XY, speed_mps: float, wind: XY, begins_agl_m: float, altitude_agl_m: float
    ) -> float:
        way = [start, *(self._fence.way(start, end) or [end])]
        level_wh = sum(self._leg_wh(a, b, speed_mps, wind) for a, b in pairwise(way))
        hills = over_hills(
            np.array([way]),
            np.array([speed_mps]),
            begins_agl_m,
            altitude_agl_m,
            self._keep_m,
            self._vehicle,
            self._terrain,
        )
        hover_s = hover_s_over(hills, self._vehicle).item()
        return level_wh + self.power_w(math.hypot(*wind)) * hover_s / 3600.0

    def _leg_wh(self, start: XY, end: XY, speed_mps: float, wind: XY) -> float:
        east, north = end[0] - start[0], end[1] - start[1]
        distance = math.hypot(east, north)
        if distance < 1.0:
            return 0.0
        tail = (wind[0] * east + wind[1] * north) / distance
        cross = (wind[1] * east - wind[0] * north) / distance
        left = self._air_speed_max_mps**2 - cross**2
        over_ground = min(speed_mps, tail + math.sqrt(left)) if left > 0.0 else 0.0
        if over_ground < _SLOWEST_MPS:
            return math.inf
        seconds = distance / over_ground + LEG_LAG_S
        return self.power_w(math.hypot(over_ground - tail, cross)) * seconds / 3600.0

    def power_w(self, air_speed_mps: float) -> float:
        """Power of level flight."""
        thrust = math.hypot(1.0, DRAG_PER_S * air_speed_mps / _G)
        return float(self._vehicle.hover_power_w * thrust**1.5)


class Charge:
    """The charge of the battery: what the vehicle reports.

    Without a report: the last one, or a full battery, less the greater of measured and estimated use.
    """

    def __init__(self, energy: ReturnEnergy, battery_wh: float, was_said: bool = False) -> None:
        self._energy, self._battery_wh = energy, battery_wh
        self._share, self._at_s, self._used_wh = 1.0, math.inf, math.inf
        self.was_said = was_said

    def left(self, state: VehicleState) -> float:
        """The share, 0..1. To be asked with the states in order."""
        if not math.isnan(state.battery_remaining):
            self._share, self.was_said = state.battery_remaining, True
        elif state.airborne:
            flown_s = max(0.0, state.time_s - self._at_s)
            east, north = wind_xy(state)
            vx, vy, _ = state.velocity_enu_mps.tolist()
            flying_wh = self._energy.power_w(math.hypot(vx - east, vy - north)) * flown_s / 3600.0
            used_wh = max(flying_wh, state.energy_used_wh - self._used_wh)
            self._share = max(0.0, self._share - used_wh / self._battery_wh)
        self._at_s, self._used_wh = state.time_s, state.energy_used_wh
        return self._share


def wind_xy(state: VehicleState) -> XY:
    """The estimated mean wind over ground; zero if unknown."""
    return known_wind_xy(state) or (0.0, 0.0)


def known_wind_xy(state: VehicleState) -> XY | None:
    """The estimated mean wind over ground; None if unknown."""
    if state.wind_enu_mps is None:
        return None
    east, north, _ = state.wind_enu_mps.tolist()
    return (east, north) if math.isfinite(east + north) else None
