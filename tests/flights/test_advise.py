from __future__ import annotations

import pytest

from skysweep.flights.advise import advise, expected_pod
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.sensing.statistical.model import model_for
from skysweep.sensing.statistical.sweep_width import sweep_width_from


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
    pod = expected_pod(s, kinds_of(s), 30.0, spacing_m)
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
