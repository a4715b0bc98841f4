"""A shipped scenario's field, smaller, and its pictures watched with a right and a wrong compass."""

import pytest
from camera_flights import doubts_on_the_way, times_trusted_again

from skysweep.scenarios.files import change_scenario, load_scenario

OFF_DEG = [0.0, -6.0, 6.0]


@pytest.fixture(scope="module")
def doubts():
    area = {"polygon_enu_m": [[0, 0], [110, 0], [110, 80], [0, 80]]}
    scenario = change_scenario(load_scenario("clusters"), {"area": area, "targets": [], "distractors": []})
    return dict(zip(OFF_DEG, doubts_on_the_way(scenario, 0, OFF_DEG), strict=True))


def test_a_right_compass_is_never_doubted(doubts):
    assert len(doubts[0.0]) > 100
    assert set(doubts[0.0]) == {None}


@pytest.mark.parametrize("off_deg", [-6.0, 6.0])
def test_a_compass_that_is_6_degrees_off_is_found_and_never_trusted_again(doubts, off_deg):
    assert doubts[off_deg][-1] is not None
    assert times_trusted_again(doubts[off_deg]) == 0
