"""The belief raster against what the sensor really sees: it may promise less, never clearly more."""

import numpy as np
import pytest

pytest.importorskip("gymnasium")
pytest.importorskip("pettingzoo")

from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.gym import SearchEnv
from skysweep.scenarios.files import change_scenario, load_scenario

N = 400


def signs_over(altitude_m):
    signs = {"class": "stop sign", "pattern": "uniform", "count": N, "size_m": 0.75, "min_separation_m": 0}
    return change_scenario(
        load_scenario("clusters"),
        {
            "targets": [],
            "distractors": [],
            "generators": [signs | {"poses": ["face-up"]}],
            "search.scan_altitude_agl_m": altitude_m,
        },
    )


@pytest.mark.parametrize("altitude_m", [45.0, 60.0])
def test_what_a_pass_leaves_unseen_is_about_what_it_says(altitude_m):
    env = SearchEnv(signs_over(altitude_m), cells=32)
    left, promised, unseen = 0, 0.0, 0
    for seed in range(2):
        env.reset(seed=seed)
        sortie = env._team.sorties[0]
        for _ in range(60):
            env.step(np.array([0.8, 0.6, -1.0]))
        raster, chart = sortie.belief.unseen, env._team.chart
        tracked = [c.position_enu_m[:2] for c in sortie._follower.seen.candidates.values()]
        for target in sortie._world.targets:
            east, north = chart.on_square(*target.position_enu_m[:2])
            value = raster[int((north + 1) * 16), int((east + 1) * 16)]
            if 0.0 < value < 1.0:
                left += 1
                promised += value
                away = np.linalg.norm(np.array(tracked) - target.position_enu_m[:2], axis=1).min()
                unseen += away > 3.0
    print(f"{altitude_m:g} m: {left} targets, promised {promised / left:.3f}, unseen {unseen / left:.3f}")
    assert left > 100
    assert unseen / left <= promised / left + 0.05
    assert unseen / left >= promised / left - 0.25


def test_a_look_lowers_the_belief_where_it_looked_and_nowhere_else():
    env = SearchEnv(cells=20)
    env.reset(seed=0)
    belief = env._team.sorties[0].belief
    before = belief.unseen.copy()
    middle = CameraPose(np.array([80.0, 65.0, 30.0]), rotation_camera_to_enu(0.0, -np.pi / 2))
    belief.look(middle)
    changed = belief.unseen < before
    assert changed[10, 10]
    assert not changed[0, 0]
    assert changed.sum() == pytest.approx(50.5 * 28.4 / (8.0 * 6.5), rel=0.25)
    assert belief.covered == 0.0
    belief.look(middle)
    assert belief.covered > 0.05


def test_below_a_roof_nothing_is_ever_seen():
    env = SearchEnv("buildings", cells=64)
    env.reset(seed=0)
    belief, chart = env._team.sorties[0].belief, env._team.chart
    for x in (52.0, 78.0):
        y = 20.0 if x == 52.0 else 50.0
        belief.look(CameraPose(np.array([x, y, 30.0]), rotation_camera_to_enu(0.0, -np.pi / 2)))
        east, north = chart.on_square(x, y)
        assert belief.unseen[int((north + 1) * 32), int((east + 1) * 32)] == 1.0
    assert (belief.unseen < 1.0).any()
