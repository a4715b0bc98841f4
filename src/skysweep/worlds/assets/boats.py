"""Boats: rowing boat, inflatable (RIB), cruiser, yacht, canoe. Origin amidships on the water line."""

from __future__ import annotations

import numpy as np

from skysweep.arrays import F64
from skysweep.worlds.assets.looks import Appearance
from skysweep.worlds.meshes import Mesh, box, ellipsoid, loft, make_mesh, merge, prism, skin_faces, tube
from skysweep.worlds.textures import Layer

_HULL = "ecece8 f0f0f0 1c3260 961e20 3c6e50 cec8b4"
_HULL_HELD_OUT = "e2e6ec 282a30 e6b43c 1e6078 b45a3c"
_DECK = "deded8 ba9668 c8ccce a8845c"
_DECK_HELD_OUT = "d6d2c4 967450 b0bac4"
_TUBES = "787a7e ec6c18 2c2e32 d2d2d0"
_TUBES_HELD_OUT = "5a6474 cc2c24 c8c4b4 e4c828"
_WOOD = "96663c 7a5434 b08454"
GLASS = (0.10, 0.13, 0.17)
DARK = (0.12, 0.12, 0.13)


def boat(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """A boat ``size_m`` long, bow towards +x."""
    if size_m < 3.6:
        makers = [_canoe, _rowing_boat, _rowing_boat, _inflatable]
    elif size_m < 6.5:
        makers = [_rowing_boat, _inflatable, _cruiser, _canoe]
    else:
        makers = [_inflatable, _cruiser, _cruiser, _yacht]
    return makers[int(looks.rng.integers(len(makers)))](looks, size_m)


def _hull_sections(
    length: float, beam: float, freeboard: float, fineness: float, transom: float
) -> tuple[F64, F64, F64]:
    """Stations x (S,), half beams (S,) and sheer heights (S,), stern to bow."""
    t = np.linspace(0, 1, 13)
    astern = transom + (1 - transom) * np.sin(np.pi / 2 * np.clip(t / 0.45, 0, 1))
    half = beam / 2 * np.minimum(1.0, (1 - t**fineness) ** 0.75 * astern)
    half[-1] = 0.01 * beam
    return (t - 0.5) * length, half, freeboard * (1 + 0.55 * t**2.5)


def _hull(
    x: F64, half: F64, sheer: F64, outside: F64, inside: F64, floor: float, layer: int = Layer.WORN
) -> Mesh:
    """An open shell: outside skin, gunwale, inside skin and floor at height ``floor``."""
    gunwale = np.minimum(0.06, 0.5 * half)
    rows = [  # half beams and heights, from the keel up to the gunwale and down to the floor
        (np.zeros_like(half), np.full_like(sheer, -0.25)),
        (0.75 * half, np.full_like(sheer, -0.15)),
        (half, 0.6 * sheer),
        (half, sheer),
        (half - gunwale, sheer),
        (0.86 * (half - gunwale), np.maximum(0.4 * sheer, floor)),
        (0.72 * (half - gunwale), np.full_like(sheer, floor)),
    ]
    starboard = [np.column_stack([x, -w, z]) for w, z in rows[::-1]]
    v = np.stack([*starboard, *(np.column_stack([x, w, z]) for w, z in rows)], axis=1)  # (S, 2R, 3)
    colours = np.array([inside] * 4 + [outside] * 6 + [inside] * 4)
    faces = skin_faces(*v.shape[:2])
    skin = make_mesh(v.reshape(-1, 3), faces, np.tile(colours, (len(v), 1)), layer, 1.5, flat=True)
    y, z = half[0], sheer[0]
    transom = prism([(-y, -0.25), (y, -0.25), (y, z), (-y, z)], 0.0, 0.06, outside, layer=layer)
    upright = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    return merge([skin, transom.moved((x[0], 0, 0), upright)])


def _deck(x: F64, half: F64, sheer: F64, first: int, last: int, colour: F64, layer: int) -> Mesh:
    """A closed deck between stations ``first`` and ``last``."""
    s = slice(first, last + 1)
    rows = [(w * half[s], sheer[s] - 0.03 + 0.05 * half[s] * (1 - w * w)) for w in (-1.0, 0.0, 1.0)]
    v = np.concatenate([np.column_stack([x[s], *row]) for row in rows])
    m = last + 1 - first
    i = np.arange(m - 1)
    faces = [np.column_stack([o + i, o + i + 1, o + m + i + 1]) for o in (0, m)]
    faces += [np.column_stack([o + i, o + m + i + 1, o + m + i]) for o in (0, m)]
    return make_mesh(v, np.concatenate(faces), colour, layer, uv=v[:, :2] / 0.9)


def _engine(x: float, z: float, colour: F64) -> Mesh:
    cowl = ellipsoid((0.28, 0.18, 0.30), colour, n=10).moved((x - 0.2, 0, z + 0.25))
    return merge([cowl, box((0.14, 0.1, 0.5), DARK).moved((x - 0.2, 0, z - 0.4))])


def _rowing_boat(looks: Appearance, size_m: float) -> Mesh:
    wooden = looks.chance(0.5)
    outside = looks.pick(_WOOD) if wooden else looks.pick(_HULL, _HULL_HELD_OUT)
    inside = looks.pick(_WOOD) if wooden or looks.chance(0.3) else looks.pick(_DECK, _DECK_HELD_OUT)
    layer = Layer.PLANKS if wooden else Layer.WORN
    beam = size_m * looks.between(0.30, 0.38)
    x, half, sheer = _hull_sections(size_m, beam, 0.1 * size_m**0.7 + 0.18, looks.between(2.6, 4.0), 0.72)
    parts = [_hull(x, half, sheer, outside, inside, 0.06, layer)]
    for t in (0.22, 0.48, 0.72):
        k = int(t * 12)
        thwart = box((0.06 * size_m, 1.75 * half[k], 0.04), inside * 0.85, layer=Layer.PLANKS)
        parts.append(thwart.moved((x[k], 0, sheer[k] * 0.7)))
    if looks.chance(0.5):
        parts.append(_engine(x[0], sheer[0], looks.pick("1e1e22 e6e6e6", "3c3c42 b41e1e")))
    for side in (1, -1):  # oars
        a = looks.between(-0.3, 0.5)
        p = np.array([x[5], side * half[5], sheer[5] + 0.05])
        tip = p + size_m * 0.3 * np.array([-np.sin(a), side * np.cos(a), -0.25])
        parts.append(tube([p - (tip - p) * 0.5, p, tip], [0.02, 0.025, 0.04], (0.75, 0.62, 0.42), n=5))
    return merge(parts)


def _canoe(looks: Appearance, size_m: float) -> Mesh:
    outside = looks.pick("c8281e f0b41e 285a3c 1e5096 ec781e", "963c82 3caaa0 b4c43c")
    inside = outside * 0.55 if looks.chance(0.6) else looks.pick(_DECK, _DECK_HELD_OUT)
    beam = looks.between(0.7, 0.9)
    x, half, sheer = _hull_sections(size_m, beam, 0.26, 2.2, 0.03)
    half = beam / 2 * np.sin(np.pi * np.linspace(0.01, 0.99, len(x))) ** 0.75
    sheer = 0.26 + 0.2 * np.abs(np.linspace(-1, 1, len(x))) ** 4
    parts = [_hull(x, half, sheer, outside, inside, 0.04)]
    if looks.chance(0.5):  # kayak: closed deck with a cockpit
        parts += [_deck(x, half, sheer, a, b, outside * 0.92, Layer.PLAIN) for a, b in ((0, 5), (7, 12))]
    else:
        for k in (3, 9):
            parts.append(box((0.2, 1.7 * half[k], 0.03), (0.7, 0.58, 0.4)).moved((x[k], 0, sheer[k] - 0.08)))
    return merge(parts)


def _inflatable(looks: Appearance, size_m: float) -> Mesh:
    colour = looks.pick(_TUBES, _TUBES_HELD_OUT)
    r = 0.05 * size_m**0.8 + 0.07
    beam = size_m * looks.between(0.36, 0.44)
    y = beam / 2 - r
    L = size_m / 2 - r
    bow = 0.55 * L
    path = [(-L, y, 0.3), (-0.2 * L, y, 0.3), (bow - 0.25 * L, y * 0.98, 0.32), (bow, y * 0.86, 0.36)]
    path += [(0.86 * L, y * 0.48, 0.44), (L, 0, 0.5)]
    points = np.array(path + [(px, -py, pz) for px, py, pz in path[-2::-1]])
    parts = [tube(points, np.full(len(points), r), colour, n=8, layer=Layer.WORN, texture_size_m=1.5)]
    floor = np.array(
        [(-L, -y), (bow, -y * 0.86), (0.86 * L, -y * 0.45), (0.86 * L, y * 0.45), (bow, y * 0.86), (-L, y)]
    )
    parts.append(prism(floor, 0.05, 0.16, looks.pick("606264 969694", "786e60 464a50"), layer=Layer.WORN))
    parts.append(box((0.06, 2 * y, 0.5), (0.3, 0.3, 0.31)).moved((-L + 0.1, 0, 0.1)))
    if size_m > 4.5:
        console = looks.pick("ececea 3c3e42", "d2d6dc 6e1e1e")
        parts.append(box((0.14 * size_m, 0.3 * beam, 0.75), console).moved((-0.05 * L, 0, 0.15)))
        parts.append(box((0.1 * size_m, 0.28 * beam, 0.5), DARK).moved((-0.36 * L, 0, 0.15)))
    parts.append(_engine(-L, 0.45, looks.pick("1e1e22 46484c", "2c2e3c c8c8c8")))
    return merge(parts)


def _cruiser(looks: Appearance, size_m: float) -> Mesh:
    outside, deck = looks.pick(_HULL, _HULL_HELD_OUT), looks.pick(_DECK, _DECK_HELD_OUT)
    beam = size_m * looks.between(0.31, 0.38)
    x, half, sheer = _hull_sections(size_m, beam, 0.12 * size_m**0.75 + 0.3, looks.between(2.4, 3.4), 0.85)
    layer = Layer.PLANKS if deck[2] < 0.6 else Layer.WORN
    parts = [_hull(x, half, sheer, outside, deck * 0.9, 0.18), _deck(x, half, sheer, 5, 12, deck, layer)]
    white = looks.pick("f0f0ee e4e2dc", "dce2e8 c8beaa")
    a, b = looks.between(-0.16, -0.05) * size_m, looks.between(0.16, 0.24) * size_m
    w, z, h = 0.68 * beam / 2, float(sheer[6]) - 0.05, 0.12 * size_m**0.6 + 0.5

    def block(x0: float, x1: float, rake: float, inset: float, z0: float, z1: float, colour: object) -> Mesh:
        low = [(x0, -w), (x1, -w * 0.8), (x1, w * 0.8), (x0, w)]
        aft, fore, side = x0 + 0.3 * rake, x1 - rake, w * 0.8 - inset
        high = [(aft, -w + inset), (fore, -side), (fore, side), (aft, w - inset)]
        rings = np.stack([np.column_stack([low, np.full(4, z0)]), np.column_stack([high, np.full(4, z1)])])
        return loft(rings, colour, flat=True)  # type: ignore[arg-type]

    parts.append(block(a, b, 0.15 * h, 0.03, z, z + 0.45 * h, white))
    parts.append(block(a + 0.02, b - 0.15 * h, 0.7 * h, 0.08, z + 0.45 * h, z + 0.9 * h, GLASS))
    side, front = 0.8 * w - 0.06, b - 0.8 * h
    roof = [(a - 0.1, -w + 0.06), (front, -side), (front, side), (a - 0.1, w - 0.06)]
    parts.append(prism(roof, z + 0.9 * h, z + 0.98 * h, white, layer=Layer.WORN))
    seat = looks.pick("cec4b0 3c5078 963c32", "5a8282 beaa78")
    parts.append(box((0.08 * size_m, 1.3 * half[1], 0.35), seat).moved((x[1], 0, 0.18)))
    if size_m < 8:
        parts.append(_engine(x[0], float(sheer[0]), looks.pick("1e1e22 e6e6e6", "464650")))
    return merge(parts)


def _yacht(looks: Appearance, size_m: float) -> Mesh:
    outside, deck = looks.pick(_HULL, _HULL_HELD_OUT), looks.pick(_DECK, _DECK_HELD_OUT)
    beam = size_m * looks.between(0.26, 0.32)
    x, half, sheer = _hull_sections(size_m, beam, 0.08 * size_m + 0.35, looks.between(1.8, 2.4), 0.6)
    layer = Layer.PLANKS if deck[2] < 0.6 else Layer.WORN
    parts = [_hull(x, half, sheer, outside, deck * 0.9, 0.35), _deck(x, half, sheer, 4, 12, deck, layer)]
    coach = np.array(
        [(-0.14, -0.30), (0.12, -0.26), (0.22, -0.14), (0.22, 0.14), (0.12, 0.26), (-0.14, 0.30)]
    ) * [size_m, beam]
    z = float(sheer[6])
    parts.append(prism(coach, z - 0.05, z + 0.32, (0.92, 0.92, 0.9)))
    parts.append(prism(coach * [0.5, 1.02], z + 0.08, z + 0.22, GLASS))
    mast = np.array([0.08 * size_m, 0, z])
    parts.append(tube([mast, mast + np.array([0, 0, 1.15 * size_m])], [0.07, 0.05], (0.8, 0.8, 0.82), n=6))
    boom = mast + np.array([[0, 0, 0.9], [-0.38 * size_m, looks.between(-0.05, 0.05) * size_m, 0.95]])
    cover = looks.pick("1e326e bebeb8 8c1e24", "285a50 78787c")
    parts.append(tube(boom, [0.16, 0.10], cover, n=7, layer=Layer.FABRIC))
    parts.append(box((0.1 * size_m, 0.5 * beam, 0.3), (0.3, 0.24, 0.18)).moved((-0.36 * size_m, 0, 0.35)))
    return merge(parts)
