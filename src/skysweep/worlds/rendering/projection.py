"""Matrices and the view frustum of a pinhole camera, for renderers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.geometry.camera import CameraPose, Lens

NEAR_M, FAR_M = 0.2, 6000.0


def view_projection(lens: Lens, pose: CameraPose) -> F64:
    """(4, 4) from ENU to clip space with the picture's first row at the bottom of the frame buffer."""
    f = lens.focal_px
    z = (FAR_M + NEAR_M) / (FAR_M - NEAR_M)
    projection = np.array(
        [
            [2 * f / lens.width_px, 0, 0, 0],
            [0, 2 * f / lens.height_px, 0, 0],
            [0, 0, z, -2 * FAR_M * NEAR_M / (FAR_M - NEAR_M)],
            [0, 0, 1, 0],
        ]
    )
    view = np.eye(4)
    view[:3, :3] = pose.R_camera_to_enu.T
    view[:3, 3] = -pose.R_camera_to_enu.T @ pose.position_enu_m
    return projection @ view


class Projection:
    """The view of a clip matrix: what is in sight, and how large."""

    def __init__(self, matrix: F64, eye: F64 | None, focal_px: float) -> None:
        """Without ``eye`` the view is parallel and ``focal_px`` is pixels a metre."""
        self.matrix = matrix
        self._eye = eye
        self._focal_px = focal_px
        m = matrix
        planes = np.stack([m[3] + m[0], m[3] - m[0], m[3] + m[1], m[3] - m[1], m[3] + m[2]])
        self._planes = planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)

    @classmethod
    def of(cls, lens: Lens, pose: CameraPose) -> Projection:
        return cls(view_projection(lens, pose), pose.position_enu_m, lens.focal_px)

    def sees(self, centres: F64, radii: F64) -> NDArray[np.bool_]:
        """Which spheres (N, 3), (N,) touch the frustum (far plane aside)."""
        distance = centres @ self._planes[:, :3].T + self._planes[:, 3]
        return np.asarray((distance >= -radii[:, None]).all(axis=1))

    def sees_boxes(self, low: F64, high: F64) -> NDArray[np.bool_]:
        """Which boxes (N, 3), (N, 3) touch the frustum (far plane aside), and a few that do not."""
        seen = np.ones(len(low), bool)
        for plane in self._planes:
            seen &= np.where(plane[:3] > 0.0, high, low) @ plane[:3] >= -plane[3]
        return seen

    def nearest(self, low: F64, high: F64) -> F64:
        """The place (N, 3) of each box that is nearest to the eye; without an eye, its low corner."""
        return low if self._eye is None else np.asarray(np.clip(self._eye, low, high))

    def frame(self, points: F64) -> F64:
        """Low and high corner (2, 2) of the part of the picture, -1..1, that holds ``points`` (N, 3)."""
        clip = np.column_stack([points, np.ones(len(points))]) @ self.matrix.T
        if (clip[:, 3] < NEAR_M).any():
            return np.array([[-1.0, -1.0], [1.0, 1.0]])
        xy = clip[:, :2] / clip[:, 3:]
        return np.asarray(np.clip([xy.min(axis=0), xy.max(axis=0)], -1.0, 1.0))

    def pixels(self, centres: F64, radii: F64) -> F64:
        """Radii (N,) in pixels of spheres (N, 3), (N,)."""
        if self._eye is None:
            return np.asarray(radii * self._focal_px)
        distance = np.linalg.norm(centres - self._eye, axis=1)
        return np.asarray(self._focal_px * radii / np.maximum(distance, NEAR_M))
