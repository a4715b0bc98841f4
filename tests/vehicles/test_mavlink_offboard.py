"""Offboard control: entering, flying, losing it, and who owns it."""

import numpy as np
import pytest
from mavlink_clients import HOLD, LAND, OFFBOARD, POSITION_ONLY, VELOCITY_ONLY, Program, Sky, local
from pymavlink.dialects.v20 import common as m

NAN = float("nan")


@pytest.fixture
def sky():
    return Sky()


@pytest.fixture
def program(sky):
    return Program(sky)


def engage(sky, program, message):
    program.say(message)
    assert program.mode(*OFFBOARD) == 0
    assert sky.pilot.mode.name == "OFFBOARD"


def test_a_stream_comes_first(sky, program):
    program.take_off(5.0)
    assert program.mode(*OFFBOARD) == m.MAV_RESULT_TEMPORARILY_REJECTED
    program.say(local(0, 0, -5))
    sky.fly(1.2)
    assert program.mode(*OFFBOARD) == m.MAV_RESULT_TEMPORARILY_REJECTED, "an old setpoint is no stream"
    engage(sky, program, local(0, 0, -5))


def test_it_takes_off_and_flies_to_positions(sky, program):
    assert program.arm() == 0
    engage(sky, program, local(0, 0, 0))
    sky.fly_streaming(program, local(0, 0, 0), 2.0)
    assert not sky.pilot.flying, "a setpoint on the ground is no order to take off"
    sky.fly_streaming(program, local(0, 0, -6), 15.0)
    assert sky.ned == pytest.approx([0, 0, -6], abs=0.15)
    westward = local(12, -7, -9, 0b1001_1111_1000, yaw=-np.pi / 2)
    sky.fly_streaming(program, westward, 15.0)
    assert sky.ned == pytest.approx([12, -7, -9], abs=0.15)
    assert np.cos(sky.pilot.yaw_rad) == pytest.approx(-1.0, abs=0.01)


def test_it_flies_velocities(sky, program):
    program.take_off(10.0)
    message = local(NAN, NAN, NAN, VELOCITY_ONLY, velocity=(2.0, -1.0, -0.5))
    engage(sky, program, message)
    sky.fly_streaming(program, message, 25.0)
    before = sky.ned
    sky.fly_streaming(program, message, 10.0)
    assert (sky.ned - before) / 10.0 == pytest.approx([2.0, -1.0, -0.5], abs=0.04)


def test_velocity_along_the_ground_at_a_height(sky, program):
    program.take_off(10.0)
    mask = 0b1101_1110_0011  # height, and velocity north and east
    message = local(0, 0, -12, mask, velocity=(3.0, 0.0, 0.0))
    engage(sky, program, message)
    sky.fly_streaming(program, message, 15.0)
    assert sky.ned[2] == pytest.approx(-12.0, abs=0.1)
    assert sky.vehicle.true_velocity_enu_mps[1] == pytest.approx(3.0, abs=0.1)


def test_velocity_and_turning_rate_of_the_body(sky, program):
    program.take_off(10.0)
    mask = 0b0101_1100_0111
    body = {"velocity": (2.0, 0.5, 0.0), "frame": m.MAV_FRAME_BODY_NED}
    straight, turning = local(0, 0, 0, mask, **body), local(0, 0, 0, mask, rate=0.3, **body)
    engage(sky, program, straight)
    sky.fly_streaming(program, straight, 25.0)
    assert sky.vehicle.true_velocity_enu_mps == pytest.approx([2.0, -0.5, 0.0], abs=0.05), "it faces east"
    message = turning
    sky.fly_streaming(program, message, 2.0)
    start = sky.pilot.yaw_rad
    sky.fly_streaming(program, message, 2.0)
    turned = (sky.pilot.yaw_rad - start + np.pi) % (2 * np.pi) - np.pi
    assert turned == pytest.approx(-0.6, abs=0.05), "clockwise seen from above"


def test_global_setpoints_above_home_and_above_the_sea(sky, program):
    program.take_off(10.0)
    latitude, longitude, altitude = sky.geodetic([15.0, 10.0, -13.0])
    for frame, height in ((m.MAV_FRAME_GLOBAL_INT, altitude), (m.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 11.0)):
        place = (round(latitude * 1e7), round(longitude * 1e7), height)
        message = m.MAVLink_set_position_target_global_int_message(
            0, 1, 1, frame, POSITION_ONLY, *place, 0, 0, 0, 0, 0, 0, 0, 0
        )
        engage(sky, program, message)
        sky.fly_streaming(program, message, 15.0)
        down = -13.0 if frame == m.MAV_FRAME_GLOBAL_INT else -11.0
        assert sky.ned == pytest.approx([15.0, 10.0, down], abs=0.15)


def test_a_moving_setpoint_is_followed_without_lag(sky, program):
    program.take_off(10.0)
    engage(sky, program, local(0, 0, -10))
    mask = 0b1101_1100_0000
    for i in range(500):
        north = 3.0 * i * 0.02
        program.say(local(north, 0, -10, mask, velocity=(3.0, 0.0, 0.0)))
        sky.tick()
    assert sky.ned == pytest.approx([north, 0.0, -10.0], abs=0.4)


def test_the_second_program_is_refused_until_the_first_is_silent(sky, program):
    second = Program(sky, port=2)  # the same ids, another address, as two MAVSDK programs are
    program.take_off(10.0)
    engage(sky, program, local(0, 0, -10))
    elsewhere = local(50, 50, -20)
    for _ in range(30):
        program.say(local(0, 0, -10))
        second.say(elsewhere)
        sky.fly(0.1)
    assert sky.ned == pytest.approx([0, 0, -10], abs=0.2)
    assert "another program is in control" in second.texts()
    assert len(second.of("STATUSTEXT")) <= 5, "it says so once a second, not at every setpoint"
    assert second.mode(*OFFBOARD) == m.MAV_RESULT_DENIED
    nowhere = (NAN, NAN, NAN, 40.0)
    assert second.command(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, *nowhere) == m.MAV_RESULT_DENIED
    assert second.command(m.MAV_CMD_NAV_TAKEOFF) == m.MAV_RESULT_DENIED
    assert second.command(m.MAV_CMD_MISSION_START) == m.MAV_RESULT_DENIED
    assert sky.pilot.mode.name == "OFFBOARD"
    sky.fly(1.2)
    assert sky.pilot.mode.name == "POSITION"
    engage(sky, second, elsewhere)
    assert program.mode(*OFFBOARD) == m.MAV_RESULT_DENIED


def test_whoever_asks_can_stop_it(sky, program):
    second = Program(sky, port=2)
    program.take_off(10.0)
    sky.fly(5.0)
    engage(sky, program, local(0, 0, -10))
    assert second.mode(*HOLD) == 0
    sky.fly_streaming(program, local(30, 0, -10), 3.0)
    assert sky.ned == pytest.approx([0, 0, -10], abs=0.3)
    engage(sky, program, local(0, 0, -10))
    assert second.mode(*LAND) == 0
    sky.fly(1.0)
    assert sky.pilot.landing


def test_the_owner_gives_control_up_by_leaving_the_mode(sky, program):
    second = Program(sky, port=2)
    program.take_off(10.0)
    engage(sky, program, local(0, 0, -10))
    assert program.mode(*HOLD) == 0
    engage(sky, second, local(5, 0, -10))


@pytest.mark.parametrize(
    "message",
    [
        local(NAN, NAN, NAN),
        local(1e30, 0, -5),
        local(float("inf"), 0, -5),
        local(0, 0, 0, VELOCITY_ONLY, velocity=(1e6, 0, 0)),
        local(0, 0, -5, 0b1111_1111_1111),
        local(0, 0, -5, frame=m.MAV_FRAME_BODY_NED),
        local(0, 0, -5, frame=99),
        m.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 6, POSITION_ONLY, 910_000_000, 0, 5, 0, 0, 0, 0, 0, 0, 0, 0
        ),
    ],
)
def test_a_setpoint_that_is_none_is_refused(sky, program, message):
    program.take_off(5.0)
    program.say(message)
    assert "Offboard denied" in program.texts() or "no such place" in program.texts()
    assert program.mode(*OFFBOARD) != 0
