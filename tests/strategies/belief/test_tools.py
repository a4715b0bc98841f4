"""The tools that print the tables of docs/belief.md still fit the strategy that they take apart."""

import importlib.util
from pathlib import Path

import pytest

from skysweep.experiments.sweep.spec import load_spec, scenarios_of

TOOLS = Path(__file__).parents[3] / "tools"


def tool(name):
    spec = importlib.util.spec_from_file_location(name, TOOLS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


ABLATE, BEND, CONFIRMED = tool("ablate_belief"), tool("bend_the_world"), tool("what_is_confirmed")
SCENARIO = dict(scenarios_of(load_spec(ABLATE.SWEEP)))["clusters-belief"]


@pytest.mark.parametrize("ablation", ABLATE.ABLATIONS)
def test_belief_flies_without_each_of_its_ingredients(ablation):
    time_s, recall, _, to_half_s = ABLATE.fly((ablation, SCENARIO, ABLATE.FIRST_SEED))
    assert recall > 0.5
    assert 0.0 < to_half_s <= time_s


@pytest.mark.parametrize("world", BEND.WORLDS)
def test_missions_are_flown_in_each_bent_world(world):
    recall, _, said = BEND.fly((world, SCENARIO, BEND.FIRST_SEED))
    assert recall > 0.5
    assert said in (0.0, 1.0)


def test_what_is_confirmed_is_told_from_what_is_not(monkeypatch):
    monkeypatch.setattr(CONFIRMED.hypotheses, "_KNOWN_OF_THINGS", 0.5)
    found = CONFIRMED.candidates((SCENARIO, CONFIRMED.FIRST_SEED, 0.0))
    assert CONFIRMED.hypotheses._KNOWN_OF_THINGS == 0.0
    assert {is_confirmed for *_, is_confirmed in found} == {True, False}
    assert 0.0 < CONFIRMED.log_loss(found) < 0.7 * len(found)
