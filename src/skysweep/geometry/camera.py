"""Pinhole camera: projection, footprints, pixels on target. Pure functions of lens and pose."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from skysweep.arrays import F64

FLATTEST_RAD = math.radians(10.0)  # below the horizon: ground seen flatter counts as not seen
_CELLS = 48  # of a picture on each side, in sums over it


@dataclass(frozen=True, slots=True)
class Lens:
    """An ideal pinhole lens with square pixels and a centred principal point."""

    width_px: int
    height_px: int
    hfov_rad: float

    @property
    def focal_px(self) -> float:
        """Focal length in pixels: f = W / (2 tan(hfov / 2))."""
        return _focal_px(self.width_px, self.hfov_rad)

    @property
    def K(self) -> F64:
        """Camera matrix (3, 3)."""
        f = self.focal_px
        return np.array([[f, 0.0, self.width_px / 2], [0.0, f, self.height_px / 2], [0.0, 0.0, 1.0]])

    @property
    def corners_px(self) -> F64:
        """The picture's corners (4, 2)."""
        return np.array([[x, y] for x in (0.0, self.width_px) for y in (0.0, self.height_px)])

    def pixels_on_target(self, size_m: float, distance_m: ArrayLike) -> F64:
        """Pixels that an object of ``size_m`` spans, seen face-on at ``distance_m``."""
        return np.asarray(self.focal_px * size_m / np.asarray(distance_m, dtype=float))

    def gsd_m(self, distance_m: float) -> float:
        """Ground sample distance (metres a pixel) looking straight down from ``distance_m``."""
        return distance_m / self.focal_px

    def footprint_m(self, altitude_agl_m: float) -> tuple[float, float]:
        """Ground (width, height) in metres of a nadir picture over flat ground."""
        gsd_m = self.gsd_m(altitude_agl_m)
        return self.width_px * gsd_m, self.height_px * gsd_m

    def seen_ground_m2(self, pose: CameraPose, height_m: float) -> float:
        """Area of level ground in a picture, ``height_m`` below the camera, out to ``FLATTEST_RAD``.

        A pixel's solid angle is cos³ / f²; the ground's distance and slope turn it into square metres.
        """
        u, v = np.meshgrid(
            (np.arange(_CELLS) + 0.5) * self.width_px / _CELLS,
            (np.arange(_CELLS) + 0.5) * self.height_px / _CELLS,
        )
        rays = rays_enu(self, pose, np.column_stack([u.ravel(), v.ravel()]))
        steep = -rays[:, 2]
        along = rays @ pose.R_camera_to_enu[:, 2]
        solid = along**3 * (self.width_px * self.height_px / _CELLS**2) / self.focal_px**2
        seen = steep >= np.sin(FLATTEST_RAD)
        return float((solid[seen] * height_m**2 / steep[seen] ** 3).sum())


@lru_cache
def _focal_px(width_px: int, hfov_rad: float) -> float:
    return float(width_px / (2.0 * np.tan(hfov_rad / 2.0)))


class CameraPose(NamedTuple):
    """Position (3,) and attitude of a camera; ``R_camera_to_enu`` (3, 3) maps optical axes to ENU."""

    position_enu_m: F64
    R_camera_to_enu: F64

    @property
    def pitch_rad(self) -> float:
        """Of the optical axis, above the horizon."""
        return math.asin(max(-1.0, min(1.0, self.R_camera_to_enu.item(8))))


class CameraMotion(NamedTuple):
    """A camera's motion in its own optical axes (x right, y down, z forward)."""

    velocity_mps: F64  # (3,)
    rates_radps: F64  # (3,)


def pose_between(a: CameraPose, b: CameraPose, share: float) -> CameraPose:
    """The pose at a share (0..1) of the way from one to another: position linear, attitude by slerp."""
    from scipy.spatial.transform import Rotation  # imported late: it takes half a second

    turn = Rotation.from_matrix(b.R_camera_to_enu @ a.R_camera_to_enu.T).as_rotvec()
    return CameraPose(
        (1 - share) * a.position_enu_m + share * b.position_enu_m,
        np.asarray(Rotation.from_rotvec(share * turn).as_matrix() @ a.R_camera_to_enu),
    )


def project(lens: Lens, pose: CameraPose, points_enu_m: ArrayLike) -> tuple[F64, F64]:
    """Pixels (N, 2) and depths (N,) in metres of points (N, 3). Depth <= 0 means behind the camera."""
    p = (np.atleast_2d(np.asarray(points_enu_m, dtype=float)) - pose.position_enu_m) @ pose.R_camera_to_enu
    return projected(lens, p)


def projected(lens: Lens, points_camera_m: F64) -> tuple[F64, F64]:
    """The same of points (N, 3) in the camera's axes."""
    p, depth = points_camera_m, points_camera_m[:, 2]
    z = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
    return lens.focal_px * p[:, :2] / z[:, None] + [lens.width_px / 2, lens.height_px / 2], depth


def rays_enu(lens: Lens, pose: CameraPose, pixels: ArrayLike) -> F64:
    """Unit ray directions (N, 3) in ENU through pixels (N, 2)."""
    uv = np.asarray(pixels, dtype=float).reshape(-1, 2)
    rays = np.empty((len(uv), 3))
    _write_rays(rays, uv, lens.width_px / 2, lens.height_px / 2, lens.focal_px, pose.R_camera_to_enu)
    return rays


@njit(cache=True)
def _write_rays(rays: F64, uv: F64, centre_u: float, centre_v: float, focal: float, R: F64) -> None:
    for k in range(len(uv)):
        x, y = (uv[k, 0] - centre_u) / focal, (uv[k, 1] - centre_v) / focal
        length = math.sqrt(x * x + y * y + 1.0)
        for i in range(3):
            rays[k, i] = (R[i, 0] * x + R[i, 1] * y + R[i, 2]) / length
