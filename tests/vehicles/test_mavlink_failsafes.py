"""Who takes the vehicle from a program that flies it in Offboard, and how it gets it back, as on PX4."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mavlink_clients import (
    ALTITUDE,
    HOLD,
    LAND,
    OFFBOARD,
    POSITION,
    RETURN,
    STABILIZED,
    TERMINATION,
    VELOCITY_ONLY,
    Program,
    Sky,
    local,
    scenario,
)
from pymavlink.dialects.v20 import development as m

from skysweep.vehicles.mavlink.modes import STICK_MODES, TICK_S, PX4Mode
from skysweep.vehicles.served.failsafes import Failsafes, Health, Reaction, why_not
from skysweep.vehicles.served.parameters import Parameters

HERE = local(0, 0, -10)
CENTRED = (0, 0, 500, 0)


class Flight:
    """A program in Offboard 10 m up, a ground station, and what the station sees."""

    def __init__(self, **parameters: float) -> None:
        self.sky = Sky()
        self.pilot = self.sky.pilot
        self.program, self.station = Program(self.sky), Program(self.sky, port=2, system=255)
        for name, value in parameters.items():
            self.station.set(name, value)
            assert self.sky.face.parameters[name] == pytest.approx(value)
        self.station.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, m.MAVLINK_MSG_ID_CURRENT_MODE, TICK_S * 1e6)
        self.sticks: tuple[int, int, int, int] | None = None

    def engage(self) -> None:
        self.program.take_off(10.0)
        self.program.say(HERE)
        assert self.program.mode(*OFFBOARD) == 0
        self.stream(2.0)
        assert self.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE)

    def stream(self, seconds: float, message=HERE) -> None:
        self.silence(seconds, message)

    def silence(self, seconds: float, message=None) -> None:
        """Lets time pass without setpoints; the sticks are heard at 10 Hz all the same."""
        for i in range(round(seconds / TICK_S)):
            if i % 5 == 0:
                if message is not None:
                    self.program.say(message)
                if self.sticks is not None:
                    self.station.say(m.MAVLink_manual_control_message(1, *self.sticks, 0))
            self.sky.tick()

    def seen(self):
        """Mode, intended mode and system status, as the ground station is told."""
        current = self.station.of("CURRENT_MODE")[-1]
        self.station.forget()
        assert self.station.command(m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_HEARTBEAT) == 0
        (beat,) = [h for h in self.station.of("HEARTBEAT") if h.get_srcComponent() == 1]
        assert beat.custom_mode == current.custom_mode
        numbers = (current.custom_mode, current.intended_custom_mode)
        flown, intended = ((n >> 16 & 0xFF, n >> 24) for n in numbers)
        return flown, intended, beat.system_status

    @property
    def beat(self):
        self.station.forget()
        self.station.command(m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_HEARTBEAT)
        return self.station.of("HEARTBEAT")[-1]


@pytest.fixture
def flight():
    flight = Flight()
    flight.engage()
    return flight


# ---- the program falls silent ----------------------------------------------------------------------------

LOST = {0: POSITION, 1: ALTITUDE, 2: STABILIZED, 3: RETURN, 4: LAND, 5: HOLD}


@pytest.mark.parametrize(("action", "mode"), LOST.items())
def test_a_silent_program_gets_its_offboard_back_when_it_is_heard_again(action, mode):
    flight = Flight(COM_OBL_RC_ACT=action)
    flight.engage()
    flight.silence(0.8)
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE)
    flight.silence(0.4)
    assert "Offboard control lost" in flight.program.texts()
    assert flight.seen() == (mode, OFFBOARD, m.MAV_STATE_CRITICAL)
    flight.silence(3.0)
    flight.program.say(HERE)
    flight.silence(0.04)
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE)


@pytest.mark.parametrize("action", LOST)
@pytest.mark.parametrize("chosen", [HOLD, RETURN, LAND])
def test_a_mode_chosen_in_the_gap_stays_when_it_is_heard_again(action, chosen):
    flight = Flight(COM_OBL_RC_ACT=action)
    flight.engage()
    flight.silence(2.0)
    assert flight.station.mode(*chosen) == 0
    flight.silence(1.0)
    flight.stream(2.0)
    assert flight.seen() == (chosen, chosen, m.MAV_STATE_ACTIVE)
    assert flight.program.mode(*OFFBOARD) == 0
    flight.stream(0.1)
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE)


def test_offboard_is_refused_while_it_is_lost_and_comes_by_itself_later():
    flight = Flight(COM_OBL_RC_ACT=3)
    flight.engage()
    flight.silence(2.0)
    assert flight.program.mode(*OFFBOARD) == m.MAV_RESULT_TEMPORARILY_REJECTED
    flight.silence(1.0)
    assert flight.seen() == (RETURN, OFFBOARD, m.MAV_STATE_CRITICAL)
    flight.stream(0.1)
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE)


def test_com_obl_rc_act_6_terminates_for_good():
    flight = Flight(COM_OBL_RC_ACT=6)
    flight.engage()
    flight.silence(2.0)
    assert flight.seen() == (TERMINATION, OFFBOARD, m.MAV_STATE_FLIGHT_TERMINATION)
    assert flight.beat.base_mode == 129
    flight.stream(1.0)
    for mode in (OFFBOARD, HOLD, LAND):
        assert flight.program.mode(*mode) == m.MAV_RESULT_TEMPORARILY_REJECTED
    flight.sky.fly(until=lambda: not flight.pilot.armed)
    assert flight.beat.system_status == m.MAV_STATE_FLIGHT_TERMINATION
    assert flight.station.arm() == m.MAV_RESULT_TEMPORARILY_REJECTED


def test_com_obl_rc_act_7_disarms_and_it_comes_down():
    flight = Flight(COM_OBL_RC_ACT=7)
    flight.engage()
    flight.silence(1.2)
    assert not flight.pilot.armed
    assert flight.beat.base_mode == 17
    flight.stream(25.0)
    assert not flight.sky.vehicle.state().airborne


def test_on_the_ground_it_falls_back_too_and_disarms():
    flight = Flight()
    flight.program.say(local(0, 0, 0))
    assert flight.program.mode(*OFFBOARD) == 0
    assert flight.program.arm() == 0
    flight.silence(1.5)
    assert flight.seen() == (POSITION, OFFBOARD, m.MAV_STATE_CRITICAL)
    flight.silence(10.0)
    assert not flight.pilot.armed
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_UNINIT)


def test_it_takes_off_again_when_setpoints_are_back_before_it_has_disarmed():
    flight = Flight(COM_OBL_RC_ACT=4)
    flight.engage()
    flight.sky.fly(until=lambda: not flight.pilot.flying)
    assert flight.pilot.armed
    flight.stream(15.0)
    assert flight.sky.ned[2] == pytest.approx(-10.0, abs=0.3)


def test_a_gap_at_lift_off_delays_the_take_off():
    flight = Flight()
    flight.program.say(HERE)
    assert flight.program.mode(*OFFBOARD) == 0
    assert flight.program.arm() == 0
    flight.stream(0.3)
    flight.silence(1.6)
    assert flight.seen() == (POSITION, OFFBOARD, m.MAV_STATE_CRITICAL)
    flight.stream(15.0)
    assert flight.sky.ned[2] == pytest.approx(-10.0, abs=0.3)


def test_current_mode_comes_every_two_seconds_unless_asked(flight):
    flight.program.forget()
    flight.stream(10.0)
    assert len(flight.program.of("CURRENT_MODE")) == 5
    flight.program.command(m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_CURRENT_MODE)
    assert len(flight.program.of("CURRENT_MODE")) == 1


@pytest.mark.parametrize(("mode", "standard"), [(HOLD, 0), (RETURN, 5), (LAND, 7), (OFFBOARD, 0)])
def test_standard_modes(flight, mode, standard):
    assert flight.program.mode(*mode) == 0
    flight.stream(0.1)
    assert flight.station.of("CURRENT_MODE")[-1].standard_mode == standard


# ---- fence -----------------------------------------------------------------------------------------------

NORTH = local(0, 0, 0, VELOCITY_ONLY, velocity=(5.0, 0.0, 0.0))


def crossed(action: int, **parameters: float) -> Flight:
    """Just beyond a fence 15 m away."""
    flight = Flight(GF_ACTION=action, GF_MAX_HOR_DIST=15.0, **parameters)
    flight.sticks = CENTRED if parameters.get("COM_RC_OVERRIDE") else None
    flight.engage()
    while flight.sky.ned[0] < 15.0:
        flight.stream(0.1, NORTH)
    flight.stream(0.3, NORTH)
    return flight


def test_a_fence_that_only_warns_changes_nothing():
    flight = crossed(1)
    assert "Geofence" in flight.station.texts()
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE)


def test_the_fences_hold_stays_inside_again_until_the_mode_is_chosen_anew():
    flight = crossed(2)
    assert flight.seen() == (HOLD, OFFBOARD, m.MAV_STATE_CRITICAL)
    flight.stream(8.0)
    assert flight.sky.ned[0] < 26.0
    assert flight.program.mode(*OFFBOARD) == 0
    flight.stream(10.0)
    assert flight.sky.ned[0] == pytest.approx(0.0, abs=0.3)
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE)


def test_a_latched_hold_survives_the_way_back_in():
    flight = crossed(2)
    flight.program.set("GF_MAX_HOR_DIST", 0.0)
    flight.stream(3.0)
    assert flight.seen() == (HOLD, OFFBOARD, m.MAV_STATE_CRITICAL)


@pytest.mark.parametrize(("action", "mode"), [(3, RETURN), (5, LAND)])
def test_return_and_land_wait_in_hold_first(action, mode):
    flight = crossed(action)
    assert flight.seen() == (HOLD, OFFBOARD, m.MAV_STATE_CRITICAL)
    flight.stream(4.5)
    assert flight.seen() == (HOLD, OFFBOARD, m.MAV_STATE_CRITICAL)
    flight.stream(1.0)
    assert flight.seen() == (mode, OFFBOARD, m.MAV_STATE_CRITICAL)


def test_without_com_fail_act_t_nothing_waits():
    flight = crossed(3, COM_FAIL_ACT_T=0.0)
    assert flight.seen() == (RETURN, OFFBOARD, m.MAV_STATE_CRITICAL)


def test_a_mode_chosen_in_the_wait_ends_it():
    flight = crossed(3)
    assert flight.program.mode(*OFFBOARD) == 0
    flight.stream(1.0)
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE)
    assert flight.sky.ned[0] > 15.0, "it is outside still"


def test_gf_action_4_terminates():
    assert crossed(4).seen() == (TERMINATION, OFFBOARD, m.MAV_STATE_FLIGHT_TERMINATION)


def test_a_link_lost_in_the_fences_hold_brings_the_worse_action():
    flight = crossed(2, COM_OBL_RC_ACT=3)
    flight.silence(1.5)
    assert flight.seen() == (RETURN, OFFBOARD, m.MAV_STATE_CRITICAL)
    flight.stream(1.0, NORTH)
    assert flight.seen() == (HOLD, OFFBOARD, m.MAV_STATE_CRITICAL)


# ---- battery ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("action", "critical", "empty"), [(0, OFFBOARD, OFFBOARD), (2, LAND, LAND), (3, RETURN, LAND)]
)
def test_a_low_battery_does_what_com_low_bat_act_says(action, critical, empty):
    flight = Flight(COM_LOW_BAT_ACT=action)
    flight.engage()
    flight.pilot.battery_share = 0.12
    flight.stream(1.0)
    assert "Battery low" in flight.station.texts()
    assert flight.seen()[0] == OFFBOARD
    for share, mode in ((0.06, critical), (0.04, empty)):
        flight.pilot.battery_share = share
        flight.stream(0.5)
        assert flight.seen()[0] == (OFFBOARD if mode == OFFBOARD else HOLD), "it waits"
        flight.stream(5.0)
        assert flight.seen()[0] == mode
        assert flight.program.mode(*OFFBOARD) == 0
        flight.stream(3.0)
        assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE), "taken over"
    flight.station.command(m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_BATTERY_STATUS)
    assert flight.station.of("BATTERY_STATUS")[-1].battery_remaining == 4


def test_a_battery_that_recovers_in_flight_is_not_believed():
    flight = Flight()
    flight.engage()
    flight.pilot.battery_share = 0.06
    flight.stream(6.0)
    flight.pilot.battery_share = 0.9
    flight.stream(1.0)
    assert flight.seen() == (RETURN, OFFBOARD, m.MAV_STATE_CRITICAL)


# ---- no position -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("action", "mode"), [(0, ALTITUDE), (1, ALTITUDE), (3, LAND), (5, LAND)])
def test_without_gnss_it_flies_on_for_5_s_then_without_a_position(action, mode):
    flight = Flight(COM_OBL_RC_ACT=action)
    flight.engage()
    flight.pilot.gnss_lost = True
    flight.stream(4.5)
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE)
    flight.stream(1.0)
    assert flight.seen() == (mode, OFFBOARD, m.MAV_STATE_CRITICAL)
    assert flight.program.mode(*OFFBOARD) == flight.station.mode(*HOLD) == m.MAV_RESULT_TEMPORARILY_REJECTED
    flight.stream(1.0)
    assert flight.program.of("GPS_RAW_INT")[-1].fix_type == 0
    flags = flight.program.of("ESTIMATOR_STATUS")[-1].flags
    assert not flags & (m.ESTIMATOR_POS_HORIZ_ABS | m.ESTIMATOR_POS_HORIZ_REL | m.ESTIMATOR_VELOCITY_HORIZ)
    assert flags & m.ESTIMATOR_POS_VERT_ABS
    flight.pilot.gnss_lost = False
    flight.stream(1.5)
    assert flight.seen()[0] == mode
    flight.stream(1.0)
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE)


def test_land_can_always_be_chosen(flight):
    flight.pilot.gnss_lost = True
    flight.stream(6.0)
    assert flight.station.mode(*LAND) == 0
    flight.stream(1.0)
    assert flight.seen()[:2] == (LAND, LAND)
    assert flight.pilot.landing


# ---- a pilot ---------------------------------------------------------------------------------------------


def receiver(flight) -> tuple[bool, bool, bool]:
    """Present, enabled and healthy."""
    status = flight.program.of("SYS_STATUS")[-1]
    words = (
        status.onboard_control_sensors_present,
        status.onboard_control_sensors_enabled,
        status.onboard_control_sensors_health,
    )
    return tuple(bool(word & m.MAV_SYS_STATUS_SENSOR_RC_RECEIVER) for word in words)


@pytest.mark.parametrize(("override", "mode"), [(0, OFFBOARD), (1, OFFBOARD), (2, POSITION), (3, POSITION)])
def test_sticks_take_over_from_offboard_where_com_rc_override_says_so(override, mode):
    flight = Flight(COM_RC_OVERRIDE=override)
    flight.sticks = CENTRED
    flight.engage()
    assert receiver(flight) == (True, True, True)
    flight.sticks = (600, 0, 500, 0)
    flight.stream(0.5)
    assert flight.seen() == (mode, mode, m.MAV_STATE_ACTIVE)
    flight.stream(2.0)
    assert (flight.sky.ned[1] > 1.5) == (mode == POSITION), "it faces east"


def test_sticks_that_hardly_move_do_not_take_over():
    flight = Flight(COM_RC_OVERRIDE=3)
    flight.sticks = CENTRED
    flight.engage()
    for deflection in range(0, 100, 10):  # a tenth of the way in a second
        flight.sticks = (deflection, 0, 500, 0)
        flight.stream(0.1)
    assert flight.seen()[0] == OFFBOARD


def test_a_station_can_choose_position_where_there_are_sticks(flight):
    assert receiver(flight) == (False, True, False)
    assert flight.station.mode(*POSITION) == m.MAV_RESULT_TEMPORARILY_REJECTED
    assert "no manual control" in flight.station.texts()
    flight.sticks = CENTRED
    flight.stream(0.5)
    assert flight.station.mode(*POSITION) == 0
    flight.stream(0.5)
    assert flight.seen() == (POSITION, POSITION, m.MAV_STATE_ACTIVE)
    assert flight.beat.base_mode == 209


def test_a_pilot_who_is_lost_brings_hold_then_nav_rcl_act(flight):
    flight.sticks = CENTRED
    flight.stream(2.0)
    flight.sticks = None
    flight.stream(0.9)
    assert flight.seen()[0] == OFFBOARD
    flight.stream(0.5)
    assert flight.seen() == (HOLD, OFFBOARD, m.MAV_STATE_CRITICAL)
    assert receiver(flight) == (False, True, False)
    flight.stream(5.0)
    assert flight.seen() == (RETURN, OFFBOARD, m.MAV_STATE_CRITICAL)
    flight.sticks = CENTRED
    flight.stream(2.0)
    assert flight.seen() == (RETURN, OFFBOARD, m.MAV_STATE_CRITICAL), "latched"
    assert flight.program.mode(*OFFBOARD) == 0
    flight.stream(2.0)
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE)


@pytest.mark.parametrize(("parameter", "value"), [("COM_RCL_EXCEPT", 4), ("COM_RC_IN_MODE", 4)])
def test_a_lost_pilot_may_be_no_matter(parameter, value):
    flight = Flight()
    flight.sticks = CENTRED
    flight.engage()
    flight.program.set(parameter, value)
    flight.sticks = None
    flight.stream(8.0)
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_ACTIVE)


def test_sticks_end_a_failsafes_return_but_not_the_wait_before_it():
    flight = crossed(3, COM_RC_OVERRIDE=1)
    flight.sticks = (0, 500, 500, 0)
    flight.stream(0.5)
    assert flight.seen()[0] == HOLD
    flight.sticks = CENTRED
    flight.stream(5.5)
    assert flight.seen()[0] == RETURN
    flight.sticks = (0, 500, 500, 0)
    flight.stream(0.5)
    assert flight.seen() == (POSITION, POSITION, m.MAV_STATE_ACTIVE)


def test_sticks_do_not_end_the_fences_hold():
    flight = crossed(2, COM_RC_OVERRIDE=3)
    flight.sticks = (0, 500, 500, 0)
    flight.stream(1.0)
    assert flight.seen() == (HOLD, OFFBOARD, m.MAV_STATE_CRITICAL)


def test_the_program_does_not_get_back_what_sticks_took_in_its_gap():
    flight = Flight(COM_OBL_RC_ACT=3)
    flight.sticks = CENTRED
    flight.engage()
    flight.silence(2.0)
    flight.sticks = (900, 0, 500, 0)
    flight.silence(0.5)
    flight.sticks = CENTRED
    flight.stream(3.0)
    assert flight.seen() == (POSITION, POSITION, m.MAV_STATE_ACTIVE)


# ---- kill and termination --------------------------------------------------------------------------------


def test_a_kill_in_the_air_disarms_at_once_and_it_comes_down(flight):
    disarm = m.MAV_CMD_COMPONENT_ARM_DISARM
    assert flight.station.command(disarm, 0) == m.MAV_RESULT_TEMPORARILY_REJECTED
    assert flight.station.command(disarm, 0, 21196) == 0
    assert flight.beat.base_mode == 17
    assert flight.station.arm() == m.MAV_RESULT_TEMPORARILY_REJECTED
    assert "still coming down" in flight.station.texts()
    flight.stream(25.0)
    assert not flight.sky.vehicle.state().airborne
    assert flight.seen() == (OFFBOARD, OFFBOARD, m.MAV_STATE_STANDBY)
    assert flight.station.arm() == 0


def test_termination_by_command(flight):
    assert flight.station.command(m.MAV_CMD_DO_FLIGHTTERMINATION, 0) == m.MAV_RESULT_DENIED
    assert flight.station.command(m.MAV_CMD_DO_FLIGHTTERMINATION, 1) == 0
    flight.stream(0.5)
    assert flight.seen() == (TERMINATION, TERMINATION, m.MAV_STATE_FLIGHT_TERMINATION)


# ---- the rules, whatever happens -------------------------------------------------------------------------

HEALTH = st.builds(
    Health, st.booleans(), st.booleans(), st.booleans(), st.booleans(), st.integers(min_value=0, max_value=3)
)
ACTIONS = {
    "COM_OBL_RC_ACT": [0, 1, 2, 3, 4, 5, 6, 7],
    "GF_ACTION": [0, 1, 2, 3, 4, 5],
    "COM_LOW_BAT_ACT": [0, 1, 2, 3],
    "NAV_RCL_ACT": [1, 2, 3, 4, 5, 6],
    "COM_FAIL_ACT_T": [0.0, 0.5, 5.0],
}
STEPS = st.lists(
    st.tuples(
        HEALTH,
        st.sampled_from([None, *PX4Mode]),
        st.booleans(),
        st.sampled_from([0.0, 0.02, 1.0, 6.0]),
    ),
    max_size=15,
)


@given(st.fixed_dictionaries({name: st.sampled_from(values) for name, values in ACTIONS.items()}), STEPS)
def test_what_is_flown_can_be_flown_and_only_people_change_what_is_intended(chosen, steps):
    parameters = Parameters(scenario().vehicle)
    for name, value in chosen.items():
        assert parameters.set(name, value)
    failsafes, intended = Failsafes(parameters, lambda *_: None), PX4Mode.OFFBOARD
    fine = Health(False, False, False, False, 0)
    failsafes.update(True, intended, True, False, fine, 0.02)
    terminated = False
    for health, asked, sticks, elapsed_s in steps:
        wanted = asked or intended
        moved = sticks and failsafes.action > Reaction.WARN
        intended = failsafes.update(True, wanted, asked is not None, moved, health, elapsed_s)
        assert intended is wanted or (intended is PX4Mode.POSITION and moved)
        terminated |= failsafes.action is Reaction.TERMINATE
        assert terminated == (failsafes.action is Reaction.TERMINATE)
        flown = failsafes.mode(intended)
        if failsafes.action not in (Reaction.DESCEND, Reaction.DISARM):
            assert why_not(flown, health) is None or terminated
        if failsafes.action <= Reaction.WARN:
            assert flown is intended
    if not terminated:
        failsafes.update(False, intended, False, False, fine, 0.02)
        assert failsafes.action is Reaction.NONE or intended is PX4Mode.TERMINATION


@given(STEPS, st.sampled_from(STICK_MODES))
def test_a_stick_mode_needs_no_failsafe_while_the_pilot_is_there(steps, mode):
    failsafes = Failsafes(Parameters(scenario().vehicle), lambda *_: None)
    for health, *_ in steps:
        good = health._replace(sticks_lost=False, position_lost=False, outside_fence=False, battery_level=0)
        assert failsafes.update(True, mode, False, False, good, 0.02) is mode
        assert failsafes.mode(mode) is mode
