"""Houses: a box with windows, a gable roof with eaves, a chimney."""

from __future__ import annotations

import numpy as np

from skysweep.arrays import F64
from skysweep.worlds.assets.looks import Appearance
from skysweep.worlds.materials import Material
from skysweep.worlds.meshes import Mesh, box, make_mesh, merge
from skysweep.worlds.textures import Layer

_WALL = "d6ccb8 b0745c deded8 963c30 c8b278 8c9696"
_ROOF = "964e3a 606064 785442 464a52 823c32"
STOREY_M = 3.0
EAVES_M = 0.4


def building_mesh(
    size_m: tuple[float, float], height_m: float, variant: int, flat_roof: bool = False
) -> Mesh:
    """A house of length (x) and width (y) with eaves at ``height_m``; the ridge runs along the length."""
    looks = Appearance.of("building", variant)
    wall, roof = looks.pick(_WALL), looks.pick(_ROOF)
    x, y = size_m[0] / 2, size_m[1] / 2
    rise = y * looks.between(0.45, 0.8)
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    parts = [_wall(a, b, height_m, wall) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    if flat_roof:
        v = [(*corner, height_m) for corner in corners]
        uv = np.array(corners) / 3.2
        roof_mesh = make_mesh(v, [[0, 1, 2], [0, 2, 3]], (0.42, 0.41, 0.40), Layer.PLAIN, uv=uv)
        return merge([*parts, roof_mesh.made_of(Material.ROOF)])
    for side in (1, -1):
        v = [(side * x, -side * y, height_m), (side * x, side * y, height_m), (side * x, 0, height_m + rise)]
        uv = np.array([(-y, 0), (y, 0), (0, rise)]) / STOREY_M
        parts.append(make_mesh(v, [[0, 1, 2]], wall, Layer.WALL, uv=uv))
    slope = np.hypot(y, rise) / y
    low = height_m - EAVES_M * rise / y
    ex, ey = x + EAVES_M, y + EAVES_M
    for side in (1, -1):
        v = [(k * ex, -side * ey, low) for k in (-side, side)] + [
            (k * ex, 0, height_m + rise) for k in (side, -side)
        ]
        length = ey * slope
        uv = np.array([(0, length), (2 * ex, length), (2 * ex, 0), (0, 0)]) / 3.2
        parts.append(
            make_mesh(np.array(v) + np.array([0, 0, 0.08]), [[0, 1, 2], [0, 2, 3]], roof, Layer.ROOF, uv=uv)
        )
        below = make_mesh(v, [[0, 2, 1], [0, 3, 2]], roof * 0.5, Layer.PLAIN, uv=uv)
        parts.append(below.made_of(Material.WOOD))
    chimney = box((0.6, 0.6, 0.9 + 0.5 * rise), (0.50, 0.33, 0.28), layer=Layer.WALL)
    parts.append(chimney.moved((looks.between(-0.6, 0.6) * x, 0.4 * y, height_m + 0.45 * rise)))
    return merge(parts)


def _wall(a: tuple[float, float], b: tuple[float, float], height_m: float, colour: F64) -> Mesh:
    """A wall from a to b, outside on the right, one window per 3 m and storey."""
    length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
    bays, storeys = max(1, round(length / STOREY_M)), max(1, round(height_m / STOREY_M))
    v = [(*a, 0), (*b, 0), (*b, height_m), (*a, height_m), (*a, -1.5), (*b, -1.5)]
    uv = [(0, storeys), (bays, storeys), (bays, 0), (0, 0), (0, storeys + 0.1), (bays, storeys + 0.1)]
    main = make_mesh(v[:4], [[0, 1, 2], [0, 2, 3]], colour, Layer.WINDOWS, uv=uv[:4])
    base = make_mesh(
        [v[4], v[5], v[1], v[0]], [[0, 1, 2], [0, 2, 3]], (0.45, 0.44, 0.42), Layer.PLAIN, uv=[(0, 0)] * 4
    )
    return merge([main, base.made_of(Material.WALL)])
