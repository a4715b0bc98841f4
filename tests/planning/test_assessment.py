import math
from datetime import datetime, timezone

import numpy as np
import pytest

from skysweep.planning.assessment import assess
from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.flown_path import flown_path, hidden_from, mast_enu_m
from skysweep.scenarios.model import Area, CameraModel, Home, Light, Safety, Scenario, Terrain, VehicleLimits
from skysweep.worlds.world import build_terrain

FLAT = np.zeros((2, 2))


def scenario(heights_m, **fields):
    s = Scenario(
        name="hills",
        area=Area(polygon_enu_m=[(0, 0), (300, 0), (300, 200), (0, 200)]),
        terrain=Terrain(heightmap_m=np.asarray(heights_m).tolist()),
        camera=CameraModel(width_px=1280, height_px=720, hfov_rad=1.2),
        vehicle=VehicleLimits(cruise_speed_mps=8.0, battery_wh=5000.0),
        **fields,
    )
    return s.with_search(scan_altitude_agl_m=40.0, scan_speed_mps=8.0)


def ridge(height_m):
    """A wall from west to east through the middle of the area."""
    heights = np.zeros((41, 41))
    heights[18:20] = height_m
    return heights


def test_flat_ground_is_all_seen_at_one_height_in_sight_of_home():
    s = scenario(FLAT)
    judged = assess(plan_scenario(s)[0], s)
    record = judged.record()
    assert record["seen_share"] == 1.0
    assert record["height_agl_m"] == {k: 40.0 for k in ("lowest", "median", "highest", "lowest_out_and_home")}
    assert record["radio_share"] == 1.0
    assert record["slowed_s"] == 0.0
    assert list(judged.warnings()) == []
    rows = dict(judged.rows())
    assert rows["height above ground"] == "40 to 40 m"
    assert rows["radio"] == "in sight of an antenna 2 m above home all the way"


def test_what_a_camera_sees_that_looks_ahead_is_not_said_to_be_known():
    s = scenario(FLAT)
    ahead = s.camera.gimbal.model_copy(update={"pitch_deg": -60.0})
    s = s.model_copy(update={"camera": s.camera.model_copy(update={"gimbal": ahead})})
    judged = assess(plan_scenario(s)[0], s)
    assert judged.record()["seen_share"] is None
    assert dict(judged.rows())["seen by the camera"] == "not known: camera.gimbal.pitch_deg is -60"


def test_the_path_keeps_clear_of_the_ground_between_its_stations():
    s = scenario(
        np.random.default_rng(3).uniform(0.0, 60.0, (24, 24)), safety=Safety(altitude_max_agl_m=600.0)
    )
    terrain = build_terrain(s)
    path = flown_path(plan_scenario(s)[0], s, 40.0, terrain)
    fine = np.linspace(0.0, path.along_m[-1], 40_000)
    xy = np.column_stack([np.interp(fine, path.along_m, c) for c in path.xy_enu_m.T])
    above_m = np.interp(fine, path.along_m, path.height_m) - terrain.height_m(xy)
    assert above_m.min() >= path.agl_m.min() - 1e-6
    assert path.agl_m.min() >= s.safety.clearance_m - 1e-9
    assert path.along_m[-1] == pytest.approx(np.linalg.norm(np.diff(path.xy_enu_m, axis=0), axis=1).sum())
    assert path.xy_enu_m[0].tolist() == path.xy_enu_m[-1].tolist() == [0.0, 0.0]


def test_a_ridge_hides_the_vehicle_from_home_and_a_mast_on_it_sees_all():
    s = scenario(ridge(60.0), safety=Safety(altitude_max_agl_m=300.0))
    terrain, plan = build_terrain(s), plan_scenario(s)[0]
    path = flown_path(plan, s, 40.0, terrain)
    hidden = hidden_from(mast_enu_m(s, terrain), path, terrain)
    assert 0.2 < hidden.mean() < 0.8
    assert (path.xy_enu_m[hidden, 1] > 80.0).all()
    for k in np.flatnonzero(hidden)[::40]:
        share = np.linspace(0.0, 1.0, 5000)[:, None]
        eye = np.array([*path.xy_enu_m[k], path.height_m[k]])
        ray = mast_enu_m(s, terrain) + share * (eye - mast_enu_m(s, terrain))
        assert (terrain.height_m(ray[:, :2]) > ray[:, 2]).any()
    (_, y), length_m = path.stretches(hidden)[0]
    assert y > 80.0
    assert length_m > 100.0
    judged = assess(plan, s)
    assert judged.record()["radio_share"] == pytest.approx(1.0 - hidden.mean())
    assert "not for" in dict(judged.rows())["radio"]
    on_the_ridge = scenario(
        ridge(60.0), safety=Safety(altitude_max_agl_m=300.0, radio_mast_enu_m=(150.0, 85.0, 20.0))
    )
    assert assess(plan, on_the_ridge).record()["radio_share"] == 1.0


def test_a_scenario_without_a_mast_has_the_keys_from_before():
    assert "radio_mast_enu_m" not in scenario(FLAT).model_dump()["safety"]
    mast = (10.0, 20.0, 5.0)
    with_mast = scenario(FLAT, safety=Safety(radio_mast_enu_m=mast)).model_dump()
    assert with_mast["safety"]["radio_mast_enu_m"] == mast


def test_a_ceiling_that_leaves_ground_unseen_is_warned_of():
    steep = 1.5 * np.linspace(0, 320, 30)[:, None].repeat(6, axis=1)
    s = scenario(steep, safety=Safety(altitude_max_agl_m=42.0)).with_search(
        sidelap=0.0, transect_heading_deg=90.0
    )
    plan = plan_scenario(s)[0]
    judged = assess(plan, s)
    (warning,) = (w for w in judged.warnings() if w.startswith("safety.altitude_max_agl_m"))
    assert "is in no picture" in warning
    assert judged.record()["seen_share"] < 1.0
    assert judged.record()["unseen"]
    assert "; not " in dict(judged.rows())["seen by the camera"]


def test_ground_that_falls_away_faster_than_the_vehicle_sinks_is_warned_of():
    cliff = np.repeat([[150.0] * 5 + [0.0] * 5], 6, axis=0)
    s = scenario(cliff, safety=Safety(altitude_max_agl_m=60.0)).with_search(transect_heading_deg=90.0)
    warnings = list(assess(plan_scenario(s)[0], s).warnings())
    (steep,) = (w for w in warnings if "the ground falls faster than the vehicle sinks" in w)
    assert steep.startswith("search.scan_speed_mps: ")


def test_where_only_the_way_home_is_too_high_its_speed_is_named():
    cliff = np.repeat([[0.0] * 4 + [100.0] + [0.0] * 19], 6, axis=0)
    s = scenario(
        cliff,
        home=Home(position_enu_m=(-400.0, 50.0)),
        safety=Safety(altitude_max_agl_m=60.0),
    )
    judged = assess(plan_scenario(s)[0], s)
    (steep,) = (w for w in judged.warnings() if "the ground falls faster" in w)
    assert steep.startswith("vehicle.cruise_speed_mps: ")


def test_the_sun_is_the_scenarios_or_that_of_the_moment():
    s = scenario(FLAT, light=Light(sun_elevation_deg=10.0))
    plan = plan_scenario(s)[0]
    (warning,) = assess(plan, s).warnings()
    assert "shadows are 5.7 times as long" in warning
    noon = assess(plan, s, datetime(2026, 6, 21, 10, 30, tzinfo=timezone.utc))
    assert noon.record()["sun"]["elevation_deg"] == pytest.approx(52.9, abs=0.3)
    assert list(noon.warnings()) == []
    night = assess(plan, s, datetime(2026, 12, 21, 22, 0, tzinfo=timezone.utc))
    assert math.isinf(night.sun.shadow_ratio)
    assert any("below the horizon" in w for w in night.warnings())
