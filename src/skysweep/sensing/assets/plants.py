"""Trees and small plants: a few unit meshes a kind, placed many times.

A tree's unit mesh has height 1 and crown radius 1; its crown is inside the ellipsoid (or cone) between 0.35
and 1.0 of the height that :class:`skysweep.scenarios.world.WorldTree` promises.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from skysweep.sensing.assets.looks import RGB, Looks
from skysweep.sensing.meshes import Mesh, icosphere, lathe, loft, lumpy, make_mesh, merge
from skysweep.sensing.textures import Layer

SHAPES = 6  # unit meshes a kind

_BROADLEAF: list[RGB] = [(110, 140, 58), (92, 126, 54), (128, 146, 70), (82, 112, 58), (140, 140, 60)]
_CONIFER: list[RGB] = [(64, 92, 58), (54, 84, 56), (78, 100, 62), (60, 88, 70)]
_TRUNK: list[RGB] = [(92, 76, 60), (112, 98, 82), (80, 66, 52)]


@lru_cache(maxsize=64)
def tree_mesh(kind: str, shape: int) -> Mesh:
    """Unit mesh ``shape`` (0 .. SHAPES - 1) of a tree kind: broadleaf, conifer or bush."""
    return {"broadleaf": _broadleaf, "conifer": _conifer, "bush": _bush}[kind](Looks.of(kind, shape))


def _crown(looks: Looks, colour: np.ndarray, subdivisions: int, lumps: int, texture_per_radius: float) -> Mesh:
    """A lumpy unit sphere, darker in its hollows and below."""
    v, f = icosphere(subdivisions)
    radius = lumpy(v, looks.rng, lumps, 0.42)
    rough = 0.42 + 0.58 * radius + 0.035 * looks.rng.normal(size=len(v))
    shade = (0.45 + 0.55 * radius**1.5) * (0.8 + 0.2 * v[:, 2])
    p = v * np.minimum(rough, 1.0)[:, None]
    return make_mesh(p, f, np.clip(colour * shade[:, None], 0, 1), Layer.LEAVES, texture_per_radius)


def _broadleaf(looks: Looks) -> Mesh:
    colour = looks.pick(_BROADLEAF, _BROADLEAF)
    crown = _crown(looks, colour, 3, 26, 0.9).moved((0, 0, 0.675), scale=(1.0, 1.0, 0.325))
    trunk = lathe([(0.11, -0.05), (0.075, 0.1), (0.06, 0.5)], looks.pick(_TRUNK, _TRUNK), n=7, layer=Layer.BARK)
    return merge([crown, trunk])


def _bush(looks: Looks) -> Mesh:
    colour = looks.pick(_BROADLEAF, _BROADLEAF) * 0.92
    return _crown(looks, colour, 2, 16, 1.0).moved((0, 0, 0.42), scale=(1.0, 1.0, 0.58))


def _conifer(looks: Looks) -> Mesh:
    """Tiers of drooping branches with ragged edges."""
    colour = looks.pick(_CONIFER, _CONIFER)
    parts = [lathe([(0.10, -0.05), (0.03, 0.9)], looks.pick(_TRUNK, _TRUNK), n=6, layer=Layer.BARK)]
    tiers, n = 7, 16
    a0 = np.arange(n) * 2 * np.pi / n
    for k in range(tiers):
        t = k / tiers
        z0, z1 = 0.18 + 0.80 * t, 0.18 + 0.80 * min(t + 0.26, 1.02)
        a = a0 + looks.rng.uniform(0, 1)
        out = (1 - t) ** 0.85 * np.where(np.arange(n) % 2, 0.62, 1.0) * looks.rng.uniform(0.82, 1.0, n)
        edge = np.column_stack([np.cos(a) * out, np.sin(a) * out, z0 + 0.03 * looks.rng.normal(size=n) * (1 - t)])
        mid = np.column_stack([np.cos(a) * out * 0.5, np.sin(a) * out * 0.5, np.full(n, z0 + 0.55 * (z1 - z0))])
        tip = np.column_stack([np.cos(a) * 0.02, np.sin(a) * 0.02, np.full(n, z1)])
        shades = np.stack([colour * 1.12, colour * 0.86, colour * 0.6])
        parts.append(loft(np.stack([edge, mid, tip]), np.clip(shades, 0, 1), caps=False, layer=Layer.NEEDLES, texture_size_m=0.7))
    return merge(parts)
