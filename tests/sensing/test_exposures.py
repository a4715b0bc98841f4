"""When a sensor exposes and which pose it is given."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import rotation_camera_to_enu, wrap_angle
from skysweep.sensing.exposures import Exposures, Pace
from skysweep.types import VehicleState

YAW_RATE = 0.5


def state(t):
    """Eastwards at 5 m/s, turning."""
    pose = CameraPose(np.array([5.0 * t, 0.0, 30.0]), rotation_camera_to_enu(YAW_RATE * t, -np.pi / 2))
    return VehicleState(t, pose.position_enu_m, np.array([5.0, 0, 0]), np.eye(3), pose, 1.0, 0.0, True)


def exposures(rate_hz, pose_delay_s=0.0, tick_s=0.1, duration_s=4.0):
    schedule = Exposures(rate_hz, pose_delay_s)
    states = [state(k * tick_s) for k in range(round(duration_s / tick_s))]
    shown = [(state, schedule.due(state)) for state in states]
    return [(state, believed) for state, believed in shown if believed is not None]


@pytest.mark.parametrize("rate_hz", [10.0, 5.0, 2.5, 1.0])
def test_rates_that_divide_the_ticks_are_kept_exactly(rate_hz):
    times = [s.time_s for s, _ in exposures(rate_hz)]
    np.testing.assert_allclose(np.diff(times), 1 / rate_hz, atol=1e-6)


def test_a_rate_between_ticks_is_kept_on_average():
    times = [s.time_s for s, _ in exposures(3.0, duration_s=30.0)]
    assert abs(len(times) / 30.0 - 3.0) < 0.1
    assert np.diff(times).max() < 0.45


def test_a_sensor_that_was_not_asked_for_long_does_not_catch_up():
    schedule = Exposures(10.0, 0.0)
    assert schedule.due(state(0.0)) is not None
    assert schedule.due(state(5.0)) is not None
    assert schedule.due(state(5.05)) is None
    assert schedule.due(state(5.1)) is not None


@pytest.mark.parametrize("delay_s", [0.1, 0.13, 0.2])
def test_the_pose_is_older_than_the_exposure(delay_s):
    for exposed, believed in exposures(2.5, delay_s, duration_s=6.0)[1:]:
        was = exposed.time_s - delay_s
        assert abs(believed.position_enu_m[0] - 5.0 * was) < 1e-3
        up = -believed.R_camera_to_enu[:, 1]
        assert abs(wrap_angle(np.arctan2(up[1], up[0]) - YAW_RATE * was)) < 1e-3


def test_before_there_is_an_older_pose_the_oldest_is_taken():
    exposed, believed = exposures(2.5, 0.3)[0]
    assert exposed.time_s == 0.0
    np.testing.assert_array_equal(believed.position_enu_m, [0.0, 0.0, 30.0])


def paced(looks_s, rate_hz=2.5):
    """The period after each look."""
    schedule = Exposures(rate_hz, 0.0)
    pace = Pace(schedule)
    periods_s = []
    for look_s in looks_s:
        pace.took(look_s)
        periods_s.append(schedule.period_s)
    return periods_s


@given(st.lists(st.floats(0.0, 0.4), max_size=40))
def test_looks_that_fit_keep_the_usual_rate_to_the_bit(looks_s):
    assert set(paced(looks_s)) <= {1.0 / 2.5}


@given(st.floats(0.41, 20.0), st.sampled_from([1.0, 2.5, 10.0]))
def test_longer_looks_get_the_next_rate_in_which_they_fit(look_s, rate_hz):
    first_s, period_s = paced([look_s] * 2, rate_hz)
    assert first_s == 1.0 / rate_hz
    usual_s = 1.0 / rate_hz
    assert period_s >= max(look_s - 0.011 * usual_s, usual_s)
    assert period_s < look_s + usual_s
    assert period_s / usual_s == pytest.approx(round(period_s / usual_s))
    assert paced([look_s] * 40, rate_hz)[-1] == period_s, "and they keep it"


def test_one_long_look_changes_nothing():
    assert set(paced([0.1, 0.1, 30.0, 0.1, 0.1] * 10)) == {0.4}


def test_the_rate_recovers_when_looks_fit_well_again():
    periods_s = paced([1.0] * 2 + [0.38] * 60)
    assert periods_s[1] == pytest.approx(1.2)
    assert periods_s[-1] == pytest.approx(0.8), "0.38 s fit into 0.4 s, but hardly"
    assert paced([1.0] * 2 + [0.3] * 60)[-1] == 0.4
    assert paced([1.0] * 2 + [0.3] * 24)[-1] == pytest.approx(1.2), "not at the first that do"
