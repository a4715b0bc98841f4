"""Setpoints to a PX4 in Offboard, at least 20 times a second."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from skysweep.geometry.frames import heading_from_yaw, ned_from_enu
from skysweep.types import F64, Setpoint
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import Site
from skysweep.vehicles.px4.link import PX4Link
from skysweep.vehicles.px4.telemetry import Telemetry

_NO_XY = m.POSITION_TARGET_TYPEMASK_X_IGNORE | m.POSITION_TARGET_TYPEMASK_Y_IGNORE
_POSITION_VELOCITY_YAW = (
    m.POSITION_TARGET_TYPEMASK_AX_IGNORE
    | m.POSITION_TARGET_TYPEMASK_AY_IGNORE
    | m.POSITION_TARGET_TYPEMASK_AZ_IGNORE
    | m.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
)


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


class SetpointStream:
    """Streams the newest setpoint from ``start`` to ``stop``, while ``may_stream``."""

    def __init__(
        self, link: PX4Link, telemetry: Telemetry, may_stream: Callable[[], bool], gain_per_s: float
    ) -> None:
        self._link, self._telemetry, self._may_stream = link, telemetry, may_stream
        self._gain_per_s = gain_per_s
        self._goal: tuple[Setpoint, Site] | None = None
        self._end: Callable[[], None] | None = None

    def aim(self, setpoint: Setpoint, site: Site) -> None:
        """Sets the setpoint of the next messages."""
        self._goal = setpoint, site

    def start(self) -> bool:
        """Starts to stream, after ``aim``; False if it streams already."""
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
        x, y, z = site.ned_from_enu(setpoint.position_enu_m).tolist()
        velocity = np.zeros(3) if setpoint.velocity_enu_mps is None else setpoint.velocity_enu_mps.copy()
        cruise = horizontal_velocity_enu_mps(setpoint, site.enu_from_ned(told.ned_m), self._gain_per_s)
        if cruise is not None:
            velocity[:2] = cruise
        vx, vy, vz = ned_from_enu(velocity).tolist()
        self._link.send(
            "SET_POSITION_TARGET_LOCAL_NED",
            time_boot_ms=round(told.boot_s * 1e3),
            coordinate_frame=m.MAV_FRAME_LOCAL_NED,
            type_mask=_POSITION_VELOCITY_YAW | (0 if cruise is None else _NO_XY),
            **{"x": x, "y": y, "z": z, "vx": vx, "vy": vy, "vz": vz, "afx": 0.0, "afy": 0.0, "afz": 0.0},
            yaw=math.radians(heading_from_yaw(setpoint.yaw_rad)),
            yaw_rate=0.0,
        )
