"""Random worlds and views for data sets of rendered pictures, by a recipe for each kind of camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, NamedTuple, get_args

import cv2
import numpy as np

from skysweep.arrays import F64
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import DEFAULT_POSE, DEFAULT_SIZE_M, CameraKind, Light, TargetClass
from skysweep.worlds.scene import GROUND_LOOKS
from skysweep.worlds.world import (
    HELD_OUT_VARIANTS,
    GroundCover,
    TerrainSurface,
    World,
    WorldBuilding,
    WorldObject,
    WorldTree,
)

Split = Literal["train", "held-out"]

SIDE_PX = 320
HALF_WORLD_M = 70.0
N_OBJECTS = 90
CLUTTER_SHARE = 0.7  # of the pictures without targets are taken of clutter, where there is some
DECOY_SHARE = 0.35  # of pictures are taken of a look-alike
CAR_SHARE = 0.1  # of the others are taken of a car, where there is one
NADIR_SHARE = 0.6
MAX_TILT_DEG = 55.0
SEPARATION_M = 3.0
N_TRAINING_LOOKS = GROUND_LOOKS * 3 // 4  # of the ground; the others are held out

LAND = ("grass", "forest floor", "rock", "sand", "snow", "asphalt")
ANIMALS = ("sheep", "deer", "dog")
CLASSES = {kind: "animal" for kind in ANIMALS}  # of the kinds that are not called as their class is


class Sky(NamedTuple):
    """Light and weather, and where."""

    light: Light
    wind_mps: float
    latitude_deg: float


class Recipe(NamedTuple):
    """What the pictures for a kind of camera show, and from where."""

    classes: tuple[str, ...]  # labelled; the other things are look-alikes
    on_land: dict[str, float]  # shares of kinds
    on_water: dict[str, float]
    land_poses: dict[str, float]  # shares of a person's
    focal_px: tuple[float, float]
    distance_m: tuple[float, float]
    empty_distance_m: tuple[float, float]  # of views of nothing in particular
    pixels_on_object: tuple[float, float]
    empty_share: float  # of the views are of nothing in particular
    patches: bool  # of another surface, on half of the land
    sky: Callable[[np.random.Generator], Sky]


def _daylight(rng: np.random.Generator) -> Sky:
    light = Light(
        sun_elevation_deg=float(rng.uniform(12, 85)),
        sun_heading_deg=float(rng.uniform(0, 360)),
        visibility_m=float(np.exp(rng.uniform(np.log(600), np.log(6000)))),
    )
    return Sky(light, 2.0, 60.0)


def _any_weather(rng: np.random.Generator) -> Sky:
    """Day or night of any season outside the tropics and the polar regions, with air as the season has it."""
    latitude_deg, declination_deg = float(rng.uniform(35, 66)), float(rng.uniform(-23.4, 23.4))
    latitude, declination = np.radians([latitude_deg, declination_deg]).tolist()
    hour = float(rng.uniform(-np.pi, np.pi))
    east = -np.cos(declination) * np.sin(hour)
    north = np.cos(latitude) * np.sin(declination) - np.sin(latitude) * np.cos(declination) * np.cos(hour)
    up = np.sin(latitude) * np.sin(declination) + np.cos(latitude) * np.cos(declination) * np.cos(hour)
    warm_c = 30.0 - 0.4 * latitude_deg + 0.45 * declination_deg + 4.0 * np.cos(hour)
    light = Light(
        sun_elevation_deg=float(np.degrees(np.arcsin(up))),
        sun_heading_deg=float(np.degrees(np.arctan2(east, north)) % 360.0),
        air_temperature_c=float(np.clip(rng.normal(warm_c, 6.0), -25.0, 38.0)),
        cloud_cover=float(rng.choice([0.0, rng.uniform(), 1.0])),
    )
    return Sky(light, float(rng.gamma(2.0, 1.5)), latitude_deg)


VISIBLE = Recipe(
    classes=get_args(TargetClass),
    on_land={
        "stop sign": 0.32, "person": 0.2, "boat": 0.03, "red bucket": 0.08, "red round sign": 0.2,
        "rock": 0.05, "stump": 0.04, "clothing": 0.08,
    },
    on_water={"person": 0.32, "boat": 0.34, "buoy": 0.18, "clothing": 0.09, "red bucket": 0.07},
    land_poses={"lying": 0.6, "standing": 0.4},
    focal_px=(200.0, 900.0),
    distance_m=(1.5, 120.0),
    empty_distance_m=(4.0, 60.0),
    pixels_on_object=(8.0, 160.0),
    empty_share=0.12,
    patches=False,
    sky=_daylight,
)  # fmt: skip
THERMAL = Recipe(
    classes=("person", "animal"),
    on_land={
        "person": 0.36, "sheep": 0.09, "deer": 0.09, "dog": 0.09, "rock": 0.19, "stump": 0.06,
        "clothing": 0.06, "red bucket": 0.02, "stop sign": 0.02, "boat": 0.02,
    },
    on_water={"person": 0.45, "boat": 0.25, "buoy": 0.15, "clothing": 0.1, "red bucket": 0.05},
    land_poses={
        "lying": 0.45, "standing": 0.15, "walking": 0.15, "sitting": 0.12, "crouching": 0.08, "waving": 0.05,
    },
    focal_px=(500.0, 1600.0),
    distance_m=(5.0, 90.0),
    empty_distance_m=(5.0, 80.0),
    pixels_on_object=(8.0, 160.0),
    empty_share=0.12,
    patches=True,
    sky=_any_weather,
)  # fmt: skip
CLUTTERED = VISIBLE._replace(
    classes=(*VISIBLE.classes, "car", "animal"),
    on_land={
        "stop sign": 0.2, "person": 0.32, "boat": 0.03, "sheep": 0.04, "deer": 0.04, "dog": 0.04,
        "red bucket": 0.05, "red round sign": 0.12, "rock": 0.05, "stump": 0.04, "clothing": 0.07,
    },
    on_water={"person": 0.38, "boat": 0.3, "buoy": 0.17, "clothing": 0.09, "red bucket": 0.06},
    land_poses=THERMAL.land_poses,
    empty_share=0.22,
)  # fmt: skip


def recipe_for(camera: CameraKind, clutter: bool) -> Recipe:
    """What the pictures of a data set show."""
    return THERMAL if camera == "thermal" else CLUTTERED if clutter else VISIBLE


def class_of(kind: str) -> str:
    """What a thing is labelled."""
    return CLASSES.get(kind, kind)


def random_world(rng: np.random.Generator, split: Split, recipe: Recipe = VISIBLE) -> World:
    """A square patch of flat land or water with objects, trees and buildings of one split's looks."""
    water = rng.random() < 0.3
    surface = "water" if water else str(rng.choice(LAND))
    bounds = (-HALF_WORLD_M, -HALF_WORLD_M, HALF_WORLD_M, HALF_WORLD_M)
    terrain = TerrainSurface(np.zeros((2, 2)), bounds, surface)
    if recipe.patches and not water and rng.random() < 0.5:
        terrain = replace(terrain, cover=_patches(surface, bounds, rng))
    first = 0 if split == "train" else HELD_OUT_VARIANTS

    def somewhere() -> F64:
        return np.array([*rng.uniform(-HALF_WORLD_M, HALF_WORLD_M, 2), 0.0])

    def variant() -> int:
        return first + int(rng.integers(HELD_OUT_VARIANTS))

    shares = recipe.on_water if water else recipe.on_land
    objects: list[WorldObject] = []
    for kind in rng.choice(list(shares), N_OBJECTS, p=list(shares.values())):
        thing = random_object(str(kind), somewhere(), water, variant(), rng, recipe)
        if all(np.hypot(*(thing.position_enu_m - o.position_enu_m)[:2]) > SEPARATION_M for o in objects):
            objects.append(thing)
    trees, buildings = [], []
    if not water:
        for _ in range(int(rng.choice([0, 40, 120, 350]))):
            kind = str(rng.choice(["broadleaf", "conifer", "bush"]))
            height = float(rng.uniform(0.6, 2.5) if kind == "bush" else rng.uniform(3, 14))
            place, radius = somewhere(), height * float(rng.uniform(0.18, 0.4))
            trees.append(WorldTree(place, height, radius, kind, variant()))
        for _ in range(int(rng.choice([0, 0, 5, 12]))):
            size = (float(rng.uniform(4, 16)), float(rng.uniform(4, 12)))
            place, height, yaw = somewhere(), float(rng.uniform(2.5, 8)), float(rng.uniform(0, 2 * np.pi))
            buildings.append(WorldBuilding(place, size, height, yaw, variant()))
    sky = recipe.sky(rng)
    looks = range(N_TRAINING_LOOKS) if split == "train" else range(N_TRAINING_LOOKS, GROUND_LOOKS)
    seed = GROUND_LOOKS * int(rng.integers(2**20)) + int(rng.choice(looks))
    return World(
        terrain,
        tuple(objects),
        tuple(trees),
        tuple(buildings),
        sky.light,
        seed,
        wind_mps=sky.wind_mps,
        latitude_deg=sky.latitude_deg,
    )


def random_object(
    kind: str,
    position: F64,
    water: bool,
    variant: int,
    rng: np.random.Generator,
    recipe: Recipe = VISIBLE,
) -> WorldObject:
    """A target or look-alike of drawn size, pose and direction."""
    size_m = DEFAULT_SIZE_M[kind] * float(rng.uniform(*((0.85, 1.12) if kind == "person" else (0.7, 1.3))))
    pose = DEFAULT_POSE.get(kind, "face-up")
    if kind == "person":
        poses = recipe.land_poses
        pose = "floating" if water else str(rng.choice(list(poses), p=list(poses.values())))
    elif kind == "stop sign" and rng.random() < 0.15:
        pose = "standing"
    elif kind in ANIMALS and rng.random() < 0.3:
        pose = "lying"
    yaw, is_target = float(rng.uniform(0, 2 * np.pi)), class_of(kind) in recipe.classes
    return WorldObject(kind, position, yaw, size_m, pose, is_target, variant)


def random_view(
    world: World, rng: np.random.Generator, recipe: Recipe = VISIBLE
) -> tuple[Lens, CameraPose] | None:
    """A lens and pose that show a chosen thing, or nothing in particular; None if the view is unsuitable.

    The thing spans a log-uniform number of pixels and lies anywhere in the picture.
    """
    focal = float(np.exp(rng.uniform(*np.log(recipe.focal_px))))
    lens = Lens(SIDE_PX, SIDE_PX, float(2 * np.arctan(SIDE_PX / (2 * focal))))
    tilt = 0.0 if rng.random() < NADIR_SHARE else float(rng.uniform(0, np.radians(MAX_TILT_DEG)))
    yaw, roll = float(rng.uniform(-np.pi, np.pi)), float(np.radians(rng.normal(0, 3)))
    R = rotation_camera_to_enu(yaw, tilt - np.pi / 2, roll)
    pixel = rng.uniform(0.06, 0.94, 2) * SIDE_PX
    ray = R @ np.array([*(pixel - SIDE_PX / 2) / focal, 1.0])
    draw = rng.random()
    if draw < recipe.empty_share:
        looked_at = np.array([*rng.uniform(-HALF_WORLD_M, HALF_WORLD_M, 2), 0.0])
        if world.clutter and rng.random() < CLUTTER_SHARE:
            looked_at = world.clutter[int(rng.integers(len(world.clutter)))].position_enu_m
        distance = float(np.exp(rng.uniform(*np.log(recipe.empty_distance_m))))
    else:
        decoy = draw < recipe.empty_share + DECOY_SHARE
        chosen = [o for o in world.objects if o.is_target != decoy and o.kind != "car"]
        cars = [o for o in world.objects if o.kind == "car"]
        if cars and not decoy and rng.random() < CAR_SHARE:
            chosen = cars
        thing = chosen[int(rng.integers(len(chosen)))]
        looked_at = thing.position_enu_m
        pixels = float(np.exp(rng.uniform(*np.log(recipe.pixels_on_object))))
        distance = float(np.clip(focal * thing.size_m / pixels, *recipe.distance_m))
    position = looked_at - ray / np.linalg.norm(ray) * distance
    if position[2] < 1.0 or (
        draw < recipe.empty_share and _targets_near(world, looked_at, 0.8 * SIDE_PX / focal * distance)
    ):
        return None
    return None if _inside_something(world, position) else (lens, CameraPose(position, R))


def _patches(
    surface: str, bounds: tuple[float, float, float, float], rng: np.random.Generator
) -> GroundCover:
    """Patches of another surface, some tens of metres large."""
    other = str(rng.choice([name for name in (*LAND, "water") if name != surface]))
    coarse = rng.normal(size=(5, 5)).astype(np.float32)
    height = cv2.resize(coarse, (28, 28), interpolation=cv2.INTER_CUBIC)
    codes = (height > np.quantile(height, rng.uniform(0.5, 0.85))).astype(np.uint8)
    return GroundCover(codes, bounds, (surface, other))


def _targets_near(world: World, centre: F64, radius_m: float) -> bool:
    return any(np.hypot(*(o.position_enu_m - centre)[:2]) < radius_m for o in world.targets)


def _inside_something(world: World, position: F64) -> bool:
    def close(place: F64, radius_m: float, height_m: float) -> bool:
        return position[2] < height_m + 0.5 and bool(np.hypot(*(position - place)[:2]) < radius_m + 0.5)

    return any(close(t.position_enu_m, t.crown_radius_m, t.height_m) for t in world.trees) or any(
        close(b.position_enu_m, max(b.size_m), 1.6 * b.height_m) for b in world.buildings
    )
