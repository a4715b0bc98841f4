"""What lies and stands about where people live, and is not searched for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skysweep.worlds.assets.looks import Appearance
from skysweep.worlds.meshes import Mesh, box, circle, ellipsoid, lathe, loft, merge, tube, yaw_rotation
from skysweep.worlds.textures import Layer

_WOOD = "8a7050 6e5c46 a89070 9a948a"
_STONES = "b0aaa0 8c8880 c8b8a0 a0705a"
_WASTE = "f0f0ee 1c1c20 2a6ab0 b83a2c d8b02c 4a8a4a c8c8c0 7a5a3a e8e0d0 30506a"
_CANVAS = "e8e4d8 c03028 2c5c9c e0b030 3a7a4a f0f0ec b05a9a"
_TYRE = (0.07, 0.07, 0.08)


def clutter_mesh(kind: str, length_m: float, variant: int) -> Mesh:
    """The mesh of a thing ``length_m`` long (x): origin on the ground or water line, z up, metres.

    Raises KeyError for a kind that is none of ``CLUTTER``.
    """
    return _MAKERS[kind](Appearance.of(kind, variant), length_m)


def _jetty(looks: Appearance, length_m: float) -> Mesh:
    wood, wide, high = looks.pick(_WOOD), looks.between(1.4, 2.6), looks.between(0.4, 0.9)
    deck = box((length_m, wide, 0.16), wood, layer=Layer.PLANKS, texture_size_m=1.2).moved((0, 0, high))
    pile = lathe([(0.12, -1.0), (0.12, high + looks.between(0.1, 0.9))], wood * 0.6, n=8, layer=Layer.BARK)
    places = np.arange(-length_m / 2 + 0.4, length_m / 2, 2.8)
    return merge([deck, *(pile.moved((x, y * wide / 2, 0)) for x in places for y in (-1, 1))])


def _fence(looks: Appearance, length_m: float) -> Mesh:
    """Rails on posts, a wall or a hedge."""
    style = looks.rng.random()
    if style < 0.3:
        size = (length_m, looks.between(0.25, 0.45), looks.between(0.8, 1.8))
        return box(size, looks.pick(_STONES), layer=Layer.STONE, texture_size_m=1.5)
    if style < 0.55:
        size = (length_m, looks.between(0.5, 1.1), looks.between(0.8, 1.8))
        return box(size, looks.pick("8aa84e 6c8c4c 547652"), layer=Layer.LEAVES, texture_size_m=1.6)
    wood, high = looks.pick(_WOOD), looks.between(0.9, 1.5)
    post = box((0.12, 0.12, high), wood * 0.8)
    rail = box((length_m, 0.06, 0.14), wood, layer=Layer.PLANKS)
    posts = [post.moved((x, 0, 0)) for x in np.arange(-length_m / 2, length_m / 2 + 0.1, 2.5)]
    return merge([*posts, *(rail.moved((0, 0, share * high)) for share in (0.4, 0.85))])


def _fallen_tree(looks: Appearance, length_m: float) -> Mesh:
    bark, thick = looks.pick("604e3c 4a3e34 7a6a58 9a9084"), looks.between(0.14, 0.32)
    s = np.linspace(0, 1, 6)
    bend = 0.04 * length_m * looks.rng.normal(size=6).cumsum()
    line = np.column_stack([(s - 0.5) * length_m, bend, thick + 0.5 * s * thick])
    parts = [tube(line, thick * (1 - 0.75 * s), bark, layer=Layer.BARK)]
    for _ in range(int(looks.rng.integers(4, 11))):
        k, side = int(looks.rng.integers(2, 6)), looks.rng.choice([-1, 1])
        reach = looks.between(0.12, 0.3) * length_m
        tip = line[k] + reach * np.array([looks.between(0.2, 0.8), side * looks.between(0.4, 0.9), 0.3])
        steps = np.linspace(line[k], tip, 3)
        parts.append(tube(steps, [0.3 * thick, 0.2 * thick, 0.1 * thick], bark, n=5, layer=Layer.BARK))
    return merge(parts)


def _rubbish(looks: Appearance, length_m: float) -> Mesh:
    """Bags, boxes, boards and tyres in a heap."""
    parts = []
    for _ in range(int(looks.rng.integers(5, 14))):
        place = [*looks.rng.normal(0, 0.28 * length_m, 2), 0.0]
        colour, size, style = looks.pick(_WASTE), looks.between(0.15, 0.6), looks.rng.random()
        if style < 0.4:
            part = ellipsoid((size / 2, size / 2.4, size / 3), colour, n=8, layer=Layer.FABRIC)
        elif style < 0.7:
            part = box((size, 0.7 * size, 0.6 * size), colour, layer=Layer.WORN)
        elif style < 0.9:
            part = box((3 * size, 0.25 * size, 0.06), looks.pick(_WOOD), layer=Layer.PLANKS)
        else:
            profile = [(0.2, 0.0), (0.32, 0.03), (0.33, 0.15), (0.2, 0.18), (0.18, 0.1)]
            part = lathe(profile, _TYRE, n=14)
        parts.append(part.moved(place, yaw_rotation(float(looks.rng.uniform(0, 2 * np.pi)))))
    return merge(parts)


def _canopy(looks: Appearance, length_m: float) -> Mesh:
    """A parasol, or a tent of the same cloth."""
    cloth, high, n = looks.pick(_CANVAS), looks.between(1.8, 2.4), int(looks.rng.integers(4, 9))
    ring = circle(n) * length_m / 2
    rings = [np.column_stack([ring * share, np.full(n, z)]) for share, z in ((1.0, high - 0.5), (0.04, high))]
    roof = loft(np.stack(rings), cloth, flat=True, layer=Layer.FABRIC, texture_size_m=2.0)
    return merge([roof, lathe([(0.03, 0.0), (0.03, high)], (0.8, 0.8, 0.78), n=6)])


def _pool(looks: Appearance, length_m: float) -> Mesh:
    """A basin with a light rim, round or long."""
    water, rim = looks.pick("3a9ac8 58b4cc 2a7a9a 6aa8a0"), looks.pick("e0ded8 c8c0b0 4a6a9a")
    wide = length_m if looks.chance(0.5) else 0.5 * length_m
    profile = [(0.5, 0.0), (0.5, 0.12), (0.46, 0.12), (0.46, 0.05)]
    basin = lathe(profile, rim, n=24, caps=False)
    surface = lathe([(0.46, 0.05), (0.0, 0.05)], water, n=24)
    return merge([basin, surface]).moved(scale=(length_m, wide, 1.0))


def _bale(looks: Appearance, length_m: float) -> Mesh:
    straw = looks.pick("c8b070 b89c5c d4c48c e8e8e0")
    lying = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    roll = lathe([(0.62, -length_m / 2), (0.62, length_m / 2)], straw, n=16, layer=Layer.FABRIC)
    return roll.moved((0, 0, 0.6), lying)


_MAKERS: dict[str, Callable[[Appearance, float], Mesh]] = {
    "jetty": _jetty,
    "fence": _fence,
    "fallen tree": _fallen_tree,
    "rubbish": _rubbish,
    "canopy": _canopy,
    "pool": _pool,
    "bale": _bale,
}

CLUTTER = tuple(_MAKERS)
