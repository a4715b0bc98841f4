"""The PettingZoo parallel environment: its checkers, one belief, and errors that are each vehicle's own."""

import numpy as np
import pytest

pytest.importorskip("gymnasium")
pytest.importorskip("pettingzoo")

from pettingzoo.test import parallel_api_test, parallel_seed_test

from skysweep.errors import UserError
from skysweep.gym import SearchParallelEnv
from skysweep.gym.baselines import PlannedPath

STILL = np.zeros(3, dtype=np.float32)


def test_pettingzoos_checkers_are_content():
    parallel_api_test(SearchParallelEnv(time_limit_s=30.0), num_cycles=60)
    parallel_seed_test(lambda: SearchParallelEnv(time_limit_s=30.0), num_cycles=20)


def test_they_share_the_belief_and_each_errs_in_its_own_way():
    env = SearchParallelEnv(n=3, period_s=2.0)
    env.reset(seed=0)
    for _ in range(8):
        told, *_ = env.step({"uav_0": STILL, "uav_1": np.array([1.0, 0.0, -1.0]), "uav_2": STILL})
    np.testing.assert_array_equal(told["uav_0"]["belief"], told["uav_1"]["belief"])
    assert told["uav_1"]["vehicle"][0] > told["uav_0"]["vehicle"][0] + 0.5
    np.testing.assert_array_equal(told["uav_0"]["others"][0, :2], told["uav_1"]["vehicle"][:2])
    assert (told["uav_0"]["vehicle"][:2] != told["uav_2"]["vehicle"][:2]).all()


def test_of_one_target_each_has_looks_of_its_own():
    env = SearchParallelEnv(period_s=2.0, time_limit_s=100.0)
    env.reset(seed=0)
    for _ in range(15):
        told, *_ = env.step({a: np.array([0.8, 0.6, -1.0]) for a in env.agents})
    first, second = (told[a]["candidates"] for a in ("uav_0", "uav_1"))
    assert told["uav_0"]["candidate_mask"][0] == told["uav_1"]["candidate_mask"][0] == 1
    assert first[0, 5] != second[0, 5]


def test_a_target_counts_for_who_finds_it_first():
    env = SearchParallelEnv(actions="waypoint", cost_second=0.0, cost_false_alarm=0.0, period_s=1.0)
    told, infos = env.reset(seed=0)
    policies = {agent: PlannedPath(info) for agent, info in infos.items()}
    rewards, summaries, found = 0.0, {}, 0
    while env.agents:
        actions = {a: policies[a].act(told[a]) for a in env.agents}
        told, reward, ended, truncated, infos = env.step(actions)
        assert not any(truncated.values())
        rewards += sum(reward.values())
        for a, over in ended.items():
            if over:
                summaries[a] = infos[a]["summary"]
                found = max(found, infos[a]["found_by_all"])
    assert set(summaries) == {"uav_0", "uav_1"}
    assert sum(s["n_confirmed"] for s in summaries.values()) > found > 0
    assert rewards == pytest.approx(10.0 * found)


@pytest.mark.parametrize("n", [1, 2.5, "3"])
def test_one_vehicle_is_no_team(n):
    with pytest.raises(UserError, match="an integer of at least 2"):
        SearchParallelEnv(n=n)
