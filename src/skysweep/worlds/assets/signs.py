"""Road signs: the stop sign (a target) and the round no-entry sign (its look-alike)."""

from __future__ import annotations

import numpy as np

from skysweep.arrays import F64
from skysweep.worlds.assets.looks import Appearance
from skysweep.worlds.meshes import Mesh, circle, merge, plate, prism, tube
from skysweep.worlds.textures import Decal, decal_layer
from skysweep.worlds.world import STANDING_SIGN_EDGE_M

STEEL = (0.62, 0.63, 0.64)


def stop_sign(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """An octagon ``size_m`` across the flats, lying a little tilted or standing on a post."""
    a = np.pi / 8 + np.arange(8) * np.pi / 4
    corners = np.column_stack([np.cos(a), np.sin(a)]) * size_m / 2 / np.cos(np.pi / 8)
    return _sign(looks, size_m, pose, corners, Decal.STOP_SIGN, size_m / 2 / np.cos(np.pi / 8))


def round_sign(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """A disc ``size_m`` in diameter."""
    return _sign(looks, size_m, pose, circle(28) * size_m / 2, Decal.ROUND_SIGN, size_m / 2)


def _sign(looks: Appearance, size_m: float, pose: str, outline: F64, decal: Decal, radius_m: float) -> Mesh:
    layer = decal_layer(decal, looks.variant)
    top = 0.02
    face = merge([prism(outline, 0.0, top, STEEL), plate(outline, top + 0.002, (1, 1, 1), layer, radius_m)])
    tilt = looks.rng.normal(0, np.radians(4 if looks.held_out else 3), 2)
    if pose == "standing":
        upright = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # facing +x
        post = tube([(-0.04, 0, 0), (-0.04, 0, STANDING_SIGN_EDGE_M + 0.9 * size_m)], [0.035, 0.035], STEEL)
        return merge([post, face.moved((0, 0, STANDING_SIGN_EDGE_M + size_m / 2), upright)])
    c, s = np.cos(tilt), np.sin(tilt)
    pitch = np.array([[c[0], 0, s[0]], [0, 1, 0], [-s[0], 0, c[0]]])
    roll = np.array([[1, 0, 0], [0, c[1], -s[1]], [0, s[1], c[1]]])
    lift = 0.03 + size_m / 2 * float(np.abs(np.sin(tilt)).sum())
    return face.moved((0, 0, lift), pitch @ roll)
