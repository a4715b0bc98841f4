"""Offboard control: its owner, and flying to the owner's setpoints.

As in PX4 the mode can be entered and kept only while setpoints stream in (COM_OF_LOSS_T). Unlike in PX4 the
first program that streams owns the control until it is silent for that long or leaves the mode; setpoints of
others are refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skysweep.geometry.frames import enu_from_ned, yaw_from_heading
from skysweep.types import F64
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import TICK_S, Refused, Site, finite
from skysweep.vehicles.mavlink.wire import Message
from skysweep.vehicles.served.items import ABOVE_HOME
from skysweep.vehicles.served.link import Key
from skysweep.vehicles.served.pilot import Pilot

_YAW_IGNORED, _YAW_RATE_IGNORED = 1024, 2048  # POSITION_TARGET_TYPEMASK
_LIFT_OFF_M, _LIFT_OFF_MPS = 0.3, 0.1  # a setpoint that means: leave the ground
_OPEN = np.full(3, np.nan)
_FARTHEST_M = 1e6
_FASTEST_MPS = 100.0
_SHORTEST_HOLD_S = 1.0  # of the control, however short COM_OF_LOSS_T is


@dataclass(frozen=True, slots=True)
class OffboardSetpoint:
    """A setpoint in ENU; open axes are NaN."""

    position_enu_m: F64  # (3,)
    velocity_enu_mps: F64  # (3,)
    yaw_rad: float | None
    yaw_rate_radps: float


class OffboardControl:
    """The owner of the control and its newest setpoint."""

    def __init__(self) -> None:
        self.owner: Key | None = None
        self._setpoint: OffboardSetpoint | None = None
        self._heard_s = -np.inf
        self._yaw_rad = 0.0

    def follow(self, key: Key, setpoint: OffboardSetpoint, pilot: Pilot) -> None:
        """Takes a setpoint. Raises Refused if another program owns the control."""
        if not self.may_control(key, pilot):
            raise Refused("Offboard denied: another program is in control")
        if self.owner != key:
            self.owner, self._yaw_rad = key, pilot.yaw_rad
        self._setpoint, self._heard_s = setpoint, pilot.time_s
        if setpoint.yaw_rad is not None:
            self._yaw_rad = setpoint.yaw_rad

    def may_control(self, key: Key, pilot: Pilot) -> bool:
        if self.owner in (None, key):
            return True
        return pilot.time_s - self._heard_s > max(pilot.parameters["COM_OF_LOSS_T"], _SHORTEST_HOLD_S)

    def release(self, key: Key) -> None:
        if self.owner == key:
            self.owner, self._setpoint = None, None

    def is_fresh(self, pilot: Pilot) -> bool:
        silent_s = pilot.time_s - self._heard_s
        return self._setpoint is not None and silent_s <= pilot.parameters["COM_OF_LOSS_T"]

    def step(self, pilot: Pilot) -> None:
        setpoint = self._setpoint
        if setpoint is None or pilot.taking_off:
            return
        here = pilot.state.position_enu_m
        if not pilot.flying:
            up = setpoint.position_enu_m[2] - here[2]
            if up > _LIFT_OFF_M or setpoint.velocity_enu_mps[2] > _LIFT_OFF_MPS:
                pilot.lift_off(float(here[2] + (up if up > _LIFT_OFF_M else 1.0)))
            return
        if setpoint.yaw_rad is None:
            self._yaw_rad += setpoint.yaw_rate_radps * TICK_S
        velocity = np.nan_to_num(setpoint.velocity_enu_mps)
        # Half a tick ahead: the position controller does not act on an axis without a position.
        drifting = here + 0.5 * TICK_S * velocity
        position = np.where(np.isnan(setpoint.position_enu_m), drifting, setpoint.position_enu_m)
        pilot.fly_to(position, self._yaw_rad, np.inf, velocity)


def setpoint_of(message: Message, pilot: Pilot) -> OffboardSetpoint:
    """The setpoint of a SET_POSITION_TARGET message. Raises Refused if PX4's position control refuses it."""
    if message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT":
        return _from_global(message, pilot.site, pilot.home_enu_m)
    return _from_local(message, pilot.site, pilot.yaw_rad)


def _from_local(message: Message, site: Site, yaw_rad: float) -> OffboardSetpoint:
    position = _axes(message, 0, (message.x, message.y, message.z), _FARTHEST_M)
    velocity = _axes(message, 3, (message.vx, message.vy, message.vz), _FASTEST_MPS)
    if message.coordinate_frame in (m.MAV_FRAME_BODY_NED, m.MAV_FRAME_BODY_FRD):
        if np.isfinite(position).any():
            raise Refused("Offboard denied: body frames are for velocities")
        c, s = np.cos(yaw_rad), np.sin(yaw_rad)
        forward, right, down = np.nan_to_num(velocity)
        velocity_enu = np.array([c * forward + s * right, s * forward - c * right, -down])
        return _setpoint(message, _OPEN, velocity_enu)
    if message.coordinate_frame != m.MAV_FRAME_LOCAL_NED:
        raise Refused("Offboard denied: this frame is not supported")
    return _setpoint(message, _in_enu(position, site.enu_from_ned), _in_enu(velocity, enu_from_ned))


def _from_global(message: Message, site: Site, home_enu_m: F64) -> OffboardSetpoint:
    if message.coordinate_frame not in {m.MAV_FRAME_GLOBAL, m.MAV_FRAME_GLOBAL_INT, *ABOVE_HOME}:
        raise Refused("Offboard denied: this frame is not supported")
    ignored = _axes(message, 0, (0.0, 0.0, message.alt), _FARTHEST_M)
    position = _OPEN
    if np.isfinite(ignored).all():
        above = site.geodetic(home_enu_m)[2] if message.coordinate_frame in ABOVE_HOME else 0.0
        position = site.enu(message.lat_int * 1e-7, message.lon_int * 1e-7, above + message.alt)
    velocity = _axes(message, 3, (message.vx, message.vy, message.vz), _FASTEST_MPS)
    return _setpoint(message, position, _in_enu(velocity, enu_from_ned))


def _axes(message: Message, first_bit: int, values: tuple[float, ...], largest: float) -> F64:
    """The values (3,), NaN where the type mask ignores them."""
    open_axes = [bool(message.type_mask & (1 << (first_bit + i))) for i in range(3)]
    axes = np.where(open_axes, np.nan, values)
    if (np.abs(axes) > largest).any():
        raise Refused("Offboard denied: setpoint out of range")
    return axes


def _in_enu(axes_ned: F64, convert: Callable[[F64], F64]) -> F64:
    """Converts axes and keeps the open ones open."""
    swapped = np.isnan(axes_ned)[[1, 0, 2]]
    return np.where(swapped, np.nan, convert(np.nan_to_num(axes_ned)))


def _setpoint(message: Message, position_enu_m: F64, velocity_enu_mps: F64) -> OffboardSetpoint:
    if np.isnan(position_enu_m).all() and np.isnan(velocity_enu_mps).all():
        raise Refused("Offboard denied: neither position nor velocity")
    yaw = None
    if not message.type_mask & _YAW_IGNORED and finite(message.yaw):
        yaw = yaw_from_heading(float(np.degrees(message.yaw)))
    turns = not message.type_mask & _YAW_RATE_IGNORED and abs(message.yaw_rate) <= 2.0 * np.pi
    return OffboardSetpoint(position_enu_m, velocity_enu_mps, yaw, -message.yaw_rate if turns else 0.0)
