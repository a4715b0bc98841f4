"""The command protocol: COMMAND_LONG and COMMAND_INT, each answered with a COMMAND_ACK."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from skysweep.geometry.frames import yaw_from_heading
from skysweep.types import F64
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import (
    AUTOPILOT,
    CAMERA,
    STICK_MODES,
    PX4Mode,
    Refused,
    finite,
    mode_of,
    whole,
)
from skysweep.vehicles.mavlink.wire import Message
from skysweep.vehicles.served.authority import Authority, Denied
from skysweep.vehicles.served.autopilot import Autopilot
from skysweep.vehicles.served.items import ABOVE_HOME
from skysweep.vehicles.served.link import Sender
from skysweep.vehicles.served.manoeuvres import Hold, TakeOff
from skysweep.vehicles.served.payload import Payload
from skysweep.vehicles.served.pilot import Manoeuvre
from skysweep.vehicles.served.telemetry import Streams

_OK: int = m.MAV_RESULT_ACCEPTED
_DENIED: int = m.MAV_RESULT_DENIED
_LATER: int = m.MAV_RESULT_TEMPORARILY_REJECTED
_UNSUPPORTED: int = m.MAV_RESULT_UNSUPPORTED
_FAILED: int = m.MAV_RESULT_FAILED
_TERMINATES = 0.5  # MAV_CMD_DO_FLIGHTTERMINATION, above it
_FORCED = 21196  # MAV_CMD_COMPONENT_ARM_DISARM
_FARTHEST_HOME_M = 1_000.0  # from the vehicle
_NO_PROGRESS = 255  # COMMAND_ACK
_ALWAYS_ALLOWED = (*STICK_MODES, PX4Mode.HOLD, PX4Mode.RETURN, PX4Mode.LAND)  # to every sender
_FOR_CAMERA = (m.MAV_CMD_REQUEST_MESSAGE, m.MAV_CMD_REQUEST_CAMERA_INFORMATION)
_HOME: int = m.MAVLINK_MSG_ID_HOME_POSITION
_VERSION: int = m.MAVLINK_MSG_ID_AUTOPILOT_VERSION
_CAMERA: int = m.MAVLINK_MSG_ID_CAMERA_INFORMATION


@dataclass(frozen=True, slots=True)
class Order:
    """A command's four parameters, and its place in degrees and metres if it has one."""

    params: tuple[float, float, float, float]
    x: float
    y: float
    z: float
    frame: int
    sender: Sender

    @classmethod
    def of(cls, message: Message, sender: Sender) -> Order:
        params = (message.param1, message.param2, message.param3, message.param4)
        if message.get_type() == "COMMAND_INT":
            return cls(params, message.x * 1e-7, message.y * 1e-7, message.z, message.frame, sender)
        return cls(params, message.param5, message.param6, message.param7, m.MAV_FRAME_GLOBAL, sender)


class Answering(Protocol):
    """The side that answers programs, as commands use it."""

    def set_mission_item(self, index: int) -> bool:
        """Continues the mission with another item; False if there is no such item."""

    def send_once(self, kind: int, sender: Sender) -> bool:
        """Sends one message of a kind; False if there is none."""

    def streams_of(self, sender: Sender) -> Streams | None:
        """The sender's streams; None if it gets none."""


class Commands:
    """Carries out commands on a vehicle and its payload."""

    def __init__(self, pilot: Autopilot, authority: Authority, payload: Payload, face: Answering) -> None:
        self._pilot, self._authority, self._payload, self._face = pilot, authority, payload, face
        self._do: dict[int, Callable[[Order], int | None]] = {
            m.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            m.MAV_CMD_DO_SET_MODE: self._set_mode,
            m.MAV_CMD_DO_FLIGHTTERMINATION: self._terminate,
            m.MAV_CMD_NAV_TAKEOFF: self._take_off,
            m.MAV_CMD_NAV_LAND: lambda o: self._change(PX4Mode.LAND, o.sender),
            m.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda o: self._change(PX4Mode.RETURN, o.sender),
            m.MAV_CMD_NAV_LOITER_UNLIM: lambda o: self._change(PX4Mode.HOLD, o.sender),
            m.MAV_CMD_DO_REPOSITION: self._reposition,
            m.MAV_CMD_DO_CHANGE_ALTITUDE: self._change_altitude,
            m.MAV_CMD_DO_CHANGE_SPEED: self._change_speed,
            m.MAV_CMD_DO_PAUSE_CONTINUE: self._pause_continue,
            m.MAV_CMD_MISSION_START: self._start_mission,
            m.MAV_CMD_DO_SET_MISSION_CURRENT: self._set_mission_item,
            m.MAV_CMD_DO_SET_HOME: self._set_home,
            m.MAV_CMD_REQUEST_MESSAGE: lambda o: self._request(o.params[0], o.sender),
            m.MAV_CMD_GET_HOME_POSITION: lambda o: self._request(_HOME, o.sender),
            m.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: lambda o: self._request(_VERSION, o.sender),
            m.MAV_CMD_REQUEST_CAMERA_INFORMATION: lambda o: self._request(_CAMERA, o.sender),
            m.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            m.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            m.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE: self._configure_gimbal,
            m.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: self._point_gimbal,
        }

    def receive(self, message: Message, sender: Sender) -> None:
        """Carries out a command and acknowledges it; a refusal comes with its reason as a text."""
        do = self._do.get(message.command)
        if message.target_component == CAMERA and message.command not in _FOR_CAMERA:
            do = None
        result = _UNSUPPORTED
        if do is not None:
            try:
                answer = do(Order.of(message, sender))
                result = _OK if answer is None else answer
            except Refused as why:
                result = _DENIED if isinstance(why, Denied) else _LATER
                sender.tell(str(why))
        if do == self._set_mode and result != _DENIED:  # PX4's link accepts it before its commander decides
            self._acknowledge(message, _OK, sender)
        self._acknowledge(message, result, sender)

    def _acknowledge(self, message: Message, result: int, sender: Sender) -> None:
        to = sender.system, sender.component
        answer = m.MAVLink_command_ack_message(message.command, result, _NO_PROGRESS, 0, *to)
        sender.reply(answer, message.target_component or AUTOPILOT)

    # ---- arming and modes ----------------------------------------------------------------------------

    def _arm(self, order: Order) -> int | None:
        wanted = whole(order.params[0])
        if wanted not in (0, 1):
            return _UNSUPPORTED
        if wanted and not self._pilot.armed:
            self._pilot.arm()
            self._authority.take(order.sender.key)
        elif not wanted:
            self._pilot.disarm(forced=whole(order.params[1]) == _FORCED)
        return None

    def _terminate(self, order: Order) -> int | None:
        if not (self._pilot.armed and order.params[0] > _TERMINATES):
            return _DENIED
        self._fly(PX4Mode.TERMINATION, order.sender)
        return None

    def _set_mode(self, order: Order) -> int | None:
        base, main, sub = (whole(v) for v in order.params[:3])
        if base is None or main is None or not base & m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return _UNSUPPORTED
        self.set_mode(main, sub or 0, order.sender)
        return None

    def set_mode(self, main: int, sub: int, sender: Sender) -> None:
        """Changes to the mode with these PX4 numbers. Raises Refused."""
        mode = mode_of(main, sub)
        if mode is None or mode is PX4Mode.TERMINATION:  # termination has its own command
            raise Refused("this vehicle has no such mode")
        self._change(mode, sender)

    def _change(self, mode: PX4Mode, sender: Sender) -> None:
        if mode not in _ALWAYS_ALLOWED:
            self._authority.must_be_free(sender.key, mode is PX4Mode.OFFBOARD)
        self._fly(mode, sender)
        if mode is not PX4Mode.OFFBOARD:
            self._pilot.offboard.release(sender.key)

    def _fly(self, mode: PX4Mode, sender: Sender, doing: Manoeuvre | None = None) -> None:
        self._pilot.change_mode(mode, doing)
        self._authority.take(sender.key)

    def _take_off(self, order: Order) -> None:
        self._authority.must_be_free(order.sender.key)
        climb = None
        if finite(order.z) and order.z != 0.0:
            climb = TakeOff(float(self._place(order.frame, 0.0, 0.0, order.z)[2]))
        self._fly(PX4Mode.TAKEOFF, order.sender, climb)

    def _start_mission(self, order: Order) -> None:
        self._authority.must_be_free(order.sender.key)
        if first := whole(order.params[0]):
            self._face.set_mission_item(first)
        self._fly(PX4Mode.MISSION, order.sender)
        self._pilot.arm()

    def _pause_continue(self, order: Order) -> int | None:
        go_on = whole(order.params[0])
        if go_on not in (0, 1):
            return _DENIED
        self._change(PX4Mode.MISSION if go_on else PX4Mode.HOLD, order.sender)
        return None

    def _set_mission_item(self, order: Order) -> int | None:
        self._authority.must_command(order.sender.key)
        index = whole(order.params[0])
        return None if index is not None and self._face.set_mission_item(index) else _DENIED

    # ---- where to ------------------------------------------------------------------------------------

    def _reposition(self, order: Order) -> int | None:
        self._authority.must_be_free(order.sender.key)
        if not (whole(order.params[1]) or 0) & m.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE:
            return _UNSUPPORTED
        if not self._pilot.flying:
            raise Refused("not flying")
        here = self._pilot.state.position_enu_m
        if finite(order.x, order.y) and (order.x, order.y) != (0.0, 0.0):
            there = self._place(order.frame, order.x, order.y, order.z if finite(order.z) else 0.0)
        else:
            there = np.array([here[0], here[1], self._place(order.frame, 0.0, 0.0, order.z)[2]])
        if not finite(order.z):
            there[2] = here[2]
        self._hold_at(there, order.params[3], order.sender)
        if order.params[0] > 0.0:
            self._pilot.speed_mps = order.params[0]
        return None

    def _change_altitude(self, order: Order) -> None:
        self._authority.must_be_free(order.sender.key)
        if not self._pilot.flying:
            raise Refused("not flying")
        here = self._pilot.state.position_enu_m
        frame = whole(order.params[1])
        height = self._place(m.MAV_FRAME_GLOBAL if frame is None else frame, 0.0, 0.0, order.params[0])[2]
        self._hold_at(np.array([here[0], here[1], height]), float("nan"), order.sender)

    def _hold_at(self, there: F64, yaw: float, sender: Sender) -> None:
        if self._pilot.outside_fence(there):
            raise Denied("denied: outside the geofence")
        heading = yaw_from_heading(float(np.degrees(yaw))) if abs(yaw) < 1e3 else None
        self._fly(PX4Mode.HOLD, sender, Hold(there, heading))

    def _change_speed(self, order: Order) -> int | None:
        self._authority.must_command(order.sender.key)
        speed = order.params[1]
        if not finite(speed):
            return _DENIED
        self._pilot.speed_mps = speed if speed > 0.0 else None
        return None

    def _set_home(self, order: Order) -> None:
        self._authority.must_command(order.sender.key)
        if whole(order.params[0]) == 1:
            self._pilot.home_enu_m = self._pilot.state.position_enu_m
            return
        home = self._pilot.site.enu(order.x, order.y, order.z)
        if np.linalg.norm(home - self._pilot.state.position_enu_m) > _FARTHEST_HOME_M:
            raise Denied("denied: home would be too far away")
        if self._pilot.flying and self._pilot.outside_fence(home):
            raise Denied("denied: outside the geofence")
        self._pilot.home_enu_m = home

    def _place(self, frame: int, latitude_deg: float, longitude_deg: float, z: float) -> F64:
        """A place in ENU; at 0, 0 only its height is used."""
        site = self._pilot.site
        above = site.geodetic(self._pilot.home_enu_m)[2] if frame in ABOVE_HOME else 0.0
        if (latitude_deg, longitude_deg) == (0.0, 0.0):
            if not abs(z) < 1e5:
                raise Denied("denied: no such altitude")
            return np.array([0.0, 0.0, above + z - site.frame.altitude_m])
        return site.enu(latitude_deg, longitude_deg, above + z)

    # ---- messages and payload ------------------------------------------------------------------------

    def _request(self, kind: float, sender: Sender) -> int | None:
        number = whole(kind)
        return None if number is not None and self._face.send_once(number, sender) else _DENIED

    def _set_interval(self, order: Order) -> int | None:
        kind = whole(order.params[0])
        streams = self._face.streams_of(order.sender)
        if streams is None:
            return _LATER
        return None if kind is not None and streams.set_interval(kind, order.params[1]) else _FAILED

    def _get_interval(self, order: Order) -> int | None:
        kind = whole(order.params[0])
        if kind is None or not 0 <= kind <= 65535:
            return _DENIED
        streams = self._face.streams_of(order.sender)
        interval = -1 if streams is None else streams.interval_us(kind)
        order.sender.reply(m.MAVLink_message_interval_message(kind, interval))
        return None

    def _configure_gimbal(self, order: Order) -> int | None:
        who = (order.sender.system, order.sender.component)
        return None if self._payload.configure(order.params, who) else _DENIED

    def _point_gimbal(self, order: Order) -> int | None:
        who = (order.sender.system, order.sender.component)
        return None if self._payload.point(order.params[0], who) else _DENIED
