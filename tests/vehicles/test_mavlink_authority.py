"""Who is in command: nobody else poisons or takes the flight unseen, and a person can always take over."""

import numpy as np
import pytest
from mavlink_clients import HOLD, LAND, MISSION, OFFBOARD, POSITION, RETURN, Program, Sky, item, local
from pymavlink.dialects.v20 import common as m

DENIED = m.MAV_RESULT_DENIED
FENCE, RALLY, ALL = 1, 2, 255
NAN = float("nan")


class Flight:
    """A program's mission under way round a square, and another program."""

    def __init__(self) -> None:
        self.sky = Sky()
        self.pilot = self.sky.pilot
        self.owner, self.other = Program(self.sky), Program(self.sky, port=2, system=246)
        corners = ((40, 0), (40, 30), (0, 30), (0, 0))
        self.items = [item(self.sky, m.MAV_CMD_NAV_TAKEOFF, 0, 0, 12.0)]
        self.items += [item(self.sky, m.MAV_CMD_NAV_WAYPOINT, e, n, 12.0) for e, n in corners]
        self.items += [item(self.sky, m.MAV_CMD_DO_JUMP, params=(1.0, -1.0, 0.0, 0.0))]
        self.fence = [
            item(self.sky, m.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, 20, 15, params=(60.0, 0.0, 0.0, 0.0))
        ]
        assert self.owner.upload(self.fence, FENCE) == 0
        assert self.owner.upload(self.items) == 0
        assert self.owner.command(m.MAV_CMD_MISSION_START) == 0
        self.sky.fly(until=lambda: self.pilot.mission.current == 2)

    def sticks(self, seconds: float, forward: int = 0) -> None:
        """The other's, at 10 Hz."""
        for _ in range(round(seconds / 0.1)):
            self.other.say(m.MAVLink_manual_control_message(1, forward, 0, 500, 0, 0))
            self.sky.fly(0.1)


@pytest.fixture
def flight():
    return Flight()


@pytest.mark.parametrize(
    ("name", "value"),
    [("COM_OF_LOSS_T", 0.0), ("COM_OBL_RC_ACT", 7.0), ("GF_ACTION", 4.0), ("MPC_XY_VEL_MAX", 3.0)],
)
def test_parameters_of_a_flight_are_its_commanders(flight, name, value):
    before = flight.pilot.parameters[name]
    flight.other.set(name, value)
    assert "another program is in command" in flight.other.texts()
    assert flight.pilot.parameters[name] == before
    flight.owner.set(name, value)
    assert flight.pilot.parameters[name] == value


def test_on_the_ground_parameters_are_everybodys():
    sky = Sky()
    first, second = Program(sky), Program(sky, port=2)
    assert first.set("MIS_TAKEOFF_ALT", 7.0) == 7.0
    assert second.set("MIS_TAKEOFF_ALT", 8.0) == 8.0


def test_a_speed_with_which_nothing_comes_home_is_none(flight):
    assert flight.owner.set("MPC_XY_VEL_MAX", 0.0) == 12.0


def test_plans_fence_and_rally_points_of_a_flight_are_its_commanders(flight):
    elsewhere = item(flight.sky, m.MAV_CMD_NAV_WAYPOINT, -40, 0, 12.0)
    rally = item(flight.sky, m.MAV_CMD_NAV_RALLY_POINT, -40, 0, 0.0)
    circle = item(flight.sky, m.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, 20, 15, params=(60.0, 0.0, 0.0, 0.0))
    for kind, items in ((0, [elsewhere]), (FENCE, [circle]), (RALLY, [rally])):
        assert flight.other.upload(items, kind) == m.MAV_MISSION_DENIED
        assert flight.other.upload([], kind) == m.MAV_MISSION_DENIED
    for kind in (0, FENCE, ALL):
        (ack,) = flight.other.answers(m.MAVLink_mission_clear_all_message(1, 1, kind), "MISSION_ACK")
        assert ack.type == m.MAV_MISSION_DENIED
    assert [len(flight.owner.download(kind)) for kind in (0, FENCE, RALLY)] == [6, 1, 0]
    assert flight.pilot.mode.name == "MISSION"


def test_home_speed_and_item_of_a_flight_are_its_commanders(flight):
    home, speed, current = flight.pilot.home_enu_m, flight.pilot.cruise_mps, flight.pilot.mission.current
    place = flight.sky.geodetic([5.0, 5.0, 0.0])
    assert flight.other.command(m.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, *place) == DENIED
    assert flight.other.command(m.MAV_CMD_DO_SET_HOME, 1) == DENIED
    assert flight.other.command(m.MAV_CMD_DO_CHANGE_SPEED, 1, 0.001, -1) == DENIED
    assert flight.other.command(m.MAV_CMD_DO_SET_MISSION_CURRENT, 0) == DENIED
    flight.other.say(m.MAVLink_mission_set_current_message(1, 1, 0))
    assert (flight.pilot.cruise_mps, flight.pilot.mission.current) == (speed, current)
    assert flight.pilot.home_enu_m is home


def test_home_is_near_and_in_the_air_inside_the_fence(flight):
    far = flight.sky.geodetic([84_000.0, 0.0, 0.0])
    outside = flight.sky.geodetic([100.0, 0.0, 0.0])
    inside = flight.sky.geodetic([5.0, 5.0, 0.0])
    for place, result in ((far, DENIED), (outside, DENIED), (inside, 0)):
        assert flight.owner.command(m.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, *place) == result
    assert flight.owner.command(m.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    flight.sky.fly(until=lambda: not flight.pilot.armed)
    assert flight.sky.ned[:2] == pytest.approx([5.0, 5.0], abs=1.5)


def test_another_program_does_not_replace_the_mission_that_is_flown(flight):
    for _ in range(10):
        flight.other.say(local(50, 50, -20))
        flight.sky.fly(0.1)
    above = (NAN, NAN, NAN, 40.0)
    assert flight.other.mode(*OFFBOARD) == DENIED
    assert flight.other.mode(*MISSION) == DENIED
    assert flight.other.command(m.MAV_CMD_NAV_TAKEOFF) == DENIED
    assert flight.other.command(m.MAV_CMD_MISSION_START) == DENIED
    assert flight.other.command(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, *above) == DENIED
    assert flight.other.command(m.MAV_CMD_DO_CHANGE_ALTITUDE, 40.0, 3) == DENIED
    assert flight.pilot.mode.name == "MISSION"


@pytest.mark.parametrize("mode", [HOLD, RETURN, LAND])
def test_whoever_asks_can_stop_it_and_is_in_command_then(flight, mode):
    assert flight.other.mode(*mode) == 0
    assert flight.pilot.mode.value == mode
    assert flight.other.set("RTL_RETURN_ALT", 21.0) == 21.0
    assert flight.owner.set("RTL_RETURN_ALT", 22.0) == 21.0
    assert flight.owner.mode(*MISSION) == 0, "given back by nobody, and asked for by its own program"
    assert flight.owner.set("RTL_RETURN_ALT", 22.0) == 22.0


def test_in_hold_a_program_prepares_to_go_on_with_a_flight_that_another_holds(flight):
    assert flight.other.mode(*HOLD) == 0
    assert flight.owner.upload(flight.fence, FENCE) == 0
    assert flight.owner.upload(flight.items) == 0
    assert flight.owner.mode(*MISSION) == 0
    assert flight.other.upload(flight.fence, FENCE) == m.MAV_MISSION_DENIED


def test_whoever_asks_can_switch_it_off(flight):
    assert flight.other.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196) == 0
    assert not flight.pilot.armed


def test_sticks_take_over_from_a_mission_that_another_program_commands(flight):
    flight.sticks(0.2)
    flight.sticks(0.3, forward=600)
    assert flight.pilot.mode.name == "POSITION"
    assert flight.owner.set("RTL_RETURN_ALT", 21.0) == 30.0
    assert flight.owner.command(m.MAV_CMD_DO_SET_HOME, 1) == DENIED
    assert flight.other.set("RTL_RETURN_ALT", 22.0) == 22.0


def test_a_pilots_flight_by_sticks_is_replaced_by_nobody_until_he_lets_go(flight):
    stranger, up = Program(flight.sky, port=3, system=77), flight.sky.geodetic([40.0, 40.0, -20.0])
    flight.sticks(0.2)
    flight.sticks(2.0, forward=600)
    flight.sticks(0.3)  # he brakes
    for program in (flight.owner, stranger):
        program.say(local(50, 50, -20))
        for mode in (MISSION, OFFBOARD):
            assert program.mode(*mode) == DENIED
        assert program.command(m.MAV_CMD_NAV_TAKEOFF) == DENIED
        assert program.command(m.MAV_CMD_MISSION_START) == DENIED
        assert program.command(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, *up) == DENIED
        assert program.command(m.MAV_CMD_DO_CHANGE_ALTITUDE, 40.0, 3) == DENIED
    assert flight.pilot.mode.name == "POSITION"
    flight.sticks(1.5)
    assert flight.owner.set("RTL_RETURN_ALT", 21.0) == 30.0, "he still commands"
    assert flight.owner.mode(*MISSION) == 0
    assert flight.owner.set("RTL_RETURN_ALT", 21.0) == 21.0


def test_whoever_flies_by_sticks_commands_also_where_another_chose_the_mode(flight):
    flight.sticks(0.2)
    assert flight.owner.mode(*POSITION) == 0
    flight.sticks(0.2)
    assert flight.owner.set("RTL_RETURN_ALT", 21.0) == 21.0
    flight.sticks(0.5, forward=300)
    assert flight.owner.set("RTL_RETURN_ALT", 22.0) == 21.0
    flight.sticks(1.0)
    assert flight.owner.mode(*HOLD) == 0
    flight.sticks(0.2)
    assert flight.owner.set("RTL_RETURN_ALT", 22.0) == 22.0


def test_sticks_that_may_not_take_over_do_not_command(flight):
    assert flight.owner.set("COM_RC_OVERRIDE", 0.0) == 0.0
    flight.sticks(0.2)
    flight.sticks(0.5, forward=600)
    assert flight.pilot.mode.name == "MISSION"
    assert flight.owner.set("RTL_RETURN_ALT", 21.0) == 21.0


def test_sticks_on_the_ground_keep_no_program_from_taking_off():
    sky = Sky()
    program, pilot = Program(sky), Program(sky, port=2, system=255)
    for _ in range(10):
        pilot.say(m.MAVLink_manual_control_message(1, 0, 0, 0, 0, 0))  # throttle down
        sky.fly(0.1)
    assert sky.pilot.mode.value == POSITION
    assert program.arm() == 0
    assert program.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, NAN) == 0


def test_whoever_terminates_the_flight_commands(flight):
    assert flight.other.command(m.MAV_CMD_DO_FLIGHTTERMINATION, 1) == 0
    assert flight.other.set("RTL_RETURN_ALT", 21.0) == 21.0
    assert flight.owner.set("RTL_RETURN_ALT", 22.0) == 21.0


def test_a_program_that_is_gone_is_not_in_command(flight):
    flight.owner.beats = False
    flight.sky.fly(4.0)
    assert flight.other.set("RTL_RETURN_ALT", 21.0) == 30.0
    flight.sky.fly(2.0)
    assert flight.other.set("RTL_RETURN_ALT", 21.0) == 21.0
    assert flight.pilot.mode.name == "MISSION"


def test_after_landing_nobody_is_in_command(flight):
    assert flight.owner.mode(*LAND) == 0
    flight.sky.fly(until=lambda: not flight.pilot.armed)
    assert flight.other.set("RTL_RETURN_ALT", 21.0) == 21.0


def test_however_short_its_time_out_a_second_program_does_not_slip_into_offboard():
    sky = Sky()
    owner, other = Program(sky), Program(sky, port=2)
    owner.take_off(10.0)
    owner.say(local(0, 0, -10))
    assert owner.mode(*OFFBOARD) == 0
    assert sky.face.parameters.set("COM_OF_LOSS_T", 0.0)
    for _ in range(30):
        owner.say(local(0, 0, -10))
        sky.fly(0.06)
        other.say(local(50, 50, -20))
        sky.fly(0.04)
    assert np.hypot(*sky.ned[:2]) < 0.5
    assert other.mode(*OFFBOARD) == DENIED


def test_a_stream_of_setpoints_does_not_keep_the_program_in_command_out_of_offboard():
    sky = Sky()
    owner, other = Program(sky), Program(sky, port=2)
    other.say(local(50, 50, -20))
    owner.take_off(10.0)
    for i in range(100):
        other.say(local(50, 50, -20))
        owner.say(local(0, 0, -10))
        if i == 10:
            assert owner.mode(*OFFBOARD) == 0
        sky.fly(0.1)
    assert sky.pilot.mode.name == "OFFBOARD"
    assert np.hypot(*sky.ned[:2]) < 0.5
