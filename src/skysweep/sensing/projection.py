"""Matrices and the view frustum of a pinhole camera, for renderers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skysweep.geometry.camera import CameraPose, Lens

F64 = NDArray[np.float64]

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


def frustum_planes(matrix: F64) -> F64:
    """Left, right, bottom, top and near planes (5, 4) of a clip matrix: n . p + d >= 0 inside, |n| = 1."""
    m = matrix
    planes = np.stack([m[3] + m[0], m[3] - m[0], m[3] + m[1], m[3] - m[1], m[3] + m[2]])
    return np.asarray(planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True))


def spheres_inside(planes: F64, centres: F64, radii: F64) -> NDArray[np.bool_]:
    """Which spheres (N, 3), (N,) touch the frustum."""
    distance = centres @ planes[:, :3].T + planes[:, 3]
    return np.asarray((distance >= -radii[:, None]).all(axis=1))
