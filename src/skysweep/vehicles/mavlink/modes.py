"""PX4's modes and coordinates as MAVLink carries them.

Sources: px4_custom_mode.h (modes), commander (base modes), MAVLink common.xml.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from skysweep.geometry.frames import LocalFrame, enu_from_ned, ned_from_enu
from skysweep.types import F64

SYSTEM_ID = 1
AUTOPILOT, CAMERA = 1, 100  # component ids
TICK_S = 0.02  # of the autopilot, in vehicle time

_MAIN_AUTO, _MAIN_OFFBOARD = 4, 6
_CUSTOM, _AUTO, _GUIDED, _STABILISED, _MANUAL, _ARMED = 1, 4, 8, 16, 64, 128  # MAV_MODE_FLAG


class PX4Mode(Enum):
    """A flight mode; its value is PX4's (main mode, sub mode)."""

    ALTITUDE = (2, 0)
    POSITION = (3, 0)
    STABILIZED = (7, 0)
    TERMINATION = (10, 0)
    TAKEOFF = (_MAIN_AUTO, 2)
    HOLD = (_MAIN_AUTO, 3)
    MISSION = (_MAIN_AUTO, 4)
    RETURN = (_MAIN_AUTO, 5)
    LAND = (_MAIN_AUTO, 6)
    OFFBOARD = (_MAIN_OFFBOARD, 0)

    @property
    def custom_mode(self) -> int:
        main, sub = self.value
        return int(main << 16 | sub << 24)

    def base_mode(self, armed: bool) -> int:
        return _CUSTOM | _FLAGS.get(self, _STABILISED | _AUTO | _GUIDED) | (_ARMED if armed else 0)

    @property
    def standard_mode(self) -> int:
        return _STANDARD_MODES.get(self, 0)


STICK_MODES = (PX4Mode.POSITION, PX4Mode.ALTITUDE, PX4Mode.STABILIZED)
_FLAGS = dict.fromkeys(STICK_MODES, _STABILISED | _MANUAL) | {
    PX4Mode.OFFBOARD: _STABILISED,
    PX4Mode.TERMINATION: 0,
}
_STANDARD_MODES = {
    PX4Mode.POSITION: 1,
    PX4Mode.ALTITUDE: 4,
    PX4Mode.RETURN: 5,
    PX4Mode.MISSION: 6,
    PX4Mode.LAND: 7,
    PX4Mode.TAKEOFF: 8,
}


def mode_of(main: int, sub: int) -> PX4Mode | None:
    """The mode with these numbers; None if there is no such mode."""
    try:
        return PX4Mode((main, sub if main == _MAIN_AUTO else 0))
    except ValueError:
        return None


class Refused(Exception):
    """The vehicle refuses an order; the text is the reason."""


@dataclass(frozen=True, slots=True)
class Site:
    """Converts between geodetic, local NED and our ENU coordinates."""

    frame: LocalFrame
    origin_enu_m: F64  # (3,) of local NED: where the estimator started

    def ned_from_enu(self, position_enu_m: F64) -> F64:
        return ned_from_enu(position_enu_m - self.origin_enu_m)

    def enu_from_ned(self, position_ned_m: F64) -> F64:
        return enu_from_ned(position_ned_m) + self.origin_enu_m

    def geodetic(self, position_enu_m: F64) -> tuple[float, float, float]:
        """Latitude and longitude in degrees, altitude AMSL in metres."""
        latitude, longitude, altitude = self.frame.geodetic_from_enu(position_enu_m)[0].tolist()
        return latitude, longitude, altitude

    def enu(self, latitude_deg: float, longitude_deg: float, altitude_amsl_m: float) -> F64:
        """The position (3,) of a place on Earth. Raises Refused if it is out of range."""
        if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0 and abs(altitude_amsl_m) < 1e5):
            raise Refused("no such place on Earth")
        return np.asarray(self.frame.enu_from_geodetic([latitude_deg, longitude_deg, altitude_amsl_m])[0])


def quaternion(roll_rad: float, pitch_rad: float, yaw_rad: float) -> list[float]:
    """(w, x, y, z) of Z-Y-X Euler angles."""
    cr, sr = math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad)
    cp, sp = math.cos(0.5 * pitch_rad), math.sin(0.5 * pitch_rad)
    cy, sy = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    return [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]


def e7(degrees: float) -> int:
    """Degrees as MAVLink's integers."""
    return round(degrees * 1e7)


def finite(*values: float) -> bool:
    """Whether all values are finite."""
    return all(math.isfinite(v) for v in values)


def whole(value: float) -> int | None:
    """The integer that a command's float stands for; None if there is none."""
    return round(value) if math.isfinite(value) and abs(value) < 2**31 else None
