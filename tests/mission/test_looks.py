"""What was flown blind, as the looks tell it."""

import numpy as np
import pytest

from skysweep.geometry.camera import CameraPose, Lens
from skysweep.mission.looks import Looks
from skysweep.scenarios.model import Scenario
from skysweep.sensing.exposures import Exposures
from skysweep.types import Detections, Doubt, VehicleState

SCENARIO = {
    "name": "looks",
    "area": {"polygon_enu_m": [[0, 0], [400, 0], [400, 40], [0, 40]]},
    "home": {"position_enu_m": [0, 0]},
    "targets": [],
}
POSE = CameraPose(np.zeros(3), np.eye(3))


def answer(time_s, doubt=None):
    return Detections(time_s, np.zeros((0, 4)), np.zeros(0), (), POSE, Lens(2, 2, 1.0), doubt)


@pytest.mark.parametrize("period_s", [0.4, 1.0, 2.0])
def test_doubt_of_25_looks_finds_the_track_that_was_flown_meanwhile(period_s):
    looks = Looks(Scenario.model_validate(SCENARIO), Exposures(1.0 / period_s, 0.0), 30.0)
    looks.begin(0.0)
    for k in range(60):
        position_enu_m = np.array([4.0 * period_s * k, 20.0, 30.0])
        looks.keep_track(
            VehicleState(period_s * k, position_enu_m, np.zeros(3), 0.0, POSE, 1.0, 0.0, True), True
        )
        assert looks.take(period_s * k, answer(period_s * k))
    since_s, now_s = 34 * period_s, 60 * period_s
    looks.take(now_s, answer(now_s, Doubt("sees the ground pass otherwise", since_s)))
    looks.give_up(now_s + 60.0)
    (start, _), *_ = looks.blind_legs()
    assert start[0] <= 4.0 * since_s


def test_looks_that_a_doubt_reaches_back_to_were_none():
    looks = Looks(Scenario.model_validate(SCENARIO), Exposures(2.5, 0.0), 30.0)
    for k in range(20):
        assert looks.take(0.4 * k, answer(0.4 * k))
    assert not looks.take(8.0, answer(8.0, Doubt("is dirty", 6.7)))
    assert looks.doubt == "is dirty (4 of the last 4 pictures)"
    assert not looks.take(8.4, answer(8.4, Doubt("is dirty", 0.0)))
    assert looks.doubt == "is dirty (10 of the last 10 pictures)"
    assert looks.newest_s == 0.0
