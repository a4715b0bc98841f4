"""Temperatures along rays, compiled with Numba: the shaders of gl_heat."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from skysweep.worlds.heat import EXTINCTION_PER_M
from skysweep.worlds.rendering.embree_textures import code_at, sample, tile
from skysweep.worlds.textures import DETAIL_M, MACRO_M, MIDDLE_M

_COARSEST = 99.0  # level of a texture's mean


@njit(cache=True)
def temperatures(
    faces: Any, bary_u: Any, bary_v: Any, points: Any, directions: Any, lit: Any, n_ground: int, density: Any,
    triangles: Any, normals: Any, parts: Any, texture: Any, layers: Any, surfaces: Any, materials: Any,
    eye: Any, focal_px: float, table: Any, sun: Any, past_suns: Any, air_c: float, sky_c: float,
) -> Any:  # fmt: skip
    """(N, 1) degrees C; ``parts`` (V, 3) are those of ``Heat`` at the vertices."""
    detail, middle, macro, water_code = surfaces[0], surfaces[1], surfaces[2], surfaces[6]
    out = np.empty((len(faces), 1), np.float32)
    a, b, c, n, own = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(faces)):
        face = faces[i]
        if face < 0:
            out[i, 0] = sky_c
            continue
        p = points[i]
        distance = np.sqrt((p[0] - eye[0]) ** 2 + (p[1] - eye[1]) ** 2 + (p[2] - eye[2]) ** 2)
        pixel_m = distance / focal_px / np.sqrt(max(abs(directions[i, 2]), 0.2))
        w1, w2 = bary_u[i], bary_v[i]
        w0 = 1.0 - w1 - w2
        i0, i1, i2 = triangles[face, 0], triangles[face, 1], triangles[face, 2]
        if face < n_ground:
            for k in range(3):
                n[k] = w0 * normals[i0, k] + w1 * normals[i1, k] + w2 * normals[i2, k]
            n /= np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
            code = code_at(surfaces, p[0], p[1], pixel_m, a)
            row = table[materials[code]]
            own[0] = row[0] + row[1] * (0.5 + 0.5 * n[2])
            for k in range(4):
                s = past_suns[k]
                own[0] += row[4 + k] * max(n[0] * s[0] + n[1] * s[1] + n[2] * s[2], 0.0)
            own[1] = row[2] * max(n[0] * sun[0] + n[1] * sun[1] + n[2] * sun[2], 0.0)
            own[2] = row[3]
            tile(macro, code, p[0] / MACRO_M, p[1] / MACRO_M, pixel_m / MACRO_M, c)
            varies = 2.0 * c[1] - 1.0
            if code != water_code:
                tile(detail, code, p[0] / DETAIL_M, p[1] / DETAIL_M, pixel_m / DETAIL_M, a)
                tile(middle, code, p[1] / MIDDLE_M, p[0] / MIDDLE_M, pixel_m / MIDDLE_M, b)
                fine = a[1] * b[1] * c[1] * 4.0
                sample(detail, code, 0.0, 0.0, _COARSEST, a)
                varies = fine / a[1] - 1.0
        else:
            for k in range(3):
                own[k] = w0 * parts[i0, k] + w1 * parts[i1, k] + w2 * parts[i2, k]
            u = w0 * texture[i0, 0] + w1 * texture[i1, 0] + w2 * texture[i2, 0]
            v = w0 * texture[i0, 1] + w1 * texture[i1, 1] + w2 * texture[i2, 1]
            layer = int(texture[i0, 2] + 0.5)
            sample(layers, layer, u, v, np.log2(max(pixel_m * density[face], 1e-6)), a)
            sample(layers, layer, 0.0, 0.0, _COARSEST, b)
            varies = a[1] / b[1] - 1.0
        seen = own[0] + own[2] * min(max(varies, -1.0), 1.0)
        if lit[i]:
            seen += own[1]
        out[i, 0] = air_c + (seen - air_c) * np.exp(-distance * EXTINCTION_PER_M)
    return out
