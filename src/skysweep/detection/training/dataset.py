"""Data sets of rendered pictures: random worlds, random views, labels from what each pixel shows.

Targets span 8 pixels to half the picture (log-uniform), on every surface and in every pose, in all light,
among trees, buildings and look-alikes; some pictures hold nothing to find. Training worlds use asset variants
below ``HELD_OUT_VARIANTS``, held-out worlds those from there on, as missions do, and other ground textures.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np

from skysweep.arrays import F64, I32, U8
from skysweep.detection.training.labelled import LabelledImage, write_labels
from skysweep.errors import UserError
from skysweep.files.writing import whole_files
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import DEFAULT_POSE, DEFAULT_SIZE_M, Light, TargetClass
from skysweep.worlds.rendering.renderer import make_renderer
from skysweep.worlds.scene import GROUND_LOOKS
from skysweep.worlds.world import (
    HELD_OUT_VARIANTS,
    TerrainSurface,
    World,
    WorldBuilding,
    WorldObject,
    WorldTree,
)

Split = Literal["train", "held-out"]

SIDE_PX = 320
PICTURES_PER_WORLD = 40
HALF_WORLD_M = 70.0
N_OBJECTS = 90
EMPTY_SHARE = 0.12
DECOY_SHARE = 0.35  # of pictures are taken of a look-alike
PIXELS_ON_OBJECT = (8.0, 160.0)
FOCAL_PX = (200.0, 900.0)
DISTANCE_M = (1.5, 120.0)
NADIR_SHARE = 0.6
MAX_TILT_DEG = 55.0
VISIBLE_MIN = 0.35
MIN_BOX_PX = 5.0
SEPARATION_M = 3.0
ID_MARGIN_PX = 96  # seen beyond the picture's edges, to know how much of an object they cut off

N_TRAINING_LOOKS = GROUND_LOOKS * 3 // 4  # of the ground; the others are held out

LAND = ("grass", "forest floor", "rock", "sand", "snow", "asphalt")
ON_LAND = {
    "stop sign": 0.32, "person": 0.2, "boat": 0.03, "red bucket": 0.08, "red round sign": 0.2, "rock": 0.05,
    "stump": 0.04, "clothing": 0.08,
}  # fmt: skip
ON_WATER = {"person": 0.32, "boat": 0.34, "buoy": 0.18, "clothing": 0.09, "red bucket": 0.07}
LAND_POSES = ("lying", "standing")


def render_dataset(
    out: Path,
    n_images: int,
    *,
    seed: int = 0,
    split: Split = "train",
    workers: int | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Path:
    """Render labelled pictures of random worlds, as a COCO and YOLO data set.

    Writes ``images/``, ``labels/``, ``data.yaml`` and ``annotations.json`` (with each picture's altitude and
    the boxes of look-alikes). A label is the box of an object's visible pixels; objects of which less than
    35 % is visible have none. The same arguments give the same data set, whatever the number of workers.

    Args:
        out: a folder that does not exist yet, or is empty.
        n_images: how many pictures.
        seed: seeds worlds and views.
        split: "train" or "held-out" assets.
        workers: processes; default: one per CPU.
        progress: called with the number of pictures done.

    Raises:
        UserError: ``out`` is not empty or cannot be written to.
    """
    if n_images < 1:
        raise UserError(f"n_images: {n_images} is too few; write at least 1")
    if out.is_dir() and any(out.iterdir()):
        raise UserError(f"{out}: not empty; write the path of a new folder")
    starts = range(0, n_images, PICTURES_PER_WORLD)
    images: dict[int, list[LabelledImage]] = {}
    n_workers = min(workers or os.cpu_count() or 1, len(starts))
    spawn = get_context("spawn")
    with whole_files(out) as unfinished, ProcessPoolExecutor(n_workers, mp_context=spawn) as pool:
        (unfinished / "images").mkdir()
        futures = {
            pool.submit(
                _render_world, unfinished, k, min(PICTURES_PER_WORLD, n_images - start), seed, split
            ): k
            for k, start in enumerate(starts)
        }
        for future in as_completed(futures):
            images[futures[future]] = future.result()
            progress(sum(map(len, images.values())))
        in_order = [image for index in sorted(images) for image in images[index]]
        info = {"description": "rendered by skysweep dataset", "split": split, "seed": seed}
        write_labels(unfinished, get_args(TargetClass), in_order, (SIDE_PX, SIDE_PX), info)
    return out


def _render_world(out: Path, index: int, n_pictures: int, seed: int, split: Split) -> list[LabelledImage]:
    cv2.setNumThreads(1)
    rng = np.random.default_rng([seed, index, 29 if split == "train" else 31])
    world = random_world(rng, split)
    renderer = make_renderer(world)
    images: list[LabelledImage] = []
    while len(images) < n_pictures:
        view = random_view(world, rng)
        if view is None:
            continue
        lens, pose = view
        number = index * PICTURES_PER_WORLD + len(images)
        picture = develop(renderer.render(lens, pose, float(rng.uniform(0, 60))), rng)
        path = out / "images" / f"{number:06d}.jpg"
        quality = int(rng.integers(60, 98))
        _, jpeg = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
        path.write_bytes(jpeg.tobytes())
        side_px = SIDE_PX + 2 * ID_MARGIN_PX
        wide = Lens(side_px, side_px, 2 * np.arctan(side_px / 2 / lens.focal_px))
        seen, whole = renderer.render_ids(wide, pose), renderer.render_ids(wide, pose, occluders=False)
        height_m = float(pose.position_enu_m[2])
        labelled = _label(path, world, seen, whole)
        ground_m2 = round(lens.seen_ground_m2(pose, height_m), 2)
        images.append(replace(labelled, altitude_agl_m=round(height_m, 2), ground_m2=ground_m2))
    return images


def _label(
    path: Path,
    world: World,
    seen: I32,
    whole: I32,
) -> LabelledImage:
    """Labels from object ids (H, W), as seen and without occluders, both with the margin around."""
    picture = seen[ID_MARGIN_PX:-ID_MARGIN_PX, ID_MARGIN_PX:-ID_MARGIN_PX]
    n_ids = len(world.objects) + 1
    n_seen = np.bincount(picture.ravel(), minlength=n_ids)
    n_whole = np.bincount(whole.ravel(), minlength=n_ids)
    targets: list[tuple[F64, str]] = []
    decoys: list[tuple[F64, str]] = []
    for index in np.flatnonzero(n_seen[1:]):
        thing = world.objects[index]
        ys, xs = np.nonzero(picture == index + 1)
        box = np.array([xs.min(), ys.min(), xs.max() + 1, ys.max() + 1], dtype=float)
        if n_seen[index + 1] < VISIBLE_MIN * n_whole[index + 1] or (box[2:] - box[:2]).max() < MIN_BOX_PX:
            continue
        (targets if thing.is_target else decoys).append((box / SIDE_PX, thing.kind))
    return LabelledImage(
        path,
        np.array([b for b, _ in targets]).reshape(-1, 4),
        tuple(k for _, k in targets),
        np.zeros((0, 4)),
        np.array([b for b, _ in decoys]).reshape(-1, 4),
        tuple(k for _, k in decoys),
    )


def random_world(rng: np.random.Generator, split: Split) -> World:
    """A square patch of flat land or water with objects, trees and buildings of one split's looks."""
    water = rng.random() < 0.3
    surface = "water" if water else str(rng.choice(LAND))
    bounds = (-HALF_WORLD_M, -HALF_WORLD_M, HALF_WORLD_M, HALF_WORLD_M)
    terrain = TerrainSurface(np.zeros((2, 2)), bounds, surface)
    first = 0 if split == "train" else HELD_OUT_VARIANTS

    def somewhere() -> F64:
        return np.array([*rng.uniform(-HALF_WORLD_M, HALF_WORLD_M, 2), 0.0])

    def variant() -> int:
        return first + int(rng.integers(HELD_OUT_VARIANTS))

    shares = ON_WATER if water else ON_LAND
    objects: list[WorldObject] = []
    for kind in rng.choice(list(shares), N_OBJECTS, p=list(shares.values())):
        thing = _random_object(str(kind), somewhere(), water, variant(), rng)
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
    light = Light(
        sun_elevation_deg=float(rng.uniform(12, 85)),
        sun_heading_deg=float(rng.uniform(0, 360)),
        visibility_m=float(np.exp(rng.uniform(np.log(600), np.log(6000)))),
    )
    looks = range(N_TRAINING_LOOKS) if split == "train" else range(N_TRAINING_LOOKS, GROUND_LOOKS)
    seed = GROUND_LOOKS * int(rng.integers(2**20)) + int(rng.choice(looks))
    return World(terrain, tuple(objects), tuple(trees), tuple(buildings), light, seed)


def _random_object(
    kind: str, position: F64, water: bool, variant: int, rng: np.random.Generator
) -> WorldObject:
    size_m = DEFAULT_SIZE_M[kind] * float(rng.uniform(*((0.85, 1.12) if kind == "person" else (0.7, 1.3))))
    pose = DEFAULT_POSE.get(kind, "face-up")
    if kind == "person":
        pose = "floating" if water else str(rng.choice(LAND_POSES, p=[0.6, 0.4]))
    elif kind == "stop sign" and rng.random() < 0.15:
        pose = "standing"
    yaw, is_target = float(rng.uniform(0, 2 * np.pi)), kind in get_args(TargetClass)
    return WorldObject(kind, position, yaw, size_m, pose, is_target, variant)


def random_view(world: World, rng: np.random.Generator) -> tuple[Lens, CameraPose] | None:
    """A lens and pose that show a chosen thing, or nothing in particular; None if the view is unsuitable.

    The thing spans a log-uniform number of pixels and lies anywhere in the picture.
    """
    focal = float(np.exp(rng.uniform(*np.log(FOCAL_PX))))
    lens = Lens(SIDE_PX, SIDE_PX, float(2 * np.arctan(SIDE_PX / (2 * focal))))
    tilt = 0.0 if rng.random() < NADIR_SHARE else float(rng.uniform(0, np.radians(MAX_TILT_DEG)))
    yaw, roll = float(rng.uniform(-np.pi, np.pi)), float(np.radians(rng.normal(0, 3)))
    R = rotation_camera_to_enu(yaw, tilt - np.pi / 2, roll)
    pixel = rng.uniform(0.06, 0.94, 2) * SIDE_PX
    ray = R @ np.array([*(pixel - SIDE_PX / 2) / focal, 1.0])
    draw = rng.random()
    if draw < EMPTY_SHARE:
        looked_at = np.array([*rng.uniform(-HALF_WORLD_M, HALF_WORLD_M, 2), 0.0])
        distance = float(np.exp(rng.uniform(*np.log([4.0, 60.0]))))
    else:
        decoy = draw < EMPTY_SHARE + DECOY_SHARE
        chosen = [o for o in world.objects if o.is_target != decoy]
        thing = chosen[int(rng.integers(len(chosen)))]
        looked_at = thing.position_enu_m
        pixels = float(np.exp(rng.uniform(*np.log(PIXELS_ON_OBJECT))))
        distance = float(np.clip(focal * thing.size_m / pixels, *DISTANCE_M))
    position = looked_at - ray / np.linalg.norm(ray) * distance
    if position[2] < 1.0 or (
        draw < EMPTY_SHARE and _targets_near(world, looked_at, 0.8 * SIDE_PX / focal * distance)
    ):
        return None
    return None if _inside_something(world, position) else (lens, CameraPose(position, R))


def _targets_near(world: World, centre: F64, radius_m: float) -> bool:
    return any(np.hypot(*(o.position_enu_m - centre)[:2]) < radius_m for o in world.targets)


def _inside_something(world: World, position: F64) -> bool:
    def close(place: F64, radius_m: float, height_m: float) -> bool:
        return position[2] < height_m + 0.5 and bool(np.hypot(*(position - place)[:2]) < radius_m + 0.5)

    return any(close(t.position_enu_m, t.crown_radius_m, t.height_m) for t in world.trees) or any(
        close(b.position_enu_m, max(b.size_m), 1.6 * b.height_m) for b in world.buildings
    )


def develop(picture: U8, rng: np.random.Generator) -> U8:
    """Add motion blur, defocus, exposure and noise, drawn more widely than those of any single camera."""
    p = picture.astype(np.float32)
    if rng.random() < 0.4:
        length, angle = rng.uniform(0.5, 4.0), rng.uniform(0, np.pi)
        steps = np.linspace(-length / 2, length / 2, 9)
        kernel = np.zeros((7, 7), dtype=np.float32)
        for x, y in zip(3 + steps * np.cos(angle), 3 + steps * np.sin(angle), strict=True):
            x0, y0 = int(np.floor(x)), int(np.floor(y))
            wx, wy = x - x0, y - y0
            kernel[y0 : y0 + 2, x0 : x0 + 2] += np.outer([1 - wy, wy], [1 - wx, wx])
        p = np.asarray(
            cv2.filter2D(p, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE), np.float32
        )
    if rng.random() < 0.3:
        p = np.asarray(cv2.GaussianBlur(p, (0, 0), float(rng.uniform(0.3, 0.9))), np.float32)
    p *= np.float32(np.exp(rng.normal(0, 0.15)))
    p += rng.standard_normal(p.shape, dtype=np.float32) * np.float32(abs(rng.normal(0, 3)))
    return np.clip(np.rint(p), 0, 255).astype(np.uint8)
