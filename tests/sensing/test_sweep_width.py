"""The sweep width that the calibrated sensor says, and the one that passes of it have."""

import numpy as np
import pytest

import skysweep as ss
from skysweep.errors import UserError
from skysweep.flights.advise import _hardest_kinds
from skysweep.scenarios.files import change_scenario
from skysweep.sensing.statistical.sweep_width import sweep_width_from, sweep_width_m


def strip(altitude_m, name="person", targets=0, **fields):
    """One transect over a strip as wide as the picture, with targets 20 m apart at any distance from it."""
    half_m = altitude_m * np.tan(0.7) - 0.01
    rng = np.random.default_rng(3)
    return ss.Scenario.model_validate(
        {
            "name": "strip",
            "area": {"polygon_enu_m": [[0, -half_m], [900, -half_m], [900, half_m], [0, half_m]]},
            "home": {"position_enu_m": [-5, 0]},
            "search": {
                "strategy": "scan-only",
                "scan_altitude_agl_m": altitude_m,
                "sidelap": 0,
                "transect_heading_deg": 90.0,
            },
            "camera": {"hfov_rad": 1.4},
            "targets": [
                {
                    "class": name,
                    "position_enu_m": [20.0 + 20.0 * i, float(rng.uniform(-half_m, half_m))],
                    "yaw_deg": float(rng.uniform(0, 360)),
                }
                for i in range(targets)
            ],
            **fields,
        }
    )


@pytest.mark.parametrize(("altitude_m", "name"), [(30.0, "person"), (45.0, "person"), (30.0, "stop sign")])
def test_passes_of_the_sensor_find_as_much_as_the_width_says(altitude_m, name):
    scenario = strip(altitude_m, name, targets=43)
    places = np.array([target.position_enu_m for target in scenario.targets])
    found = []
    for seed in range(3):
        run = ss.run(scenario, sensor="statistical", seed=seed)
        scanned_s = run.track.filter(run.track["mode"] == "SCAN")["time_s"].max()
        seen = run.candidates.filter(run.candidates["first_seen_s"] < scanned_s)
        at = np.column_stack([seen["east_m"], seen["north_m"]])
        found.append((np.linalg.norm(places[:, None] - at, axis=2).min(axis=1) < 3.0).mean())
    flown_m = np.mean(found) * scenario.camera.lens.footprint_m(altitude_m)[0]
    assert sweep_width_m(scenario) == pytest.approx(flown_m, rel=0.08)


def test_a_width_is_at_most_the_picture_s_and_falls_where_targets_get_small():
    widths = {h: sweep_width_m(strip(h)) for h in (10.0, 20.0, 85.0)}
    assert all(width <= strip(h).camera.lens.footprint_m(h)[0] + 1e-9 for h, width in widths.items())
    assert widths[10.0] < widths[20.0]
    assert widths[85.0] < 0.5 * strip(85.0).camera.lens.footprint_m(85.0)[0]


def test_a_camera_of_three_times_the_pixels_sweeps_as_wide_from_three_times_the_height():
    """Its pictures show the same, but for the speed over the ground."""
    small = strip(30.0, camera={"width_px": 640, "height_px": 360, "hfov_rad": 1.4})
    large = strip(30.0, camera={"width_px": 1920, "height_px": 1080, "hfov_rad": 1.4})
    ratio = sweep_width_from(large, 90.0) / sweep_width_from(small, 30.0)
    assert ratio == pytest.approx(3.0, rel=0.05)
    assert sweep_width_from(small, 90.0) < 0.8 * sweep_width_from(large, 90.0)


def test_a_camera_of_more_noise_needs_its_own_model():
    with pytest.raises(UserError, match="another detector or camera"):
        sweep_width_m(strip(30.0, camera={"noise_std": 8.0}))


def test_a_target_smaller_than_any_that_was_measured_is_never_found():
    """4 pixels were measured; 0.8 of that is where the sensor reports nothing any more."""
    scenario = strip(30.0)
    pixels = scenario.pixels_on_target(30.0)
    assert sweep_width_from(scenario, 30.0) == sweep_width_m(scenario)
    assert sweep_width_from(scenario, 30.0 * pixels / 3.0) == 0.0
    with pytest.raises(UserError, match="finds nothing; write a lower altitude"):
        sweep_width_m(strip(30.0 * pixels / 3.0))


def test_a_pose_that_was_not_measured_is_swept_as_the_others_of_its_class():
    """It flies so, and the width was that of an empty list."""
    boat = {"class": "boat", "pose": "floating", "position_enu_m": [50, 0]}
    water = strip(40.0, terrain={"surface": "water"})
    floating = change_scenario(water, {"targets": [boat]})
    assert 0.0 < sweep_width_m(floating) <= 2.0 * 40.0 * np.tan(0.7)
    both = change_scenario(water, {"targets": [boat, {"class": "person", "position_enu_m": [80, 0]}]})
    assert {kind.kind for kind, _ in _hardest_kinds(both)} == {"boat", "person"}
