from __future__ import annotations

import pytest

from skysweep.errors import UserError
from skysweep.flights.advise import advise, expected_pod
from skysweep.flights.fly import fly_unwritten
from skysweep.flights.rig import Rig
from skysweep.results.pod import coverage_of
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.statistical.model import model_for
from skysweep.sensing.statistical.sweep_width import sweep_width_from, sweep_width_m
from skysweep.worlds.world import surfaces_of


def wilderness(**changes):
    return change_scenario(load_scenario("person-wilderness"), changes)


def kinds_of(scenario):
    return [
        (kind, scenario.target_sizes_m["person"][0])
        for kind in model_for(scenario).kinds
        if kind.kind == kind.reported_as == "person" and kind.pose in scenario.target_poses["person"]
    ]


@pytest.fixture(scope="module")
def advice():
    return advise(wilderness(), 0.8)


def test_the_best_is_the_shortest_flight_that_finds_enough(advice):
    assert advice.best in advice.options
    assert advice.best.pod >= 0.8
    assert "80%" in advice.why
    for option in advice.options:
        assert option.time_s is None or option.pod < 0.8 or option.time_s >= advice.best.time_s


def test_lower_finds_more_and_takes_longer(advice):
    at_speed = [o for o in advice.options if o.speed_mps == 5.0]
    high, low = at_speed[0], at_speed[-1]
    assert high.altitude_agl_m > low.altitude_agl_m
    assert low.pod > high.pod
    assert low.pixels_on_target > high.pixels_on_target
    assert low.time_s > high.time_s


def test_the_scenarios_own_altitude_and_speed_are_among_the_options(advice):
    assert any((o.altitude_agl_m, o.speed_mps) == (25.0, 5.0) for o in advice.options)


def test_the_expected_pod_of_wide_spacing_is_the_sweep_width_over_it():
    """Far apart, passes add up to Koopman's sweep width."""
    s = wilderness()
    spacing_m = 3.0 * s.camera.lens.footprint_m(30.0)[0]
    pod = expected_pod(s, kinds_of(s), surfaces_of(s), 30.0, spacing_m)
    assert pod == pytest.approx(sweep_width_from(s, 30.0) / spacing_m, rel=0.06)


def test_no_flight_on_a_tiny_battery():
    s = wilderness(**{"vehicle.battery_wh": 1.5})
    advice = advise(s, 0.8)
    assert advice.best is None
    assert "battery_wh" in advice.why


def test_an_uncalibrated_detector_is_judged_by_its_pixels():
    advice = advise(wilderness(**{"detector.model": "other.onnx"}), 0.8)
    assert advice.uncalibrated
    assert advice.best.pod is None
    assert advice.best.pixels_on_target >= 12.0
    assert "12 pixels" in advice.why


def field(**changes):
    """500 x 400 m of level ground with somebody who lies there, seen from 82 m."""
    lying = {"class": "person", "pattern": "uniform", "count": 1, "poses": ["lying"]}
    scenario = Scenario.model_validate(
        {
            "name": "field",
            "area": {"polygon_enu_m": [[0, 0], [500, 0], [500, 400], [0, 400]]},
            "camera": {"hfov_rad": 1.2},
            "generators": [lying],
            "search": {"strategy": "scan-only", "scan_altitude_agl_m": 82, "sidelap": 0.1},
        }
    )
    return change_scenario(scenario, changes)


def best_of(scenario):
    best = advise(scenario, 0.8).best
    assert best is not None
    return best


def test_the_ground_counts_as_in_the_map_of_what_was_searched(tmp_path):
    """The POD map of a flight is the sensor's as well, and draws no luck."""
    for surface in ("grass", "rock"):
        scenario = field(**{"terrain.surface": surface})
        flown = coverage_of(fly_unwritten(scenario, 0, Rig("statistical", threads=1), tmp_path))
        spacing_m = 0.9 * scenario.camera.lens.footprint_m(82.0)[0]
        expected = expected_pod(scenario, kinds_of(scenario), surfaces_of(scenario), 82.0, spacing_m)
        assert expected == pytest.approx(flown.pod()[flown.inside].mean(), abs=0.06)
    assert sweep_width_m(field(**{"terrain.surface": "rock"})) < 0.8 * sweep_width_m(field())


def test_what_no_mission_may_fly_is_no_option():
    narrow = {
        "safety.fence_tolerance_m": 0,
        "safety.altitude_max_agl_m": 60,
        "search.scan_altitude_agl_m": 40,
    }
    long_lens = {"safety.altitude_max_agl_m": 600, "camera.width_px": 3840, "camera.hfov_rad": 0.6}
    for changes in (narrow, long_lens):
        advice = advise(field(**changes), 0.8)
        assert any("search.scan_altitude_agl_m: is" in o.why_not for o in advice.options)
        assert advice.best is not None
    slow = advise(field(**{"vehicle.cruise_speed_mps": 0.1}), 0.8)
    assert {o.speed_mps for o in slow.options} == {0.1}
    small = [{"class": "stop sign", "pattern": "uniform", "count": 1, "size_m": 0.3}]
    slowly = {"search.scan_speed_mps": 3.0, "search.scan_altitude_agl_m": 20, "vehicle.cruise_speed_mps": 9.0}
    advice = advise(field(**{"camera.exposure_s": 0.05, "generators": small}, **slowly), 0.8)
    assert any("camera.exposure_s" in o.why_not for o in advice.options)
    assert advice.best is not None


def test_the_best_is_one_that_the_batteries_last_for():
    changes = ({"vehicle.battery_wh": 45.0, "vehicle.batteries": n} for n in (1, 9))
    flights = [advise(field(**changed), 0.7).best for changed in changes]
    assert flights[0].batteries == 1
    assert flights[0].time_s <= flights[1].time_s


def test_a_tilted_camera_is_judged_by_its_pixels():
    advice = advise(field(**{"camera.gimbal.pitch_deg": -45}), 0.8)
    assert "camera.gimbal.pitch_deg: is -45" in advice.uncalibrated
    assert advice.best.pod is None
    with pytest.raises(UserError, match=r"camera.gimbal.pitch_deg: is -45; the sweep width"):
        sweep_width_m(field(**{"camera.gimbal.pitch_deg": -45}))


def test_a_strategy_with_a_height_of_its_own_is_refused():
    with pytest.raises(UserError, match=r"low-only covers the area from .* write scan-only"):
        advise(field(**{"search.strategy": "low-only"}), 0.8)
