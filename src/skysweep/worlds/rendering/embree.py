"""Ray-cast renderer with Embree, for machines without OpenGL. Same scene, same light, same look.

One ray a pixel, four where parts meet; one shadow ray. Shading is compiled with Numba.
"""

from __future__ import annotations

import math
from typing import Any, Final

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F32, F64, I32, I64, U8
from skysweep.errors import MissingExtraError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.worlds.meshes import Mesh, merge, yaw_rotation
from skysweep.worlds.rendering.projection import NEAR_M
from skysweep.worlds.scene import PLANT_TEXTURE_M, Planting, Scene
from skysweep.worlds.textures import DETAIL_M, MACRO_M, MIDDLE_M

_GROUND, _WATER, _SOLID = 0, 1, 2
_SUBPIXELS = np.array([[-0.375, -0.125], [0.125, -0.375], [0.375, 0.125], [-0.125, 0.375]])


class EmbreeRenderer:
    """A ``Renderer`` that casts rays. Raises MissingExtraError if embreex is not installed."""

    backend: Final = "embree"

    def __init__(self, scene: Scene) -> None:
        parts = [(scene.ground.mesh(), 0)] + [(s.mesh, s.id) for s in scene.solids]
        parts += [(_expanded(p), 0) for p in scene.plantings]
        n_still = sum(len(m.faces) for m, _ in parts)
        parts += [(m.mesh, m.id) for m in scene.movers]
        mesh = merge([m for m, _ in parts])
        face_counts = [len(m.faces) for m, _ in parts]
        self._mesh = mesh
        self._ids = np.repeat(np.array([k for _, k in parts], dtype=np.int32), face_counts)
        self._part = np.repeat(np.arange(len(parts), dtype=np.int32), face_counts)
        self._material = np.full(len(mesh.faces), _SOLID, np.int32)
        self._material[: face_counts[0]] = _WATER if scene.terrain.surface == "water" else _GROUND
        self._density = _texel_density(mesh, scene.layers.shape[1])
        self._sun = scene.sun
        g = scene.ground_textures
        images = g.detail[None], g.middle[None], g.macro[None], scene.layers
        self._textures = tuple(_mips(image) for image in images)
        objects = np.flatnonzero(self._ids[:n_still] > 0)
        self._everything = [_Faces(mesh, np.arange(n_still))]
        self._objects = [_Faces(mesh, objects)] if len(objects) else []
        self._movers, self._moving, self._moved_s = (
            scene.movers,
            np.arange(n_still, len(mesh.faces)),
            math.nan,
        )
        self._moved: list[_Faces] = []

    def close(self) -> None:
        """Does nothing: the garbage collector frees the scene."""

    def render(self, lens: Lens, pose: CameraPose, time_s: float = 0.0) -> U8:
        self._move(time_s)
        shape = (lens.height_px, lens.width_px)
        x, y = _pixel_centres(lens)
        colours, faces = self._shoot(lens, pose, x, y, time_s)
        part = np.where(faces >= 0, self._part[faces], -1).reshape(shape)
        edge = np.zeros(shape, bool)
        edge[1:] |= part[1:] != part[:-1]
        edge[:-1] |= part[1:] != part[:-1]
        edge[:, 1:] |= part[:, 1:] != part[:, :-1]
        edge[:, :-1] |= part[:, 1:] != part[:, :-1]
        at = np.flatnonzero(edge.ravel())
        if len(at):
            fine = [self._shoot(lens, pose, x[at] + dx, y[at] + dy, time_s)[0] for dx, dy in _SUBPIXELS]
            colours[at] = np.mean(fine, axis=0)
        return np.asarray((colours * 255 + 0.5).astype(np.uint8).reshape(*shape, 3))

    def render_ids(self, lens: Lens, pose: CameraPose, occluders: bool = True, time_s: float = 0.0) -> I32:
        self._move(time_s)
        shape = (lens.height_px, lens.width_px)
        scenes = (self._everything if occluders else self._objects) + self._moved
        if not scenes:
            return np.zeros(shape, np.int32)
        faces = _nearest([s.hits(*_rays(lens, pose, *_pixel_centres(lens))) for s in scenes])["primID"]
        return np.where(faces >= 0, self._ids[faces], 0).astype(np.int32).reshape(shape)

    def _move(self, time_s: float) -> None:
        """Have what moves where it is at this time, in a scene of its own."""
        if not self._movers or time_s == self._moved_s:
            return
        moved = merge([mover.at(time_s) for mover in self._movers])
        first = len(self._mesh.vertices) - len(moved.vertices)
        self._mesh.vertices[first:], self._mesh.normals[first:] = moved.vertices, moved.normals
        self._moved, self._moved_s = [_Faces(self._mesh, self._moving)], time_s

    def _shoot(self, lens: Lens, pose: CameraPose, x: F64, y: F64, time_s: float) -> tuple[F32, I32]:
        """Colours (N, 3) 0..1 and faces (N,) seen through picture points."""
        origins, directions = _rays(lens, pose, x, y)
        scenes = self._everything + self._moved
        hit = _nearest([s.hits(origins, directions) for s in scenes])
        faces = hit["primID"]
        points = origins + directions * np.where(faces >= 0, hit["tfar"], 0)[:, None]
        sun = self._sun.direction_enu.astype(np.float32)
        side = np.where((hit["Ng"] * directions).sum(axis=1, keepdims=True) > 0, -1.0, 1.0)
        normals = side * hit["Ng"] / np.maximum(np.linalg.norm(hit["Ng"], axis=1, keepdims=True), 1e-12)
        starts = (points + 0.01 * normals).astype(np.float32)
        towards_sun = np.tile(sun, (len(starts), 1))
        lit = ~np.logical_or.reduce([s.hides(starts, towards_sun) for s in scenes])
        mesh, s = self._mesh, self._sun
        colours = _shade(
            faces, hit["u"], hit["v"], points.astype(np.float64), directions, lit, self._material,
            self._density, mesh.faces, mesh.normals, mesh.colours, mesh.texture, self._textures,
            pose.position_enu_m, lens.focal_px, s.direction_enu, s.sun_rgb, s.sky_rgb,
            s.ground_rgb, s.haze_rgb, 3.912 / s.visibility_m, time_s,
        )  # fmt: skip
        return colours, faces


class _Faces:
    """Some faces of a mesh as an Embree scene. Raises MissingExtraError if embreex is not installed."""

    def __init__(self, mesh: Mesh, numbers: NDArray[np.intp]) -> None:
        try:
            from embreex import rtcore_scene
            from embreex.mesh_construction import TriangleMesh
        except ImportError as error:
            raise MissingExtraError("The Embree camera", "embree") from error
        self._numbers = numbers.astype(np.int32)
        self._scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self._scene, mesh.vertices, mesh.faces[numbers])

    def hits(self, origins: F32, directions: F32) -> dict[str, Any]:
        """What rays (N, 3) meet first; ``primID`` is the face's number in the mesh, -1 for none."""
        found: dict[str, Any] = self._scene.run(origins, directions, output=1)
        faces = found["primID"]
        found["primID"] = np.where(faces >= 0, self._numbers[faces], -1)
        return found

    def hides(self, origins: F32, directions: F32) -> NDArray[np.bool_]:
        """(N,) whether rays meet anything."""
        return np.asarray(self._scene.run(origins, directions, query="OCCLUDED") >= 0)


def _nearest(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Of the hits of the same rays in several scenes, the nearest of each ray."""
    first, *others = found
    for other in others:
        closer = (other["primID"] >= 0) & ((first["primID"] < 0) | (other["tfar"] < first["tfar"]))
        for key in ("u", "v", "Ng", "tfar", "primID"):
            first[key][closer] = other[key][closer]
    return first


def _expanded(planting: Planting) -> Mesh:
    """All copies of a planting as one mesh."""
    unit = planting.meshes[1]
    copies = []
    for x, y, z, yaw, radius, height, shade in planting.places.tolist():
        copy = unit.moved((x, y, z), yaw_rotation(yaw), (radius, radius, height)).tinted(shade)
        sized = unit.vertices * (radius, radius, height)
        uv = (sized[:, :2] + sized[:, 2:] * (0.61, 0.73)) / PLANT_TEXTURE_M
        texture = np.column_stack([uv, unit.texture[:, 2]])
        copies.append(Mesh(copy.vertices, copy.normals, copy.colours, texture.astype(np.float32), copy.faces))
    return merge(copies)


def _pixel_centres(lens: Lens) -> tuple[F64, F64]:
    y, x = np.mgrid[0 : lens.height_px, 0 : lens.width_px] + 0.5
    return x.ravel(), y.ravel()


def _rays(lens: Lens, pose: CameraPose, x: F64, y: F64) -> tuple[F32, F32]:
    f = lens.focal_px
    d = np.column_stack([(x - lens.width_px / 2) / f, (y - lens.height_px / 2) / f, np.ones(len(x))])
    start = pose.position_enu_m + NEAR_M * (d @ pose.R_camera_to_enu.T)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return start.astype(np.float32), (d @ pose.R_camera_to_enu.T).astype(np.float32)


def _texel_density(mesh: Mesh, layer_px: int) -> F32:
    """Texels a metre (F,) of each face."""
    v, t = mesh.vertices[mesh.faces].astype(float), mesh.texture[mesh.faces, :2].astype(float)
    world = np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1)
    a, b = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
    texels = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * layer_px**2
    return np.asarray(np.sqrt(texels / np.maximum(world, 1e-12)), dtype=np.float32)


def _mips(images: U8) -> tuple[F32, I64]:
    """Mip maps of square layers (L, n, n, 3): texels (T, 3) 0..1 in a row, and where levels start."""
    levels, level = [], images.astype(np.float32) / 255
    while True:
        levels.append(level.reshape(-1, 3))
        n = level.shape[1]
        if n == 1:
            break
        smaller = [cv2.resize(i, (n // 2, n // 2), interpolation=cv2.INTER_AREA) for i in level]
        level = np.stack(smaller).reshape(-1, n // 2, n // 2, 3)
    starts = np.cumsum([0] + [len(t) for t in levels])
    return np.concatenate(levels), starts.astype(np.int64)


@njit(cache=True)
def _tile(texture: Any, u: float, v: float, pixel: float, out: Any) -> None:
    """A sample of a single layer; ``pixel`` is the share of the tile's side that a pixel spans."""
    n = 1 << (len(texture[1]) - 2)
    _sample(texture, 0, u, v, np.log2(pixel * n), out)


@njit(cache=True)
def _sample(texture: Any, layer: int, u: float, v: float, level: float, out: Any) -> None:
    """Trilinear, wrapping: writes (3,) to ``out``."""
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
                for c in range(3):
                    out[c] += w * texels[row, c]


@njit(cache=True)
def _shade(
    faces: Any, bary_u: Any, bary_v: Any, points: Any, directions: Any, lit: Any, material: Any, density: Any,
    triangles: Any, normals: Any, tints: Any, texture: Any, textures: Any, eye: Any, focal_px: float,
    sun: Any, sun_rgb: Any, sky_rgb: Any, ground_rgb: Any, haze_rgb: Any, haze_per_m: float, time_s: float,
) -> Any:  # fmt: skip
    """The shaders of gl_shaders, ray by ray."""
    detail, middle, macro, layers = textures
    n_rays = len(faces)
    out = np.empty((n_rays, 3), np.float32)
    a, b, c, n, light = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(n_rays):
        face = faces[i]
        if face < 0:
            for k in range(3):
                out[i, k] = np.sqrt(1.6 * haze_rgb[k] / (haze_rgb[k] + 1.3))
            continue
        p = points[i]
        distance = np.sqrt((p[0] - eye[0]) ** 2 + (p[1] - eye[1]) ** 2 + (p[2] - eye[2]) ** 2)
        w1, w2 = bary_u[i], bary_v[i]
        w0 = 1.0 - w1 - w2
        i0, i1, i2 = triangles[face, 0], triangles[face, 1], triangles[face, 2]
        for k in range(3):
            n[k] = w0 * normals[i0, k] + w1 * normals[i1, k] + w2 * normals[i2, k]
        n /= np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
        shine = 1.0 if lit[i] else 0.0
        lean = max(abs(directions[i, 2]), 0.2)
        pixel_m = distance / focal_px / np.sqrt(lean)
        if material[face] == _WATER:
            _tile(detail, p[0] / 2.9 + 0.11 * time_s, p[1] / 2.9 + 0.05 * time_s, pixel_m / 2.9, a)
            _tile(detail, p[1] / 11.7 - 0.031 * time_s, p[0] / 11.7 + 0.043 * time_s, pixel_m / 11.7, b)
            _tile(detail, p[0] / 47.0 + 0.017 * time_s, p[1] / 47.0 - 0.008 * time_s, pixel_m / 47.0, c)
            crest = b[2] + c[2]
            for k in range(2):
                n[k] = -((a[k] - 0.5) * 0.32 + (b[k] - 0.5) * 0.42 + (c[k] - 0.5) * 0.40)
            n[2] = 1.0
            n /= np.sqrt(n[0] ** 2 + n[1] ** 2 + 1.0)
            facing = -(n[0] * directions[i, 0] + n[1] * directions[i, 1] + n[2] * directions[i, 2])
            facing = min(max(facing, 0.0), 1.0)
            fresnel = 0.02 + 0.98 * (1.0 - facing) ** 5
            towards_sun, up = 0.0, 0.0
            for k in range(3):
                r = directions[i, k] + 2.0 * facing * n[k]
                towards_sun += r * sun[k]
                if k == 2:
                    up = min(max(r, 0.0), 1.0)
            glint = max(towards_sun, 0.0) ** 90.0
            slope_light = max(n[0] * sun[0] + n[1] * sun[1] + n[2] * sun[2], 0.0)
            _tile(macro, p[0] / MACRO_M, p[1] / MACRO_M, pixel_m / MACRO_M, a)
            _tile(
                middle,
                p[0] / MIDDLE_M + 0.006 * time_s,
                p[1] / MIDDLE_M + 0.004 * time_s,
                pixel_m / MIDDLE_M,
                b,
            )
            t = min(max((crest - 1.0) / 0.3, 0.0), 1.0)
            foam = b[0] * t * t * (3.0 - 2.0 * t)
            for k in range(3):
                deep = (0.012, 0.052, 0.062)[k] * (2.0 * a[k]) ** 2 * (0.6 + 0.7 * crest)
                deep *= sky_rgb[k] * 1.6 + sun_rgb[k] * shine * (0.35 + 0.65 * slope_light)
                sky = haze_rgb[k] * 1.1 * (1.0 - up) + sky_rgb[k] * (0.45, 0.62, 0.9)[k] * up
                rgb = deep * (1.0 - fresnel) + sky * fresnel + sun_rgb[k] * glint * shine * 0.8
                light[k] = rgb * (1.0 - foam) + 0.75 * (sky_rgb[k] + sun_rgb[k] * shine * 0.7) * foam
        else:
            beam = max(n[0] * sun[0] + n[1] * sun[1] + n[2] * sun[2], 0.0) * shine
            if material[face] == _GROUND:
                _tile(detail, p[0] / DETAIL_M, p[1] / DETAIL_M, pixel_m / DETAIL_M, a)
                _tile(middle, p[1] / MIDDLE_M, p[0] / MIDDLE_M, pixel_m / MIDDLE_M, b)
                _tile(macro, p[0] / MACRO_M, p[1] / MACRO_M, pixel_m / MACRO_M, c)
                for k in range(3):
                    light[k] = (4.0 * a[k] * b[k] * c[k]) ** 2 * (sky_rgb[k] + sun_rgb[k] * beam)
            else:
                u = w0 * texture[i0, 0] + w1 * texture[i1, 0] + w2 * texture[i2, 0]
                v = w0 * texture[i0, 1] + w1 * texture[i1, 1] + w2 * texture[i2, 1]
                level = np.log2(max(pixel_m * density[face], 1e-6))
                _sample(layers, int(texture[i0, 2] + 0.5), u, v, level, a)
                for k in range(3):
                    tint = w0 * tints[i0, k] + w1 * tints[i1, k] + w2 * tints[i2, k]
                    ambient = ground_rgb[k] + (sky_rgb[k] - ground_rgb[k]) * (0.5 + 0.5 * n[2])
                    light[k] = (tint * a[k]) ** 2 * (ambient + sun_rgb[k] * beam)
        clear = np.exp(-distance * haze_per_m)
        for k in range(3):
            x = haze_rgb[k] + (light[k] - haze_rgb[k]) * clear
            out[i, k] = min(np.sqrt(1.6 * x / (x + 1.3)), 1.0)
    return out
