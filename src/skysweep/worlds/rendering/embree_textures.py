"""Samples of textures for the Embree renderer, as OpenGL takes them, compiled with Numba."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numba import njit

from skysweep.arrays import F32, I64, U8
from skysweep.worlds.scene import STRAY, WANDER_M


def mips(images: U8) -> tuple[F32, I64]:
    """Mip maps of square layers (L, n, n, C): texels (T, C) 0..1 in a row, and where levels start."""
    levels, level = [], images.astype(np.float32) / 255
    while True:
        levels.append(level.reshape(-1, images.shape[3]))
        n = level.shape[1]
        if n == 1:
            break
        smaller = [cv2.resize(i, (n // 2, n // 2), interpolation=cv2.INTER_AREA) for i in level]
        level = np.stack(smaller).reshape(-1, n // 2, n // 2, images.shape[3])
    starts = np.cumsum([0] + [len(t) for t in levels])
    return np.concatenate(levels), starts.astype(np.int64)


@njit(cache=True)
def tile(texture: Any, layer: int, u: float, v: float, pixel: float, out: Any) -> None:
    """A sample of a layer; ``pixel`` is the share of the tile's side that a pixel spans."""
    n = 1 << (len(texture[1]) - 2)
    sample(texture, layer, u, v, np.log2(pixel * n), out)


@njit(cache=True)
def sample(texture: Any, layer: int, u: float, v: float, level: float, out: Any) -> None:
    """Trilinear, wrapping: writes (C,) to ``out``."""
    texels, starts = texture
    top = len(starts) - 2
    level = min(max(level, 0.0), float(top))
    k0 = int(level)
    w1 = level - k0
    out[:] = 0.0
    for k, wk in ((k0, 1.0 - w1), (min(k0 + 1, top), w1)):
        if wk == 0.0:
            continue
        n = 1 << (top - k)
        x, y = u * n - 0.5, v * n - 0.5
        x0, y0 = int(np.floor(x)), int(np.floor(y))
        fx, fy = x - x0, y - y0
        base = starts[k] + layer * n * n
        for oy in range(2):
            for ox in range(2):
                w = wk * (fx if ox else 1.0 - fx) * (fy if oy else 1.0 - fy)
                row = base + ((y0 + oy) % n) * n + (x0 + ox) % n
                for c in range(len(out)):
                    out[c] += w * texels[row, c]


@njit(cache=True)
def code_at(surfaces: Any, x: float, y: float, pixel_m: float, out: Any) -> int:
    """The surface at a place: ``code_here`` of gl_shaders."""
    codes, frame = surfaces[4], surfaces[5]
    rows, columns = codes.shape
    if rows == 1 and columns == 1:
        return int(codes[0, 0])
    tile(surfaces[3], 0, x / WANDER_M, y / WANDER_M, pixel_m / WANDER_M, out)
    u, v = (x - frame[0]) * frame[2] - 0.5, (y - frame[1]) * frame[3] - 0.5
    j, i = int(np.floor(u)), int(np.floor(v))
    fx = min(max(u - j + STRAY * (out[0] - 0.5), 0.0), 1.0)
    fy = min(max(v - i + STRAY * (out[1] - 0.5), 0.0), 1.0)
    found, most = 0, 0.0
    for k in range(4):
        code = codes[min(max(i + k // 2, 0), rows - 1), min(max(j + k % 2, 0), columns - 1)]
        weight = 0.0
        for m in range(4):
            if codes[min(max(i + m // 2, 0), rows - 1), min(max(j + m % 2, 0), columns - 1)] == code:
                weight += (fx if m % 2 else 1.0 - fx) * (fy if m // 2 else 1.0 - fy)
        if weight > most:
            found, most = code, weight
    return int(found)


@njit(cache=True)
def pictured(windows: Any, x: float, y: float, pixel_m: float, out: Any) -> float:
    """The ground's picture at a place (4,) to ``out``; returns the size of its pixels there."""
    texture, frames, _ = windows
    out[:] = 0.0
    for k in range(len(frames)):
        u, v, side = x - frames[k, 0], y - frames[k, 1], frames[k, 2]
        if max(abs(u - 0.5 * side), abs(v - 0.5 * side)) < 0.5 * side - frames[k, 3]:
            sample(texture, k, u / side, v / side, np.log2(pixel_m / frames[k, 3]), out)
            return float(frames[k, 3])
    return 1.0
