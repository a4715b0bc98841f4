"""Distractors that lie about: bucket, rock, stump, clothing, buoy."""

from __future__ import annotations

import numpy as np

from skysweep.arrays import F64
from skysweep.worlds.assets.looks import Appearance
from skysweep.worlds.materials import Material
from skysweep.worlds.meshes import (
    Mesh,
    circle,
    ellipsoid,
    icosphere,
    lathe,
    loft,
    lumpy,
    make_mesh,
    merge,
    plate,
    tilt_rotation,
    tube,
)
from skysweep.worlds.textures import Decal, Layer, decal_layer

_BUCKET = "c41e20 d22c24 b0161e"
_BUCKET_HELD_OUT = "c8381c a01e2c dc2838"
_ROCK = "bebab2 9e968c d6cab8 86868a c8b298"
_ROCK_HELD_OUT = "aea29a e4dcd2 8e7e6e a8b2b8"
_BARK = "604e3c 4a3e34 7a6a58"
_BARK_HELD_OUT = "544236 887c6e 68543c"
_CLOTH = "be2224 1e3e8c e4e4e0 242428 f09618 e0e028 2e683e 76787c 243054 5a4c36"
_CLOTH_HELD_OUT = "ce461e 146e78 f6f6f0 3c3c5a a01e3c 70644c"
_BUOY = "e65a14 d6281e f0781e"
_BUOY_HELD_OUT = "ec4632 e08214 be1e28"


def bucket(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """A red bucket ``size_m`` in diameter, open at the top, with its handle hanging to one side."""
    red = looks.pick(_BUCKET, _BUCKET_HELD_OUT)
    r, h = size_m / 2, size_m * looks.between(0.8, 1.15)
    foot = looks.between(0.66, 0.8) * r
    profile = [(foot, 0), (0.96 * r, 0.93 * h), (r, 0.93 * h), (r, h), (0.91 * r, h), (foot * 0.93, 0.03 * h)]
    colours = np.stack([red * 0.8, red, red * 1.05, red * 1.1, red * 1.1, red * 0.62])
    shell = lathe(profile, np.clip(colours, 0, 1), n=20, layer=Layer.WORN, texture_size_m=0.6)
    if looks.chance(0.2):  # something in it
        fill = looks.pick("46545c 6e5c40 3c3228", "546050 8c826e")
        level = looks.between(0.25, 0.55)
        inside = lathe([(0.9 * r * level + foot * 0.9 * (1 - level), level * h)] * 2, fill, n=20)
        shell = merge([shell, inside])
    a = np.linspace(0, np.pi, 9)
    fall = looks.between(1.2, 1.75)  # rad from upright
    arc = np.column_stack(
        [1.04 * r * np.sin(a) * np.sin(fall), 1.04 * r * np.cos(a), 0.93 * h + r * np.sin(a) * np.cos(fall)]
    )
    handle = tube(arc, np.full(len(a), 0.004 + 0.006 * size_m), (0.55, 0.55, 0.57), n=5)
    return merge([shell.grounded(0.3 * h, 0.7), handle])


def rock(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """A boulder about ``size_m`` long, sunk a little."""
    v, f = icosphere(3)
    rng = looks.rng
    planes = rng.normal(size=(14, 3))
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    cut = rng.uniform(0.62, 0.95, 14)
    reach = np.maximum(v @ planes.T, 1e-3)
    radius = np.minimum(1.0, (cut / reach).min(axis=1)) * (0.97 + 0.03 * lumpy(v, rng, 30, 0.3))
    shape = np.array([0.5, 0.5 * looks.between(0.55, 0.9), 0.5 * looks.between(0.45, 0.75)]) * size_m
    colour = looks.pick(_ROCK, _ROCK_HELD_OUT)
    points = v * radius[:, None] * shape
    moss = np.clip(1.6 * v[:, 2:] - 0.7, 0, 1) * (0.6 if looks.chance(0.3) else 0.0)
    colours = colour * (1 - moss) + np.array([0.34, 0.40, 0.20]) * moss
    mesh = make_mesh(points + np.array([0, 0, 0.30 * shape[2]]), f, colours, Layer.STONE, 0.8)
    return mesh.grounded(0.25 * size_m, 0.65)


def stump(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """A cut tree ``size_m`` in diameter: bark, root flare, growth rings on top."""
    bark = looks.pick(_BARK, _BARK_HELD_OUT)
    n, h = 22, size_m * looks.between(0.35, 0.8)
    ring = circle(n)
    wobble = 1 + 0.05 * looks.rng.normal(size=n)
    phase = np.arange(n) * 2 * np.pi / n * looks.rng.integers(3, 6) + looks.rng.uniform(0, 6)
    roots = 1 + 0.28 * np.maximum(0, np.cos(phase))
    rings = []
    for z, flare in ((-0.1, 1.0), (0.05, 0.7), (0.4 * h, 0.2), (0.96 * h, 0.0), (h, 0.0)):
        radius = size_m / 2 * wobble * (1 + (roots - 1 + 0.12) * flare) * (0.97 if z == h else 1.0)
        rings.append(np.column_stack([ring * radius[:, None], np.full(n, z)]))
    side = loft(np.stack(rings), bark, caps=False, layer=Layer.BARK, texture_size_m=0.5).grounded(0.3, 0.6)
    top = plate(rings[-1][:, :2], h, (1, 1, 1), decal_layer(Decal.RINGS, looks.variant), size_m / 2)
    return merge([side, top.made_of(Material.WOOD)])


def clothing(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """A jacket or a pair of trousers ``size_m`` long, dropped and crumpled."""
    colour = looks.pick(_CLOTH, _CLOTH_HELD_OUT)
    jacket = looks.chance(0.55)
    rng = looks.rng

    def bend(a: float, length: float, start: tuple[float, float]) -> F64:
        turn = np.cumsum([a, rng.normal(0, 0.35), rng.normal(0, 0.5)])
        steps = np.column_stack([np.cos(turn), np.sin(turn)]) * length / 3
        return np.concatenate([[start], np.array(start) + np.cumsum(steps, axis=0)])

    if jacket:
        strips = [(bend(0.0, 0.72, (-0.36, 0.0)), looks.between(0.24, 0.30))]
        splay, length, half_m, x, y = (0.7, 1.9), 0.55, 0.085, 0.28, 0.22  # of the sleeves
    else:
        strips = [(np.array([(0.5, 0.0), (0.36, 0.0), (0.26, 0.0)]), 0.19)]
        splay, length, half_m, x, y = (0.0, 0.5), 0.8, 0.095, 0.34, 0.10  # of the legs
    for side in (1, -1):
        strips.append((bend(np.pi - side * looks.between(*splay), length, (x, side * y)), half_m))
    return merge(
        [
            _heap(looks, line * size_m, half * size_m, colour * (1.0 - 0.06 * k), 0.07 * size_m)
            for k, (line, half) in enumerate(strips)
        ]
    )


def _heap(looks: Appearance, line: F64, half_m: float, colour: F64, height_m: float) -> Mesh:
    """A rumpled strip of cloth along a line (S, 2)."""
    s = np.linspace(0, len(line) - 1, 14)
    p = np.column_stack([np.interp(s, np.arange(len(line)), line[:, c]) for c in (0, 1)])
    d = np.gradient(p, axis=0)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    across = np.linspace(-1, 1, 9)
    edge = half_m * (1 + 0.14 * looks.rng.normal(size=len(s)))
    xy = p[:, None] + (edge[:, None] * across)[..., None] * np.column_stack([-d[:, 1], d[:, 0]])[:, None]
    phase = looks.rng.uniform(0, 2 * np.pi, 4)
    k = looks.rng.uniform(1.5, 4.0, 4)
    u, w = np.meshgrid(np.linspace(0, 2 * np.pi, len(s)), across, indexing="ij")
    folds = 0.5 + 0.25 * np.sin(k[0] * u + 2 * w + phase[0]) + 0.25 * np.sin(k[1] * u - 3 * w + phase[1])
    folds *= 0.75 + 0.25 * np.sin(2 * k[2] * u + phase[2])
    z = 0.012 + height_m * folds * (1 - w**6)
    z[:, [0, -1]] = 0.0
    v = np.concatenate([xy, z[..., None]], axis=2).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(len(s) - 1), np.arange(8), indexing="ij")
    a = (i * 9 + j).ravel()
    faces = np.concatenate([np.column_stack([a, a + 10, a + 1]), np.column_stack([a, a + 9, a + 10])])
    shade = (0.62 + 0.38 * np.clip(z / height_m, 0, 1)).reshape(-1, 1)
    return make_mesh(v, faces, colour * shade, Layer.FABRIC, 0.5)


def buoy(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """A mooring buoy ``size_m`` in diameter, half afloat and leaning a little, with an eye on top."""
    colour = looks.pick(_BUOY, _BUOY_HELD_OUT)
    r, squash = size_m / 2, looks.between(0.85, 1.15)
    t = np.linspace(-np.pi / 2, np.pi / 2, 12)[1:-1]
    band = (np.abs(t - 0.25) < 0.2) if looks.chance(0.4) else np.zeros(len(t), bool)
    colours = np.where(band[:, None], (0.93, 0.93, 0.9), colour)
    ball = lathe(np.column_stack([np.cos(t), squash * np.sin(t)]) * r, colours, n=16, layer=Layer.WORN)
    top = squash * r
    arc = [(0.0, -0.12 * r, top), (0.0, 0.0, top + 0.18 * r), (0.0, 0.12 * r, top)]
    eye = tube(arc, [0.05 * r] * 3, (0.3, 0.3, 0.32), n=5)
    foot = ellipsoid((0.3 * r, 0.3 * r, 0.12 * r), (0.16, 0.16, 0.17), n=8).moved((0, 0, 0.96 * top))
    lean = np.array([*looks.rng.normal(0, 0.12, 2), 1.0])
    return merge([ball, eye, foot]).moved((0, 0, 0.25 * r), tilt_rotation(lean / np.linalg.norm(lean)))
