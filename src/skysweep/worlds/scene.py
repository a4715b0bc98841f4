"""A world as arrays that a renderer can draw: ground, solid things, trees, light."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F32, F64, U8
from skysweep.scenarios.model import SUN_LEAST_DEG, Light
from skysweep.worlds.assets import object_mesh
from skysweep.worlds.assets.buildings import building_mesh
from skysweep.worlds.assets.clutter import clutter_mesh
from skysweep.worlds.assets.plants import SHAPES, tree_meshes
from skysweep.worlds.ground_grid import GroundGrid
from skysweep.worlds.heat import Heat, heat_of
from skysweep.worlds.meshes import Mesh, tilt_rotation, yaw_rotation
from skysweep.worlds.rasters import GroundPicture
from skysweep.worlds.textures import GroundTextures, ground_textures, layer_image
from skysweep.worlds.world import GroundCover, TerrainSurface, World, WorldObject

GROUND_LOOKS = 8
WANDER_M = 64.0  # a tile of the noise by which borders of surfaces stray
STRAY = 1.6  # cells, by which they stray at full noise
FINE_LEAST, FINE_MOST = 0.4, 2.5  # what a surface's detail does to the tones of the ground's picture
PICTURE_LIGHT = 1.55  # under which level ground has the tones of its picture
PLANT_TEXTURE_M = 2.2  # a plant's texture repeats after this, whatever the plant's size
_DAYLIGHT_DEG = 45.0
UPRIGHT_POSES = ("standing", "sitting", "floating", "crouching", "walking", "waving")


@dataclass(frozen=True, slots=True)
class Sun:
    """Light of the scene, linear RGB: what a white surface facing it sends back."""

    direction_enu: F64  # (3,) towards the sun
    sun_rgb: F64  # (3,)
    sky_rgb: F64  # (3,) ambient from above
    ground_rgb: F64  # (3,) ambient from below
    haze_rgb: F64  # (3,)
    visibility_m: float


@dataclass(frozen=True, slots=True)
class Solid:
    """A thing with its own mesh; ``id`` is 0, or 1 + its index in ``world.objects``."""

    mesh: Mesh  # in ENU
    id: int


@dataclass(frozen=True, slots=True)
class Mover:
    """An object that moves, with its mesh about the origin, facing east; ``id`` is as of a ``Solid``."""

    mesh: Mesh
    id: int
    thing: WorldObject
    world: World

    @property
    def radius_m(self) -> float:
        """Of a sphere about its place that holds it."""
        return float(np.linalg.norm(self.mesh.vertices, axis=1).max())

    def place(self, time_s: float) -> F64:
        """Its place (3,) at a time."""
        return self.world.position(self.thing, time_s)

    def at(self, time_s: float) -> Mesh:
        """Its mesh in ENU at a time."""
        return _put(self.mesh, self.world.terrain, self.world.at(self.thing, time_s))


@dataclass(frozen=True, slots=True)
class Planting:
    """A unit mesh, coarse to fine, and its places: rows of x, y, z, yaw, radius, height, shade."""

    meshes: tuple[Mesh, ...]
    places: F32  # (N, 7)


@dataclass(frozen=True, slots=True)
class Covering:
    """What differs from place to place on the ground: its surfaces, and its picture over them."""

    cover: GroundCover
    textures: tuple[GroundTextures, ...]  # by code of the cover
    picture: GroundPicture | None


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything to draw. ``layers`` holds the texture layers in use, renumbered from 0."""

    ground: GroundGrid
    terrain: TerrainSurface
    ground_textures: GroundTextures  # of the terrain's surface
    covering: Covering | None  # None: that surface is everywhere
    solids: tuple[Solid, ...]
    movers: tuple[Mover, ...]
    plantings: tuple[Planting, ...]
    layers: U8  # (L, 256, 256, 3)
    sun: Sun
    heat: Heat
    bounds_enu_m: tuple[F64, F64]  # low and high corner (3,) of all that can cast a shadow


def build_scene(world: World) -> Scene:
    """Meshes, textures and light of a world. Deterministic."""
    solids: list[Solid] = []
    movers: list[Mover] = []
    for k, o in enumerate(world.objects, start=1):
        mesh = object_mesh(o.kind, o.size_m, o.pose, o.variant, o.clothing)
        if o.track is None:
            solids.append(Solid(_put(mesh, world.terrain, o), k))
        else:
            movers.append(Mover(mesh, k, o, world))
    for b in world.buildings:
        house = building_mesh(b.size_m, b.height_m, b.variant, b.flat_roof)
        solids.append(Solid(house.moved(b.position_enu_m, yaw_rotation(b.yaw_rad)), 0))
    for c in world.clutter:
        thing = clutter_mesh(c.kind, c.length_m, c.variant)
        solids.append(Solid(thing.moved(c.position_enu_m, yaw_rotation(c.yaw_rad)), 0))
    plantings = _plant(world)
    shown = [s.mesh for s in solids] + [m.mesh for m in movers] + [p.meshes[-1] for p in plantings]
    used = np.unique(np.concatenate([[0.0], *(m.texture[:, 2] for m in shown)])).astype(int)
    solids = [Solid(_renumbered(s.mesh, used), s.id) for s in solids]
    movers = [replace(m, mesh=_renumbered(m.mesh, used)) for m in movers]
    plantings = [Planting(tuple(_renumbered(m, used) for m in p.meshes), p.places) for p in plantings]
    return Scene(
        GroundGrid(world.terrain),
        world.terrain,
        ground_textures(world.terrain.surface, world.seed % GROUND_LOOKS),
        _covering(world),
        tuple(solids),
        tuple(movers),
        tuple(plantings),
        np.stack([layer_image(int(layer)) for layer in used]),
        make_sun(world.light),
        heat_of(world.light, world.wind_mps, world.latitude_deg),
        _bounds(world.terrain, solids, movers, plantings),
    )


def _covering(world: World) -> Covering | None:
    terrain = world.terrain
    if terrain.cover is None and world.ground_picture is None:
        return None
    cover = terrain.cover or everywhere(terrain)
    textures = tuple(ground_textures(name, world.seed % GROUND_LOOKS) for name in cover.names)
    return Covering(cover, textures, world.ground_picture)


def everywhere(terrain: TerrainSurface) -> GroundCover:
    """The terrain's one surface as a cover."""
    return GroundCover(np.zeros((1, 1), np.uint8), terrain.bounds_enu_m, (terrain.surface,))


def make_sun(light: Light) -> Sun:
    """Sun and sky: warm and weak near the horizon, and exposed so that level ground keeps its tone.

    Where the sun is down, as for a thermal camera, maps and views for people are drawn as by day.
    """
    is_day = light.sun_elevation_deg >= SUN_LEAST_DEG
    elevation_deg = light.sun_elevation_deg if is_day else _DAYLIGHT_DEG
    shown = light.model_copy(update={"sun_elevation_deg": elevation_deg})
    direction, elevation = np.array(shown.to_sun_enu), np.radians(elevation_deg)
    air_mass = 1.0 / (np.sin(elevation) + 0.15 * (elevation_deg + 3.885) ** -1.253)  # Kasten (1965)
    sun = 1.6 * np.exp(-np.array([0.06, 0.11, 0.20]) * air_mass)
    clear = np.clip(light.visibility_m / 4000.0, 0.0, 1.0) ** 0.5
    sky = np.array([0.34, 0.39, 0.47]) * (0.45 + 0.55 * np.sin(elevation)) + 0.22 * (1 - clear)
    sun = sun * (0.25 + 0.75 * clear)
    level = float((sun * np.sin(elevation) + sky).mean())
    exposure = 1.55 / level**0.85
    haze = np.array([0.40, 0.45, 0.52]) * (0.5 + 0.5 * np.sin(elevation) ** 0.5) + 0.08 * sun / sun.max()
    return Sun(
        direction,
        sun * exposure,
        sky * exposure,
        0.45 * sky * exposure,
        np.clip(haze, 0, 0.9),
        light.visibility_m,
    )


def _put(mesh: Mesh, terrain: TerrainSurface, thing: WorldObject) -> Mesh:
    """The mesh of an object in its place, along the ground unless it is upright."""
    R = yaw_rotation(thing.yaw_rad)
    if thing.pose not in UPRIGHT_POSES and not terrain.is_flat:
        R = tilt_rotation(_slope_normal(terrain, thing.position_enu_m[:2], 0.5 * thing.size_m)) @ R
    return mesh.moved(thing.position_enu_m, R)


def _slope_normal(terrain: TerrainSurface, xy: F64, reach_m: float) -> F64:
    e, w, n, s = terrain.height_m(xy + reach_m * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
    normal = np.array([w - e, s - n, 2 * reach_m])
    return np.asarray(normal / np.linalg.norm(normal))


def _plant(world: World) -> list[Planting]:
    groups: dict[tuple[str, int], list[list[float]]] = {}
    for tree in world.trees:
        yaw, shade, shape = _plant_looks(tree.variant)
        place = [*tree.position_enu_m.tolist(), yaw, tree.crown_radius_m, tree.height_m, shade]
        groups.setdefault((tree.kind, shape), []).append(place)
    return [Planting(tree_meshes(*key), np.array(rows, np.float32)) for key, rows in sorted(groups.items())]


@lru_cache(maxsize=4096)
def _plant_looks(variant: int) -> tuple[float, float, int]:
    """Yaw, shade and shape of a plant."""
    rng = np.random.default_rng([variant, 31])
    return float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(0.78, 1.12)), int(rng.integers(SHAPES))


def _renumbered(mesh: Mesh, used: NDArray[np.int_]) -> Mesh:
    texture = mesh.texture.copy()
    texture[:, 2] = np.searchsorted(used, mesh.texture[:, 2].astype(int))
    return replace(mesh, texture=texture)


def _bounds(
    terrain: TerrainSurface, solids: list[Solid], movers: list[Mover], plantings: list[Planting]
) -> tuple[F64, F64]:
    west, south, east, north = terrain.bounds_enu_m
    low, high = float(terrain.heights_m.min()), float(terrain.heights_m.max())
    top = max(
        [high]
        + [float(s.mesh.vertices[:, 2].max()) for s in solids]
        + [high + m.radius_m for m in movers]
        + [float((p.places[:, 2] + p.places[:, 5]).max()) for p in plantings]
    )
    return np.array([west, south, low - 1.0]), np.array([east, north, top])
