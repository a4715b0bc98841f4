"""How long a mission will still take."""

from __future__ import annotations

import math
import time

import numpy as np

from skysweep.arrays import F64
from skysweep.mission.believable import has_place
from skysweep.mission.mission import Mission
from skysweep.planning.flight_plan import TAKE_OFF_LAG_S, landing_time_s, leg_time_s, plan_scenario
from skysweep.types import Mode, VehicleState

_PLANNED = (Mode.TAKEOFF, Mode.SCAN)
_BETWEEN = (Mode.RETURN, Mode.LAND, Mode.SWAP, Mode.TRANSIT)
_PERIOD_S = 0.5  # on the wall, between two estimates
_NEWEST = 0.3  # weight of the newest speed


class Outlook:
    """Estimates the time left from the plan and from how fast the mission runs.

    ``left_s`` is on the wall, until landing; None while it is unknown. What is left of the plan is what was
    not yet spent in take-off and SCAN, and between the planned sorties: every CHECK moves the end. ``sortie``
    counts the flights, each with one of ``batteries``.
    """

    def __init__(self) -> None:
        self.left_s: float | None = None
        self.sortie = self.batteries = 1
        self._mission: Mission | None = None
        self._search_left_s = self._landing_s = 0.0
        self._between_left_s = 0.0  # the planned sorties
        self._mode = Mode.TAKEOFF
        self._rate: float | None = None  # mission time over wall time
        self._time_s: float | None = None  # of the mission, at the newest tick
        self._estimated_s: tuple[float, float] | None = None  # of the mission and on the wall

    def prepare(self, mission: Mission) -> None:
        """Take note of the plan, before take-off."""
        path, limits = mission.waypoints_xy_enu_m, mission.scenario.vehicle
        home = mission.scenario.home.position_enu_m
        legs_m = np.linalg.norm(np.diff(path, axis=0, prepend=[home]), axis=1)
        climb_s = TAKE_OFF_LAG_S + mission.cover_altitude_agl_m / limits.climb_speed_mps
        scan_s = leg_time_s(legs_m, mission.scenario.search.scan_speed_mps).sum()
        self._search_left_s = climb_s + float(scan_s)
        self._landing_s = _landing_s(mission, path[-1], mission.return_altitude_agl_m)
        self._mission, self.batteries = mission, limits.batteries
        if limits.batteries > 1:
            estimate = plan_scenario(mission.scenario, mission.cover_altitude_agl_m)[1]
            self._between_left_s = max(0.0, estimate.search_time_s - self._search_left_s)

    def look(self, state: VehicleState, mode: Mode) -> None:
        """Take note of a tick."""
        self.sortie += self._mode is Mode.SWAP and mode is not Mode.SWAP
        if self._time_s is not None and (mode in _BETWEEN or (mode is Mode.TAKEOFF and self.sortie > 1)):
            self._between_left_s = max(0.0, self._between_left_s - (state.time_s - self._time_s))
        elif self._time_s is not None and mode in _PLANNED:
            self._search_left_s = max(0.0, self._search_left_s - (state.time_s - self._time_s))
        self._time_s, self._mode = state.time_s, mode
        now_s = time.monotonic()
        if self._estimated_s is None:
            self._estimated_s = state.time_s, now_s
        before_s, estimated_s = self._estimated_s
        if self._mission is None or now_s < estimated_s + _PERIOD_S:
            return
        rate = (state.time_s - before_s) / (now_s - estimated_s)
        self._rate = rate if self._rate is None else _NEWEST * rate + (1.0 - _NEWEST) * self._rate
        self._estimated_s = state.time_s, now_s
        left_s = self._mission_left_s(self._mission, state, mode)
        self.left_s = left_s / self._rate if self._rate > 0.0 and math.isfinite(left_s) else None

    def _mission_left_s(self, mission: Mission, state: VehicleState, mode: Mode) -> float:
        if not has_place(state):
            return math.nan
        comes_back = self._search_left_s > 0.0 and self.sortie < self.batteries
        if mode in (Mode.RETURN, Mode.LAND) and not comes_back:
            return _landing_s(mission, state.position_enu_m[:2], state.position_enu_m[2])
        return self._search_left_s + self._between_left_s + self._landing_s


def _landing_s(mission: Mission, xy_enu_m: F64, altitude_m: float) -> float:
    """From a place (2,) at a height to touchdown at home."""
    limits = mission.scenario.vehicle
    home_m = np.linalg.norm(xy_enu_m - np.asarray(mission.scenario.home.position_enu_m))
    back_s = float(leg_time_s(home_m, limits.cruise_speed_mps))
    return back_s + landing_time_s(max(0.0, float(altitude_m)), limits.descent_speed_mps)
