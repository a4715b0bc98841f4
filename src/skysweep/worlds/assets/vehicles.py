"""Cars and vans."""

from __future__ import annotations

import numpy as np

from skysweep.arrays import F64
from skysweep.worlds.assets.looks import Appearance
from skysweep.worlds.meshes import Mesh, ellipsoid, loft, merge

_PAINT = "e8e8e6 c8cacc 8a8c90 2a2a2e 1e2024 8c1a1c b02a24 22406e 3a6a94 5a6a4a b8a888 d8c020"
_PAINT_HELD_OUT = "dcdcdc 9a9ea4 3a3c40 16181c a43c20 1a5a6a 6a2a3a 44583a c89040"
_GLASS = (0.09, 0.11, 0.14)
_TYRE = (0.07, 0.07, 0.08)


def car(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """A car, or a van where it is long: bonnet, screens, roof, wheels."""
    paint, wide = looks.pick(_PAINT, _PAINT_HELD_OUT), 0.21 * size_m + 0.9
    van = size_m > 4.9
    belt, top = (1.0, looks.between(1.9, 2.4)) if van else (0.85, looks.between(1.38, 1.6))
    rear, front = (-0.49, 0.30) if van else (-looks.between(0.28, 0.46), looks.between(0.12, 0.2))
    sections = [  # height, rear and front as shares of the length, share of the width, colour
        (0.22, -0.49, 0.49, 0.92, paint * 0.5),
        (0.55, -0.5, 0.5, 1.0, paint),
        (belt - 0.05, -0.49, 0.48, 0.98, paint),
        (belt, -0.48, 0.47, 0.95, paint),
        (belt, rear - 0.02, front + 0.09, 0.92, np.array(_GLASS)),
        (top - 0.06, rear + 0.03, front - 0.03, 0.80, np.array(_GLASS)),
        (top - 0.06, rear + 0.03, front - 0.03, 0.80, paint),
        (top, rear + 0.06, front - 0.07, 0.74, paint),
    ]
    rings, colours = [], []
    for z, back, ahead, share, colour in sections:
        rings.append(_rounded(back * size_m, ahead * size_m, share * wide / 2, z))
        colours.append(colour)
    body = loft(np.stack(rings), np.clip(np.stack(colours), 0, 1))
    wheel = ellipsoid((0.33, 0.12, 0.33), _TYRE, n=8)
    wheels = [wheel.moved((x * size_m, y * 0.46 * wide, 0.33)) for x in (-0.3, 0.3) for y in (-1, 1)]
    return merge([body, *wheels])


def _rounded(back: float, front: float, half: float, z: float) -> F64:
    """A rectangle (16, 3) with round corners, counter-clockwise."""
    r = 0.35 * half
    corners = ((front - r, half - r), (back + r, half - r), (back + r, r - half), (front - r, r - half))
    ring = []
    for k, (x, y) in enumerate(corners):
        a = (k + np.linspace(0, 1, 4)) * np.pi / 2
        ring.append(np.column_stack([x + r * np.cos(a), y + r * np.sin(a), np.full(4, z)]))
    return np.concatenate(ring)
