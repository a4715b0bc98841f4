"""Telemetry: the vehicle's reports about itself, to each listener at its own rates in vehicle time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skysweep.geometry.frames import euler_from_rotation, heading_from_yaw, ned_from_enu, rotation_frd_to_ned
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import AUTOPILOT, CAMERA, TICK_S, PX4Mode, e7, quaternion
from skysweep.vehicles.mavlink.wire import Message
from skysweep.vehicles.served.autopilot import Autopilot
from skysweep.vehicles.served.link import Peer
from skysweep.vehicles.served.payload import Payload

_SENSORS = (
    m.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | m.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | m.MAV_SYS_STATUS_SENSOR_3D_MAG
    | m.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | m.MAV_SYS_STATUS_SENSOR_GPS
    | m.MAV_SYS_STATUS_SENSOR_BATTERY
    | m.MAV_SYS_STATUS_AHRS
    | m.MAV_SYS_STATUS_PREARM_CHECK
)
_ESTIMATES = (
    m.ESTIMATOR_ATTITUDE
    | m.ESTIMATOR_VELOCITY_HORIZ
    | m.ESTIMATOR_VELOCITY_VERT
    | m.ESTIMATOR_POS_HORIZ_REL
    | m.ESTIMATOR_POS_HORIZ_ABS
    | m.ESTIMATOR_POS_VERT_ABS
    | m.ESTIMATOR_PRED_POS_HORIZ_REL
    | m.ESTIMATOR_PRED_POS_HORIZ_ABS
)
_ESTIMATES_WITHOUT_POSITION = m.ESTIMATOR_ATTITUDE | m.ESTIMATOR_VELOCITY_VERT | m.ESTIMATOR_POS_VERT_ABS
_CAPABILITIES = (
    m.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | m.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | m.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | m.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | m.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | m.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | m.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | m.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
)
_PX4_VERSION = 1 << 24 | 17 << 16 | 0 << 8 | 255  # 1.17.0, release
_UID = 0x736B79737765  # "skyswe"
_CELLS, _CELL_EMPTY_V, _CELL_FULL_V = 4, 3.6, 4.05
_NO_GPS, _GPS_3D, _SATELLITES = 0, 3, 12
_NONE_U16, _MAX_I16, _NAN = 65535, 32767, float("nan")
_HORIZONTAL_M, _VERTICAL_M = 0.3, 0.15
_LONGEST_US = 2.0**31  # of an interval, below it: MESSAGE_INTERVAL carries an int32


class Moment:
    """The vehicle at one moment, in MAVLink's frames; each part is computed on first use."""

    def __init__(self, pilot: Autopilot, power_w: float, unix_start_s: float) -> None:
        self.pilot, self.state, self.power_w = pilot, pilot.state, power_w
        self.boot_ms = round(self.state.time_s * 1e3)
        self.boot_us = round(self.state.time_s * 1e6)
        self.unix_us = round(unix_start_s * 1e6) + self.boot_us
        self._made: dict[int, Message | None] = {}

    def message(self, kind: int, report: Report) -> Message | None:
        """The message of a kind, made once for all listeners."""
        if kind not in self._made:
            self._made[kind] = report.make(self)
        return self._made[kind]

    @cached_property
    def ned(self) -> list[float]:
        return list(self.pilot.site.ned_from_enu(self.state.position_enu_m).tolist())

    @cached_property
    def velocity_ned(self) -> list[float]:
        return list(ned_from_enu(self.state.velocity_enu_mps).tolist())

    @cached_property
    def geodetic(self) -> tuple[float, float, float]:
        return self.pilot.site.geodetic(self.state.position_enu_m)

    @cached_property
    def euler(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw of FRD in NED."""
        return euler_from_rotation(rotation_frd_to_ned(self.state.R_body_to_enu))

    @cached_property
    def above_home_m(self) -> float:
        return float(self.state.position_enu_m[2] - self.pilot.home_enu_m[2])

    @cached_property
    def heading_deg(self) -> float:
        return heading_from_yaw(self.pilot.yaw_rad)

    @property
    def ground_speed_mps(self) -> float:
        return float(np.hypot(self.velocity_ned[0], self.velocity_ned[1]))

    @property
    def volts(self) -> float:
        full = self.pilot.battery_remaining
        return _CELLS * (_CELL_EMPTY_V + full * (_CELL_FULL_V - _CELL_EMPTY_V))

    @property
    def centiamperes(self) -> int:
        return round(min(max(self.power_w / self.volts * 100.0, 0.0), _MAX_I16))


def _heartbeat(p: Moment) -> Message:
    pilot = p.pilot
    if pilot.mode is PX4Mode.TERMINATION:
        status = m.MAV_STATE_FLIGHT_TERMINATION
    elif pilot.armed:
        status = m.MAV_STATE_CRITICAL if pilot.failsafe else m.MAV_STATE_ACTIVE
    else:
        status = m.MAV_STATE_STANDBY if pilot.why_not_arm() is None else m.MAV_STATE_UNINIT
    base_mode, custom_mode = pilot.mode.base_mode(pilot.armed), pilot.mode.custom_mode
    kind = m.MAV_TYPE_QUADROTOR, m.MAV_AUTOPILOT_PX4
    return m.MAVLink_heartbeat_message(*kind, base_mode, custom_mode, status, 3)


def _current_mode(p: Moment) -> Message:
    mode, intended = p.pilot.mode, p.pilot.intended
    return m.MAVLink_current_mode_message(mode.standard_mode, mode.custom_mode, intended.custom_mode)


def _attitude(p: Moment) -> Message:
    return m.MAVLink_attitude_message(p.boot_ms, *p.euler, 0.0, 0.0, 0.0)


def _attitude_quaternion(p: Moment) -> Message:
    return m.MAVLink_attitude_quaternion_message(p.boot_ms, *quaternion(*p.euler), 0.0, 0.0, 0.0)


def _local_position(p: Moment) -> Message:
    return m.MAVLink_local_position_ned_message(p.boot_ms, *p.ned, *p.velocity_ned)


def _global_position(p: Moment) -> Message:
    return m.MAVLink_global_position_int_message(
        p.boot_ms,
        *_place(p.geodetic),
        round(p.above_home_m * 1e3),
        *(round(v * 100.0) for v in p.velocity_ned),
        round(p.heading_deg * 100.0) % 36000,
    )


def _gps(p: Moment) -> Message:
    course = np.degrees(np.arctan2(p.velocity_ned[1], p.velocity_ned[0])) % 360.0
    return m.MAVLink_gps_raw_int_message(
        p.boot_us,
        _NO_GPS if p.pilot.gnss_lost else _GPS_3D,
        *_place(p.geodetic),
        70,
        110,
        round(p.ground_speed_mps * 100.0),
        round(course * 100.0) % 36000,
        0 if p.pilot.gnss_lost else _SATELLITES,
        round(p.geodetic[2] * 1e3),
        round(_HORIZONTAL_M * 1e3),
        round(_VERTICAL_M * 1e3),
    )


def _home(p: Moment) -> Message:
    home, site = p.pilot.home_enu_m, p.pilot.site
    place, local, level = _place(site.geodetic(home)), site.ned_from_enu(home).tolist(), [1.0, 0.0, 0.0, 0.0]
    return m.MAVLink_home_position_message(*place, *local, level, _NAN, _NAN, _NAN, p.boot_us)


def _origin(p: Moment) -> Message:
    site = p.pilot.site
    return m.MAVLink_gps_global_origin_message(*_place(site.geodetic(site.origin_enu_m)), p.boot_us)


def _place(geodetic: tuple[float, float, float]) -> tuple[int, int, int]:
    """Latitude and longitude in 1e-7 degrees, altitude in millimetres."""
    latitude_deg, longitude_deg, altitude_m = geodetic
    return e7(latitude_deg), e7(longitude_deg), round(altitude_m * 1e3)


def _battery(p: Moment) -> Message:
    cell = round(p.volts / _CELLS * 1e3)
    return m.MAVLink_battery_status_message(
        0,
        m.MAV_BATTERY_FUNCTION_ALL,
        m.MAV_BATTERY_TYPE_LIPO,
        _MAX_I16,
        [cell] * _CELLS + [_NONE_U16] * (10 - _CELLS),
        p.centiamperes,
        -1,
        round(p.state.energy_used_wh * 36.0),
        round(p.pilot.battery_remaining * 100.0),
    )


def _sys_status(p: Moment) -> Message:
    # As in PX4, a missing pilot counts as a required sensor that does not work.
    required = _SENSORS | m.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    works = _SENSORS if p.pilot.sticks.lost else required
    power = round(p.volts * 1e3), p.centiamperes, round(p.pilot.battery_remaining * 100.0)
    return m.MAVLink_sys_status_message(works, required, works, 300, *power, *[0] * 6)


def _extended_state(p: Moment) -> Message:
    pilot = p.pilot
    if not pilot.flying or not pilot.state.airborne:
        landed = m.MAV_LANDED_STATE_ON_GROUND
    elif pilot.landing:
        landed = m.MAV_LANDED_STATE_LANDING
    elif pilot.mode is PX4Mode.TAKEOFF:
        landed = m.MAV_LANDED_STATE_TAKEOFF
    else:
        landed = m.MAV_LANDED_STATE_IN_AIR
    return m.MAVLink_extended_sys_state_message(m.MAV_VTOL_STATE_UNDEFINED, landed)


def _hud(p: Moment) -> Message:
    speed, climb, throttle = p.ground_speed_mps, -p.velocity_ned[2], 50 if p.pilot.flying else 0
    heading = round(p.heading_deg) % 360
    return m.MAVLink_vfr_hud_message(speed, speed, heading, throttle, p.geodetic[2], climb)


def _altitude(p: Moment) -> Message:
    altitude = p.geodetic[2]
    return m.MAVLink_altitude_message(p.boot_us, altitude, altitude, -p.ned[2], p.above_home_m, _NAN, _NAN)


def _system_time(p: Moment) -> Message:
    return m.MAVLink_system_time_message(p.unix_us, p.boot_ms)


def _estimator(p: Moment) -> Message:
    known = _ESTIMATES_WITHOUT_POSITION if p.pilot.position_lost else _ESTIMATES
    return m.MAVLink_estimator_status_message(
        p.boot_us, known, 0.1, 0.1, 0.1, 0.1, 0.0, 0.0, _HORIZONTAL_M, _VERTICAL_M
    )


def _position_target(p: Moment) -> Message | None:
    setpoint = p.pilot.setpoint
    if setpoint is None:
        return None
    velocity = np.zeros(3) if setpoint.velocity_enu_mps is None else setpoint.velocity_enu_mps
    return m.MAVLink_position_target_local_ned_message(
        p.boot_ms,
        m.MAV_FRAME_LOCAL_NED,
        0,
        *p.pilot.site.ned_from_enu(setpoint.position_enu_m).tolist(),
        *ned_from_enu(velocity).tolist(),
        *[0.0] * 3,
        float(np.radians(heading_from_yaw(setpoint.yaw_rad))),
        0.0,
    )


def _mission_current(p: Moment) -> Message:
    run = p.pilot.mission
    if not run.items:
        state = m.MISSION_STATE_NO_MISSION
    elif run.finished:
        state = m.MISSION_STATE_COMPLETE
    elif p.pilot.mode is PX4Mode.MISSION:
        state = m.MISSION_STATE_ACTIVE
    else:
        state = m.MISSION_STATE_PAUSED if run.current else m.MISSION_STATE_NOT_STARTED
    total = len(run.items) or _NONE_U16
    flown = 1 if p.pilot.mode is PX4Mode.MISSION else 2
    return m.MAVLink_mission_current_message(run.current, total, state, flown)


def _version(_: Moment) -> Message:
    return m.MAVLink_autopilot_version_message(
        _CAPABILITIES, _PX4_VERSION, _PX4_VERSION, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, _UID
    )


@dataclass(frozen=True, slots=True)
class Report:
    """One kind of message: how it is made, its default rate (0: never), and the component that sends it."""

    make: Callable[[Moment], Message | None]
    rate_hz: float
    component: int = AUTOPILOT


def reports(payload: Payload) -> dict[int, Report]:
    """All messages that can be streamed or requested, by id."""
    by_name = {
        "HEARTBEAT": Report(_heartbeat, 1.0),
        "CURRENT_MODE": Report(_current_mode, 0.5),
        "ATTITUDE": Report(_attitude, 25.0),
        "ATTITUDE_QUATERNION": Report(_attitude_quaternion, 25.0),
        "LOCAL_POSITION_NED": Report(_local_position, 25.0),
        "GLOBAL_POSITION_INT": Report(_global_position, 25.0),
        "POSITION_TARGET_LOCAL_NED": Report(_position_target, 5.0),
        "GPS_RAW_INT": Report(_gps, 5.0),
        "SYS_STATUS": Report(_sys_status, 5.0),
        "EXTENDED_SYS_STATE": Report(_extended_state, 5.0),
        "VFR_HUD": Report(_hud, 5.0),
        "ALTITUDE": Report(_altitude, 5.0),
        "BATTERY_STATUS": Report(_battery, 0.5),
        "HOME_POSITION": Report(_home, 0.5),
        "GPS_GLOBAL_ORIGIN": Report(_origin, 1.0),
        "SYSTEM_TIME": Report(_system_time, 1.0),
        "ESTIMATOR_STATUS": Report(_estimator, 1.0),
        "MISSION_CURRENT": Report(_mission_current, 1.0),
        "GIMBAL_DEVICE_ATTITUDE_STATUS": Report(lambda p: payload.gimbal_attitude(p.state, p.boot_ms), 5.0),
        "GIMBAL_MANAGER_STATUS": Report(lambda p: payload.manager_status(p.boot_ms), 0.5),
        "GIMBAL_MANAGER_INFORMATION": Report(lambda p: payload.manager_information(p.boot_ms), 0.0),
        "GIMBAL_DEVICE_INFORMATION": Report(lambda p: payload.device_information(p.boot_ms), 0.0),
        "CAMERA_INFORMATION": Report(lambda p: payload.camera_information(p.boot_ms), 0.0, CAMERA),
        "AUTOPILOT_VERSION": Report(_version, 0.0),
    }
    return {getattr(m, f"MAVLINK_MSG_ID_{name}"): report for name, report in by_name.items()}


class Streams:
    """The rates of one listener. ``messages`` is ``reports(...)``."""

    def __init__(self, messages: dict[int, Report]) -> None:
        self._messages = messages
        self._periods_s = {kind: 1.0 / r.rate_hz for kind, r in messages.items() if r.rate_hz > 0.0}
        self._next_s = dict.fromkeys(self._periods_s, 0.0)

    def set_interval(self, kind: int, interval_us: float) -> bool:
        """As MAV_CMD_SET_MESSAGE_INTERVAL: -1 stops, 0 is the default rate.

        False for unknown messages, intervals that MESSAGE_INTERVAL cannot tell, and the heartbeat, whose rate
        is fixed in PX4.
        """
        report = self._messages.get(kind)
        if report is None or kind == m.MAVLINK_MSG_ID_HEARTBEAT or not abs(interval_us) < _LONGEST_US:
            return False
        self._periods_s.pop(kind, None)
        if interval_us > 0.0:
            self._periods_s[kind] = max(interval_us * 1e-6, TICK_S)
        elif interval_us == 0.0 and report.rate_hz > 0.0:
            self._periods_s[kind] = 1.0 / report.rate_hz
        self._next_s[kind] = 0.0
        return True

    def now(self, kind: int) -> None:
        """Sends a streamed kind with the next tick."""
        self._next_s[kind] = 0.0

    def interval_us(self, kind: int) -> int:
        """For MESSAGE_INTERVAL: -1 if it is not streamed, 0 if there is no such message."""
        period = self._periods_s.get(kind)
        return round(period * 1e6) if period is not None else -1 if kind in self._messages else 0

    def send_due(self, peer: Peer, moment: Moment) -> None:
        now = moment.state.time_s + 1e-6
        for kind, period in self._periods_s.items():
            if now >= self._next_s[kind]:
                self._next_s[kind] = max(self._next_s[kind] + period, now)
                report = self._messages[kind]
                message = moment.message(kind, report)
                if message is not None:
                    peer.send(message, report.component)
