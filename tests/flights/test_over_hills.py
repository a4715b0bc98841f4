"""A mission over steep hills flies its transects as high and as fast as they were planned."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skysweep.flights.fly import fly_unwritten
from skysweep.flights.rig import Rig
from skysweep.planning.flight_plan import plan_scenario
from skysweep.scenarios.model import Area, CameraModel, Scenario, Terrain, VehicleLimits
from skysweep.worlds.world import build_terrain


@pytest.fixture(scope="module")
def scenario():
    return Scenario(
        name="steep",
        area=Area(polygon_enu_m=[(0, 0), (300, 0), (300, 150), (0, 150)]),
        terrain=Terrain(hills_height_m=60, hills_wavelength_m=250, seed=2),
        vehicle=VehicleLimits(cruise_speed_mps=5, battery_wh=2000),
        camera=CameraModel(hfov_rad=1.2),
    ).with_search(strategy="scan-only", scan_altitude_agl_m=40, scan_speed_mps=8)


@pytest.fixture(scope="module")
def flown(scenario, tmp_path_factory):
    return fly_unwritten(scenario, 0, Rig(sensor="statistical"), tmp_path_factory.mktemp("pictures"))


def test_the_vehicle_keeps_above_its_profile_and_the_clock_of_the_estimate(scenario, flown):
    plan, estimate = plan_scenario(scenario)
    assert min(p.speed_mps.min() for p in plan.profiles) < 4.0
    below_m, places = 0.0, 0
    for line in flown.records:
        if line["kind"] != "state" or line["mode"] != "SCAN":
            continue
        x, y, z = line["p"]
        for p in plan.profiles:
            (x0, y0), (x1, y1) = p.leg_xy_enu_m
            along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / p.length_m
            aside = ((x - x0) * (y1 - y0) - (y - y0) * (x1 - x0)) / p.length_m
            if 10.0 <= along <= p.length_m and abs(aside) < 6.0:
                below_m = max(below_m, np.interp(along, p.along_m, p.height_m) - z)
                places += 1
    assert places > 200
    assert below_m < 1.0
    last_s = max(line["t"] for line in flown.records if line["kind"] == "state" and line["mode"] == "SCAN")
    assert last_s == pytest.approx(estimate.search_time_s, rel=0.08)


def test_it_never_comes_near_the_ground(scenario, flown):
    terrain = build_terrain(scenario)
    above_m = [
        line["p"][2] - terrain.height_at_m(*line["p"][:2])
        for line in flown.records
        if line["kind"] == "state" and line["mode"] == "SCAN"
    ]
    assert min(above_m) > 36.0
    assert math.isfinite(max(above_m))
    assert flown.end_reason == "completed"
