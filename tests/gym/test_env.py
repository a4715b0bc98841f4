"""The Gymnasium environment: Gymnasium's checker, the same bits again, no truth in sight, and how it ends."""

import hashlib
import json
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")
pytest.importorskip("pettingzoo")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from typer.testing import CliRunner  # noqa: E402

import skysweep.gym  # noqa: E402
from skysweep.cli import app  # noqa: E402
from skysweep.errors import UserError  # noqa: E402
from skysweep.gym.baselines import PlannedPath  # noqa: E402
from skysweep.scenarios.files import change_scenario, list_scenarios, load_scenario  # noqa: E402

DIGEST = """
import hashlib, gymnasium, numpy as np, skysweep.gym
env = gymnasium.make("skysweep/Search-v0", time_limit_s=60.0)
digest = hashlib.sha256()
observation, info = env.reset(seed=7)
env.action_space.seed(7)
over = False
while not over:
    for key in sorted(observation):
        digest.update(np.ascontiguousarray(observation[key]).tobytes())
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    digest.update(np.float64(reward).tobytes())
    over = terminated or truncated
info["summary"].pop("wall_time_s")
digest.update(repr(sorted(info["summary"].items())).encode())
"""


def make(**arguments):
    return gymnasium.make("skysweep/Search-v0", **arguments).unwrapped


def test_gymnasiums_checker_is_content():
    for actions in ("velocity", "waypoint"):
        env = gymnasium.make(
            "skysweep/Search-v0", render_mode="rgb_array", actions=actions, time_limit_s=40.0
        )
        check_env(env.unwrapped, skip_render_check=False)


def test_a_seed_gives_the_same_bits_here_and_in_another_process():
    def digest():
        names = {}
        exec(DIGEST, names)
        return names["digest"].hexdigest()

    here = digest()
    assert digest() == here
    told = subprocess.run(
        [sys.executable, "-c", DIGEST + "print(digest.hexdigest())"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout.strip() == here
    assert here != hashlib.sha256().hexdigest()


def test_what_nobody_has_seen_is_not_in_the_observation():
    def seen_from_home(x, y):
        sign = {"class": "stop sign", "position_enu_m": [x, y]}
        env = make(
            scenario=change_scenario(load_scenario("clusters"), {"targets": [sign], "distractors": []})
        )
        told = [env.reset(seed=3)]
        told += [env.step(np.zeros(3, dtype=np.float32)) for _ in range(25)]
        return [(t[0], t[1:-1] if len(t) == 5 else (), t[-1]) for t in told]

    for here, there in zip(seen_from_home(150, 120), seen_from_home(90, 110), strict=True):
        for key, value in here[0].items():
            np.testing.assert_array_equal(value, there[0][key], err_msg=key)
        assert here[1] == there[1]
        assert here[2] == there[2]


def test_the_planned_path_ends_the_search_and_the_reward_is_that_of_the_summary():
    env = make(actions="waypoint", cost_missed=8.0, cost_false_alarm=2.0, cost_second=0.5)
    observation, info = env.reset(seed=1)
    policy, total, over, modes = PlannedPath(info, till_check=3), 0.0, False, set()
    while not over:
        assert env.observation_space.contains(observation)
        observation, reward, over, truncated, info = env.step(policy.act(observation))
        assert not truncated
        total += reward
        modes.add(info["mode"])
    summary = info["summary"]
    assert modes == {"SCAN", "CHECK"}
    assert (summary["strategy"], summary["end_reason"], summary["completed"]) == (
        "learner",
        "completed",
        True,
    )
    assert summary["recall"] > 0.8
    assert summary["area_covered"] > 0.98
    false_alarms = summary["false_positives"] - summary["duplicates"]
    searched_s = summary["mission_time_s"] - 19.1  # less the take-off
    expected = 8.0 * summary["n_confirmed"] - 2.0 * false_alarms - 0.5 * searched_s
    assert total == pytest.approx(expected, abs=1.0)
    assert observation["vehicle"][9] == 0.0
    confirmed = (observation["candidate_status"] == 2).sum()
    assert confirmed == summary["n_confirmed"] + summary["false_positives"]


def test_a_mission_that_takes_too_long_is_called_home_and_truncated():
    env = make(time_limit_s=30.0)
    env.reset(seed=0)
    over = False
    while not over:
        _, _, terminated, over, info = env.step(np.zeros(3))
        assert not terminated
    assert info["summary"]["end_reason"] == "operator"
    assert info["summary"]["battery_remaining"] > 0.9
    assert any("calls the vehicle home" in sentence for sentence in info["safety"])


def test_the_time_limit_holds_while_the_battery_is_changed():
    """The first sortie leaves for home at 200 s, the second one searches from 307 s on."""
    scenario = change_scenario(
        load_scenario("clusters"),
        {"vehicle.battery_wh": 14.0, "vehicle.batteries": 6, "vehicle.swap_s": 60.0},
    )
    env = make(scenario=scenario, time_limit_s=250.0)
    env.reset(seed=1)
    over = False
    while not over:
        _, _, terminated, over, info = env.step(np.zeros(3))
        assert not terminated
    assert info["summary"]["end_reason"] == "operator"
    assert info["summary"]["total_time_s"] == pytest.approx(250.0, abs=1.0)


def test_the_time_limit_holds_in_the_midst_of_a_long_decision():
    env = make(time_limit_s=40.0, period_s=15.0)
    env.reset(seed=0)
    searched_s, truncated = 0.0, False
    while not truncated:
        _, reward, terminated, truncated, info = env.step(np.zeros(3))
        assert not terminated
        searched_s -= reward / env._team.rules.cost_second
    assert info["summary"]["end_reason"] == "operator"
    assert searched_s == pytest.approx(40.0 - 19.1, abs=0.5)  # less the take-off


def test_what_safety_refuses_is_told_and_not_flown_to():
    env = make()
    env.reset(seed=0)
    told = []
    for _ in range(60):
        observation, *_, info = env.step(np.array([-1.0, -1.0, -1.0]))
        told += info["safety"]
    assert any("outside the geofence" in sentence for sentence in told)
    env.close()
    east, north = observation["vehicle"][:2] * [80.0, 65.0] + [80.0, 65.0]
    assert east > -36.0
    assert north > -36.0


def test_who_insists_on_a_refused_place_waits_and_searches_on():
    area = {"area.polygon_enu_m": [[0, 0], [200, 0], [0, 200]]}
    env = make(scenario=change_scenario(load_scenario("clusters"), area), actions="waypoint", period_s=0.1)
    env.reset(seed=0)
    told = []
    for _ in range(40):
        *_, terminated, _, info = env.step(np.array([1.0, 1.0, -1.0]))
        assert not terminated
        told += info["safety"]
    assert len(told) > 2
    assert all("outside the geofence" in sentence for sentence in told)


def test_another_scenario_at_a_reset_and_new_layouts_where_it_says_at_random():
    signs = {"class": "stop sign", "pattern": "uniform", "count": 5, "seed": 0}
    scenario = change_scenario(load_scenario("clusters"), {"targets": [], "generators": [signs]})

    def places(env):
        return [t.position_enu_m.tolist() for t in env._team.sorties[0]._world.targets]

    env = make()
    assert env.reset(seed=0, options={"scenario": scenario})[1]["scenario"] == "clusters"
    first = places(env)
    env.reset()
    assert env._team.scenario.name == "clusters"
    env.reset(options={"scenario": scenario})
    assert len(first) == 5
    assert places(env) != first
    assert env.reset(options={"scenario": "sparse"})[1]["scenario"] == "sparse"

    kept = make(new_layouts=False, scenario=scenario)
    kept.reset(seed=0)
    before = places(kept)
    kept.reset()
    assert places(kept) == before


@pytest.mark.parametrize("name", list_scenarios())
def test_every_shipped_scenario_begins(name):
    env = make(scenario=name)
    assert env.reset(seed=0)[1]["scenario"] == name
    env.close()


def test_members_of_a_vector_may_fly_different_scenarios():
    names = "clusters", "coast"
    vector = gymnasium.vector.SyncVectorEnv([lambda name=name: make(scenario=name) for name in names])
    _, info = vector.reset(seed=0)
    for plan, name in zip(info["plan"], names, strict=True):
        assert plan == make(scenario=name).reset(seed=0)[1]["plan"]
        assert all(-1.0 <= place <= 1.0 for waypoint in plan for place in waypoint)
    vector.close()


def test_an_option_that_does_not_exist_is_refused():
    with pytest.raises(UserError, match="no option 'scenari'; write scenario"):
        make().reset(options={"scenari": "sparse"})


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"actions": "rudder"}, "velocity or waypoint"),
        ({"period_s": 0.0}, "period_s"),
        ({"period_s": "1"}, "period_s: is '1'; write a finite number"),
        ({"cost_missed": float("nan")}, "cost_missed"),
        ({"cost_missed": None}, "cost_missed: is None; write a finite number"),
        ({"cells": 64.5}, "cells: is 64.5; write an integer of at least 1"),
        ({"slots": "3"}, "slots: is '3'; write an integer of at least 1"),
        ({"horizon": 3}, "horizon"),
        ({"render_mode": "human"}, "rgb_array"),
        ({"scenario": "nowhere"}, "nowhere"),
    ],
)
def test_what_cannot_be_is_one_sentence(arguments, word):
    with pytest.raises(UserError, match=word):
        skysweep.gym.SearchEnv(**arguments).reset()


def test_an_action_that_is_no_number_is_refused():
    env = make()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="finite"):
        env.step(np.array([np.nan, 0.0, 0.0]))


def test_the_command_prints_what_policies_that_learn_nothing_achieve():
    told = CliRunner().invoke(app, ["gym", "sparse", "--episodes", "1"])
    assert told.exit_code == 0
    for word in ("random", "scan-only", "scan-check", "steps/s"):
        assert word in told.stdout
    told = CliRunner().invoke(app, ["gym", "sparse", "--episodes", "1", "--json"])
    policies = json.loads(told.stdout)["policies"]
    assert [each["policy"] for each in policies] == ["random", "scan-only", "scan-check"]
    assert all(isinstance(each["steps_per_cpu_s"], float) for each in policies)


def test_without_gymnasium_the_extra_is_named():
    code = "import sys; sys.modules['gymnasium'] = None; import skysweep.gym"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert told.returncode == 1
    assert "tools/setup.sh gym" in told.stderr


def test_the_example_runs(capsys):
    runpy.run_path(str(Path(__file__).parents[2] / "examples" / "gym_random.py"), run_name="__main__")
    assert "recall" in capsys.readouterr().out


def test_an_agent_goes_on_with_another_battery():
    """The decision in which the battery runs low takes as long as the swap."""
    scenario = change_scenario(
        load_scenario("clusters"),
        {"vehicle.battery_wh": 14.0, "vehicle.batteries": 6, "vehicle.swap_s": 60.0},
    )
    env = make(scenario=scenario, actions="waypoint")
    observation, info = env.reset(seed=1)
    policy, over, charges = PlannedPath(info, till_check=3), False, []
    while not over:
        charges.append(observation["vehicle"][6])
        observation, _, over, truncated, info = env.step(policy.act(observation))
        assert not truncated
    assert info["summary"]["completed"]
    assert np.diff(charges).max() > 0.3
    assert info["summary"]["total_energy_wh"] > 14.0
