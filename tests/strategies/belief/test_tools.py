"""The tools that print the tables of docs/belief.md still fit the strategy that they take apart."""

import importlib.util
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[3] / "tools"


def tool(name):
    spec = importlib.util.spec_from_file_location(name, TOOLS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


ABLATE, BEND = tool("ablate_belief"), tool("bend_the_world")


@pytest.mark.parametrize("ablation", ABLATE.ABLATIONS)
def test_belief_flies_without_each_of_its_ingredients(ablation):
    time_s, recall, _, to_half_s = ABLATE.fly((ablation, "clusters-belief", ABLATE.FIRST_SEED))
    assert recall > 0.5
    assert 0.0 < to_half_s <= time_s


@pytest.mark.parametrize("world", BEND.WORLDS)
def test_missions_are_flown_in_each_bent_world(world):
    recall, _, said = BEND.fly((world, "clusters-belief", BEND.FIRST_SEED))
    assert recall > 0.5
    assert said in (0.0, 1.0)
