"""A shipped scenario's field, smaller, and its pictures watched with a right and a wrong compass."""

import pytest
from camera_flights import doubts_on_the_way, times_trusted_again

from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import Scenario

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


@pytest.mark.parametrize(("scan_m", "check_m"), [(100, 60), (110, 40)])
def test_a_narrow_lens_from_high_up_is_not_doubted_for_what_its_gimbal_lags(scan_m, check_m):
    """An angle of 8 degrees, as at the beginning of a check, is 14 m on the ground from 100 m."""
    high = Scenario.model_validate(
        {
            "name": "high",
            "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
            "targets": [
                {"class": "person", "pose": "lying", "position_enu_m": at} for at in ([20, 15], [45, 30])
            ],
            "camera": {"hfov_rad": 0.8},
            "search": {"n_c": 1, "scan_altitude_agl_m": scan_m, "check_altitude_agl_m": check_m},
        }
    )
    (doubts,) = doubts_on_the_way(high, 1, [0.0])
    assert len(doubts) > 200
    assert set(doubts) == {None}
