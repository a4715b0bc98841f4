"""Trees and small plants: a few unit meshes a kind, placed many times.

A tree's unit mesh has height 1 and crown radius 1; its crown is inside the ellipsoid (or cone) between 0.35
and 1.0 of the height that :class:`skysweep.worlds.world.WorldTree` promises.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from skysweep.arrays import F64
from skysweep.worlds.assets.looks import Appearance
from skysweep.worlds.meshes import Mesh, icosphere, lathe, loft, lumpy, make_mesh, merge
from skysweep.worlds.textures import Layer

SHAPES = 6  # unit meshes a kind
DETAILS = 3

_BROADLEAF = "8aa84e 769a48 9cac58 6c8c4c aca854"
_CONIFER = "608054 547652 6e8658 5c7a62"
_TRUNK = "5c4c3c 706252 504234"


@lru_cache(maxsize=128)
def tree_meshes(kind: str, shape: int) -> tuple[Mesh, ...]:
    """Unit mesh ``shape`` (0 .. SHAPES - 1) of a tree kind (broadleaf, conifer or bush), coarse to fine."""
    make = {"broadleaf": _broadleaf, "conifer": _conifer, "bush": _bush}[kind]
    return tuple(make(Appearance.of(kind, shape), detail) for detail in range(DETAILS))


def _crown(looks: Appearance, colour: F64, detail: int, lumps: int) -> Mesh:
    """A lumpy unit sphere, darker in its hollows and below; coarse ones are subsets of the finest."""
    v, _ = icosphere(DETAILS)
    radius = lumpy(v, looks.rng, lumps, 0.42)
    rough = 0.42 + 0.58 * radius + 0.035 * looks.rng.normal(size=len(v))
    shade = (0.62 + 0.45 * radius**1.5) * (0.85 + 0.15 * v[:, 2])
    shade *= looks.rng.uniform(0.84, 1.14, len(v))
    p = v * np.minimum(rough, 1.0)[:, None]
    colours = np.clip(colour * shade[:, None], 0, 1)
    coarse, faces = icosphere(detail + 1)
    n = len(coarse)
    return make_mesh(p[:n], faces, colours[:n], Layer.LEAVES)


def _broadleaf(looks: Appearance, detail: int) -> Mesh:
    colour = looks.pick(_BROADLEAF)
    profile = [(0.11, -0.05), (0.075, 0.1), (0.06, 0.5)]
    trunk = lathe(profile, looks.pick(_TRUNK), n=5, layer=Layer.BARK)
    crown = _crown(looks, colour, detail, 26).moved((0, 0, 0.675), scale=(1.0, 1.0, 0.325))
    return merge([crown, trunk])


def _bush(looks: Appearance, detail: int) -> Mesh:
    colour = looks.pick(_BROADLEAF) * 0.92
    return _crown(looks, colour, detail, 16).moved((0, 0, 0.42), scale=(1.0, 1.0, 0.58))


def _conifer(looks: Appearance, detail: int) -> Mesh:
    """Tiers of drooping branches with ragged edges."""
    colour = looks.pick(_CONIFER)
    parts = [lathe([(0.10, -0.05), (0.03, 0.9)], looks.pick(_TRUNK), n=5, layer=Layer.BARK)]
    tiers, n = ((4, 8), (6, 12), (8, 18))[detail]
    a0 = np.arange(n) * 2 * np.pi / n
    for k in range(tiers):
        t = k / tiers
        z0, z1 = 0.18 + 0.80 * t, 0.18 + 0.80 * min(t + 1.9 / tiers, 1.02)
        a = a0 + looks.rng.uniform(0, 1)
        out = (1 - t) ** 0.85 * np.where(np.arange(n) % 2, 0.62, 1.0) * looks.rng.uniform(0.82, 1.0, n)
        cos, sin = np.cos(a), np.sin(a)
        edge = np.column_stack([cos * out, sin * out, z0 + 0.03 * looks.rng.normal(size=n) * (1 - t)])
        middle = np.column_stack([cos * out / 2, sin * out / 2, np.full(n, 0.45 * z0 + 0.55 * z1)])
        tip = np.column_stack([cos * 0.02, sin * 0.02, np.full(n, z1)])
        rings, shades = [edge, middle, tip], [colour * 1.12, colour * 0.86, colour * 0.6]
        if detail == 0:
            del rings[1], shades[1]
        parts.append(loft(np.stack(rings), np.clip(np.stack(shades), 0, 1), caps=False, layer=Layer.NEEDLES))
    return merge(parts)
