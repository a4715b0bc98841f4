import math

import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.planning.flight_plan import (
    ACCEPTANCE_M,
    estimate_flight,
    landing_time_s,
    leg_time_s,
    plan_scenario,
)
from skysweep.planning.qgc import plan_for_qgc, write_plan
from skysweep.scenarios.model import Area, CameraModel, Home, Scenario, VehicleLimits, Wind
from skysweep.strategies.scan_check import SCAN_ACCEPTANCE_M
from skysweep.types import Setpoint
from skysweep.vehicles.embedded.multirotor import Multirotor

AREA = [(0, 0), (160, 0), (160, 60), (60, 60), (60, 120), (0, 120)]


def scenario(**changes):
    fields = {
        "area": Area(polygon_enu_m=AREA),
        "camera": CameraModel(hfov_rad=0.7),
        "wind": Wind(mean_speed_mps=0, gust_std_mps=0),
    }
    return Scenario(name="test", **{**fields, **changes})


@pytest.mark.parametrize(
    ("distance_m", "speed_mps", "logged_s"),
    [
        (60, 5, [13.96, 14.76, 14.72, 14.16]),
        (50, 5, [12.28]),
        (60, 1, [62.8, 65.1, 61.4, 63.2]),
        (15, 1, [18.1, 14.0, 12.7]),
    ],
)
def test_legs_take_as_long_as_px4_logged(distance_m, speed_mps, logged_s):
    """PX4 v1.17 SIH, steps: until within 2 m of the end (15 m legs at 5 m/s: 4.9, 4.2, 4.4 s)."""
    assert leg_time_s(distance_m, speed_mps) == pytest.approx(np.mean(logged_s), rel=0.1)
    assert leg_time_s(15, 5) == pytest.approx(np.mean([4.88, 4.2, 4.36]), abs=0.6)


def test_a_lawn_mower_takes_as_long_as_px4_logged():
    logged_s = 13.96 + 14.76 + 14.72 + 14.16 + 4.88 + 4.2 + 4.36
    assert 4 * leg_time_s(60, 5) + 3 * leg_time_s(15, 5) == pytest.approx(logged_s, rel=0.03)


def test_a_leg_within_acceptance_takes_no_time_and_longer_ones_take_longer():
    times = leg_time_s(np.linspace(0, 100, 400), 5.0)
    assert times[0] == 0.0
    assert (np.diff(times) >= 0).all()
    assert ACCEPTANCE_M == SCAN_ACCEPTANCE_M


def test_landing_slows_down_near_the_ground():
    """PX4 v1.17 SIH: from 20.1 m to 0.3 m in 23.1 s."""
    assert landing_time_s(20.1, 1.5) - landing_time_s(0.3, 1.5) == pytest.approx(23.1, rel=0.25)
    assert landing_time_s(30, 1.5) - landing_time_s(20, 1.5) == pytest.approx(10 / 1.5, rel=0.01)


@pytest.mark.parametrize("scan_speed_mps", [2.0, 5.0])
def test_the_estimate_agrees_with_the_embedded_vehicle(scan_speed_mps):
    s = scenario().with_search(scan_speed_mps=scan_speed_mps)
    plan, estimate = plan_scenario(s)
    vehicle = Multirotor(s.vehicle, s.wind, s.camera, np.zeros(3), lambda x, y: 0.0, 0)
    height = s.search.scan_altitude_agl_m
    vehicle.takeoff(height)
    while vehicle.state().position_enu_m[2] < height - 0.8:
        vehicle.advance(0.1)

    def go(xy, speed_mps):
        while math.dist(vehicle.state().position_enu_m[:2], xy) > ACCEPTANCE_M:
            vehicle.command(Setpoint(np.array([*xy, height]), speed_mps, 0.0))
            vehicle.advance(0.1)

    for xy in plan.waypoints_xy_enu_m:
        go(xy, scan_speed_mps)
    assert estimate.search_time_s == pytest.approx(vehicle.state().time_s, rel=0.08)
    go((0.0, 0.0), s.vehicle.cruise_speed_mps)
    vehicle.land()
    while vehicle.state().airborne:
        vehicle.advance(0.1)
    assert estimate.time_s == pytest.approx(vehicle.state().time_s, rel=0.08)
    assert estimate.energy_wh == pytest.approx(vehicle.state().energy_used_wh, rel=0.12)


def test_the_figures_are_those_of_plan_and_camera():
    s = scenario()
    plan, estimate = plan_scenario(s)
    assert estimate.path_length_m == plan.length_m
    assert estimate.n_transects == len(plan.transects)
    assert estimate.area_m2 == pytest.approx(160 * 60 + 60 * 60)
    assert estimate.gsd_cm == pytest.approx(100 * 30 * 2 * math.tan(0.35) / 640)
    assert estimate.pixels_on_target == pytest.approx(75.0 / estimate.gsd_cm)
    assert estimate.batteries == 1
    assert plan.waypoints_xy_enu_m[0] == pytest.approx([0, 0], abs=12)


def test_a_small_battery_means_more_flights_and_more_time():
    s = scenario()
    plan, one = plan_scenario(s)
    small = s.model_copy(update={"vehicle": VehicleLimits(battery_wh=14)})
    estimate = estimate_flight(plan, small)
    assert 2 <= estimate.batteries <= 4
    swaps_s = (estimate.batteries - 1) * small.vehicle.swap_s
    assert one.time_s + 60 + swaps_s < estimate.time_s < 2 * one.time_s + swaps_s
    assert estimate.energy_wh <= estimate.batteries * 14 * (1 - small.safety.landing_reserve) + 1e-6


def test_a_battery_that_cannot_reach_the_area_is_told_with_what_would():
    s = scenario(home=Home(position_enu_m=(-4000, 0)))
    with pytest.raises(UserError, match=r"vehicle\.battery_wh: 98 Wh .*write at least (\d+)") as refusal:
        plan_scenario(s)
    needed = float(str(refusal.value).split("at least ")[1].split(",")[0])
    enough = s.model_copy(update={"vehicle": VehicleLimits(battery_wh=needed + 5)})
    assert plan_scenario(enough)[1].batteries >= 1


def test_heading_and_altitude_are_honoured():
    s = scenario().with_search(transect_heading_deg=30.0)
    plan, _ = plan_scenario(s)
    assert plan.heading_deg == 30.0
    low, estimate = plan_scenario(s, 6.0)
    assert low.swath_m == pytest.approx(plan.swath_m / 5)
    assert estimate.gsd_cm == pytest.approx(100 * 6 * 2 * math.tan(0.35) / 640)


def test_a_drawn_plan_is_flown_as_drawn(tmp_path):
    s = scenario()
    planned, _ = plan_scenario(s.with_search(transect_heading_deg=30.0))
    file = write_plan(tmp_path / "a.plan", plan_for_qgc(s, planned))
    drawn, _ = plan_scenario(s.with_search(plan=str(file)))
    assert drawn.waypoints_xy_enu_m == pytest.approx(planned.waypoints_xy_enu_m, abs=1e-4)
    assert drawn.heading_deg == pytest.approx(30.0, abs=0.01)
    low, _ = plan_scenario(s.with_search(plan=str(file)), 10.0)
    assert len(low.transects) > len(drawn.transects)


def test_a_plan_drawn_at_another_altitude_is_refused(tmp_path):
    s = scenario()
    file = write_plan(tmp_path / "a.plan", plan_for_qgc(s, plan_scenario(s)[0], 50.0))
    with pytest.raises(UserError, match=r"a\.plan: flies at 50 m above home .*scan_altitude_agl_m: 50"):
        plan_scenario(s.with_search(plan=str(file)))


def test_a_path_that_leaves_the_fence_is_refused():
    area = Area(polygon_enu_m=[(0, 0), (100, 0), (100, 8), (0, 60)])
    tight = [(0, 0), (100, 0), (100, 8), (0, 60)]
    s = scenario(area=area, geofence_enu_m=tight).with_search(transect_heading_deg=90.0)
    with pytest.raises(UserError, match=r"geofence_enu_m: .*widen the fence"):
        plan_scenario(s)
