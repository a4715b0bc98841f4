"""Boats: rowing boat, inflatable (RIB), cruiser, yacht, canoe. Origin amidships on the water line."""

from __future__ import annotations

import numpy as np

from skysweep.arrays import F64
from skysweep.worlds.assets.looks import RGB, Appearance
from skysweep.worlds.meshes import Mesh, box, ellipsoid, loft, make_mesh, merge, prism, skin_faces, tube
from skysweep.worlds.textures import Layer

_HULL: list[RGB] = [
    (236, 236, 232),
    (240, 240, 240),
    (28, 50, 96),
    (150, 30, 32),
    (60, 110, 80),
    (206, 200, 180),
]
_HULL_HELD_OUT: list[RGB] = [(226, 230, 236), (40, 42, 48), (230, 180, 60), (30, 96, 120), (180, 90, 60)]
_DECK: list[RGB] = [(222, 222, 216), (186, 150, 104), (200, 204, 206), (168, 132, 92)]
_DECK_HELD_OUT: list[RGB] = [(214, 210, 196), (150, 116, 80), (176, 186, 196)]
_TUBES: list[RGB] = [(120, 122, 126), (236, 108, 24), (44, 46, 50), (210, 210, 208)]
_TUBES_HELD_OUT: list[RGB] = [(90, 100, 116), (204, 44, 36), (200, 196, 180), (228, 200, 40)]
_WOOD: list[RGB] = [(150, 102, 60), (122, 84, 52), (176, 132, 84)]
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
    half = (
        beam
        / 2
        * np.minimum(
            1.0,
            (1 - t**fineness) ** 0.75
            * (transom + (1 - transom) * np.sin(np.pi / 2 * np.clip(t / 0.45, 0, 1))),
        )
    )
    half[-1] = 0.01 * beam
    return (t - 0.5) * length, half, freeboard * (1 + 0.55 * t**2.5)


def _hull(
    x: F64, half: F64, sheer: F64, outside: F64, inside: F64, floor: float, layer: int = Layer.WORN
) -> Mesh:
    """An open shell: outside skin, gunwale, inside skin and floor at height ``floor``."""
    gunwale = np.minimum(0.06, 0.5 * half)
    profile = [
        (np.full_like(half, 0.0), np.full_like(sheer, -0.25)),
        (0.75 * half, np.full_like(sheer, -0.15)),
        (half, 0.6 * sheer),
        (half, sheer),
    ]
    inner = [
        (half - gunwale, sheer),
        (0.86 * (half - gunwale), np.maximum(0.4 * sheer, floor)),
        (0.72 * (half - gunwale), np.full_like(sheer, floor)),
    ]
    rows = profile + inner
    port = [np.column_stack([x, w, z]) for w, z in rows]
    starboard = [np.column_stack([x, -w, z]) for w, z in rows]
    loop = starboard[::-1] + port  # starboard inside .. keel .. port inside
    v = np.stack(loop, axis=1)  # (S, 2R, 3)
    colours = np.array([inside] * 4 + [outside] * 6 + [inside] * 4)
    stations, n, _ = v.shape
    faces = skin_faces(stations, n)
    skin = make_mesh(v.reshape(-1, 3), faces, np.tile(colours, (stations, 1)), layer, 1.5, flat=True)
    y, z = half[0], sheer[0]
    transom = prism([(-y, -0.25), (y, -0.25), (y, z), (-y, z)], 0.0, 0.06, outside, layer=layer)
    upright = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    return merge([skin, transom.moved((x[0], 0, 0), upright)])


def _deck(x: F64, half: F64, sheer: F64, first: int, last: int, colour: F64, layer: int) -> Mesh:
    """A closed deck between stations ``first`` and ``last``."""
    s = slice(first, last + 1)
    v = np.concatenate(
        [
            np.column_stack([x[s], w * half[s], sheer[s] - 0.03 + 0.05 * half[s] * (1 - w * w)])
            for w in (-1.0, 0.0, 1.0)
        ]
    )
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
    outside = looks.pick(_WOOD, _WOOD) if wooden else looks.pick(_HULL, _HULL_HELD_OUT)
    inside = looks.pick(_WOOD, _WOOD) if wooden or looks.chance(0.3) else looks.pick(_DECK, _DECK_HELD_OUT)
    layer = Layer.PLANKS if wooden else Layer.WORN
    beam = size_m * looks.between(0.30, 0.38)
    x, half, sheer = _hull_sections(size_m, beam, 0.1 * size_m**0.7 + 0.18, looks.between(2.6, 4.0), 0.72)
    parts = [_hull(x, half, sheer, outside, inside, 0.06, layer)]
    for t in (0.22, 0.48, 0.72):
        k = int(t * 12)
        parts.append(
            box((0.06 * size_m, 1.75 * half[k], 0.04), inside * 0.85, layer=Layer.PLANKS).moved(
                (x[k], 0, sheer[k] * 0.7)
            )
        )
    if looks.chance(0.5):
        parts.append(
            _engine(
                x[0], sheer[0], looks.pick([(30, 30, 34), (230, 230, 230)], [(60, 60, 66), (180, 30, 30)])
            )
        )
    for side in (1, -1):  # oars
        a = looks.between(-0.3, 0.5)
        p = np.array([x[5], side * half[5], sheer[5] + 0.05])
        tip = p + size_m * 0.3 * np.array([-np.sin(a), side * np.cos(a), -0.25])
        parts.append(tube([p - (tip - p) * 0.5, p, tip], [0.02, 0.025, 0.04], (0.75, 0.62, 0.42), n=5))
    return merge(parts)


def _canoe(looks: Appearance, size_m: float) -> Mesh:
    outside = looks.pick(
        [(200, 40, 30), (240, 180, 30), (40, 90, 60), (30, 80, 150), (236, 120, 30)],
        [(150, 60, 130), (60, 170, 160), (180, 196, 60)],
    )
    inside = outside * 0.55 if looks.chance(0.6) else looks.pick(_DECK, _DECK_HELD_OUT)
    beam = looks.between(0.7, 0.9)
    x, half, sheer = _hull_sections(size_m, beam, 0.26, 2.2, 0.03)
    half = beam / 2 * np.sin(np.pi * np.linspace(0.01, 0.99, len(x))) ** 0.75
    sheer = 0.26 + 0.2 * np.abs(np.linspace(-1, 1, len(x))) ** 4
    parts = [_hull(x, half, sheer, outside, inside, 0.04)]
    if looks.chance(0.5):  # kayak: closed deck with a cockpit
        parts += [
            _deck(x, half, sheer, 0, 5, outside * 0.92, Layer.PLAIN),
            _deck(x, half, sheer, 7, 12, outside * 0.92, Layer.PLAIN),
        ]
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
    path = [
        (-L, y, 0.3),
        (-0.2 * L, y, 0.3),
        (bow - 0.25 * L, y * 0.98, 0.32),
        (bow, y * 0.86, 0.36),
        (0.86 * L, y * 0.48, 0.44),
        (L, 0, 0.5),
    ]
    points = np.array(path + [(px, -py, pz) for px, py, pz in path[-2::-1]])
    parts = [tube(points, np.full(len(points), r), colour, n=8, layer=Layer.WORN, texture_size_m=1.5)]
    floor = np.array(
        [(-L, -y), (bow, -y * 0.86), (0.86 * L, -y * 0.45), (0.86 * L, y * 0.45), (bow, y * 0.86), (-L, y)]
    )
    parts.append(
        prism(
            floor,
            0.05,
            0.16,
            looks.pick([(96, 98, 100), (150, 150, 148)], [(120, 110, 96), (70, 74, 80)]),
            layer=Layer.WORN,
        )
    )
    parts.append(box((0.06, 2 * y, 0.5), (0.3, 0.3, 0.31)).moved((-L + 0.1, 0, 0.1)))
    if size_m > 4.5:
        console = looks.pick([(236, 236, 234), (60, 62, 66)], [(210, 214, 220), (110, 30, 30)])
        parts.append(box((0.14 * size_m, 0.3 * beam, 0.75), console).moved((-0.05 * L, 0, 0.15)))
        parts.append(box((0.1 * size_m, 0.28 * beam, 0.5), DARK).moved((-0.36 * L, 0, 0.15)))
    parts.append(_engine(-L, 0.45, looks.pick([(30, 30, 34), (70, 72, 76)], [(44, 46, 60), (200, 200, 200)])))
    return merge(parts)


def _cruiser(looks: Appearance, size_m: float) -> Mesh:
    outside, deck = looks.pick(_HULL, _HULL_HELD_OUT), looks.pick(_DECK, _DECK_HELD_OUT)
    beam = size_m * looks.between(0.31, 0.38)
    x, half, sheer = _hull_sections(size_m, beam, 0.12 * size_m**0.75 + 0.3, looks.between(2.4, 3.4), 0.85)
    layer = Layer.PLANKS if deck[2] < 0.6 else Layer.WORN
    parts = [_hull(x, half, sheer, outside, deck * 0.9, 0.18), _deck(x, half, sheer, 5, 12, deck, layer)]
    white = looks.pick([(240, 240, 238), (228, 226, 220)], [(220, 226, 232), (200, 190, 170)])
    a, b = looks.between(-0.16, -0.05) * size_m, looks.between(0.16, 0.24) * size_m
    w, z, h = 0.68 * beam / 2, float(sheer[6]) - 0.05, 0.12 * size_m**0.6 + 0.5

    def block(x0: float, x1: float, rake: float, inset: float, z0: float, z1: float, colour: object) -> Mesh:
        low = [(x0, -w), (x1, -w * 0.8), (x1, w * 0.8), (x0, w)]
        high = [
            (x0 + 0.3 * rake, -w + inset),
            (x1 - rake, -w * 0.8 + inset),
            (x1 - rake, w * 0.8 - inset),
            (x0 + 0.3 * rake, w - inset),
        ]
        rings = np.stack([np.column_stack([low, np.full(4, z0)]), np.column_stack([high, np.full(4, z1)])])
        return loft(rings, colour, flat=True)  # type: ignore[arg-type]

    parts.append(block(a, b, 0.15 * h, 0.03, z, z + 0.45 * h, white))
    parts.append(block(a + 0.02, b - 0.15 * h, 0.7 * h, 0.08, z + 0.45 * h, z + 0.9 * h, GLASS))
    roof = [
        (a - 0.1, -w + 0.06),
        (b - 0.8 * h, -0.8 * w + 0.06),
        (b - 0.8 * h, 0.8 * w - 0.06),
        (a - 0.1, w - 0.06),
    ]
    parts.append(prism(roof, z + 0.9 * h, z + 0.98 * h, white, layer=Layer.WORN))
    seat = looks.pick([(206, 196, 176), (60, 80, 120), (150, 60, 50)], [(90, 130, 130), (190, 170, 120)])
    parts.append(box((0.08 * size_m, 1.3 * half[1], 0.35), seat).moved((x[1], 0, 0.18)))
    if size_m < 8:
        parts.append(
            _engine(x[0], float(sheer[0]), looks.pick([(30, 30, 34), (230, 230, 230)], [(70, 70, 80)]))
        )
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
    boom = [
        mast + np.array([0, 0, 0.9]),
        mast + np.array([-0.38 * size_m, looks.between(-0.05, 0.05) * size_m, 0.95]),
    ]
    cover = looks.pick([(30, 50, 110), (190, 190, 184), (140, 30, 36)], [(40, 90, 80), (120, 120, 124)])
    parts.append(tube(boom, [0.16, 0.10], cover, n=7, layer=Layer.FABRIC))
    parts.append(box((0.1 * size_m, 0.5 * beam, 0.3), (0.3, 0.24, 0.18)).moved((-0.36 * size_m, 0, 0.35)))
    return merge(parts)
