"""Coordinate frames: the only place where one frame becomes another.

Inside skysweep everything is local ENU metres with body FLU (REP-103). NED/FRD (PX4, MAVLink) and
geodetic latitude/longitude (QGroundControl, exports) exist at the borders and are converted here.
Camera frames are optical: x right, y down, z forward.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pyproj
from numpy.typing import ArrayLike

from skysweep.arrays import F64

# ENU <-> NED is its own inverse: swap x and y, flip z. FLU <-> FRD flips y and z.
_ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_FLU_FRD = np.diag([1.0, -1.0, -1.0])


def ned_from_enu(vectors_enu: ArrayLike) -> F64:
    """Vectors (..., 3) from ENU to NED."""
    return np.asarray(np.asarray(vectors_enu, dtype=float) @ _ENU_NED.T)


enu_from_ned = ned_from_enu  # its own inverse


def rotation_flu_to_enu(R_frd_to_ned: ArrayLike) -> F64:
    """Attitude (3, 3) from PX4's convention (FRD -> NED) to ours (FLU -> ENU)."""
    return np.asarray(_ENU_NED @ np.asarray(R_frd_to_ned, dtype=float) @ _FLU_FRD)


def rotation_frd_to_ned(R_flu_to_enu: ArrayLike) -> F64:
    """Attitude (3, 3) from our convention (FLU -> ENU) to PX4's (FRD -> NED)."""
    return np.asarray(_ENU_NED @ np.asarray(R_flu_to_enu, dtype=float) @ _FLU_FRD)


def heading_from_yaw(yaw_rad: float) -> float:
    """Compass heading in degrees [0, 360) from ENU yaw (0 = east, counter-clockwise)."""
    return float((90.0 - np.degrees(yaw_rad)) % 360.0)


def yaw_from_heading(heading_deg: float) -> float:
    """ENU yaw in radians (-pi, pi] from compass heading in degrees (0 = north, clockwise)."""
    return wrap_angle(np.radians(90.0 - heading_deg))


def wrap_angle(angle_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    return float(np.pi - (np.pi - angle_rad) % (2.0 * np.pi))


def rotation_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> F64:
    """R_body_to_parent (3, 3) for intrinsic Z-Y-X Euler angles (yaw, then pitch, then roll)."""
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    cp, sp = np.cos(pitch_rad), np.sin(pitch_rad)
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def euler_from_rotation(R: ArrayLike) -> tuple[float, float, float]:
    """Roll, pitch, yaw in radians of R_body_to_parent (3, 3), Z-Y-X intrinsic."""
    m = np.asarray(R, dtype=float)
    pitch = -np.arcsin(np.clip(m[2, 0], -1.0, 1.0))
    return float(np.arctan2(m[2, 1], m[2, 2])), float(pitch), float(np.arctan2(m[1, 0], m[0, 0]))


def rotation_camera_to_enu(yaw_rad: float, pitch_rad: float, roll_rad: float = 0.0) -> F64:
    """R_camera_to_enu (3, 3) of a camera looking along ENU yaw with pitch above the horizon.

    pitch_rad = -pi/2 looks straight down with the image's top towards yaw_rad. Optical axes: x right,
    y down, z forward. roll_rad turns the picture clockwise about the optical axis.
    """
    cp, sp, cy, sy = np.cos(pitch_rad), np.sin(pitch_rad), np.cos(yaw_rad), np.sin(yaw_rad)
    right = np.array([sy, -cy, 0.0])
    forward = np.array([cy * cp, sy * cp, sp])
    down = np.cross(forward, right)
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    return np.column_stack([cr * right + sr * down, cr * down - sr * right, forward])


@dataclass(frozen=True)
class LocalFrame:
    """An ENU tangent frame at a geodetic origin (WGS 84; altitudes are ellipsoidal metres).

    Uses PROJ's topocentric conversion (EPSG method 9837), exact at any distance.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0
    _to_enu: pyproj.Transformer = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        longitude, latitude, altitude = map(float, (self.longitude_deg, self.latitude_deg, self.altitude_m))
        pipeline = (
            "+proj=pipeline +step +proj=axisswap +order=2,1 +step +proj=unitconvert +xy_in=deg +xy_out=rad "
            "+step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
            f"+lon_0={longitude!r} +lat_0={latitude!r} +h_0={altitude!r}"
        )
        object.__setattr__(self, "_to_enu", pyproj.Transformer.from_pipeline(pipeline))

    def enu_from_geodetic(self, lat_lon_alt: ArrayLike) -> F64:
        """(N, 3) latitude deg, longitude deg, ellipsoidal altitude m -> (N, 3) ENU metres."""
        a = np.atleast_2d(np.asarray(lat_lon_alt, dtype=float))
        return np.column_stack(self._to_enu.transform(a[:, 0], a[:, 1], a[:, 2]))

    def geodetic_from_enu(self, position_enu_m: ArrayLike) -> F64:
        """(N, 3) ENU metres -> (N, 3) latitude deg, longitude deg, ellipsoidal altitude m."""
        a = np.atleast_2d(np.asarray(position_enu_m, dtype=float))
        inverse = pyproj.enums.TransformDirection.INVERSE
        return np.column_stack(self._to_enu.transform(a[:, 0], a[:, 1], a[:, 2], direction=inverse))
