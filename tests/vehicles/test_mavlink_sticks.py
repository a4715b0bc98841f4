"""Flying by MANUAL_CONTROL, and whose sticks count."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mavlink_clients import ALTITUDE, HOLD, OFFBOARD, POSITION, STABILIZED, Program, Sky, local
from pymavlink.dialects.v20 import development as m

from skysweep.vehicles.mavlink.modes import TICK_S
from skysweep.vehicles.served.sticks import Sticks

CENTRED = (0, 0, 500, 0)
HERE = ("10.0.0.1", 1)


def control(forward=0, right=0, up=500, turn=0, target=1):
    return m.MAVLink_manual_control_message(target, forward, right, up, turn, 0)


def hold_sticks(sky: Sky, pilot: Program, seconds: float, sticks=CENTRED) -> None:
    for i in range(round(seconds / TICK_S)):
        if i % 5 == 0:
            pilot.say(control(*sticks))
        sky.tick()


@pytest.fixture
def sky():
    return Sky()


@pytest.fixture
def pilot(sky):
    pilot = Program(sky, system=255)
    pilot.take_off(20.0)
    sky.fly(4.0)
    hold_sticks(sky, pilot, 0.5)
    assert pilot.mode(*POSITION) == 0
    return pilot


@pytest.mark.parametrize(
    ("sticks", "velocity_ned"),
    [
        ((1000, 0, 500, 0), (0.0, 10.0, 0.0)),  # it faces east
        ((-1000, 0, 500, 0), (0.0, -10.0, 0.0)),
        ((0, 1000, 500, 0), (-10.0, 0.0, 0.0)),
        ((0, 0, 1000, 0), (0.0, 0.0, -3.0)),
        ((0, 0, 0, 0), (0.0, 0.0, 1.5)),
        ((1000, 1000, 500, 0), (-7.07, 7.07, 0.0)),
        ((550, 0, 500, 0), (0.0, 2.75, 0.0)),  # half the way beyond the dead zone: 0.4 / 2 + 0.6 / 8
        ((90, -90, 450, 90), (0.0, 0.0, 0.0)),
    ],
)
def test_sticks_fly_velocities_at_px4s_limits(sky, pilot, sticks, velocity_ned):
    hold_sticks(sky, pilot, 8.0 if sticks[2] != 500 else 30.0, sticks)  # drag is overcome slowly
    before, from_s = sky.ned, sky.pilot.time_s
    hold_sticks(sky, pilot, 2.0, sticks)
    assert (sky.ned - before) / (sky.pilot.time_s - from_s) == pytest.approx(velocity_ned, abs=0.2)


def test_centred_sticks_hover_where_it_comes_to_rest(sky, pilot):
    hold_sticks(sky, pilot, 4.0, (500, 0, 800, 0))
    hold_sticks(sky, pilot, 15.0)
    before = sky.ned
    hold_sticks(sky, pilot, 5.0)
    assert np.linalg.norm(sky.vehicle.true_velocity_enu_mps) < 0.05
    assert sky.ned == pytest.approx(before, abs=0.1)


def test_height_is_kept_while_it_moves_along_the_ground(sky, pilot):
    down = sky.ned[2]
    hold_sticks(sky, pilot, 8.0, (700, 300, 500, 0))
    assert sky.ned[2] == pytest.approx(down, abs=0.3)


def test_the_yaw_stick_turns_clockwise_and_forward_goes_with_it(sky, pilot):
    hold_sticks(sky, pilot, 1.0, (0, 0, 500, 550))  # 0.275 of 150 degrees a second
    hold_sticks(sky, pilot, 2.0)
    assert np.degrees(sky.pilot.yaw_rad) == pytest.approx(-41.0, abs=4.0)
    hold_sticks(sky, pilot, 5.0, (600, 0, 500, 0))
    assert sky.ned[0] < -6.0
    assert sky.ned[1] == pytest.approx(-sky.ned[0], rel=0.2)


@pytest.mark.parametrize("mode", [ALTITUDE, STABILIZED])
def test_the_other_modes_with_sticks_fly_too(sky, pilot, mode):
    assert pilot.mode(*mode) == 0
    hold_sticks(sky, pilot, 4.0, (600, 0, 500, 0))
    assert sky.ned[1] > 5.0
    assert sky.pilot.mode.value == mode


def test_without_a_pilot_it_comes_straight_down(sky, pilot):
    pilot.set("COM_RC_IN_MODE", 4)  # no failsafe
    pilot.mode(*POSITION)
    sky.fly(5.0)
    east, north, up = sky.vehicle.true_velocity_enu_mps
    assert np.hypot(east, north) < 0.1
    assert up < -0.3


def test_position_at_lift_off_sets_it_down_again(sky):
    pilot = Program(sky)
    hold_sticks(sky, pilot, 0.5)
    assert pilot.mode(*HOLD) == 0
    assert pilot.arm() == 0
    pilot.say(local(0, 0, -10))
    assert pilot.mode(*OFFBOARD) == 0
    hold_sticks(sky, pilot, 0.5)
    assert sky.pilot.flying
    assert pilot.mode(*POSITION) == 0
    hold_sticks(sky, pilot, 12.0)
    assert not sky.pilot.flying
    assert sky.ned[2] == pytest.approx(0.0, abs=0.1)


def test_sticks_on_the_ground_choose_position_unless_somebody_chose_a_mode(sky):
    pilot = Program(sky)
    hold_sticks(sky, pilot, 0.5)
    assert sky.pilot.mode.value == POSITION
    assert pilot.mode(*HOLD) == 0
    hold_sticks(sky, pilot, 0.5, (500, 0, 500, 0))
    assert sky.pilot.mode.value == HOLD


# ---- whose sticks count ----------------------------------------------------------------------------------

OTHER = ("10.0.0.1", 2)


@pytest.mark.parametrize(
    ("in_mode", "followed", "after_a_loss"),
    [(0, None, None), (1, HERE, OTHER), (2, HERE, OTHER), (3, HERE, HERE), (4, None, None)],
)
def test_com_rc_in_mode(in_mode, followed, after_a_loss):
    sticks, hers, his = Sticks(), control(forward=500), control(forward=-500)
    sign = {HERE: 0.5, OTHER: -0.5, None: 0.0}
    sticks.hear(hers, HERE, in_mode, 0.0)
    sticks.hear(his, OTHER, in_mode, 0.1)
    sticks.tick(0.2, 1.0, 30.0)
    assert sticks.position[0] == sign[followed]
    assert sticks.lost == (followed is None)
    sticks.tick(2.0, 1.0, 30.0)
    assert sticks.lost
    assert sticks.position[0] == 0.0
    sticks.hear(his, OTHER, in_mode, 2.0)
    sticks.hear(hers, HERE, in_mode, 2.0)
    assert sticks.position[0] == sign[after_a_loss]


def test_another_vehicles_sticks_are_not_ours(sky):
    pilot = Program(sky)
    pilot.say(control(target=2))
    assert sky.pilot.sticks.lost
    pilot.say(control(target=0))
    assert not sky.pilot.sticks.lost


@given(st.tuples(*[st.integers(-32768, 32767)] * 4))
def test_what_is_out_of_range_is_centred(numbers):
    sticks = Sticks()
    sticks.hear(control(*numbers), HERE, 1, 0.0)
    forward, right, up, turn = numbers
    axes = (forward / 1000.0, right / 1000.0, up / 500.0 - 1.0, turn / 1000.0)
    assert sticks.position == pytest.approx([v if abs(v) <= 1.0 else 0.0 for v in axes])


@given(st.floats(min_value=0.0, max_value=0.25), st.sampled_from([-1, 1]))
def test_sticks_slower_than_com_rc_stick_ov_a_second_do_not_move(speed, sign):
    sticks = Sticks()
    for i in range(150):
        sticks.hear(control(forward=sign * round(1000.0 * min(speed * i * TICK_S, 1.0))), HERE, 1, i * TICK_S)
        sticks.tick(i * TICK_S, 1.0, 30.0)
        assert not sticks.moving


def test_a_push_moves_for_a_moment_and_the_first_position_is_none():
    sticks = Sticks()
    sticks.hear(control(forward=900), HERE, 1, 0.0)
    sticks.tick(0.02, 1.0, 30.0)
    assert not sticks.moving
    sticks.hear(control(forward=600), HERE, 1, 0.04)
    sticks.tick(0.04, 1.0, 30.0)
    assert sticks.moving
    for i in range(3, 60):
        sticks.tick(i * TICK_S, 5.0, 30.0)
    assert not sticks.moving
