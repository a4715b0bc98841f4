"""Triangle meshes and the few shapes from which every asset is made.

Pure functions of numbers: metres, z up, colours sRGB 0..1. A vertex's ``texture`` is (u, v, layer); its
colour is multiplied by that texture layer (see :mod:`skysweep.worlds.textures`). Its material gives it a
temperature (see :mod:`skysweep.worlds.heat`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skysweep.arrays import F32, F64, I32, U8
from skysweep.worlds.materials import Material, material_of


@dataclass(frozen=True, slots=True)
class Mesh:
    """Indexed triangles with everything that shading needs, one row per vertex."""

    vertices: F32  # (V, 3) metres
    normals: F32  # (V, 3) unit, outward
    colours: F32  # (V, 3) sRGB 0..1
    texture: F32  # (V, 3) u, v, layer
    faces: I32  # (F, 3)
    material: U8  # (V,) as ``materials.Material``

    def moved(
        self, offset: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike | None = None, scale: ArrayLike = 1.0
    ) -> Mesh:
        """This mesh scaled (per axis), then rotated (3, 3), then shifted."""
        s = np.broadcast_to(np.asarray(scale, dtype=float), (3,))
        R = np.eye(3) if rotation is None else np.asarray(rotation, dtype=float)
        normals = (self.normals / s) @ R.T
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        vertices = (self.vertices * s) @ R.T + np.asarray(offset, dtype=float)
        return replace(self, vertices=vertices.astype(np.float32), normals=normals.astype(np.float32))

    def tinted(self, factors: ArrayLike) -> Mesh:
        """This mesh with colours multiplied by (3,) or per vertex by (V, 1) or (V, 3)."""
        colours = np.clip(self.colours * np.asarray(factors, dtype=float), 0, 1)
        return replace(self, colours=colours.astype(np.float32))

    def made_of(self, material: Material, where: ArrayLike = True) -> Mesh:
        """This mesh of another material, all of it or where a mask (V,) says so."""
        return replace(self, material=np.where(where, np.uint8(material), self.material))

    def grounded(self, depth_m: float, darkest: float = 0.55) -> Mesh:
        """This mesh darkened towards z = 0, where less sky reaches it, over ``depth_m``."""
        shade = darkest + (1 - darkest) * np.clip(self.vertices[:, 2:] / depth_m, 0, 1)
        return self.tinted(shade)


def make_mesh(
    vertices: ArrayLike,
    faces: ArrayLike,
    colour: ArrayLike,
    layer: int = 0,
    texture_size_m: float = 1.0,
    uv: ArrayLike | None = None,
    flat: bool = False,
) -> Mesh:
    """A mesh with area-weighted smooth normals, or one normal per face when ``flat``.

    ``colour`` is (3,) or (V, 3). Without ``uv`` (V, 2), the texture repeats every ``texture_size_m``.
    """
    v = np.asarray(vertices, dtype=float)
    f = np.asarray(faces, dtype=np.int32)
    c = np.broadcast_to(np.asarray(colour, dtype=float), v.shape)
    if uv is None:
        uv = np.column_stack([v[:, 0] + 0.61 * v[:, 2], v[:, 1] + 0.73 * v[:, 2]]) / texture_size_m
    t = np.asarray(uv, dtype=float)
    if flat:
        v, c, t = v[f].reshape(-1, 3), c[f].reshape(-1, 3), t[f].reshape(-1, 2)
        f = np.arange(len(v), dtype=np.int32).reshape(-1, 3)
    area = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
    n = np.zeros_like(v)
    for corner in range(3):
        np.add.at(n, f[:, corner], area)
    length = np.linalg.norm(n, axis=1, keepdims=True)
    n = np.where(length > 1e-12, n / np.maximum(length, 1e-12), [0.0, 0.0, 1.0])
    texture = np.column_stack([t, np.full(len(v), layer)])
    return Mesh(
        v.astype(np.float32),
        n.astype(np.float32),
        c.astype(np.float32),
        texture.astype(np.float32),
        f,
        np.full(len(v), material_of(layer), np.uint8),
    )


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of all; ``meshes`` must not be empty."""
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.normals for m in meshes]),
        np.concatenate([m.colours for m in meshes]),
        np.concatenate([m.texture for m in meshes]),
        np.concatenate([m.faces + start for m, start in zip(meshes, starts, strict=True)]).astype(np.int32),
        np.concatenate([m.material for m in meshes]),
    )


def yaw_rotation(yaw_rad: float) -> F64:
    """Rotation (3, 3) about z."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def tilt_rotation(normal: ArrayLike) -> F64:
    """The smallest rotation (3, 3) that takes z to the unit vector ``normal``."""
    n = np.asarray(normal, dtype=float)
    axis = np.cross([0.0, 0.0, 1.0], n)
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + n[2]))


def loft(rings: ArrayLike, colour: ArrayLike, caps: bool = True, **kwargs: Any) -> Mesh:
    """Skin over closed rings (S, N, 3), each counter-clockwise seen from the last ring's side.

    ``colour`` is (3,) or per ring (S, 3). Caps close both ends with a fan.
    """
    r = np.asarray(rings, dtype=float)
    stations, n, _ = r.shape
    c = np.asarray(colour, dtype=float)
    c = np.repeat(c, n, axis=0) if c.ndim == 2 else np.broadcast_to(c, (stations * n, 3))
    faces = [skin_faces(stations, n)]
    v = r.reshape(-1, 3)
    if caps:
        i = np.arange(n)
        j = (i + 1) % n
        bottom, top = len(v), len(v) + 1
        faces += [np.column_stack([np.full(n, bottom), j, i])]
        faces += [np.column_stack([np.full(n, top), (stations - 1) * n + i, (stations - 1) * n + j])]
        v = np.concatenate([v, [r[0].mean(0), r[-1].mean(0)]])
        c = np.concatenate([c, c[:1], c[-1:]])
    return make_mesh(v, np.concatenate(faces), c, **kwargs)


def skin_faces(stations: int, n: int) -> NDArray[np.int_]:
    """Triangles (F, 3) between closed rings of ``n`` vertices each, one ring after another."""
    i = np.arange(n)
    j = (i + 1) % n
    faces = []
    for a in range(0, (stations - 1) * n, n):
        b = a + n
        faces += [np.column_stack([a + i, a + j, b + j]), np.column_stack([a + i, b + j, b + i])]
    return np.concatenate(faces)


def circle(n: int) -> F64:
    """Unit circle (n, 2), counter-clockwise."""
    a = np.arange(n) * 2 * np.pi / n
    return np.column_stack([np.cos(a), np.sin(a)])


def lathe(profile: ArrayLike, colour: ArrayLike, n: int = 16, **kwargs: Any) -> Mesh:
    """Surface of revolution about z of a profile (S, 2) of (radius, z), bottom to top."""
    p = np.asarray(profile, dtype=float)
    ring = circle(n)
    rings = [np.column_stack([radius * ring, np.full(n, z)]) for radius, z in p]
    return loft(rings, colour, **kwargs)


def tube(points: ArrayLike, radii: ArrayLike, colour: ArrayLike, n: int = 7, **kwargs: Any) -> Mesh:
    """A round limb along points (S, 3) with radii (S,), its ends rounded."""
    p, r = np.asarray(points, dtype=float), np.asarray(radii, dtype=float)
    d = np.gradient(p, axis=0)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    p = np.concatenate([[p[0] - 0.7 * r[0] * d[0]], p, [p[-1] + 0.7 * r[-1] * d[-1]]])
    r = np.concatenate([[0.5 * r[0]], r, [0.5 * r[-1]]])
    d = np.concatenate([d[:1], d, d[-1:]])
    helper = np.where(np.abs(d[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = np.cross(helper, d)
    for k in range(1, len(side)):  # parallel transport, so that the skin does not twist
        side[k] = side[k - 1] - (side[k - 1] @ d[k]) * d[k]
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(d, side)
    x, y = circle(n).T[..., None]
    rings = p[:, None] + r[:, None, None] * (x * side[:, None] + y * up[:, None])
    c = np.asarray(colour, dtype=float)
    c = np.concatenate([c[:1], c, c[-1:]]) if c.ndim == 2 else c
    return loft(rings, c, **kwargs)


def ellipsoid(radii: ArrayLike, colour: ArrayLike, n: int = 10, **kwargs: Any) -> Mesh:
    """An ellipsoid about the origin with semi-axes (3,)."""
    t = np.linspace(-np.pi / 2, np.pi / 2, max(n // 2, 4) + 1)[1:-1]
    unit = lathe(np.column_stack([np.cos(t), np.sin(t)]), colour, n=n, **kwargs)
    return unit.moved(scale=radii)


def box(size: ArrayLike, colour: ArrayLike, **kwargs: Any) -> Mesh:
    """A box (sx, sy, sz) standing on z = 0, flat shaded."""
    x, y, z = np.asarray(size, dtype=float) / (2, 2, 1)
    return prism([[-x, -y], [x, -y], [x, y], [-x, y]], 0.0, z, colour, **kwargs)


def prism(outline: ArrayLike, z0: float, z1: float, colour: ArrayLike, **kwargs: Any) -> Mesh:
    """A convex outline (N, 2), counter-clockwise, extruded from z0 to z1, flat shaded."""
    p = np.asarray(outline, dtype=float)
    rings = np.stack([np.column_stack([p, np.full(len(p), z)]) for z in (z0, z1)])
    return loft(rings, colour, flat=True, **kwargs)


def plate(outline: ArrayLike, z: float, colour: ArrayLike, layer: int, uv_radius: float) -> Mesh:
    """A flat convex plate (N, 2) facing up whose texture spans [-uv_radius, uv_radius]."""
    p = np.asarray(outline, dtype=float)
    n = len(p)
    i = np.arange(n)
    v = np.concatenate([np.column_stack([p, np.full(n, z)]), [[0.0, 0.0, z]]])
    uv = v[:, :2] / (2 * uv_radius) * [1, -1] + 0.5
    faces = np.column_stack([np.full(n, n), i, (i + 1) % n])
    return make_mesh(v, faces, colour, layer, uv=uv)


@lru_cache(maxsize=8)
def icosphere(subdivisions: int) -> tuple[F64, I32]:
    """Unit sphere: vertices (V, 3) and faces (F, 3); 20 * 4**subdivisions faces."""
    g = (1 + 5**0.5) / 2
    v = np.array([
        (-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g),
        (0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1),
    ])  # fmt: skip
    f = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2)]
    f += [(10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5)]
    f += [(2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    vertices, faces = v, np.array(f, dtype=np.int32)
    for _ in range(subdivisions):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        m = index.reshape(-1, 3) + len(vertices)
        vertices = np.concatenate([vertices, vertices[unique].mean(axis=1)])
        a, b, c = faces.T
        ab, bc, ca = m.T
        faces = np.concatenate(
            [np.column_stack(t) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces.astype(np.int32)


def lumpy(directions: F64, rng: np.random.Generator, lumps: int, size: float) -> F64:
    """Radii (V,) of a sphere with ``lumps`` bulges of angular ``size`` rad, the largest radius 1."""
    centres = rng.normal(size=(lumps, 3))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    distance = np.arccos(np.clip(directions @ centres.T, -1, 1))
    height = np.exp(-((distance / size) ** 2)) * rng.uniform(0.5, 1.0, lumps)
    bulge = height.max(axis=1)
    return np.asarray(bulge / bulge.max())
