"""What must not be possible between our program, a pilot and PX4's failsafes: sequences that once were."""

import os
import time
from types import SimpleNamespace

import numpy as np
import pytest
from look_alike import LookAlike
from takeovers import ALTITUDE, HOLD, LAND, OFFBOARD, POSITION, RETURN

from skysweep.cli.fly import _Operator
from skysweep.cli.live import PageOrders
from skysweep.cli.terminal import enter_pressed, has_keyboard
from skysweep.errors import UserError
from skysweep.mission.orders import CONTINUE, TAKE_BACK, Order
from skysweep.types import Mode, Setpoint
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.px4.link import message_id

FAR = Setpoint(np.array([80.0, 0.0, 12.0]), 5.0, 0.0)


def in_offboard(on_loss=5):
    """Flies to a far place, 12 m up."""
    there = LookAlike(on_loss)
    there.vehicle.takeoff(12.0)
    run(there, 60.0, lambda: there.vehicle.state().position_enu_m[2] > 10.5)
    run(there, 3.0)
    assert there.flown() == (OFFBOARD, True)
    return there


def run(there, seconds, until=lambda: False):
    """As a mission does; the modes that the vehicle flew, each change once."""
    modes, end_s = [there.flown()[0]], there.now_s() + seconds
    while there.now_s() < end_s and not until():
        if not there.vehicle.state().taken_over:
            there.vehicle.command(FAR)
        there.wait(0.1)
        if there.flown()[0] != modes[-1]:
            modes.append(there.flown()[0])
    return modes


@pytest.mark.parametrize("on_loss", [3, 4, 5])
def test_a_link_that_px4_alone_does_not_hear_does_not_make_it_go_to_and_fro(on_loss):
    there = in_offboard(on_loss)
    link = there.vehicle.link
    say, link._say = link._say, lambda _message: None
    run(there, 8.0)
    assert there.vehicle.state().taken_over
    link._say = say
    assert len(run(there, 30.0)) <= 2


@pytest.mark.parametrize("ends", [False, True])
def test_the_end_of_the_program_does_not_end_a_failsafe(ends):
    there = in_offboard()
    there.fail("low battery")
    run(there, 40.0, lambda: there.flown()[0] == HOLD)
    there.wait(0.5)
    there.orders()
    if ends:
        there.vehicle.close()
        assert there.orders() == []
    for _ in range(1000):
        there.sky.face.tick()
    assert there.flown()[0] in (RETURN, LAND)


def stand_still(there, seconds, meanwhile=lambda _passed_s: None):
    """Our program does not run for a while, as after Ctrl-Z; what it is sent waits in its socket."""
    link = there.vehicle.link
    tick, link.tick = link.tick, lambda: None
    begun_s = there.now_s()
    while (passed_s := there.now_s() - begun_s) < seconds - 1e-6:
        meanwhile(passed_s)
        for other in link.others:
            other()
        there.sky.face.tick()
    link.tick = tick
    del link._inbox[60:]  # a socket holds the oldest
    pass_time, there.sky.face.tick = there.sky.face.tick, lambda: None
    link.tick()  # the thread that receives is the first to wake, then the one that streams
    there.sky.face.tick = pass_time


def test_a_pilot_who_took_it_while_our_program_stood_still_keeps_it():
    there = in_offboard(on_loss=0)
    stand_still(there, 6.0, lambda passed_s: passed_s > 0.5 and there.sticks(moving=passed_s > 3.5))
    assert there.flown()[0] == POSITION
    assert run(there, 6.0) == [POSITION]
    assert there.vehicle.state().taken_over


def test_what_landed_while_our_program_stood_still_stays_down():
    there = in_offboard(on_loss=4)
    stand_still(there, 30.0)
    assert not there.flown()[1]
    run(there, 6.0)
    assert not there.flown()[1]
    assert there.vehicle.state().taken_over


def test_a_flight_goes_on_after_our_program_stood_still():
    there = in_offboard(on_loss=5)
    stand_still(there, 4.0)
    assert there.flown()[0] == HOLD  # PX4's failsafe
    assert run(there, 6.0)[-1] == OFFBOARD
    assert not there.vehicle.state().taken_over


def test_a_pilot_who_insists_is_not_asked_twice():
    there = in_offboard()
    there.sticks(moving=False)
    there.wait(0.3)
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)
    there.wait(2.0)
    assert there.vehicle.state().taken_over
    entered = []

    def insists():
        if there.flown()[0] == OFFBOARD:
            entered.append(there.now_s())
            there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)

    there.vehicle.link.others.append(insists)
    assert there.vehicle.regain().endswith("say take back again")
    there.wait(1.0)
    assert 1 <= len(entered) <= 2
    assert there.vehicle.state().taken_over


def found_in_hold():
    """A vehicle that another program left in Hold, 12 m up."""
    there = in_offboard()
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *HOLD)
    there.wait(2.0)
    there.sticks(moving=False)
    there.connect()
    there.vehicle.begins_in_air = True
    there.wait(0.5)
    return there


def test_what_landed_since_the_list_is_not_armed_again():
    there = found_in_hold()
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *LAND)
    while there.flown()[1]:
        there.wait(1.0)
    there.orders()
    with pytest.raises(UserError, match="landed since the preflight list"):
        there.vehicle.takeoff(12.0)
    assert there.orders() == []


def test_what_a_pilot_armed_or_flies_is_not_taken():
    there = LookAlike(5)
    there.sticks(moving=False)
    there.wait(0.5)
    there.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    there.wait(1.0)
    with pytest.raises(UserError, match="armed already"):
        there.vehicle.takeoff(12.0)
    nan = float("nan")
    there.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, nan)
    there.wait(8.0)
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)
    there.wait(1.0)
    with pytest.raises(UserError, match="somebody flies the vehicle in Position"):
        there.vehicle.takeoff(12.0)
    assert there.flown()[0] == POSITION


def test_a_program_that_ends_before_lift_off_does_not_leave_a_vehicle_that_takes_off():
    there = LookAlike(5)

    class Ended(BaseException):
        pass

    def ends():
        if there.flown()[1]:
            there.vehicle.link.others.remove(ends)
            raise Ended

    there.vehicle.link.others.append(ends)
    with pytest.raises(Ended):
        there.vehicle.takeoff(12.0)
    there.vehicle.close()
    for _ in range(1500):
        there.sky.face.tick()
    assert there.sky.pilot.state.position_enu_m[2] < 2.0


def test_a_landed_vehicle_is_not_regained():
    there = in_offboard()
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *LAND)
    run(there, 90.0, lambda: not there.vehicle.state().airborne)
    there.wait(2.0)
    there.orders()
    there.vehicle.regain()
    assert there.orders() == []


def taken_in(mode, on_loss=5):
    """A ground station has chosen this mode, two seconds ago."""
    there = in_offboard(on_loss)
    there.sticks(moving=False)
    there.wait(0.3)
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *mode)
    there.wait(2.0)
    there.orders()
    return there


def test_who_has_it_is_told_anew_when_somebody_else_takes_it():
    there = taken_in(HOLD)
    assert there.vehicle.state().taken_over == "it is in Hold: somebody chose that"
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)
    there.wait(1.0)
    assert there.vehicle.state().taken_over == "it is in Position: somebody chose that"
    there.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0)
    there.wait(2.0)
    assert there.vehicle.state().taken_over in ("its motors were stopped", "it was disarmed")


def test_it_is_taken_back_only_from_whom_the_person_has_read_of():
    there = taken_in(HOLD)
    held = there.vehicle.state().taken_over
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)
    there.wait(0.3)
    assert "since then somebody else took the vehicle (it is in Position" in there.vehicle.regain(held)
    assert "just now (it is in Position" in there.vehicle.regain()
    there.wait(2.0)
    assert "since then somebody else took the vehicle" in there.vehicle.regain(held)
    assert there.orders() == []
    assert there.flown() == (POSITION, True)
    flies = there.vehicle.state().taken_over
    assert there.vehicle.regain(flies) == ""
    assert there.flown() == (OFFBOARD, True)
    assert "nobody else flies the vehicle" in there.vehicle.regain(flies)


def test_who_takes_it_while_it_is_taken_back_keeps_it():
    there = taken_in(HOLD)
    link, begun_s = there.vehicle.link, there.now_s()

    def pilot():
        if there.now_s() >= begun_s + 0.1:
            link.others.remove(pilot)
            there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)

    there.vehicle._offboard.stop()  # it has to send setpoints for a while, first
    link.others.append(pilot)
    assert "somebody keeps the vehicle (it is in Position" in there.vehicle.regain()
    there.wait(3.0)
    assert there.flown() == (POSITION, True)
    assert there.vehicle.state().taken_over
    assert there.orders() == []


def test_what_is_not_heard_is_not_taken_back():
    there = taken_in(HOLD)
    there.cut(3.0)
    there.wait(1.0)
    assert there.vehicle.regain() == "the vehicle is not heard; say it again when it is"
    there.wait(5.0)
    assert there.flown() == (HOLD, True)
    assert there.vehicle.regain() == ""
    assert there.flown() == (OFFBOARD, True)


def test_what_stands_with_its_motors_running_is_not_taken_back():
    there = taken_in(LAND)
    run(there, 90.0, lambda: not there.vehicle.state().airborne)
    assert there.flown()[1]
    assert "its motors run on the ground" in there.vehicle.regain()
    assert there.orders() == []


class State:
    def __init__(self, taken_over):
        self.taken_over, self.waits, self.airborne = taken_over, "", True


def test_an_old_enter_does_not_take_the_vehicle_back(monkeypatch, tmp_path):
    ours, terminal = os.openpty()
    with os.fdopen(terminal) as keyboard:
        monkeypatch.setattr("sys.stdin", keyboard)
        operator = _Operator(tmp_path, PageOrders())
        operator.look(State(""), Mode.SCAN)
        os.write(ours, b"\n")
        time.sleep(0.1)
        assert operator() is None
        operator.look(State("it is in Position"), Mode.HOLD)
        os.write(ours, b"\n")
        time.sleep(0.1)
        assert operator() is None
        time.sleep(1.1)
        assert operator() is None
        os.write(ours, b"\n")
        time.sleep(0.1)
        assert operator() == Order(TAKE_BACK, holder="it is in Position")
    os.close(ours)


def test_enter_says_on_the_ground_that_the_battery_was_changed(monkeypatch, tmp_path):
    ours, terminal = os.openpty()
    with os.fdopen(terminal) as keyboard:
        monkeypatch.setattr("sys.stdin", keyboard)
        operator = _Operator(tmp_path, PageOrders())
        operator.look(State(""), Mode.LAND)
        operator.look(State(""), Mode.SWAP)
        assert "change the battery" in operator.hint
        os.write(ours, b"\n")
        time.sleep(0.1)
        assert operator() is None  # pressed before it could be read
        time.sleep(1.1)
        assert operator() is None
        os.write(ours, b"\n")
        time.sleep(0.1)
        assert operator() == Order(CONTINUE)
    os.close(ours)


def test_without_a_keyboard_nobody_can_say_that_the_battery_was_changed(monkeypatch, tmp_path):
    with open(os.devnull) as nobody:
        monkeypatch.setattr("sys.stdin", nobody)
        with pytest.raises(UserError, match=r"landed for another battery.*skysweep fly "):
            _Operator(tmp_path, PageOrders()).look(State(""), Mode.SWAP)
        _Operator(tmp_path, PageOrders(SimpleNamespace(is_there=True))).look(State(""), Mode.SWAP)


@pytest.mark.parametrize("in_the_gap", [True, False])
def test_a_flight_goes_on_only_after_the_link_is_heard(in_the_gap):
    """A pilot takes it in a gap in which our program begins, or nobody does."""
    there = found_in_hold()
    there.cut(3.0)
    there.wait(0.7)
    there.orders()
    took_s, taken = there.now_s() + 1.0, []

    def pilot():
        if in_the_gap and there.now_s() >= took_s and not taken:
            taken.append(there.now_s())
            there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)

    there.vehicle.link.others.append(pilot)
    if in_the_gap:
        with pytest.raises(UserError, match="somebody flies the vehicle in Position"):
            there.vehicle.takeoff(12.0)
        there.wait(5.0)
        assert there.flown() == (POSITION, True)
    else:
        there.vehicle.takeoff(12.0)
        assert there.flown() == (OFFBOARD, True)
        assert not there.vehicle.state().taken_over


def test_a_vehicle_that_stays_silent_is_ordered_nothing():
    there = found_in_hold()
    there.cut(100.0)
    there.wait(0.7)
    there.orders()
    with pytest.raises(UserError, match="is silent"):
        there.vehicle.takeoff(12.0)
    assert there.orders() == []


def test_what_somebody_took_before_the_first_order_is_theirs():
    there = found_in_hold()
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)
    there.wait(1.0)
    there.orders()
    there.vehicle.command(FAR)
    assert there.vehicle.authority.lost()
    there.vehicle.land()
    there.wait(2.0)
    assert there.orders() == []
    assert there.flown()[0] == POSITION


def test_a_flight_that_goes_on_in_the_air_takes_off_again_after_a_landing():
    there = found_in_hold()
    there.vehicle.takeoff(12.0)
    there.vehicle.land()
    while there.flown()[1]:
        there.wait(1.0)
    there.wait(5.0)
    there.vehicle.takeoff(12.0)
    assert there.vehicle.state().airborne


def test_no_order_is_repeated_to_a_vehicle_that_is_not_heard():
    """A pilot may have taken it meanwhile."""
    there = in_offboard()
    link, ordered_s = there.vehicle.link, []
    send, hear = link.send, link.hear

    def sends(name, **fields):
        if name == "COMMAND_LONG" and fields["command"] == m.MAV_CMD_DO_SET_MODE:
            ordered_s.append(there.now_s())
        send(name, **fields)

    link.send = sends
    link.hear = lambda data: None if ordered_s and there.now_s() < ordered_s[0] + 8.0 else hear(data)
    there.sticks(moving=False)

    def pilot():
        if ordered_s and there.now_s() >= ordered_s[0] + 2.0:
            link.others.remove(pilot)
            there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)

    link.others.append(pilot)
    there.vehicle.land()
    there.wait(12.0)
    assert len(ordered_s) == 1
    assert there.flown() == (POSITION, True)
    assert there.vehicle.state().taken_over


@pytest.mark.parametrize("on_loss", [3, 5])
@pytest.mark.parametrize("gap_s", [0.8, 3.0, 8.0])
def test_an_order_to_land_that_a_gap_swallows_is_given_after_it(on_loss, gap_s):
    """PX4 does meanwhile what it does without us, which is nobody's choice."""
    there = in_offboard(on_loss)
    there.cut(gap_s)
    there.vehicle.land()
    end_s = there.now_s() + 90.0
    while there.flown()[1] and there.now_s() < end_s:
        there.wait(0.5)
    assert there.flown()[1] is False
    assert not there.vehicle.state().taken_over


@pytest.mark.parametrize("mode", [HOLD, RETURN, POSITION])
def test_who_takes_it_in_the_gap_that_swallows_an_order_to_land_keeps_it(mode):
    there = in_offboard()
    there.sticks(moving=False)
    there.wait(0.3)
    there.cut(4.0)
    took_s = there.now_s() + 2.0

    def pilot():
        if there.now_s() >= took_s:
            there.vehicle.link.others.remove(pilot)
            there.command(m.MAV_CMD_DO_SET_MODE, 1, *mode)

    there.vehicle.link.others.append(pilot)
    there.vehicle.land()
    for _ in range(100):
        there.wait(0.1)
    assert there.flown()[0] == mode
    assert there.vehicle.state().taken_over


def test_the_camera_of_a_vehicle_that_somebody_flies_is_left_alone():
    there = in_offboard()
    link = there.vehicle.link
    link.orders.clear()
    there.connect()
    assert there.vehicle.gimbal
    there.wait(2.0)
    there.vehicle.close()
    of_the_camera = {m.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, m.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW}
    assert not of_the_camera & set(link.orders)


def test_a_pilot_who_flies_may_turn_the_camera():
    there = in_offboard()
    there.sticks(moving=False)
    there.wait(0.3)
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)
    there.wait(1.0)
    assert there.vehicle.state().taken_over
    there.sky.face.payload._look(0.2)
    there.vehicle.link.orders.clear()
    there.wait(4.0)
    assert there.vehicle.telemetry.gimbal_is_off
    assert m.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW not in there.vehicle.link.orders


def test_a_simulator_that_was_paused_is_heard_when_it_runs():
    there = LookAlike(5)
    link, told = there.vehicle.link, there.vehicle.telemetry
    now_s, paused_s = link.now_s, [0.0]
    link.now_s = lambda: now_s() + paused_s[0]
    there.wait(2.0)
    paused_s[0] = 600.0
    there.wait(1.0)
    ended_s = told.silence.until_s
    assert ended_s > 600.0
    there.wait(3.0)
    assert told.silence.until_s == ended_s


def test_two_vehicles_of_one_system_id_are_not_flown_together():
    there = LookAlike(5)
    link = there.vehicle.link

    def fly_with_another():
        for _ in range(12):
            said = link.newest("LOCAL_POSITION_NED")
            link._take("LOCAL_POSITION_NED", {**said, "time_boot_ms": said["time_boot_ms"] - 503})
            there.wait(0.1)

    with pytest.raises(UserError, match="two vehicles with the system id 1"):
        fly_with_another()


def test_a_message_that_comes_twice_is_of_one_vehicle():
    there = LookAlike(5)
    link = there.vehicle.link
    for _ in range(40):
        there.wait(0.1)
        before = dict(link.newest("LOCAL_POSITION_NED"))
        there.wait(0.1)
        link._take("LOCAL_POSITION_NED", before)
    there.vehicle.advance(0.1)


def test_a_program_in_the_background_reads_no_keys(monkeypatch):
    ours, theirs = os.openpty()
    with open(theirs, encoding="ascii") as keyboard:
        monkeypatch.setattr("sys.stdin", keyboard)
        os.write(ours, b"\n")
        time.sleep(0.1)
        monkeypatch.setattr("os.tcgetpgrp", lambda _descriptor: os.getpgrp() + 1)
        assert not enter_pressed()
        monkeypatch.setattr("os.tcgetpgrp", lambda _descriptor: os.getpgrp())
        assert enter_pressed()


def test_a_program_without_standard_input_has_no_keyboard(monkeypatch):
    monkeypatch.setattr("sys.stdin", None)
    assert not has_keyboard()
    assert not enter_pressed()


def taken_while_arming(after_s, take, lost_s=0.0):
    """Somebody acts that long after our arming; a take-off order is lost for ``lost_s``."""
    there = LookAlike(5)
    there.sticks(moving=False)
    there.wait(1.0)
    link, at_s = there.vehicle.link, {}
    say = link._say

    def loses(message):
        is_take_off = message.get_type() == "COMMAND_LONG" and message.command == m.MAV_CMD_NAV_TAKEOFF
        if not is_take_off or there.now_s() >= at_s.setdefault("take-off", there.now_s()) + lost_s:
            say(message)

    def somebody():
        if there.flown()[1] and there.now_s() >= at_s.setdefault("armed", there.now_s()) + after_s:
            link.others.remove(somebody)
            take(there)
            at_s["taken"] = len(link.orders)

    link._say = loses
    link.others.append(somebody)
    with pytest.raises(UserError, match="take off"):
        there.vehicle.takeoff(12.0)
    assert m.MAV_CMD_COMPONENT_ARM_DISARM not in link.orders[at_s["taken"] :]
    there.orders()
    there.vehicle.close()
    assert there.orders() == []
    return there


@pytest.mark.parametrize(("lost_s", "after_s"), [(0.0, 0.02), (0.0, 0.3), (20.0, 3.0)])
def test_who_disarms_it_after_our_arming_is_not_overruled(lost_s, after_s):
    def disarm(there):
        there.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0)

    there = taken_while_arming(after_s, disarm, lost_s)
    assert not there.flown()[1]
    assert "disarmed" in there.vehicle.authority.theirs


@pytest.mark.parametrize("mode", [ALTITUDE, LAND])
def test_who_chooses_a_mode_after_our_arming_keeps_it(mode):
    there = taken_while_arming(0.3, lambda there: there.command(m.MAV_CMD_DO_SET_MODE, 1, *mode))
    assert there.flown()[0] == mode
    assert there.vehicle.authority.theirs


def test_an_order_to_arm_that_was_lost_is_given_again():
    there = LookAlike(5)
    link, lost = there.vehicle.link, []
    say = link._say

    def loses(message):
        if (
            message.get_type() == "COMMAND_LONG"
            and message.command == m.MAV_CMD_COMPONENT_ARM_DISARM
            and not lost
        ):
            lost.append(message)
        else:
            say(message)

    link._say = loses
    there.vehicle.takeoff(12.0)
    assert lost
    assert there.vehicle.state().airborne


def lost_by_px4_alone(seconds):
    """In Offboard again, by itself, after a time in which only PX4 heard nothing."""
    there = in_offboard()
    there.sticks(moving=False)
    link = there.vehicle.link
    say, link._say = link._say, lambda _message: None
    run(there, seconds)
    assert "in Hold" in there.vehicle.state().taken_over
    link._say = say
    return there


def test_what_px4_flies_on_our_setpoints_again_hovers_and_waits_for_a_word():
    there = lost_by_px4_alone(6.0)
    run(there, 10.0, lambda: not there.vehicle.state().taken_over)
    assert there.flown()[0] == OFFBOARD
    assert "until a person says continue" in there.vehicle.state().waits
    there.wait(3.0)
    place = there.vehicle.state().position_enu_m
    there.wait(10.0)
    assert np.linalg.norm(there.vehicle.state().position_enu_m - place) < 1.0
    there.vehicle.command(FAR)
    there.wait(5.0)
    state = there.vehicle.state()
    assert not state.waits
    assert np.linalg.norm(state.position_enu_m - place) > 5.0


def test_what_px4_flies_again_is_landed_where_the_battery_demands_it():
    there = lost_by_px4_alone(6.0)
    run(there, 10.0, lambda: not there.vehicle.state().taken_over)
    there.vehicle.land()
    run_out_s = there.now_s() + 60.0
    while there.flown()[1] and there.now_s() < run_out_s:
        there.wait(0.5)
    assert not there.flown()[1]


@pytest.mark.parametrize("mode", [POSITION, HOLD])
def test_what_a_person_took_from_a_failsafe_is_not_ours_in_offboard_either(mode):
    there = lost_by_px4_alone(6.0)
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *mode)
    there.wait(1.0)
    assert there.flown()[0] == mode
    there.orders()
    there.station.command(m.MAV_CMD_DO_SET_MODE, 1, *OFFBOARD)
    there.wait(10.0)
    state = there.vehicle.state()
    assert state.taken_over
    assert not state.waits
    assert there.orders() == []


def jumped(there, seconds, east_m):
    """The vehicle tells a false place for so long."""
    link, until_s = there.vehicle.link, there.now_s() + seconds
    take = link._take

    def falsely(name, fields):
        if name == "LOCAL_POSITION_NED" and there.now_s() < until_s:
            fields = fields | {"y": fields["y"] + east_m}
        take(name, fields)

    link._take = falsely


@pytest.mark.parametrize("east_m", [60.0, 5e6])
def test_a_hover_never_aims_at_a_place_that_was_told_in_a_jump(east_m):
    there = in_offboard()
    there.vehicle.hold()
    there.wait(5.0)
    place = np.array(there.sky.vehicle.true_position_enu_m)
    jumped(there, 4.0, east_m)
    there.wait(0.2)
    there.vehicle.hold()
    for _ in range(60):
        there.wait(1.0)
        assert np.linalg.norm(there.sky.vehicle.true_position_enu_m - place) < 3.0
    assert there.flown()[0] == OFFBOARD


MODES = {message_id("HEARTBEAT"), message_id("CURRENT_MODE")}


@pytest.mark.parametrize("word", ["land", "close"])
def test_no_mode_is_ordered_from_one_that_was_heard_long_ago(word):
    """Positions come, modes do not: a pilot has had the vehicle for half a minute."""
    there = in_offboard()
    there.sticks(moving=False)
    there.wait(0.3)
    hear = there.vehicle.link.hear
    there.vehicle.link.hear = lambda data: (
        None if int.from_bytes(data[7:10], "little") in MODES else hear(data)
    )
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)
    run(there, 30.0)
    there.orders()
    getattr(there.vehicle, word)()
    there.wait(1.0)
    assert there.orders() == []
    assert there.flown() == (POSITION, True)


def test_a_pilot_just_before_an_order_is_heard_first():
    """As a PX4 that tells its mode once a second."""
    there = in_offboard()
    there.sticks(moving=False)
    there.wait(0.3)
    hear = there.vehicle.link.hear
    there.vehicle.link.hear = lambda data: (
        None if int.from_bytes(data[7:10], "little") == message_id("CURRENT_MODE") else hear(data)
    )
    run(there, 2.0)
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)
    there.wait(0.05)
    there.orders()
    there.vehicle.land()
    there.wait(0.5)
    assert m.MAV_CMD_DO_SET_MODE not in there.orders()
    assert there.flown() == (POSITION, True)


@pytest.mark.parametrize("after_s", [0.02, 0.1, 0.18])
def test_a_pilot_between_hold_and_offboard_keeps_the_vehicle(after_s):
    """A flight is gone on with in the air; PX4 takes setpoints for a moment before Offboard is ordered."""
    there = found_in_hold()
    there.orders()
    began = []

    def pilot():
        if not began and there.vehicle._offboard._end is not None:
            began.append(there.now_s())
        if began and there.now_s() >= began[0] + after_s:
            there.vehicle.link.others.remove(pilot)
            there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)

    there.vehicle.link.others.append(pilot)
    there.vehicle.takeoff(12.0)
    there.wait(1.0)
    assert m.MAV_CMD_DO_SET_MODE not in there.orders()
    assert there.flown() == (POSITION, True)
    assert "it is in Position" in there.vehicle.state().taken_over
