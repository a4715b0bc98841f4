"""Setpoints to a PX4 in Offboard, at least 20 times a second."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from skysweep.geometry.frames import enu_from_ned, heading_from_yaw, ned_from_enu
from skysweep.types import F64, Setpoint
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import PX4Mode, Site
from skysweep.vehicles.px4.link import PX4Link
from skysweep.vehicles.px4.telemetry import Telemetry

_BRAKES_MPS2 = 3.0  # deceleration into a hover
_NO_XY = m.POSITION_TARGET_TYPEMASK_X_IGNORE | m.POSITION_TARGET_TYPEMASK_Y_IGNORE
_NO_PLACE = _NO_XY | m.POSITION_TARGET_TYPEMASK_Z_IGNORE
_NO_ACCELERATION = (
    m.POSITION_TARGET_TYPEMASK_AX_IGNORE
    | m.POSITION_TARGET_TYPEMASK_AY_IGNORE
    | m.POSITION_TARGET_TYPEMASK_AZ_IGNORE
)
_POSITION_VELOCITY_YAW = _NO_ACCELERATION | m.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_STANDSTILL = _NO_ACCELERATION | _NO_PLACE | m.POSITION_TARGET_TYPEMASK_YAW_IGNORE


def horizontal_velocity_enu_mps(setpoint: Setpoint, position_enu_m: F64, gain_per_s: float) -> F64 | None:
    """The velocity (2,) towards the setpoint; None near it, where the position is enough.

    PX4 flies to a position at ``feed-forward + gain (sent - position)`` (MPC_XY_P), up to MPC_XY_VEL_MAX. If
    that exceeds ``Setpoint.speed_mps``, the velocity is sent instead, cut to that speed: no parameter is
    written, and the age of the position does not matter.
    """
    ahead = np.zeros(2) if setpoint.velocity_enu_mps is None else setpoint.velocity_enu_mps[:2]
    velocity: F64 = ahead + gain_per_s * (setpoint.position_enu_m[:2] - position_enu_m[:2])
    speed = math.hypot(velocity[0], velocity[1])
    return velocity * (setpoint.speed_mps / speed) if speed > setpoint.speed_mps else None


def stopping_place(told: Telemetry, site: Site) -> Setpoint:
    """Where the vehicle comes to rest if it brakes now."""
    velocity = enu_from_ned(told.velocity_ned_mps)
    speed = math.hypot(velocity[0], velocity[1])
    place = site.enu_from_ned(told.ned_m)
    place[:2] += velocity[:2] * speed / (2.0 * _BRAKES_MPS2)
    return Setpoint(place, max(speed, 1.0), told.yaw_rad)


class SetpointStream:
    """Streams the newest setpoint from ``start`` to ``stop``, while ``may_stream``."""

    def __init__(
        self, link: PX4Link, telemetry: Telemetry, may_stream: Callable[[], bool], gain_per_s: float
    ) -> None:
        self._link, self._telemetry, self._may_stream = link, telemetry, may_stream
        self._gain_per_s = gain_per_s
        self._goal: tuple[Setpoint | None, Site] | None = None  # without a setpoint: a hover
        self._place: Setpoint | None = None  # of the hover
        self._end: Callable[[], None] | None = None

    def aim(self, setpoint: Setpoint, site: Site) -> None:
        """Sets the setpoint of the next messages."""
        self._goal = setpoint, site

    def hover(self, site: Site) -> None:
        """Lets the next messages stop the vehicle and keep it there."""
        self._place = None
        self._goal = None, site

    @property
    def hovers(self) -> bool:
        return self._goal is not None and self._goal[0] is None

    def start(self) -> bool:
        """Starts to stream, after ``aim`` or ``hover``; False if it streams already."""
        if self._end is not None:
            return False
        self._end = self._link.stream(self._send)
        return True

    def stop(self) -> None:
        """Ends the stream. PX4 then follows COM_OBL_RC_ACT, unless it was ordered into another mode."""
        if self._end is not None:
            self._end()
            self._end = None

    def _send(self) -> None:
        goal, told = self._goal, self._telemetry
        if goal is None or not self._may_stream():
            return
        setpoint, site = goal
        setpoint = self._hover_place(site) if setpoint is None else setpoint
        if setpoint is None:
            self._say(_STANDSTILL, np.zeros(3), np.zeros(3), 0.0)
            return
        velocity = np.zeros(3) if setpoint.velocity_enu_mps is None else setpoint.velocity_enu_mps.copy()
        cruise = horizontal_velocity_enu_mps(setpoint, site.enu_from_ned(told.ned_m), self._gain_per_s)
        if cruise is not None:
            velocity[:2] = cruise
        mask = _POSITION_VELOCITY_YAW | (0 if cruise is None else _NO_XY)
        heading_rad = math.radians(heading_from_yaw(setpoint.yaw_rad))
        self._say(mask, site.ned_from_enu(setpoint.position_enu_m), ned_from_enu(velocity), heading_rad)

    def _hover_place(self, site: Site) -> Setpoint | None:
        """Chosen anew until Offboard is flown; none after a jump of the position: it only stands still."""
        told = self._telemetry
        if told.has_jumped:
            self._place = None
        elif self._place is None or told.flown != PX4Mode.OFFBOARD.value:
            self._place = stopping_place(told, site)
        return self._place

    def _say(self, mask: int, place_ned_m: F64, velocity_ned_mps: F64, heading_rad: float) -> None:
        (x, y, z), (vx, vy, vz) = place_ned_m.tolist(), velocity_ned_mps.tolist()
        self._link.send(
            "SET_POSITION_TARGET_LOCAL_NED",
            time_boot_ms=round(self._telemetry.boot_s * 1e3),
            coordinate_frame=m.MAV_FRAME_LOCAL_NED,
            type_mask=mask,
            **{"x": x, "y": y, "z": z, "vx": vx, "vy": vy, "vz": vz, "afx": 0.0, "afy": 0.0, "afz": 0.0},
            yaw=heading_rad,
            yaw_rate=0.0,
        )
