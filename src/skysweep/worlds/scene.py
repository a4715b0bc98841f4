"""A world as arrays that a renderer can draw: ground, solid things, trees, light."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F32, F64, U8
from skysweep.scenarios.model import Light
from skysweep.worlds.assets import object_mesh
from skysweep.worlds.assets.buildings import building_mesh
from skysweep.worlds.assets.plants import SHAPES, tree_meshes
from skysweep.worlds.meshes import Mesh, make_mesh, tilt_rotation, yaw_rotation
from skysweep.worlds.textures import GroundTextures, ground_textures, layer_image
from skysweep.worlds.world import TerrainSurface, World, WorldObject

GROUND_LOOKS = 8
HORIZON_M = 4000.0  # the ground goes on flat this far beyond the world
PLANT_TEXTURE_M = 2.2  # a plant's texture repeats after this, whatever the plant's size
UPRIGHT_POSES = ("standing", "sitting", "floating")


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
class Planting:
    """A unit mesh, coarse to fine, and its places: rows of x, y, z, yaw, radius, height, shade."""

    meshes: tuple[Mesh, ...]
    places: F32  # (N, 7)


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything to draw. ``layers`` holds the texture layers in use, renumbered from 0."""

    ground: Mesh
    terrain: TerrainSurface
    ground_textures: GroundTextures
    solids: tuple[Solid, ...]
    plantings: tuple[Planting, ...]
    layers: U8  # (L, 256, 256, 3)
    sun: Sun
    bounds_enu_m: tuple[F64, F64]  # low and high corner (3,) of all that can cast a shadow


def build_scene(world: World) -> Scene:
    """Meshes, textures and light of a world. Deterministic."""
    solids = [Solid(_placed(world.terrain, o), k) for k, o in enumerate(world.objects, start=1)]
    for b in world.buildings:
        house = building_mesh(b.size_m, b.height_m, b.variant, b.flat_roof)
        solids.append(Solid(house.moved(b.position_enu_m, yaw_rotation(b.yaw_rad)), 0))
    plantings = _plant(world)
    shown = [s.mesh for s in solids] + [p.meshes[-1] for p in plantings]
    used = np.unique(np.concatenate([[0.0], *(m.texture[:, 2] for m in shown)])).astype(int)
    solids = [Solid(_renumbered(s.mesh, used), s.id) for s in solids]
    plantings = [Planting(tuple(_renumbered(m, used) for m in p.meshes), p.places) for p in plantings]
    return Scene(
        ground_mesh(world.terrain),
        world.terrain,
        ground_textures(world.terrain.surface, world.seed % GROUND_LOOKS),
        tuple(solids),
        tuple(plantings),
        np.stack([layer_image(int(layer)) for layer in used]),
        make_sun(world.light),
        _bounds(world.terrain, solids, plantings),
    )


def make_sun(light: Light) -> Sun:
    """Sun and sky: warm and weak near the horizon, and exposed so that level ground keeps its tone."""
    elevation, heading = np.radians(light.sun_elevation_deg), np.radians(light.sun_heading_deg)
    direction = np.array(
        [np.cos(elevation) * np.sin(heading), np.cos(elevation) * np.cos(heading), np.sin(elevation)]
    )
    air_mass = 1.0 / (np.sin(elevation) + 0.15 * (light.sun_elevation_deg + 3.885) ** -1.253)  # Kasten (1965)
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


def ground_mesh(terrain: TerrainSurface) -> Mesh:
    """The heightfield as a grid that continues flat to the horizon; its faces are sorted row by row."""
    west, south, east, north = terrain.bounds_enu_m
    rows, columns = (17, 17) if terrain.is_flat else terrain.heights_m.shape
    far = np.array([HORIZON_M, 0.25 * HORIZON_M, 0.05 * HORIZON_M])
    x = np.concatenate([west - far, np.linspace(west, east, columns), east + far[::-1]])
    y = np.concatenate([south - far, np.linspace(south, north, rows), north + far[::-1]])
    X, Y = np.meshgrid(x, y)
    xy = np.column_stack([X.ravel(), Y.ravel()])
    v = np.column_stack([xy, terrain.height_m(xy)])
    n = len(x)
    i, j = np.meshgrid(np.arange(len(y) - 1), np.arange(n - 1), indexing="ij")
    a = (i * n + j).ravel()
    faces = np.stack([np.column_stack([a, a + 1, a + n + 1]), np.column_stack([a, a + n + 1, a + n])], axis=1)
    return make_mesh(v, faces.reshape(-1, 3), (1, 1, 1))


def _placed(terrain: TerrainSurface, thing: WorldObject) -> Mesh:
    mesh = object_mesh(thing.kind, thing.size_m, thing.pose, thing.variant)
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
        rng = np.random.default_rng([tree.variant, 31])
        yaw, shade = rng.uniform(0, 2 * np.pi), rng.uniform(0.78, 1.12)
        place = [*tree.position_enu_m, yaw, tree.crown_radius_m, tree.height_m, shade]
        groups.setdefault((tree.kind, int(rng.integers(SHAPES))), []).append(place)
    return [Planting(tree_meshes(*key), np.array(rows, np.float32)) for key, rows in sorted(groups.items())]


def _renumbered(mesh: Mesh, used: NDArray[np.int_]) -> Mesh:
    texture = mesh.texture.copy()
    texture[:, 2] = np.searchsorted(used, mesh.texture[:, 2].astype(int))
    return replace(mesh, texture=texture)


def _bounds(terrain: TerrainSurface, solids: list[Solid], plantings: list[Planting]) -> tuple[F64, F64]:
    west, south, east, north = terrain.bounds_enu_m
    low, high = float(terrain.heights_m.min()), float(terrain.heights_m.max())
    top = max(
        [high]
        + [float(s.mesh.vertices[:, 2].max()) for s in solids]
        + [float((p.places[:, 2] + p.places[:, 5]).max()) for p in plantings]
    )
    return np.array([west, south, low - 1.0]), np.array([east, north, top])
