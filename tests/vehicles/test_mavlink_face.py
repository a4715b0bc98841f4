"""What a ground station sees and orders: heartbeat, telemetry, parameters, arming, modes."""

import struct

import numpy as np
import pytest
from mavlink_clients import (
    ALTITUDE,
    HOLD,
    LAND,
    MISSION,
    OFFBOARD,
    POSITION,
    RETURN,
    STABILIZED,
    TERMINATION,
    Program,
    Sky,
    scenario,
)
from pymavlink.dialects.v20 import common as m

from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.mavlink.wire import Voice
from skysweep.vehicles.served.face import Face

NAN = float("nan")


@pytest.fixture
def sky():
    return Sky()


@pytest.fixture
def gcs(sky):
    program = Program(sky)
    program.say(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    return program


def test_the_heartbeat_is_that_of_a_px4_quadrotor(sky, gcs):
    sky.fly(5.0)
    beats = [b for b in gcs.of("HEARTBEAT") if b.get_srcComponent() == 1]
    assert 5 <= len(beats) <= 6
    beat = beats[-1]
    assert (beat.type, beat.autopilot, beat.system_status) == (2, 12, 3)
    assert (beat.base_mode, beat.custom_mode) == (29, 4 << 16 | 3 << 24)
    assert gcs.arm() == 0
    sky.fly(1.0)
    armed = [b for b in gcs.of("HEARTBEAT") if b.get_srcComponent() == 1][-1]
    assert (armed.base_mode, armed.system_status) == (157, 4)
    assert {b.get_srcComponent() for b in gcs.of("HEARTBEAT")} == {1, 100}


def test_sequence_numbers_have_no_gap_for_any_listener(sky, gcs):
    other = Program(sky, port=2)
    other.say(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    gcs.command(m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    sky.fly(3.0)
    for program in (gcs, other):
        numbers = [h.get_seq() for h in program.heard if h.get_srcComponent() == 1]
        assert (np.diff(numbers) % 256 == 1).all()


def test_telemetry_tells_where_it_is_in_every_frame(sky, gcs):
    gcs.take_off(12.0)
    sky.fly(5.0)
    gcs.forget()
    sky.fly(2.5)
    last = {h.get_type(): h for h in gcs.heard}
    here, home = sky.vehicle.true_position_enu_m, sky.pilot.home_enu_m
    ned, place = last["LOCAL_POSITION_NED"], last["GLOBAL_POSITION_INT"]
    assert (ned.x, ned.y, ned.z) == pytest.approx(tuple(sky.ned), abs=0.02)
    assert place.relative_alt * 1e-3 == pytest.approx(12.0, abs=0.3)
    assert place.alt * 1e-3 == pytest.approx(30.0 + here[2], abs=0.02)
    back = sky.scenario.frame.enu_from_geodetic([place.lat * 1e-7, place.lon * 1e-7, place.alt * 1e-3])[0]
    assert back == pytest.approx(here, abs=0.03)
    assert last["HOME_POSITION"].altitude * 1e-3 == pytest.approx(30.0 + home[2], abs=0.01)
    assert last["ALTITUDE"].altitude_relative == pytest.approx(12.0, abs=0.3)
    assert last["GPS_RAW_INT"].fix_type == 3
    assert last["EXTENDED_SYS_STATE"].landed_state == m.MAV_LANDED_STATE_IN_AIR
    assert last["ATTITUDE"].yaw == pytest.approx(np.pi / 2, abs=0.05)  # it stands facing east
    q = last["ATTITUDE_QUATERNION"]
    assert (q.q1, q.q4) == pytest.approx((np.sqrt(0.5), np.sqrt(0.5)), abs=0.03)
    assert last["VFR_HUD"].heading == pytest.approx(90, abs=3)
    assert last["SYSTEM_TIME"].time_boot_ms == pytest.approx(sky.pilot.time_s * 1e3, abs=1000)
    battery = last["BATTERY_STATUS"]
    assert battery.battery_remaining >= 98
    watts = battery.current_battery * 0.01 * sum(v for v in battery.voltages if v < 65535) * 1e-3
    assert watts == pytest.approx(200.0, rel=0.1)


def test_a_listener_sets_its_own_rates(sky, gcs):
    other = Program(sky, port=2)
    other.say(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    kind = m.MAVLINK_MSG_ID_LOCAL_POSITION_NED
    assert gcs.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, kind, 500_000) == 0
    for program in (gcs, other):
        program.forget()
    sky.fly(10.0)
    assert len(gcs.of("LOCAL_POSITION_NED")) == pytest.approx(20, abs=1)
    assert len(other.of("LOCAL_POSITION_NED")) == pytest.approx(250, abs=3)
    assert gcs.command(m.MAV_CMD_GET_MESSAGE_INTERVAL, kind) == 0
    assert gcs.of("MESSAGE_INTERVAL")[0].interval_us == 500_000
    assert gcs.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, kind, -1) == 0
    gcs.forget()
    sky.fly(3.0)
    assert not gcs.of("LOCAL_POSITION_NED")
    for fixed in (7777, m.MAVLINK_MSG_ID_HEARTBEAT):
        assert gcs.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, fixed, 1e5) == m.MAV_RESULT_FAILED


def test_an_interval_is_one_that_message_interval_can_tell(gcs):
    kind, longest = m.MAVLINK_MSG_ID_ATTITUDE, float(np.nextafter(np.float32(2.0**31), np.float32(0.0)))
    for interval in (5e9, 2.0**31, -5e9, NAN, float("inf")):
        assert gcs.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, kind, interval) == m.MAV_RESULT_FAILED
        assert gcs.command(m.MAV_CMD_GET_MESSAGE_INTERVAL, kind) == 0
        assert gcs.of("MESSAGE_INTERVAL")[0].interval_us == 40_000
    assert gcs.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, kind, longest) == 0
    assert gcs.command(m.MAV_CMD_GET_MESSAGE_INTERVAL, kind) == 0
    assert gcs.of("MESSAGE_INTERVAL")[0].interval_us == longest


def test_a_mistake_of_ours_is_told_once_and_ends_no_flight(sky, gcs, monkeypatch, caplog):
    def mistaken(_):
        raise OverflowError("ours")

    gcs.take_off(5.0)
    monkeypatch.setattr(sky.pilot.offboard, "release", mistaken)
    for _ in range(3):
        gcs.say(m.MAVLink_command_long_message(1, 1, m.MAV_CMD_NAV_RETURN_TO_LAUNCH, 0, *[0.0] * 7))
    assert gcs.texts().count("internal error: COMMAND_LONG was not handled") == 1
    assert sky.face.faulty == {"COMMAND_LONG"}
    (record,) = caplog.records
    assert "please report it" in record.getMessage()
    assert record.exc_info[0] is OverflowError
    sky.fly(until=lambda: not sky.pilot.armed)


def test_of_two_vehicles_each_has_its_own_system_id(sky):
    heard = []
    face = Face(sky.vehicle, sky.scenario, lambda datagram, _: heard.append(datagram), system_id=2)
    decoder, voice = m.MAVLink(None), Voice(190, Signing(None), 245)

    def say(message):
        heard.clear()
        face.receive(voice.pack(message), ("10.0.0.1", 1))
        return [decoder.decode(bytearray(datagram)) for datagram in heard]

    arm, configure = m.MAV_CMD_COMPONENT_ARM_DISARM, m.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
    assert not say(m.MAVLink_command_long_message(1, 1, arm, 0, 1, *[0.0] * 6))
    say(m.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0))
    assert face.pilot.sticks.lost
    say(m.MAVLink_manual_control_message(2, 0, 0, 500, 0, 0))
    assert not face.pilot.sticks.lost
    (ack,) = say(m.MAVLink_command_long_message(2, 1, configure, 0, -2, -2, *[0.0] * 5))
    assert (ack.get_srcSystem(), ack.result) == (2, 0)
    assert face.payload.control == (2, 1)
    (value,) = say(m.MAVLink_param_request_read_message(2, 1, b"MAV_SYS_ID", -1))
    assert struct.pack("<f", value.param_value) == struct.pack("<i", 2)
    heard.clear()
    face.tick()
    assert {datagram[5] for datagram in heard} == {2}


def test_messages_on_request(sky, gcs):
    assert gcs.command(m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == 0
    (version,) = gcs.of("AUTOPILOT_VERSION")
    assert version.flight_sw_version >> 24 == 1
    for bit in ("MAVLINK2", "MISSION_INT", "MISSION_FENCE", "MISSION_RALLY", "PARAM_ENCODE_BYTEWISE"):
        assert version.capabilities & getattr(m, f"MAV_PROTOCOL_CAPABILITY_{bit}")
    assert gcs.command(m.MAV_CMD_REQUEST_MESSAGE, 7777) == m.MAV_RESULT_DENIED
    assert gcs.command(m.MAV_CMD_REQUEST_MESSAGE, NAN) == m.MAV_RESULT_DENIED
    assert gcs.command(m.MAV_CMD_DO_PARACHUTE, 2) == m.MAV_RESULT_UNSUPPORTED


def test_camera_and_gimbal_introduce_themselves(sky, gcs):
    assert gcs.command(m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_CAMERA_INFORMATION, component=100) == 0
    (camera,) = gcs.of("CAMERA_INFORMATION")
    assert (camera.get_srcComponent(), camera.resolution_h, camera.resolution_v) == (100, 640, 360)
    hfov = 2.0 * np.arctan(0.5 * camera.sensor_size_h / camera.focal_length)
    assert hfov == pytest.approx(sky.scenario.camera.hfov_rad)
    assert gcs.command(m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION) == 0
    (gimbal,) = gcs.of("GIMBAL_MANAGER_INFORMATION")
    assert (gimbal.pitch_min, gimbal.pitch_max) == pytest.approx((-np.pi / 2, np.pi / 4))


def test_the_camera_takes_no_orders_of_the_autopilot(gcs):
    message = m.MAVLink_command_long_message(1, 100, m.MAV_CMD_DO_SET_MODE, 0, 1, 4, 3, 0, 0, 0, 0)
    (answer,) = gcs.answers(message, "COMMAND_ACK")
    assert answer.result == m.MAV_RESULT_UNSUPPORTED


def test_the_gimbal_obeys_the_program_that_took_it_and_looks_down(sky, gcs):
    point = (m.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, -90, 0, NAN, NAN, 0, 0, 0)
    configure = m.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
    other = Program(sky, port=2, system=7)
    assert gcs.command(*point) == m.MAV_RESULT_DENIED
    assert gcs.command(configure, -2, -2, -1, -1) == 0
    assert gcs.command(*point) == m.MAV_RESULT_DENIED  # the vehicle has it now, as with PX4
    assert gcs.command(configure, 245, 190, -1, -1) == 0
    assert gcs.command(*point) == 0
    assert other.command(*point) == m.MAV_RESULT_DENIED
    gcs.forget()
    sky.fly(2.5)
    status = gcs.of("GIMBAL_MANAGER_STATUS")[-1]
    assert (status.primary_control_sysid, status.primary_control_compid) == (245, 190)
    w, x, y, z = gcs.of("GIMBAL_DEVICE_ATTITUDE_STATUS")[-1].q
    assert (w, x, y, z) == pytest.approx((np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0), abs=1e-3)


def test_the_camera_looks_where_the_gimbal_was_told(sky, gcs):
    gcs.command(m.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, 245, 190, -1, -1)
    for asked, pitch in ((-30.0, -30.0), (80.0, 45.0), (NAN, 45.0)):
        assert gcs.command(m.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, asked, 0, NAN, NAN, 0, 0, 0) == 0
        sky.fly(2.0)
        forward_up = sky.vehicle.true_camera_pose().R_camera_to_enu[2, 2]
        assert forward_up == pytest.approx(np.sin(np.radians(pitch)), abs=0.02)
        q = gcs.of("GIMBAL_DEVICE_ATTITUDE_STATUS")[-1].q
        assert 2.0 * np.degrees(np.arctan2(q[2], q[0])) == pytest.approx(pitch, abs=0.1)


def test_parameters_are_listed_read_and_written(sky, gcs):
    gcs.answers(m.MAVLink_param_request_list_message(1, 1), "PARAM_VALUE")
    sky.fly(1.0)
    listed = gcs.of("PARAM_VALUE")
    assert sorted(p.param_index for p in listed) == list(range(listed[0].param_count))
    names = {p.param_id: p for p in listed}
    assert {"MPC_XY_VEL_MAX", "MIS_TAKEOFF_ALT", "COM_OF_LOSS_T", "GF_ACTION", "SYS_AUTOSTART"} <= set(names)
    autostart = names["SYS_AUTOSTART"]
    assert autostart.param_type == m.MAV_PARAM_TYPE_INT32
    assert struct.unpack("<i", struct.pack("<f", autostart.param_value))[0] == 10040
    (by_name,) = gcs.answers(m.MAVLink_param_request_read_message(1, 1, b"MPC_XY_P", -1), "PARAM_VALUE")
    assert by_name.param_value == pytest.approx(0.95)
    assert gcs.set("MIS_TAKEOFF_ALT", 17.5) == 17.5
    assert gcs.set("MPC_XY_P", 3.0) == pytest.approx(0.95), "it describes the vehicle"
    assert gcs.set("MPC_XY_VEL_MAX", 1e9) == 12.0
    assert gcs.set("MPC_XY_VEL_MAX", NAN) == 12.0
    bits = struct.unpack("<f", struct.pack("<i", 3))[0]
    message = m.MAVLink_param_set_message(1, 1, b"GF_ACTION", bits, m.MAV_PARAM_TYPE_INT32)
    (written,) = gcs.answers(message, "PARAM_VALUE")
    assert struct.pack("<f", written.param_value) == struct.pack("<i", 3)
    assert sky.face.parameters["GF_ACTION"] == 3
    assert not gcs.answers(m.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1), "PARAM_VALUE")


@pytest.mark.parametrize("above_m", [NAN, 6.0])
def test_an_order_to_take_off_that_is_repeated_changes_nothing(sky, gcs, above_m):
    gcs.set("MIS_TAKEOFF_ALT", 6.0)
    gcs.arm()
    up = sky.geodetic([0.0, 0.0, -above_m])[2]
    for _ in range(4):
        assert gcs.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, up) == 0
        sky.fly(0.3)
    sky.fly(until=lambda: sky.pilot.mode.name == "HOLD")
    assert sky.ned[2] == pytest.approx(-6.0, abs=1.0)


def test_take_off_hold_move_return_and_disarm(sky, gcs):
    gcs.take_off(10.0)
    assert sky.ned[2] == pytest.approx(-10.0, abs=0.9)
    sky.fly(5.0)
    assert sky.ned == pytest.approx([0.0, 0.0, -10.0], abs=0.2)
    latitude, longitude, altitude = sky.geodetic([30.0, 20.0, -15.0])
    x, y = round(latitude * 1e7), round(longitude * 1e7)
    move = m.MAVLink_command_int_message(
        1, 1, 5, m.MAV_CMD_DO_REPOSITION, 0, 0, -1, 1, 0, NAN, x, y, altitude
    )
    assert gcs.answers(move, "COMMAND_ACK")[0].result == 0
    sky.fly(25.0)
    assert sky.ned == pytest.approx([30.0, 20.0, -15.0], abs=0.3)
    assert gcs.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0) == m.MAV_RESULT_TEMPORARILY_REJECTED
    assert gcs.command(m.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    highest = 0.0
    while sky.pilot.armed:
        sky.fly(0.5)
        highest = max(highest, -sky.ned[2])
    assert highest == pytest.approx(30.0, abs=1.0), "RTL_RETURN_ALT"
    assert sky.ned == pytest.approx([0.0, 0.0, 0.0], abs=1.2)
    assert sky.pilot.mode.name == "HOLD"
    assert "landed" in gcs.texts()


@pytest.mark.parametrize("mode", [RETURN, HOLD, LAND])
def test_a_changed_speed_ends_with_its_mode(sky, gcs, mode):
    gcs.take_off(10.0)
    there = sky.geodetic([60.0, 0.0, -10.0])
    assert gcs.command(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, *there) == 0
    assert gcs.mode(*(LAND if mode == HOLD else HOLD)) == 0
    assert gcs.command(m.MAV_CMD_DO_CHANGE_SPEED, 1, 0.01, -1) == 0
    assert sky.pilot.cruise_mps == pytest.approx(0.01)
    assert gcs.mode(*mode) == 0
    assert sky.pilot.cruise_mps == sky.scenario.vehicle.cruise_speed_mps


def test_it_comes_home_however_slow_it_was_told_to_be(sky, gcs):
    gcs.take_off(10.0)
    there = sky.geodetic([60.0, 0.0, -10.0])
    assert gcs.command(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, *there) == 0
    sky.fly(25.0)
    assert gcs.command(m.MAV_CMD_DO_CHANGE_SPEED, 1, 0.01, -1) == 0
    assert gcs.command(m.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    assert sky.fly(until=lambda: not sky.pilot.armed) < 120.0
    assert sky.ned[:2] == pytest.approx([0.0, 0.0], abs=1.2)


def test_a_reposition_brings_its_own_speed(sky, gcs):
    gcs.take_off(10.0)
    there = sky.geodetic([60.0, 0.0, -10.0])
    assert gcs.command(m.MAV_CMD_DO_REPOSITION, 2.0, 1, 0, NAN, *there) == 0
    sky.fly(12.0)
    assert np.hypot(*sky.vehicle.true_velocity_enu_mps[:2]) == pytest.approx(2.0, abs=0.3)


def test_land_where_it_is(sky, gcs):
    gcs.take_off(8.0)
    assert gcs.mode(*LAND) == 0
    sky.fly(1.0)
    assert gcs.of("EXTENDED_SYS_STATE")[-1].landed_state == m.MAV_LANDED_STATE_LANDING
    sky.fly(until=lambda: not sky.pilot.armed)
    assert not sky.vehicle.state().airborne
    assert gcs.arm() == 0, "it can fly again"
    sky.fly(1.0)
    assert not sky.pilot.flying


def test_an_armed_vehicle_that_does_nothing_disarms(sky, gcs):
    assert gcs.arm() == 0
    assert sky.fly(until=lambda: not sky.pilot.armed) == pytest.approx(10.0, abs=0.1)


def test_hold_stops_a_vehicle_at_speed(sky, gcs):
    gcs.take_off(10.0)
    latitude, longitude, altitude = sky.geodetic([200.0, 0.0, -10.0])
    gcs.command(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, latitude, longitude, altitude)
    sky.fly(10.0)
    before = sky.ned[0]
    assert gcs.mode(*HOLD) == 0
    sky.fly(10.0)
    assert np.linalg.norm(sky.vehicle.true_velocity_enu_mps) < 0.2
    assert 3.0 < sky.ned[0] - before < 9.0


@pytest.mark.parametrize(
    "mode", [MISSION, OFFBOARD, POSITION, ALTITUDE, STABILIZED, TERMINATION, (1, 0), (4, 99)]
)
def test_a_mode_that_cannot_be_had_in_the_air_is_refused_and_says_why(sky, gcs, mode):
    gcs.take_off(5.0)
    gcs.forget()
    assert gcs.mode(*mode) == m.MAV_RESULT_TEMPORARILY_REJECTED
    assert gcs.texts()
    assert sky.pilot.mode.name == "HOLD"


def test_a_mode_is_acknowledged_twice_as_by_px4(sky, gcs):
    gcs.take_off(5.0)
    for mode, results in ((HOLD, [0, 0]), (OFFBOARD, [0, m.MAV_RESULT_TEMPORARILY_REJECTED])):
        gcs.mode(*mode)
        assert [a.result for a in gcs.of("COMMAND_ACK")] == results


@pytest.mark.parametrize(
    ("mode", "why"),
    [
        (MISSION, "no mission"),
        (OFFBOARD, "no stream of setpoints"),
        (POSITION, "no manual control"),
        (RETURN, "choose Hold"),
        (LAND, "choose Hold"),
    ],
)
def test_on_the_ground_any_mode_can_be_chosen_but_not_armed_in(sky, gcs, mode, why):
    assert gcs.mode(*mode) == m.MAV_RESULT_ACCEPTED
    assert sky.pilot.mode.value == mode
    gcs.forget()
    sky.fly(1.1)
    beat = [b for b in gcs.of("HEARTBEAT") if b.get_srcComponent() == 1][-1]
    assert beat.system_status == m.MAV_STATE_UNINIT
    assert gcs.arm() == m.MAV_RESULT_TEMPORARILY_REJECTED
    assert "Arming denied" in gcs.texts()
    assert why in gcs.texts()
    assert gcs.mode(*HOLD) == 0
    assert gcs.arm() == 0


def test_its_own_battery_brings_it_down_when_it_is_empty():
    small = {"position_noise_m": 0.0, "attitude_noise_deg": 0.0, "battery_wh": 12.0}
    sky = Sky(scenario(vehicle=small))
    gcs = Program(sky)
    gcs.take_off(20.0)
    sky.fly(until=lambda: sky.pilot.failsafe)
    assert sky.vehicle.state().battery_remaining == pytest.approx(0.07, abs=0.001)
    assert "Battery low Battery critical: hold, return in 5 s" in gcs.texts()
    sky.fly(until=lambda: sky.pilot.mode.name in ("RETURN", "LAND"))
    sky.fly(until=lambda: not sky.pilot.armed)
    assert not sky.vehicle.state().airborne
    gcs.forget()
    assert gcs.arm() == m.MAV_RESULT_TEMPORARILY_REJECTED
    assert "battery" in gcs.texts()


def test_frames_for_another_vehicle_are_not_ours(sky, gcs):
    gcs.say(m.MAVLink_command_long_message(2, 1, m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0))
    gcs.say(m.MAVLink_command_long_message(1, 42, m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0))
    assert not sky.pilot.armed
    assert not gcs.of("COMMAND_ACK")


def test_time_is_answered_with_the_vehicles(sky, gcs):
    sky.fly(2.0)
    (answer,) = gcs.answers(m.MAVLink_timesync_message(0, 4242), "TIMESYNC")
    assert (answer.tc1, answer.ts1) == (2_000_000_000, 4242)
