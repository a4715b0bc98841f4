"""What a strategy is told before take-off."""

from dataclasses import fields

import numpy as np
import pytest
from contexts import context_of

from skysweep.errors import UserError
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import Flight
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.strategies import strategy_spec
from skysweep.strategies.context import MissionContext
from skysweep.strategies.spec import NoParameters
from skysweep.worlds.obstacles import known_obstacles

NOT_COMPARED = ("obstacles", "load_sensor_model", "load_sensor_view", "load_occluders", "searched_area")


def told(scenario):
    f = np.array([[0.0, 0.0], [10.0, 0.0]])
    return MissionContext.of(scenario, f, 0.0, known_obstacles(scenario), NoParameters())


def test_it_says_nothing_of_where_targets_are_or_how_many():
    scenario = load_scenario("clusters")
    fewer = [t.model_copy(update={"position_enu_m": (50.0, 50.0)}) for t in scenario.targets[:1]]
    other = scenario.model_copy(update={"targets": fewer, "distractors": []})
    one, two = told(scenario), told(other)
    for field in fields(MissionContext):
        if field.name not in NOT_COMPARED:
            assert getattr(one, field.name) == getattr(two, field.name), field.name


def test_it_says_what_is_searched_for():
    maritime = told(load_scenario("maritime"))
    assert maritime.poses["person"] == ("floating",)
    assert maritime.sizes_m["boat"] == (3.2, 6.5)
    assert told(load_scenario("person-wilderness")).poses["person"] == ("lying", "standing")


def test_the_price_of_a_leg_is_that_of_the_slower_axis():
    context = context_of()
    assert context.leg_s(0.0, 30.0, 5.0) == pytest.approx(10.0)  # climb at 3 m/s
    assert context.leg_s(0.0, -30.0, 5.0) == pytest.approx(20.0)  # descent at 1.5 m/s
    assert context.leg_s(200.0, 3.0, 5.0) > 40.0


@pytest.mark.parametrize(
    ("strategy", "parameters", "sentence"),
    [
        ("belief", {"missed_cost_s": -1.0}, "search.parameters of belief: missed_cost_s: "),
        ("belief", {"mised_cost_s": 1.0}, "search.parameters of belief: .*mised_cost_s"),
        ("scan-check", {"missed_cost_s": 1.0}, "search.parameters of scan-check: .*missed_cost_s"),
    ],
)
def test_parameters_that_a_strategy_does_not_have_are_one_sentence(strategy, parameters, sentence):
    scenario = change_scenario(
        load_scenario("clusters"), {"search.strategy": strategy, "search.parameters": parameters}
    )
    with pytest.raises(UserError, match=sentence):
        strategy_spec(strategy).parameters_of(scenario.search)


def test_parameters_are_set_one_by_one():
    scenario = change_scenario(load_scenario("clusters"), {"search.parameters.missed_cost_s": 500.0})
    assert scenario.search.parameters == {"missed_cost_s": 500.0}


@pytest.mark.parametrize(
    ("altitude_agl_m", "words"),
    [
        (30.0, ""),
        (95.0, "calibrated for 4 to 220 pixels on target, not 3.6: "),
        (
            110.0,
            "calibrated for 4 to 220 pixels on target, not 3.11 "
            "and for 0.79 to 26.3 cm of ground a pixel, not 29: ",
        ),
    ],
)
def test_a_scan_that_the_sensor_model_was_not_calibrated_for_is_said_at_the_start(altitude_agl_m, words):
    changes = {"search.strategy": "belief", "search.scan_altitude_agl_m": altitude_agl_m}
    mission = build_mission(change_scenario(load_scenario("clusters"), changes), 0, Rig("statistical"))
    journal = MemoryJournal()
    with Flight(mission, journal) as flight:
        next(flight)
    said = [line for line in journal.lines if line["kind"] == "safety"]
    assert bool(said) == bool(words)
    for line in said:
        assert (line["t"], line["cause"], line["action"]) == (0.0, "sensor model", "CONTINUE")
        assert words in line["sentence"]


def test_a_strategy_that_needs_a_sensor_model_does_not_take_off_without_one():
    changes = {"search.strategy": "belief", "camera.noise_std": 8}
    other_camera = change_scenario(load_scenario("clusters"), changes)
    with pytest.raises(UserError, match=r"camera.noise_std is 8 .* not 2.*another search.strategy"):
        build_mission(other_camera, 0, Rig("imaging"))
    assert build_mission(change_scenario(other_camera, {"search.strategy": "scan-check"}), 0)
