"""Procedural textures: ground at every scale, materials, and the faces of signs. sRGB bytes, tileable.

Layers are numbered: materials first, then decals. Each group of decals has training looks and held-out
looks (:data:`skysweep.worlds.world.HELD_OUT_VARIANTS`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike

from skysweep.arrays import F64, U8
from skysweep.types import XY
from skysweep.worlds.world import HELD_OUT_VARIANTS

LAYER_PX = 256
LOOKS = 16  # decals in a group


class Layer(IntEnum):
    """Material textures; their brightest texel is white, the mesh's vertex colours give the hue."""

    PLAIN = 0
    LEAVES = 1
    NEEDLES = 2
    BARK = 3
    FABRIC = 4
    STONE = 5
    ROOF = 6
    WALL = 7
    WINDOWS = 8
    PLANKS = 9
    WORN = 10


class Decal(IntEnum):
    """Groups of decals, painted in full colour on a white mesh."""

    STOP_SIGN = 0
    ROUND_SIGN = 1
    RINGS = 2


def decal_layer(group: Decal, variant: int) -> int:
    """The texture layer that shows ``group`` with the looks of ``variant``."""
    held_out = variant >= HELD_OUT_VARIANTS
    return 16 + (2 * group + held_out) * LOOKS + variant % LOOKS


@lru_cache(maxsize=256)
def layer_image(layer: int) -> U8:
    """The texture (256, 256, 3) of a layer."""
    rng = np.random.default_rng([layer, 23])
    if layer < 16:
        return _MATERIALS[Layer(layer)](rng)
    group, held_out = divmod((layer - 16) // LOOKS, 2)
    return _DECALS[Decal(group)](rng, bool(held_out))


def noise(n: int, rng: np.random.Generator, slope: float = 1.0, low: float = 1.0, high: float = 1e9) -> F64:
    """Tileable noise (n, n) in 0..1, mean 0.5.

    Its amplitude falls as frequency ** -slope within [low, high] cycles a tile.
    """
    f = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None]) * n
    amplitude = np.where((f >= low) & (f <= high), np.maximum(f, 1.0) ** -slope, 0.0)
    field = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(n, n))) * amplitude, s=(n, n))
    return np.asarray(np.clip(0.5 + field / (5 * field.std()), 0, 1))


def blend(a: ArrayLike, b: ArrayLike, t: F64) -> F64:
    """Colours (n, n, 3) from ``a`` where t (n, n) is 0 to ``b`` where it is 1."""
    return np.asarray(a, dtype=float) * (1 - t[..., None]) + np.asarray(b, dtype=float) * t[..., None]


def _bytes(image: ArrayLike) -> U8:
    return np.asarray(np.clip(np.asarray(image, dtype=float), 0, 255).round(), dtype=np.uint8)


def _grey(values: F64, darkest: float) -> U8:
    return _bytes(np.repeat((255 * (darkest + (1 - darkest) * values))[..., None], 3, axis=2))


def _step(values: F64, edge: float, width: float) -> F64:
    return np.asarray(np.clip((values - edge) / width + 0.5, 0, 1))


def _strokes(
    image: U8,
    rng: np.random.Generator,
    count: int,
    length: tuple[float, float],
    colours: ArrayLike,
    thickness: int = 1,
) -> None:
    """Draw short straight strokes that wrap around the edges, in place."""
    n = len(image)
    palette = np.asarray(colours)
    p = rng.uniform(0, n, (count, 2))
    a = rng.uniform(0, 2 * np.pi, count)
    d = rng.uniform(*length, count)[:, None] * np.column_stack([np.cos(a), np.sin(a)])
    c = palette[rng.integers(len(palette), size=count)] * rng.uniform(0.8, 1.15, (count, 1))
    for start, end, colour in zip(p, p + d, np.clip(c, 0, 255).tolist(), strict=True):
        for shift in {(0, 0)} | {(int(np.floor(end[0] / n)), int(np.floor(end[1] / n)))}:
            s = np.array(shift) * n
            q0, q1 = (start - s).astype(int), (end - s).astype(int)
            cv2.line(image, tuple(map(int, q0)), tuple(map(int, q1)), colour, thickness, cv2.LINE_AA)


def _spots(
    image: U8,
    rng: np.random.Generator,
    count: int,
    radius: tuple[float, float],
    colours: ArrayLike,
    stretch: float = 1.0,
) -> None:
    """Draw filled ellipses that wrap around the edges, in place."""
    n = len(image)
    palette = np.asarray(colours)
    c = palette[rng.integers(len(palette), size=count)] * rng.uniform(0.75, 1.2, (count, 1))
    radii = rng.uniform(radius[0] ** 0.5, radius[1] ** 0.5, count) ** 2
    centres, angles = rng.uniform(0, n, (count, 2)), rng.uniform(0, 360, count)
    for (x, y), r, colour, angle in zip(centres, radii, np.clip(c, 0, 255).tolist(), angles, strict=True):
        for dx in (-n, 0, n) if min(x, n - x) < r * 2 else (0,):
            for dy in (-n, 0, n) if min(y, n - y) < r * 2 else (0,):
                centre = (round((x + dx) * 8), round((y + dy) * 8))
                axes = (max(round(r * stretch * 8), 4), max(round(r * 8), 4))
                cv2.ellipse(image, centre, axes, angle, 0, 360, colour, -1, cv2.LINE_AA, 3)


DETAIL_PX, MIDDLE_PX, MACRO_PX = 1024, 512, 512
DETAIL_M, MIDDLE_M, MACRO_M = 5.0, 27.0, 211.0  # tile sizes, so that none repeats with another


@dataclass(frozen=True, slots=True)
class GroundTextures:
    """Three scales of one surface; albedo = detail * 4 * middle * macro, so 0.5 is neutral in the last two.

    For water the three are: wave normals (x, y slopes about 0.5, height), foam, colour variation.
    """

    detail: U8  # (1024, 1024, 3) over 5 m
    middle: U8  # (512, 512, 3) over 27 m
    macro: U8  # (512, 512, 3) over 211 m


@lru_cache(maxsize=8)
def ground_textures(surface: str, look: int) -> GroundTextures:
    """Textures of a terrain surface; ``look`` seeds them."""
    rng = np.random.default_rng([look, sorted(_GROUND).index(surface), 29])
    return _GROUND[surface](rng)


@lru_cache(maxsize=1)
def border_noise() -> U8:
    """Tileable noise (256, 256, 3), mean 0.5, by which borders of surfaces stray."""
    rng = np.random.default_rng(37)
    return _bytes(255 * np.stack([noise(LAYER_PX, rng, 1.35, 2) for _ in range(3)], axis=2))


def _variation(
    n: int, rng: np.random.Generator, tints: ArrayLike, contrast: float, slope: float, high: float
) -> U8:
    """A neutral (0.5) multiplier with brightness contrast and patches of tints."""
    base = 1 + contrast * (noise(n, rng, slope, 1, high) - 0.5) * 2
    image = np.repeat(base[..., None], 3, axis=2)
    for tint in np.atleast_2d(np.asarray(tints, dtype=float)):
        patch = _step(noise(n, rng, 1.5, 2, high), rng.uniform(0.58, 0.66), 0.14)
        image = image * blend(np.ones(3), tint, patch)
    return _bytes(image * 127.5)


def _grass(rng: np.random.Generator) -> GroundTextures:
    soil, green = np.array([82, 78, 46]), np.array([92, 106, 50])
    detail = _bytes(blend(soil, green, noise(DETAIL_PX, rng, 1.0, 3)) * 0.8)
    blades = [(86, 112, 44), (104, 126, 56), (122, 132, 66), (74, 98, 40), (142, 140, 84)]
    _strokes(detail, rng, 26000, (8, 26), blades)
    _spots(detail, rng, 60, (2, 9), [(66, 96, 38), (108, 122, 56)], 1.6)
    _spots(detail, rng, 24, (1, 2.5), [(232, 226, 190), (226, 200, 70)])
    tints = [(1.09, 1.03, 0.96), (0.9, 0.95, 0.92), (1.13, 1.04, 0.95)]
    macro = _variation(MACRO_PX, rng, tints, 0.12, 1.2, 90)
    middle = _variation(MIDDLE_PX, rng, [(1.08, 1.04, 0.98), (0.9, 0.96, 0.92)], 0.20, 0.6, 200)
    return GroundTextures(detail, middle, macro)


def _forest_floor(rng: np.random.Generator) -> GroundTextures:
    detail = _bytes(blend((58, 46, 34), (92, 74, 52), noise(DETAIL_PX, rng, 0.8, 3)))
    _strokes(detail, rng, 9000, (5, 18), [(122, 92, 58), (88, 66, 44), (140, 110, 74)])
    litter = [(128, 88, 46), (104, 78, 46), (150, 112, 62), (78, 62, 42), (92, 98, 50)]
    _spots(detail, rng, 2600, (3, 9), litter, 1.7)
    _strokes(detail, rng, 130, (40, 150), [(74, 60, 48), (110, 96, 78)], 3)
    middle = _variation(MIDDLE_PX, rng, [(0.9, 1.06, 0.85), (0.86, 0.86, 0.88)], 0.22, 0.7, 200)
    macro = _variation(MACRO_PX, rng, [(0.9, 1.07, 0.86), (1.09, 1.03, 0.96)], 0.14, 1.1, 80)
    return GroundTextures(detail, middle, macro)


def _rock(rng: np.random.Generator) -> GroundTextures:
    n = noise(DETAIL_PX, rng, 1.1, 2)
    cracks = 1 - _step(np.abs(noise(DETAIL_PX, rng, 1.5, 2, 60) - 0.5), 0.012, 0.014)
    image = blend((108, 104, 98), (150, 146, 138), n) * (1 - 0.5 * cracks[..., None])
    detail = _bytes(image * (0.85 + 0.3 * noise(DETAIL_PX, rng, 0.2, 40))[..., None])
    _spots(detail, rng, 350, (2, 12), [(150, 152, 132), (126, 130, 108), (98, 94, 90)], 1.3)
    middle = _variation(MIDDLE_PX, rng, [(0.86, 0.92, 0.8), (1.12, 1.08, 1.0)], 0.34, 0.9, 200)
    macro = _variation(MACRO_PX, rng, [(0.9, 0.95, 0.82), (1.12, 1.08, 1.04)], 0.22, 1.2, 80)
    return GroundTextures(detail, middle, macro)


def _sand(rng: np.random.Generator) -> GroundTextures:
    rows = np.arange(DETAIL_PX)[:, None] / DETAIL_PX
    ripples = 0.5 + 0.5 * np.sin(2 * np.pi * (36 * rows + 5 * (noise(DETAIL_PX, rng, 1.6, 1, 20) - 0.5)))
    image = blend((178, 154, 116), (208, 186, 146), 0.6 * ripples + 0.4 * noise(DETAIL_PX, rng, 0.8, 2))
    detail = _bytes(image * (0.93 + 0.14 * noise(DETAIL_PX, rng, 0.0, 60))[..., None])
    _spots(detail, rng, 160, (1, 4), [(128, 112, 92), (226, 214, 190), (150, 130, 104)])
    middle = _variation(MIDDLE_PX, rng, [(0.9, 0.89, 0.88)], 0.16, 0.9, 150)
    macro = _variation(MACRO_PX, rng, [(0.86, 0.86, 0.84), (1.06, 1.06, 1.05)], 0.12, 1.3, 60)
    return GroundTextures(detail, middle, macro)


def _snow(rng: np.random.Generator) -> GroundTextures:
    image = blend((206, 214, 228), (240, 243, 248), noise(DETAIL_PX, rng, 1.2, 2))
    detail = _bytes(image * (0.97 + 0.06 * noise(DETAIL_PX, rng, 0.0, 60))[..., None])
    _strokes(detail, rng, 40, (10, 40), [(150, 142, 128)])
    middle = _variation(MIDDLE_PX, rng, [(0.95, 0.97, 1.0)], 0.10, 1.1, 120)
    macro = _variation(MACRO_PX, rng, [(0.93, 0.95, 0.99)], 0.08, 1.3, 60)
    return GroundTextures(detail, middle, macro)


def _asphalt(rng: np.random.Generator) -> GroundTextures:
    image = blend((74, 74, 76), (98, 97, 96), noise(DETAIL_PX, rng, 0.5, 2))
    detail = _bytes(image * (0.8 + 0.4 * noise(DETAIL_PX, rng, 0.0, 40))[..., None])
    _spots(detail, rng, 2500, (1, 2.2), [(120, 118, 114), (60, 60, 62), (140, 136, 128)])
    cracks = 1 - _step(np.abs(noise(DETAIL_PX, rng, 1.7, 1, 40) - 0.5), 0.006, 0.006)
    detail = _bytes(detail * (1 - 0.45 * cracks[..., None]))
    middle = _variation(MIDDLE_PX, rng, [(0.84, 0.84, 0.85), (1.1, 1.1, 1.08)], 0.12, 1.0, 120)
    macro = _variation(MACRO_PX, rng, [(0.85, 0.85, 0.86), (1.14, 1.13, 1.1)], 0.10, 1.3, 60)
    return GroundTextures(detail, middle, macro)


def _water(rng: np.random.Generator) -> GroundTextures:
    height = noise(DETAIL_PX, rng, 1.9, 3, 160)
    dy = np.roll(height, -1, 0) - np.roll(height, 1, 0)
    dx = np.roll(height, -1, 1) - np.roll(height, 1, 1)
    scale = 0.16 / np.hypot(dx, dy).std()
    waves = np.stack([0.5 + dx * scale, 0.5 + dy * scale, height], axis=2) * 255
    streaks = 1 - _step(np.abs(noise(MIDDLE_PX, rng, 1.1, 6, 90) - 0.5), 0.03, 0.05)
    streaks *= _step(noise(MIDDLE_PX, rng, 1.4, 3, 40), 0.60, 0.2) * noise(MIDDLE_PX, rng, 0.3, 20)
    middle = np.repeat(streaks[..., None], 3, axis=2) * 255
    macro = _variation(MACRO_PX, rng, [(0.85, 1.05, 1.02), (0.92, 0.95, 1.0)], 0.14, 1.4, 40)
    return GroundTextures(_bytes(waves), _bytes(middle), macro)


_GROUND = {
    "grass": _grass,
    "forest floor": _forest_floor,
    "rock": _rock,
    "sand": _sand,
    "snow": _snow,
    "asphalt": _asphalt,
    "water": _water,
}


def _plain(rng: np.random.Generator) -> U8:
    return np.full((LAYER_PX, LAYER_PX, 3), 255, np.uint8)


def _leaves(rng: np.random.Generator) -> U8:
    image = _grey(noise(LAYER_PX, rng, 0.8, 3), 0.30)
    image = _bytes(image * 0.7)
    greys = [(g, g, 0.82 * g) for g in (90, 130, 165, 195, 225)]
    _spots(image, rng, 1100, (3, 8), greys, 1.6)
    return image


def _needles(rng: np.random.Generator) -> U8:
    image = _bytes(_grey(noise(LAYER_PX, rng, 0.6, 3), 0.3) * 0.75)
    _strokes(image, rng, 2600, (6, 18), [(g, g, g) for g in (80, 130, 175, 215)])
    return image


def _bark(rng: np.random.Generator) -> U8:
    return _grey(noise(LAYER_PX, rng, 0.5, 4), 0.35)


def _fabric(rng: np.random.Generator) -> U8:
    folds = 1 - np.abs(noise(LAYER_PX, rng, 1.6, 2, 24) - 0.5) * 2
    return _grey(0.75 * folds**2 + 0.25 * noise(LAYER_PX, rng, 0.1, 30), 0.55)


def _stone(rng: np.random.Generator) -> U8:
    image = _grey(noise(LAYER_PX, rng, 0.9, 2), 0.45)
    _spots(image, rng, 70, (2, 9), [(225, 228, 200), (170, 175, 150), (130, 126, 120)], 1.3)
    return image


def _roof(rng: np.random.Generator) -> U8:
    y, x = np.mgrid[0:LAYER_PX, 0:LAYER_PX]
    row = y // 16
    across = (x + 8 * (row % 2)) % 16
    tone = rng.uniform(0.72, 1.0, (16, 17))[row, ((x + 8 * (row % 2)) // 16) % 16]
    shade = np.where((y % 16 < 3) | (across < 1), 0.6, 1.0) * (1.0 - 0.012 * (y % 16))
    return _bytes(_grey(noise(LAYER_PX, rng, 0.8, 3), 0.7) * (tone * shade)[..., None])


def _wall(rng: np.random.Generator) -> U8:
    image = _grey(noise(LAYER_PX, rng, 0.8, 2), 0.82)
    image[::32] = image[::32] * 0.85
    return image


def _windows(rng: np.random.Generator) -> U8:
    """One storey of 3 m by 3 m wall with a window."""
    image = _wall(rng)
    cv2.rectangle(image, (72, 60), (184, 190), (250, 250, 250), -1)
    cv2.rectangle(image, (82, 70), (174, 180), (52, 62, 74), -1)
    cv2.line(image, (90, 172), (140, 76), (84, 98, 112), 10, cv2.LINE_AA)
    cv2.line(image, (128, 70), (128, 180), (250, 250, 250), 6)
    cv2.line(image, (82, 112), (174, 112), (250, 250, 250), 5)
    cv2.rectangle(image, (66, 190), (190, 200), (190, 190, 186), -1)
    return image


def _planks(rng: np.random.Generator) -> U8:
    y = np.arange(LAYER_PX)[:, None]
    tone = rng.uniform(0.75, 1.0, 8)[y // 32] * np.where(y % 32 < 2, 0.45, 1.0)
    grain = cv2.resize(noise(LAYER_PX, rng, 0.6, 4)[:, :32].astype(np.float32), (LAYER_PX, LAYER_PX))
    return _grey(tone * (0.8 + 0.2 * grain), 0.25)


def _worn(rng: np.random.Generator) -> U8:
    image = _grey(noise(LAYER_PX, rng, 1.0, 2), 0.86)
    _strokes(image, rng, 60, (10, 60), [(205, 200, 195), (240, 240, 240), (180, 174, 166)])
    return image


_MATERIALS = {
    Layer.PLAIN: _plain,
    Layer.LEAVES: _leaves,
    Layer.NEEDLES: _needles,
    Layer.BARK: _bark,
    Layer.FABRIC: _fabric,
    Layer.STONE: _stone,
    Layer.ROOF: _roof,
    Layer.WALL: _wall,
    Layer.WINDOWS: _windows,
    Layer.PLANKS: _planks,
    Layer.WORN: _worn,
}


def _weather(image: F64, rng: np.random.Generator, held_out: bool) -> U8:
    """Fading, dirt, scratches and grit on a large picture; returned at layer size."""
    n = len(image)
    fade = rng.uniform(0.0, 0.40 if held_out else 0.30)
    grey = image.mean(axis=2, keepdims=True)
    image = image * (1 - fade) + fade * (0.5 * grey + 0.5 * 205)
    dirt = _step(noise(n, rng, 1.3, 2), rng.uniform(0.62, 0.85), 0.25) * rng.uniform(0.2, 0.85)
    image = blend(image, np.array([94, 80, 58]) * rng.uniform(0.7, 1.3), dirt)
    image = image * (0.92 + 0.16 * noise(n, rng, 0.9, 2))[..., None]
    small = _bytes(cv2.resize(image, (LAYER_PX, LAYER_PX), interpolation=cv2.INTER_AREA))
    _strokes(small, rng, int(rng.integers(0, 14)), (5, 50), [(200, 190, 180), (110, 92, 80)])
    _spots(small, rng, int(rng.integers(0, 12)), (1, 7), [(120, 104, 80), (96, 110, 60), (90, 70, 50)], 1.5)
    return small


def _sign_red(rng: np.random.Generator, held_out: bool) -> F64:
    low, high = ((150, 24, 20), (205, 52, 62)) if held_out else ((158, 10, 22), (206, 38, 48))
    return np.asarray(rng.uniform(low, high))


def _stop_sign(rng: np.random.Generator, held_out: bool) -> U8:
    """A red octagon with a white border and the word STOP; spans the circumscribed circle."""
    n = 4 * LAYER_PX
    image = np.full((n, n, 3), 238.0)
    red = tuple(_sign_red(rng, held_out).tolist())
    corners = np.array([[np.cos(a), np.sin(a)] for a in np.pi / 8 + np.arange(8) * np.pi / 4])
    border = rng.uniform(0.90, 0.945)
    cv2.fillPoly(image, [(n / 2 * (1 + border * corners)).astype(np.int32)], red)
    white = (242.0, 242.0, 238.0)
    h = n * rng.uniform(0.27, 0.31)  # letter height
    w, gap = h * rng.uniform(0.46, 0.53), h * 0.16
    t = round(h * rng.uniform(0.17, 0.21))  # stroke
    top, x = n / 2 - h / 2, n / 2 - (4 * w + 3 * gap) / 2
    for letter in "STOP":
        for line in _LETTERS[letter]:
            q = np.array(line) * [w - t, h - t] + [x + t / 2, top + t / 2]
            cv2.polylines(image, [q.round().astype(np.int32)], False, white, t, cv2.LINE_8)
        x += w + gap
    return _weather(image, rng, held_out)


def _arc(cx: float, cy: float, rx: float, ry: float, start_deg: float, end_deg: float) -> list[XY]:
    a = np.radians(np.linspace(start_deg, end_deg, 13))
    return [(float(x), float(y)) for x, y in zip(cx + rx * np.cos(a), cy + ry * np.sin(a), strict=True)]


_LETTERS: dict[str, list[list[XY]]] = {  # strokes in a unit box, y down
    "S": [_arc(0.5, 0.25, 0.5, 0.25, -20, -270) + _arc(0.5, 0.75, 0.5, 0.25, -90, 160)],
    "T": [[(-0.05, 0), (1.05, 0)], [(0.5, 0), (0.5, 1)]],
    "O": [_arc(0.5, 0.3, 0.5, 0.3, 180, 360) + _arc(0.5, 0.7, 0.5, 0.3, 0, 180) + [(0, 0.3)]],
    "P": [[(0, 1), (0, 0), (0.6, 0), *_arc(0.6, 0.27, 0.4, 0.27, -90, 90), (0, 0.54)]],
}


def _round_sign(rng: np.random.Generator, held_out: bool) -> U8:
    """A no-entry sign: red disc, white rim, white bar (some have a blank or crossed face)."""
    n = 4 * LAYER_PX
    image = np.full((n, n, 3), 238.0)
    red = tuple(_sign_red(rng, held_out).tolist())
    c = (n // 2, n // 2)
    cv2.circle(image, c, round(n / 2 * rng.uniform(0.90, 0.95)), red, -1)
    white = (242.0, 242.0, 238.0)
    style = rng.random()
    if style < 0.7:
        w, h = n * rng.uniform(0.33, 0.38), n * rng.uniform(0.07, 0.10)
        cv2.rectangle(image, (int(c[0] - w), int(c[1] - h)), (int(c[0] + w), int(c[1] + h)), white, -1)
    elif style < 0.85:
        cv2.circle(image, c, round(n * rng.uniform(0.24, 0.36)), white, -1)
    return _weather(image, rng, held_out)


def _rings(rng: np.random.Generator, held_out: bool) -> U8:
    """The cut face of a stump: growth rings, cracks, bark at the rim."""
    n = LAYER_PX
    y, x = (np.mgrid[0:n, 0:n] + 0.5) / n * 2 - 1
    wobble = 0.08 * (noise(n, rng, 1.6, 1, 12) - 0.5)
    r = np.hypot(x - rng.uniform(-0.15, 0.15), y - rng.uniform(-0.15, 0.15)) + wobble
    a = np.arctan2(y, x)
    ring = 0.5 + 0.5 * np.sin(r * rng.uniform(60, 110))
    light, dark = ((226, 186, 130), (188, 142, 92)) if not held_out else ((206, 178, 140), (150, 122, 92))
    image = blend(dark, light, 0.45 * ring + 0.55 * noise(n, rng, 0.6, 4)) * rng.uniform(0.75, 1.05)
    for angle in rng.uniform(-np.pi, np.pi, rng.integers(2, 6)):
        crack = (np.abs(np.angle(np.exp(1j * (a - angle)))) < 0.03) & (r > rng.uniform(0.05, 0.5))
        image[crack] *= 0.45
    rim = _step(np.hypot(x, y), 0.93, 0.04)
    return _bytes(blend(image, (78, 60, 44), rim))


_DECALS = {Decal.STOP_SIGN: _stop_sign, Decal.ROUND_SIGN: _round_sign, Decal.RINGS: _rings}
