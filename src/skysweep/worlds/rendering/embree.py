"""Ray-cast renderer with Embree, for machines without OpenGL. Same scene, same light, same look.

One ray a pixel, four where parts meet; one shadow ray. Shading is compiled with Numba.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F32, F64, I32, U8
from skysweep.errors import MissingExtraError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.worlds.materials import OF_SURFACE
from skysweep.worlds.meshes import Mesh, merge, yaw_rotation
from skysweep.worlds.rendering.embree_heat import temperatures
from skysweep.worlds.rendering.embree_textures import code_at, mips, pictured, sample, tile
from skysweep.worlds.rendering.picture_windows import PictureWindows, Window, ground_reach_m
from skysweep.worlds.rendering.projection import FAR_M, NEAR_M
from skysweep.worlds.scene import (
    FINE_LEAST,
    FINE_MOST,
    PICTURE_LIGHT,
    PLANT_TEXTURE_M,
    Mover,
    Scene,
    everywhere,
)
from skysweep.worlds.textures import DETAIL_M, MACRO_M, MIDDLE_M, border_noise

_SUBPIXELS = np.array([[-0.375, -0.125], [0.125, -0.375], [0.375, 0.125], [-0.125, 0.375]])
_NEAR_M = 400.0  # plants are drawn finely within this, and nothing less is built
_STEP_M = 100.0  # in which the place moves around which things are built
_SHADOWS_M = 160.0  # that things out of sight cast into the picture
_FOCAL_PX = 1000.0  # for which the ground's posts are chosen


class _Rays(NamedTuple):
    """What rays met first."""

    hit: dict[str, Any]
    points: F64  # (N, 3)
    directions: F32  # (N, 3)
    lit: NDArray[np.bool_]  # (N,)
    focal_px: float
    eye: F64  # (3,)


class EmbreeRenderer:
    """A ``Renderer`` that casts rays. Raises MissingExtraError if embreex is not installed."""

    backend: Final = "embree"

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._solids_enu_m = np.array([s.mesh.vertices.mean(axis=0) for s in scene.solids]).reshape(-1, 3)
        self._layers = mips(scene.layers)
        self._cover = _Cover(scene)
        self._place: tuple[int, int, float] | None = None
        self._stage: _Stage | None = None
        self._set_stage(Lens(16, 16, 0.1), CameraPose(np.zeros(3), rotation_camera_to_enu(0.0, -np.pi / 2)))

    def close(self) -> None:
        """Does nothing: the garbage collector frees the scene."""

    def render(self, lens: Lens, pose: CameraPose, time_s: float = 0.0) -> U8:
        self._cover.show(lens, pose, self._ground_m(pose))
        colours = self._smooth(self._colours, lens, pose, time_s)
        return np.asarray((colours * 255 + 0.5).astype(np.uint8))

    def render_heat_c(self, lens: Lens, pose: CameraPose, time_s: float = 0.0) -> F32:
        return self._smooth(self._temperatures, lens, pose, time_s)[..., 0]

    def _smooth(self, look: _Look, lens: Lens, pose: CameraPose, time_s: float) -> F32:
        """What ``look`` gives (H, W, C), the mean of four rays a pixel where parts meet."""
        stage = self._set_stage(lens, pose)
        stage.move(time_s)
        shape = (lens.height_px, lens.width_px)
        x, y = _pixel_centres(lens)
        values, faces = self._shoot(look, stage, lens, pose, x, y, time_s)
        part = np.where(faces >= 0, stage.part[faces], -1).reshape(shape)
        edge = np.zeros(shape, bool)
        edge[1:] |= part[1:] != part[:-1]
        edge[:-1] |= part[1:] != part[:-1]
        edge[:, 1:] |= part[:, 1:] != part[:, :-1]
        edge[:, :-1] |= part[:, 1:] != part[:, :-1]
        at = np.flatnonzero(edge.ravel())
        if len(at):
            fine = [
                self._shoot(look, stage, lens, pose, x[at] + dx, y[at] + dy, time_s)[0]
                for dx, dy in _SUBPIXELS
            ]
            values[at] = np.mean(fine, axis=0)
        return values.reshape(*shape, -1)

    def render_ids(self, lens: Lens, pose: CameraPose, occluders: bool = True, time_s: float = 0.0) -> I32:
        shape = (lens.height_px, lens.width_px)
        stage = self._set_stage(lens, pose)
        stage.move(time_s)
        scenes = stage.everything() if occluders else stage.objects()
        if not scenes:
            return np.zeros(shape, np.int32)
        faces = _nearest([s.hits(*_rays(lens, pose, *_pixel_centres(lens))) for s in scenes])["primID"]
        return np.where(faces >= 0, stage.ids[faces], 0).astype(np.int32).reshape(shape)

    def _shoot(
        self, look: _Look, stage: _Stage, lens: Lens, pose: CameraPose, x: F64, y: F64, time_s: float
    ) -> tuple[F32, I32]:
        """What ``look`` gives (N, C) and faces (N,) seen through picture points."""
        origins, directions = _rays(lens, pose, x, y)
        hit = _nearest([scene.hits(origins, directions) for scene in stage.everything()])
        faces = hit["primID"]
        points = origins + directions * np.where(faces >= 0, hit["tfar"], 0)[:, None]
        sun = self._scene.sun.direction_enu.astype(np.float32)
        side = np.where((hit["Ng"] * directions).sum(axis=1, keepdims=True) > 0, -1.0, 1.0)
        normals = side * hit["Ng"] / np.maximum(np.linalg.norm(hit["Ng"], axis=1, keepdims=True), 1e-12)
        starts = (points + 0.01 * normals).astype(np.float32)
        towards_sun = np.tile(sun, (len(starts), 1))
        lit = ~np.logical_or.reduce([scene.hides(starts, towards_sun) for scene in stage.everything()])
        rays = _Rays(hit, points.astype(np.float64), directions, lit, lens.focal_px, pose.position_enu_m)
        return look(stage, rays, time_s), faces

    def _colours(self, stage: _Stage, rays: _Rays, time_s: float) -> F32:
        """Colours (N, 3) 0..1."""
        s, mesh = self._scene.sun, stage.mesh
        return np.asarray(_shade(
            rays.hit["primID"], rays.hit["u"], rays.hit["v"], rays.points, rays.directions, rays.lit,
            stage.n_ground, stage.density, mesh.faces, mesh.normals, mesh.colours, mesh.texture, self._layers,
            self._cover.surfaces, self._cover.windows,
            rays.eye, rays.focal_px, s.direction_enu, s.sun_rgb, s.sky_rgb,
            s.ground_rgb, s.haze_rgb, 3.912 / s.visibility_m, time_s,
        ))  # fmt: skip

    def _temperatures(self, stage: _Stage, rays: _Rays, time_s: float) -> F32:
        """Temperatures (N, 1) in degrees C."""
        heat, mesh = self._scene.heat, stage.mesh
        return np.asarray(temperatures(
            rays.hit["primID"], rays.hit["u"], rays.hit["v"], rays.points, rays.directions, rays.lit,
            stage.n_ground, stage.density, mesh.faces, mesh.normals, heat.parts(mesh.material, mesh.normals),
            mesh.texture, self._layers, self._cover.surfaces, self._cover.materials,
            rays.eye, rays.focal_px, heat.table, heat.sun_enu, heat.past_suns_enu, heat.air_c, heat.sky_c,
        ))  # fmt: skip

    def _ground_m(self, pose: CameraPose) -> float:
        return self._scene.terrain.height_at_m(*pose.position_enu_m[:2])

    def _set_stage(self, lens: Lens, pose: CameraPose) -> _Stage:
        """What is near enough to a view to be seen in it or to cast shadows into it.

        It is built anew when the view leaves it, in steps, so that a picture does not depend on earlier ones.
        """
        x, y = (round(v / _STEP_M) for v in pose.position_enu_m[:2].tolist())
        above_m = max(float(pose.position_enu_m[2]) - self._ground_m(pose), 1.0)
        reach_m = _NEAR_M
        while reach_m < 1.2 * ground_reach_m(lens, pose, above_m) + _SHADOWS_M + _STEP_M and reach_m < FAR_M:
            reach_m *= 2.0
        if self._stage is None or self._place != (x, y, reach_m):
            self._place = x, y, reach_m
            self._stage = self._build(np.array([x, y]) * _STEP_M, reach_m)
        return self._stage

    def _build(self, place_m: F64, reach_m: float) -> _Stage:
        scene, grid = self._scene, self._scene.ground
        low, high = grid.low_enu_m[:, :2], grid.high_enu_m[:, :2]
        distance_m = np.linalg.norm(np.clip(place_m, low, high) - place_m, axis=1)
        chunks = np.flatnonzero(distance_m <= reach_m)
        spacing_px = _FOCAL_PX * grid.spacing_m / np.maximum(distance_m, 1.0)
        parts = [(grid.mesh_of(chunks, spacing_px), 0)]
        near = np.linalg.norm(self._solids_enu_m[:, :2] - place_m, axis=1) <= reach_m
        parts += [(scene.solids[k].mesh, scene.solids[k].id) for k in np.flatnonzero(near)]
        for planting in scene.plantings:
            away_m = np.linalg.norm(planting.places[:, :2] - place_m, axis=1)
            for detail, chosen in ((1, away_m <= _NEAR_M), (0, (away_m > _NEAR_M) & (away_m <= reach_m))):
                if chosen.any():
                    parts.append((_expanded(planting.meshes[detail], planting.places[chosen]), 0))
        return _Stage(parts, scene.movers, scene.layers.shape[1])


_Look = Callable[["_Stage", _Rays, float], F32]


class _Stage:
    """Meshes, the ground first, with their objects' numbers, as scenes of Embree: what stands, what moves."""

    def __init__(self, standing: list[tuple[Mesh, int]], movers: Sequence[Mover], layer_px: int) -> None:
        parts = standing + [(m.mesh, m.id) for m in movers]
        self.mesh = merge([m for m, _ in parts])
        face_counts = [len(m.faces) for m, _ in parts]
        self.n_ground, n_standing = face_counts[0], sum(face_counts[: len(standing)])
        self.ids = np.repeat(np.array([k for _, k in parts], dtype=np.int32), face_counts)
        self.part = np.repeat(np.arange(len(parts), dtype=np.int32), face_counts)
        self.density = _texel_density(self.mesh, layer_px)
        self._standing = [_Faces(self.mesh, np.arange(n_standing))]
        objects = np.flatnonzero(self.ids[:n_standing] > 0)
        self._objects = [_Faces(self.mesh, objects)] if len(objects) else []
        self._movers, self._moving = movers, np.arange(n_standing, len(self.mesh.faces))
        self._moved: list[_Faces] = []
        self._moved_s = math.nan

    def everything(self) -> list[_Faces]:
        """All faces."""
        return self._standing + self._moved

    def objects(self) -> list[_Faces]:
        """Those of objects."""
        return self._objects + self._moved

    def move(self, time_s: float) -> None:
        """Have what moves where it is at this time."""
        if not self._movers or time_s == self._moved_s:
            return
        moved = merge([mover.at(time_s) for mover in self._movers])
        first = len(self.mesh.vertices) - len(moved.vertices)
        self.mesh.vertices[first:], self.mesh.normals[first:] = moved.vertices, moved.normals
        self._moved, self._moved_s = [_Faces(self.mesh, self._moving)], time_s


class _Cover:
    """The ground's surfaces and the windows of its picture, as tuples for Numba."""

    def __init__(self, scene: Scene) -> None:
        c = scene.covering
        cover = c.cover if c else everywhere(scene.terrain)
        looks = c.textures if c else (scene.ground_textures,)
        west, south, east, north = cover.bounds_enu_m
        rows, columns = cover.codes.shape
        self.surfaces = (
            mips(np.stack([look.detail for look in looks])),
            mips(np.stack([look.middle for look in looks])),
            mips(np.stack([look.macro for look in looks])),
            mips(border_noise()[None]),
            cover.codes,
            np.array([west, south, columns / (east - west), rows / (north - south)]),
            cover.names.index("water") if "water" in cover.names else -1,
        )
        self.materials = np.array([OF_SURFACE[name] for name in cover.names])
        self._windows = PictureWindows(c.picture) if c and c.picture else None
        self._finest_m = c.picture.pixel_m if c and c.picture else 1.0
        self._shown: tuple[Window, ...] = ()
        self.windows = mips(np.zeros((1, 1, 1, 4), np.uint8)), np.zeros((1, 4)), self._finest_m

    def show(self, lens: Lens, pose: CameraPose, ground_m: float) -> None:
        """Hold the parts of the picture that a view needs."""
        windows = self._windows.of(lens, pose, ground_m) if self._windows else ()
        if windows != self._shown:
            frames = np.array([(w.west_m, w.south_m, w.side_m, w.pixel_m) for w in windows])
            self.windows = mips(np.stack([w.rgba for w in windows])), frames, self._finest_m
            self._shown = windows


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


def _expanded(unit: Mesh, places: F32) -> Mesh:
    """Copies of a plant's unit mesh as one mesh; ``places`` as in ``Planting``."""
    copies = []
    for x, y, z, yaw, radius, height, shade in places.tolist():
        copy = unit.moved((x, y, z), yaw_rotation(yaw), (radius, radius, height)).tinted(shade)
        sized = unit.vertices * (radius, radius, height)
        uv = (sized[:, :2] + sized[:, 2:] * (0.61, 0.73)) / PLANT_TEXTURE_M
        texture = np.column_stack([uv, unit.texture[:, 2]])
        copies.append(replace(copy, texture=texture.astype(np.float32)))
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


@njit(cache=True)
def _shade(
    faces: Any, bary_u: Any, bary_v: Any, points: Any, directions: Any, lit: Any, n_ground: int, density: Any,
    triangles: Any, normals: Any, tints: Any, texture: Any, layers: Any, surfaces: Any, windows: Any,
    eye: Any, focal_px: float,
    sun: Any, sun_rgb: Any, sky_rgb: Any, ground_rgb: Any, haze_rgb: Any, haze_per_m: float, time_s: float,
) -> Any:  # fmt: skip
    """The shaders of gl_shaders, ray by ray."""
    detail, middle, macro = surfaces[0], surfaces[1], surfaces[2]
    seen = np.zeros(4)
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
        code, picture_m = 0, 1.0
        if face < n_ground:
            code = code_at(surfaces, p[0], p[1], pixel_m, a)
            picture_m = pictured(windows, p[0], p[1], pixel_m, seen)
        if face < n_ground and code == surfaces[6] and seen[3] <= 0.5:
            tile(detail, code, p[0] / 2.9 + 0.11 * time_s, p[1] / 2.9 + 0.05 * time_s, pixel_m / 2.9, a)
            tile(detail, code, p[1] / 11.7 - 0.031 * time_s, p[0] / 11.7 + 0.043 * time_s, pixel_m / 11.7, b)
            tile(detail, code, p[0] / 47.0 + 0.017 * time_s, p[1] / 47.0 - 0.008 * time_s, pixel_m / 47.0, c)
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
            tile(macro, code, p[0] / MACRO_M, p[1] / MACRO_M, pixel_m / MACRO_M, a)
            tile(
                middle,
                code,
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
            if face < n_ground:
                tile(detail, code, p[0] / DETAIL_M, p[1] / DETAIL_M, pixel_m / DETAIL_M, a)
                tile(middle, code, p[1] / MIDDLE_M, p[0] / MIDDLE_M, pixel_m / MIDDLE_M, b)
                tile(macro, code, p[0] / MACRO_M, p[1] / MACRO_M, pixel_m / MACRO_M, c)
                for k in range(3):
                    light[k] = (4.0 * a[k] * b[k] * c[k]) ** 2
                if seen[3] > 0.0:
                    tile(
                        detail,
                        code,
                        p[0] / DETAIL_M,
                        p[1] / DETAIL_M,
                        max(picture_m, windows[2]) / DETAIL_M,
                        b,
                    )
                    for k in range(3):
                        tone, fine = (seen[k] / seen[3]) ** 2, min(max(a[k] / b[k], FINE_LEAST), FINE_MOST)
                        fine = 1.0 if code == surfaces[6] else fine
                        shown = 1.3 * tone / ((1.6 - tone) * PICTURE_LIGHT) * fine**2
                        light[k] += (shown - light[k]) * seen[3]
                for k in range(3):
                    light[k] *= sky_rgb[k] + sun_rgb[k] * beam
            else:
                u = w0 * texture[i0, 0] + w1 * texture[i1, 0] + w2 * texture[i2, 0]
                v = w0 * texture[i0, 1] + w1 * texture[i1, 1] + w2 * texture[i2, 1]
                level = np.log2(max(pixel_m * density[face], 1e-6))
                sample(layers, int(texture[i0, 2] + 0.5), u, v, level, a)
                for k in range(3):
                    tint = w0 * tints[i0, k] + w1 * tints[i1, k] + w2 * tints[i2, k]
                    ambient = ground_rgb[k] + (sky_rgb[k] - ground_rgb[k]) * (0.5 + 0.5 * n[2])
                    light[k] = (tint * a[k]) ** 2 * (ambient + sun_rgb[k] * beam)
        clear = np.exp(-distance * haze_per_m)
        for k in range(3):
            x = haze_rgb[k] + (light[k] - haze_rgb[k]) * clear
            out[i, k] = min(np.sqrt(1.6 * x / (x + 1.3)), 1.0)
    return out
