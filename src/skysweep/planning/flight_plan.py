"""What a plan costs: flight time, energy, batteries; and what it shows: GSD, pixels on target.

The time of a leg is that of PX4 stepping from waypoint to waypoint under position control: full speed until
the position controller's proportional gain slows the vehicle down, then an exponential approach until the
waypoint counts as reached. The lags are fitted to logs of PX4 v1.17 SIH: in a lawn-mower at 5 m/s the 60 m
legs take 14.4 s and the 15 m legs 4.5 s until within 2 m (model: 14.0 and 5.0); an automatic take-off is at
19.2 m after 18.2 s (model: 16.4). Power grows with the thrust that drag asks for (momentum theory: thrust to
the power of 1.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.planning.coverage import CoveragePlan, plan_coverage
from skysweep.planning.hills import plan_over_hills, with_profiles
from skysweep.planning.qgc import coverage_from_qgc, read_plan
from skysweep.scenarios.model import Scenario
from skysweep.worlds.world import build_terrain

ACCEPTANCE_M = 2.0  # PX4 NAV_ACC_RAD: a waypoint counts as reached
POSITION_GAIN = 0.95  # PX4 MPC_XY_P, 1/s
LEG_LAG_S = 2.0  # to turn and get up to speed
TAKE_OFF_LAG_S = 10.0  # arming, spool-up, PX4's gentle start and arrival
LAND_SPEED_MPS, LAND_SLOW_BELOW_M, LAND_SLOW_FROM_M = 0.7, 5.0, 10.0  # PX4 MPC_LAND_SPEED, _ALT2, _ALT1
DRAG_PER_S = 1.0  # deceleration by drag in m/s2 for each m/s of air speed (PX4 SIH_KDV, 1 kg)
RESERVE = 0.2  # of a battery that is still there after landing
_BREAK_EVERY_M = 20.0  # where a flight may be broken off for another battery
_ALTITUDE_SLACK_M = 1.0


@dataclass(frozen=True, slots=True)
class FlightEstimate:
    """Times run from the take-off command to touchdown, without the work on the ground between flights."""

    path_length_m: float  # of the plan, first waypoint to last
    search_time_s: float  # take-off to the end of the plan: the shortest possible mission time
    time_s: float  # with return and landing, and with the flights to change batteries
    energy_wh: float
    batteries: int
    gsd_cm: float
    pixels_on_target: float  # of the smallest target
    area_m2: float
    n_transects: int


def plan_scenario(
    scenario: Scenario, altitude_agl_m: float | None = None
) -> tuple[CoveragePlan, FlightEstimate]:
    """F of Algorithm 1 and what flying it costs.

    ``altitude_agl_m`` is the scan altitude unless a strategy covers the area from another one. At the scan
    altitude ``search.plan``, where given, is flown as drawn; else transects are planned over the area at
    ``search.transect_heading_deg`` or the best angle. Raises UserError where no flight is possible.
    """
    search = scenario.search
    altitude = search.scan_altitude_agl_m if altitude_agl_m is None else altitude_agl_m
    terrain = build_terrain(scenario)
    if search.plan is not None and altitude == search.scan_altitude_agl_m:
        plan = _drawn_plan(scenario, search.plan)
        if not terrain.is_flat:
            plan = with_profiles(plan, scenario, altitude, terrain)
    elif not terrain.is_flat:
        plan = plan_over_hills(scenario, altitude, terrain)
    else:
        plan = plan_coverage(
            scenario.area_enu_m,
            scenario.camera.lens,
            altitude,
            search.sidelap,
            search.transect_heading_deg,
            scenario.home.position_enu_m,
        )
    _stay_inside_fence(scenario, plan)
    return plan, estimate_flight(plan, scenario, altitude)


def estimate_flight(
    plan: CoveragePlan, scenario: Scenario, altitude_agl_m: float | None = None
) -> FlightEstimate:
    """Time, energy and batteries of flying ``plan`` at ``altitude_agl_m`` (default: the scan altitude).

    A battery is changed at home, as late as its charge allows less ``RESERVE``; the search goes on where it
    was broken off. Raises UserError when a full battery does not last to the farthest place and back.
    """
    altitude = scenario.search.scan_altitude_agl_m if altitude_agl_m is None else altitude_agl_m
    vehicle, lens = scenario.vehicle, scenario.camera.lens
    home = np.array(scenario.home.position_enu_m, dtype=float)
    up_s = altitude / vehicle.climb_speed_mps + TAKE_OFF_LAG_S
    down_s = landing_time_s(altitude, vehicle.descent_speed_mps)
    power_w = _power_w(scenario)
    endurance_s = 3600.0 * vehicle.battery_wh * (1.0 - RESERVE) / power_w

    stops, times = _timed_path(plan.waypoints_xy_enu_m, scenario.search.scan_speed_mps)
    distances = np.linalg.norm(stops - home, axis=1)
    out_s = up_s + leg_time_s(distances, scenario.search.scan_speed_mps)
    back_s = leg_time_s(distances, vehicle.cruise_speed_mps) + down_s
    flights, at, total_s = 0, 0, 0.0
    while True:
        flights += 1
        farthest = max(at + 2, int(np.searchsorted(times, times[at] + endurance_s)) + 1)
        landed_s = out_s[at] + times[at:farthest] - times[at] + back_s[at:farthest]
        in_reach = np.flatnonzero(landed_s <= endurance_s)
        reached = at + (int(in_reach[-1]) if len(in_reach) else -1)
        if reached == len(stops) - 1:
            break
        if reached <= at:
            needed_wh = vehicle.battery_wh * float(landed_s[:2].max()) / endurance_s
            raise UserError(
                f"vehicle.battery_wh: {vehicle.battery_wh:g} Wh do not last to a place {distances[at]:.0f} m "
                f"from home and back; write at least {math.ceil(needed_wh)}, or move home nearer"
            )
        total_s += float(landed_s[reached - at])
        at = reached
    search_time_s = total_s + float(landed_s[-1] - back_s[-1])
    total_s += float(landed_s[-1])
    return FlightEstimate(
        path_length_m=plan.length_m,
        search_time_s=search_time_s,
        time_s=total_s,
        energy_wh=total_s * power_w / 3600.0,
        batteries=flights,
        gsd_cm=float(100.0 * lens.gsd_m(altitude)),
        pixels_on_target=scenario.pixels_on_target(altitude),
        area_m2=float(scenario.area_enu_m.area),
        n_transects=len(plan.transects),
    )


def leg_time_s(distance_m: ArrayLike, speed_mps: float) -> F64:
    """Seconds from the command to go ``distance_m`` (N,) until within ``ACCEPTANCE_M`` of the end."""
    distance = np.asarray(distance_m, dtype=float)
    slowing = np.minimum(speed_mps / POSITION_GAIN, distance)
    cruise = np.maximum(distance - np.maximum(slowing, ACCEPTANCE_M), 0.0) / speed_mps
    approach = np.log(np.maximum(slowing, ACCEPTANCE_M) / ACCEPTANCE_M) / POSITION_GAIN
    return np.where(distance > ACCEPTANCE_M, LEG_LAG_S + cruise + approach, 0.0)


def landing_time_s(height_m: float, descent_speed_mps: float) -> float:
    """Seconds to touchdown from ``height_m``: PX4 slows linearly down to its land speed on the way."""
    land = min(LAND_SPEED_MPS, descent_speed_mps)
    heights = height_m * (np.arange(500) + 0.5) / 500
    speeds = np.interp(heights, [LAND_SLOW_BELOW_M, LAND_SLOW_FROM_M], [land, descent_speed_mps])
    return float(np.mean(1.0 / speeds) * height_m)


def _power_w(scenario: Scenario) -> float:
    """Power at scan speed in the mean wind, from any side."""
    air_speed_mps = math.hypot(scenario.search.scan_speed_mps, scenario.wind.mean_speed_mps)
    thrust_to_weight = math.hypot(1.0, DRAG_PER_S * air_speed_mps / 9.81)
    return scenario.vehicle.hover_power_w * float(thrust_to_weight**1.5)


def _timed_path(waypoints: F64, speed_mps: float) -> tuple[F64, F64]:
    """Places (K, 2) where the path may be broken off, and the seconds (K,) from the first one."""
    legs = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    durations = leg_time_s(legs, speed_mps)
    pieces = np.maximum(1, np.ceil(legs / _BREAK_EVERY_M).astype(int))
    shares = [np.arange(1, n + 1) / n for n in pieces]
    stops = [waypoints[:1]]
    times = [np.zeros(1)]
    begin = 0.0
    for i, share in enumerate(shares):
        stops.append(waypoints[i] + share[:, None] * (waypoints[i + 1] - waypoints[i]))
        times.append(begin + share * durations[i])
        begin += float(durations[i])
    return np.concatenate(stops), np.concatenate(times)


def _drawn_plan(scenario: Scenario, path: str) -> CoveragePlan:
    altitude = scenario.search.scan_altitude_agl_m
    drawn = read_plan(path)
    sea_level_m = scenario.home.altitude_amsl_m
    for point in drawn.waypoints:
        height = point.altitude_m - (sea_level_m if point.above == "sea level" else 0.0)
        if not math.isclose(height, altitude, rel_tol=0.05, abs_tol=_ALTITUDE_SLACK_M):
            raise UserError(
                f"{path}: flies at {point.altitude_m:g} m above {point.above} where the scenario scans from "
                f"{altitude:g} m; write search.scan_altitude_agl_m: {height:g}, or change the plan"
            )
    try:
        return coverage_from_qgc(drawn, scenario.frame, scenario.camera.lens, altitude)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


def _stay_inside_fence(scenario: Scenario, plan: CoveragePlan) -> None:
    if scenario.geofence_enu_m is None:
        return
    fence = shapely.Polygon(scenario.geofence_enu_m)
    beyond = shapely.distance(fence, shapely.points(plan.waypoints_xy_enu_m)).max()
    if beyond > 0.01:
        raise UserError(
            f"geofence_enu_m: the path leaves the fence by up to {beyond:.1f} m; widen the fence by that "
            "much, or write another search.transect_heading_deg"
        )
