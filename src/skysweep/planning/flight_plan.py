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
from skysweep.planning.relief import Hills, over_hills
from skysweep.scenarios.model import Scenario, VehicleLimits
from skysweep.worlds.obstacles import keep_m
from skysweep.worlds.world import build_terrain

ACCEPTANCE_M = 2.0  # PX4 NAV_ACC_RAD: a waypoint counts as reached
POSITION_GAIN = 0.95  # PX4 MPC_XY_P, 1/s
LEG_LAG_S = 2.0  # to turn and get up to speed
TAKE_OFF_LAG_S = 10.0  # arming, spool-up, PX4's gentle start and arrival
LAND_SPEED_MPS, LAND_SLOW_BELOW_M, LAND_SLOW_FROM_M = 0.7, 5.0, 10.0  # PX4 MPC_LAND_SPEED, _ALT2, _ALT1
DRAG_PER_S = 1.0  # deceleration by drag in m/s2 for each m/s of air speed (PX4 SIH_KDV, 1 kg)
GUSTS = 0.05  # of the mean wind, that it is stronger on the way home than it was told to be
CHARGED = 0.8  # share of a battery from which it is good for one of several sorties
_G = 9.81
_SLOWEST_MPS = 1.0  # over ground
_BREAK_EVERY_M = 20.0  # where a flight may be broken off for another battery
_ALTITUDE_SLACK_M = 1.0


@dataclass(frozen=True, slots=True)
class FlightEstimate:
    """Times run from the take-off command to touchdown, with the swaps of batteries between sorties."""

    path_length_m: float  # of the plan, first waypoint to last
    search_time_s: float  # take-off to the end of the plan: the shortest possible mission time
    time_s: float  # with return and landing
    energy_wh: float  # of all batteries
    batteries: int  # one a sortie
    gsd_cm: float
    pixels_on_target: float  # of the smallest target
    area_m2: float
    n_transects: int
    shares_flown: tuple[float, ...]  # of the plan's time, after each sortie


def plan_scenario(
    scenario: Scenario, altitude_agl_m: float | None = None
) -> tuple[CoveragePlan, FlightEstimate]:
    """F of Algorithm 1 and what flying it costs.

    ``altitude_agl_m`` is the scan altitude unless a strategy covers the area from another one. At the scan
    altitude ``search.plan``, where given, is flown as drawn; else transects are planned over the area at
    ``search.transect_heading_deg`` or the best angle. Over hilly ground they have profiles of height and
    speed. Raises UserError where no flight is possible.
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

    Sorties are those of a mission: each turns home when the rules of ``safety`` (``landing_reserve``,
    ``battery_low``) say so, and after ``vehicle.swap_s`` on the ground the next one goes on there. Checks are
    not counted. Raises UserError when a full battery does not last to the farthest place and back.
    """
    altitude = scenario.search.scan_altitude_agl_m if altitude_agl_m is None else altitude_agl_m
    vehicle, lens = scenario.vehicle, scenario.camera.lens
    stops, path = _path(plan, scenario)
    home = np.broadcast_to(np.array(scenario.home.position_enu_m, dtype=float), stops.shape)
    hover_w = float(_power_w(scenario, scenario.wind.mean_speed_mps))
    climb = Spent.at(altitude / vehicle.climb_speed_mps + TAKE_OFF_LAG_S, hover_w)
    landing = Spent.at(landing_time_s(altitude, vehicle.descent_speed_mps), hover_w)
    terrain = build_terrain(scenario)

    def of_hills(starts: F64, ends: F64, speed_mps: float) -> Spent:
        ways, speeds = np.stack([starts, ends], axis=1), np.full(len(starts), speed_mps)
        hills = over_hills(ways, speeds, altitude, altitude, keep_m(scenario), vehicle, terrain)
        return Spent(hills.lost_s, hover_s_over(hills, vehicle) * hover_w / 3600.0)

    scan_mps, cruise_mps = scenario.search.scan_speed_mps, vehicle.cruise_speed_mps
    out = _legs(home, stops, scan_mps, scenario) + climb
    again = _legs(home, stops, cruise_mps, scenario) + climb
    down = landing + of_hills(stops, home, cruise_mps)
    back = _legs(stops, home, cruise_mps, scenario) + down
    kept = _legs(stops, home, cruise_mps, scenario, GUSTS) + down

    ends: list[int] = []  # of the sorties, among the stops
    spent = Spent(np.zeros(()), np.zeros(()))
    at = 0
    while True:
        there, there_mps = (again, cruise_mps) if ends else (out, scan_mps)
        there = there[at] + of_hills(home[:1], stops[at : at + 1], there_mps)[0]
        most = int(np.searchsorted(path.energy_wh, path.energy_wh[at] + vehicle.battery_wh)) + 1
        reach = slice(at, max(at + 2, most))
        search = path[reach] + Spent(there.time_s - path.time_s[at], there.energy_wh - path.energy_wh[at])
        needed_wh = _battery_for(search.energy_wh, kept.energy_wh[reach], scenario)
        is_last = reach.stop >= len(stops) and bool((needed_wh <= vehicle.battery_wh).all())
        reached = at + (len(needed_wh) if is_last else int(np.argmax(needed_wh > vehicle.battery_wh))) - 1
        if reached <= at and not is_last:
            away_m = float(np.linalg.norm(stops[at] - home[at]))
            raise UserError(
                f"vehicle.battery_wh: {vehicle.battery_wh:g} Wh do not last to a place {away_m:.0f} m "
                f"from home and back; write at least {math.ceil(needed_wh[:2].max())}, or move home nearer"
            )
        ends.append(reached)
        spent += search[reached - at]
        if is_last:
            break
        spent += back[reached] + Spent.at(vehicle.swap_s, 0.0)
        at = reached
    whole = spent + back[-1]
    return FlightEstimate(
        path_length_m=plan.length_m,
        search_time_s=float(spent.time_s),
        time_s=float(whole.time_s),
        energy_wh=float(whole.energy_wh),
        batteries=len(ends),
        gsd_cm=float(100.0 * lens.gsd_m(altitude)),
        pixels_on_target=scenario.pixels_on_target(altitude),
        area_m2=float(scenario.area_enu_m.area),
        n_transects=len(plan.transects),
        shares_flown=tuple(float(path.time_s[end] / max(path.time_s[-1], 1e-9)) for end in ends),
    )


@dataclass(frozen=True, slots=True)
class Spent:
    """Time and energy, of one flight or (K,) of several."""

    time_s: F64
    energy_wh: F64

    @classmethod
    def at(cls, time_s: float, power_w: float) -> Spent:
        """That time at this power."""
        return cls(np.asarray(time_s), np.asarray(time_s * power_w / 3600.0))

    def __add__(self, other: Spent) -> Spent:
        return Spent(self.time_s + other.time_s, self.energy_wh + other.energy_wh)

    def __getitem__(self, key: int | slice) -> Spent:
        return Spent(self.time_s[key], self.energy_wh[key])


def _battery_for(used_wh: F64, back_wh: F64, scenario: Scenario) -> F64:
    """(K,) the smallest battery that lasts to places and back, by the rules that turn a mission home."""
    safety = scenario.safety
    needed_wh = np.maximum(
        (used_wh + back_wh) / (1.0 - safety.landing_reserve), used_wh / (1.0 - safety.battery_low)
    )
    return np.asarray(needed_wh)


def _legs(starts: F64, ends: F64, speed_mps: float, scenario: Scenario, gusts: float = 0.0) -> Spent:
    """Of straight legs (K, 2) to (K, 2), each flown from a stop, in the mean wind, or a share stronger.

    The vehicle keeps ``speed_mps`` over ground where its air speed allows.
    """
    way = ends - starts
    length_m = np.linalg.norm(way, axis=1)
    along = way / np.maximum(length_m, 1e-9)[:, None]
    heading = math.radians(scenario.wind.from_heading_deg)
    mean = -scenario.wind.mean_speed_mps * np.array([math.sin(heading), math.cos(heading)])
    wind = (1.0 + gusts) * mean
    tail, cross = along @ wind, along[:, 0] * wind[1] - along[:, 1] * wind[0]
    left = np.sqrt(np.maximum(scenario.safety.air_speed_max_mps**2 - cross**2, 0.0))
    over_ground = np.minimum(speed_mps, np.maximum(tail + left, _SLOWEST_MPS))
    time_s = leg_time_s(length_m, over_ground)
    power_w = _power_w(scenario, np.hypot(over_ground - tail, cross))
    return Spent(time_s, time_s * power_w / 3600.0)


def leg_time_s(distance_m: ArrayLike, speed_mps: ArrayLike) -> F64:
    """Seconds from the command to go ``distance_m`` (N,) until within ``ACCEPTANCE_M`` of the end."""
    distance, speed_mps = np.asarray(distance_m, dtype=float), np.asarray(speed_mps, dtype=float)
    slowing = np.minimum(speed_mps / POSITION_GAIN, distance)
    cruise = np.maximum(distance - np.maximum(slowing, ACCEPTANCE_M), 0.0) / speed_mps
    approach = np.log(np.maximum(slowing, ACCEPTANCE_M) / ACCEPTANCE_M) / POSITION_GAIN
    return np.where(distance > ACCEPTANCE_M, LEG_LAG_S + cruise + approach, 0.0)


def hover_s_over(hills: Hills, vehicle: VehicleLimits) -> F64:
    """Seconds (K,) of hovering that take the energy of hills: the time lost, and climbs less descents."""
    up = (1.0 + DRAG_PER_S * vehicle.climb_speed_mps / _G) ** 1.5 - 1.0
    down = 1.0 - max(0.0, 1.0 - DRAG_PER_S * vehicle.descent_speed_mps / _G) ** 1.5
    climbs_s = hills.up_m * up / vehicle.climb_speed_mps - hills.down_m * down / vehicle.descent_speed_mps
    return np.asarray(hills.lost_s + np.maximum(climbs_s, 0.0))


def landing_time_s(height_m: float, descent_speed_mps: float) -> float:
    """Seconds to touchdown from ``height_m``: PX4 slows linearly down to its land speed on the way."""
    land = min(LAND_SPEED_MPS, descent_speed_mps)
    heights = height_m * (np.arange(500) + 0.5) / 500
    speeds = np.interp(heights, [LAND_SLOW_BELOW_M, LAND_SLOW_FROM_M], [land, descent_speed_mps])
    return float(np.mean(1.0 / speeds) * height_m)


def _power_w(scenario: Scenario, air_speed_mps: ArrayLike) -> F64:
    """Power of level flight at air speeds (K,)."""
    thrust_to_weight = np.hypot(1.0, DRAG_PER_S * np.asarray(air_speed_mps, dtype=float) / _G)
    return np.asarray(scenario.vehicle.hover_power_w * thrust_to_weight**1.5)


def _path(plan: CoveragePlan, scenario: Scenario) -> tuple[F64, Spent]:
    """Places (K, 2) where the path may be broken off, and what is spent (K,) from the first one to them."""
    waypoints, scan_mps = plan.waypoints_xy_enu_m, scenario.search.scan_speed_mps
    legs = _legs(waypoints[:-1], waypoints[1:], scan_mps, scenario)
    if plan.profiles:
        lost_s = plan.lost_s(scan_mps)
        hover_w = float(_power_w(scenario, scenario.wind.mean_speed_mps))
        legs = Spent(legs.time_s + lost_s, legs.energy_wh + lost_s * hover_w / 3600.0)
    lengths_m = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    pieces = np.maximum(1, np.ceil(lengths_m / _BREAK_EVERY_M).astype(int))
    leg = np.repeat(np.arange(len(pieces)), pieces)
    nth = np.arange(len(leg)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 1
    share = nth / pieces[leg]
    stops = waypoints[leg] + share[:, None] * (waypoints[leg + 1] - waypoints[leg])
    time_s, energy_wh = (
        np.concatenate([[0.0], (np.cumsum(of) - of)[leg] + share * of[leg]])
        for of in (legs.time_s, legs.energy_wh)
    )
    return np.concatenate([waypoints[:1], stops]), Spent(time_s, energy_wh)


def _drawn_plan(scenario: Scenario, path: str) -> CoveragePlan:
    altitude = scenario.search.scan_altitude_agl_m
    try:
        drawn = read_plan(path)
    except UserError as error:
        raise UserError(f"search.plan: {error}") from None
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
