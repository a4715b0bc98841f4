"""The designed experiment behind the statistical sensor: known objects, rendered, shown to the real detector.

Worlds hold one kind of ground, one light and objects of held-out looks on a loose grid. Every picture is
aimed at one object at a chosen number of pixels; whatever else is in view is scored as well. An object is
looked at again and again from other places, so that how objects differ can be told from how looks differ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from skysweep.experiments.workers import run_jobs
from skysweep.geometry.camera import CameraPose, Lens, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import DEFAULT_SIZE_M, CameraModel, Light, TargetClass
from skysweep.scenarios.world import HELD_OUT_VARIANTS, TerrainSurface, World, WorldObject, WorldTree
from skysweep.sensing.camera_effects import CameraEffects
from skysweep.sensing.detector import YoloDetector
from skysweep.sensing.occlusion import Occluders, pixels_on_target
from skysweep.sensing.render import make_renderer
from skysweep.types import Detections, Frame

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

CONFIDENCE_FLOOR = 0.1  # detections below are not looked at; missions keep those from 0.25
PICTURES_PER_WORLD = 60
EMPTY_SHARE = 0.2  # of the pictures show no object
PIXELS = (4.0, 220.0)
MIN_HEIGHT_M = 1.2
MAX_HEIGHT_M = 250.0
MAX_TILT_DEG = 25.0
NADIR_SHARE = 0.6
HIT_RADIUS = 0.6  # of the object's pixels, ...
HIT_RADIUS_MIN_PX = 6.0  # ... but at least this
CLASSES: tuple[str, ...] = get_args(TargetClass)

_IOU_MAX = 0.5
_TREE_SHARE = 0.35  # of the worlds on land have bushes and trees between the objects
_FAR_M = 400.0


@dataclass(frozen=True, slots=True)
class Layout:
    """What stands in a world, on a grid so wide that neighbours stay apart in every picture."""

    subjects: tuple[tuple[str, str], ...]  # kind and pose
    surfaces: tuple[str, ...]
    spacing_m: float
    columns: int
    share: float  # of the worlds


LAYOUTS = (
    Layout(
        (
            ("stop sign", "face-up"),
            ("stop sign", "standing"),
            ("person", "lying"),
            ("person", "standing"),
            ("red bucket", "face-up"),
            ("red round sign", "face-up"),
            ("rock", "face-up"),
            ("stump", "face-up"),
            ("clothing", "face-up"),
        ),
        ("grass", "forest floor", "rock", "sand", "snow", "asphalt"),
        8.0,
        11,
        0.7,
    ),
    Layout(
        (
            ("person", "floating"),
            ("buoy", "face-up"),
            ("clothing", "face-up"),
            ("red bucket", "face-up"),
            ("rock", "face-up"),
        ),
        ("water",),
        8.0,
        10,
        0.18,
    ),
    Layout((("boat", "face-up"),), ("water",), 26.0, 6, 0.12),
)
SUBJECTS = tuple(dict.fromkeys(subject for layout in LAYOUTS for subject in layout.subjects))


@dataclass(frozen=True, slots=True)
class Looks:
    """Every object in every picture: N looks, C classes."""

    subject: I64  # (N,) index in SUBJECTS
    instance: I64  # (N,) which object
    pixels: F64  # (N,) on target
    confidences: F64  # (N, C) of the best detection of a class on the object; 0 for none
    offsets_px: F64  # (N, C, 2) of that detection's centre from the object's; NaN for none


@dataclass(frozen=True, slots=True)
class Empties:
    """Pictures without objects and what was detected in them."""

    altitude_agl_m: F64  # (M,)
    picture: I64  # (K,) index of the picture that a detection is in
    class_index: I64  # (K,)
    confidences: F64  # (K,)
    pixels: F64  # (K,) longer side of the box


@dataclass(frozen=True, slots=True)
class WorldJob:
    """Pictures of one world."""

    model_path: str
    camera: CameraModel
    layout: Layout
    index: int
    n_pictures: int
    seed: int


def observe(
    model_path: str,
    camera: CameraModel,
    pictures: int,
    seed: int,
    workers: int | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Looks, Empties]:
    """Render and detect. The same arguments give the same looks, whatever the number of workers.

    ``progress`` is called with pictures done and total. Raises UserError when the model cannot be used.
    """
    YoloDetector(model_path)  # an error here is told once and before anything is rendered
    jobs = plan_jobs(model_path, camera, pictures, seed)
    results: dict[int, tuple[Looks, Empties]] = {}
    done = 0
    for job, result in run_jobs(look_around, jobs, workers):
        results[job.index] = result
        done += job.n_pictures
        progress(done, pictures)
    ordered = [results[job.index] for job in jobs]
    return _join_looks([r[0] for r in ordered]), _join_empties([r[1] for r in ordered])


def plan_jobs(model_path: str, camera: CameraModel, pictures: int, seed: int) -> list[WorldJob]:
    """Worlds in a fixed order, layouts by share, the last world with the rest of the pictures."""
    jobs: list[WorldJob] = []
    counts = [0] * len(LAYOUTS)
    left = pictures
    while left > 0:
        owed = [layout.share * (len(jobs) + 1) - count for layout, count in zip(LAYOUTS, counts, strict=True)]
        chosen = int(np.argmax(owed))
        counts[chosen] += 1
        n = min(left, PICTURES_PER_WORLD)
        jobs.append(WorldJob(model_path, camera, LAYOUTS[chosen], len(jobs), n, seed))
        left -= n
    return jobs


@dataclass(slots=True)
class _Notes:
    """Rows of Looks and Empties while they grow."""

    looks: list[tuple[int, int, float, F64, F64]] = field(default_factory=list)
    altitudes: list[float] = field(default_factory=list)
    strays: list[tuple[int, int, float, float]] = field(default_factory=list)


def look_around(job: WorldJob) -> tuple[Looks, Empties]:
    """All pictures of one world."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng([job.seed, job.index, 53])
    world = _make_world(job.layout, rng)
    occluders = Occluders(world)
    lens, c = job.camera.lens, job.camera
    renderer = make_renderer(world)
    effects = CameraEffects(lens, c.exposure_s, c.noise_std, c.jpeg_quality, int(rng.integers(2**31)))
    detector = YoloDetector(job.model_path, None, confidence_min=CONFIDENCE_FLOOR, iou_max=_IOU_MAX)
    notes = _Notes()
    for number in range(job.n_pictures):
        pose = _empty_view(job.layout, rng) if rng.random() < EMPTY_SHARE else _view(world, lens, rng)
        direction = rng.normal(size=3)
        velocity = direction / np.linalg.norm(direction) * rng.uniform(0, 5)
        image = effects.apply(
            renderer.render(lens, pose, float(rng.uniform(0, 60))),
            number,
            pose,
            velocity,
            rng.normal(0, 0.05, 3),
            float(pose.position_enu_m[2]),
        )
        found = detector.detect(Frame(0.0, image, pose, lens))
        _score(world, occluders, job.index, found, notes)
    renderer.close()
    return _pack(notes)


def _make_world(layout: Layout, rng: np.random.Generator) -> World:
    half = layout.columns * layout.spacing_m / 2
    bounds = (-_FAR_M, -_FAR_M, _FAR_M, _FAR_M)
    n = layout.columns**2
    kinds = rng.permutation(np.arange(n) % len(layout.subjects))
    cells = np.stack(np.meshgrid(np.arange(layout.columns), np.arange(layout.columns)), -1).reshape(-1, 2)
    middles = (cells + 0.5) * layout.spacing_m - half
    jitter = rng.uniform(-0.15, 0.15, (n, 2)) * layout.spacing_m
    objects = []
    for k in range(n):
        kind, pose = layout.subjects[kinds[k]]
        x, y = middles[k] + jitter[k]
        low, high = (0.85, 1.12) if kind == "person" else (0.7, 1.3)
        objects.append(
            WorldObject(
                kind,
                np.array([x, y, 0.0]),
                float(rng.uniform(0, 2 * np.pi)),
                DEFAULT_SIZE_M[kind] * float(rng.uniform(low, high)),
                pose,
                kind in CLASSES,
                HELD_OUT_VARIANTS + int(rng.integers(1000)),
            )
        )
    surface = str(rng.choice(layout.surfaces))
    trees = _trees(layout, half, rng) if surface != "water" and rng.random() < _TREE_SHARE else ()
    light = Light(
        sun_elevation_deg=float(rng.uniform(25, 75)),
        sun_heading_deg=float(rng.uniform(0, 360)),
        visibility_m=3000.0,
    )
    terrain = TerrainSurface(np.zeros((2, 2)), bounds, surface)
    return World(terrain, tuple(objects), trees, (), light, int(rng.integers(2**31)))


def _trees(layout: Layout, half_m: float, rng: np.random.Generator) -> tuple[WorldTree, ...]:
    """On the corners of the grid's cells, and as many again around the grid where nothing else stands."""
    corners = np.stack(np.meshgrid(np.arange(layout.columns), np.arange(layout.columns)), -1).reshape(-1, 2)
    inside = corners[rng.random(len(corners)) < 0.25] * layout.spacing_m - half_m
    around = rng.uniform(-_FAR_M, _FAR_M, (700, 2))
    around = around[np.abs(around).max(axis=1) > half_m + 5.0]
    trees = []
    for x, y in np.vstack([inside, around]):
        kind = str(rng.choice(["broadleaf", "conifer", "bush"]))
        height = float(rng.uniform(0.6, 1.5) if kind == "bush" else rng.uniform(3, 7))
        radius = height * float(rng.uniform(0.2, 0.35))
        trees.append(WorldTree(np.array([x, y, 0.0]), height, radius, kind, int(rng.integers(1000))))
    return tuple(trees)


def _view(world: World, lens: Lens, rng: np.random.Generator) -> CameraPose:
    """From where an object spans a log-uniform number of pixels, anywhere in the picture that it fits."""
    while True:
        thing = world.objects[int(rng.integers(len(world.objects)))]
        wanted = float(np.exp(rng.uniform(*np.log(PIXELS))))
        R = _orientation(rng)
        size_px = np.array([lens.width_px, lens.height_px], dtype=float)
        border = np.minimum(0.5 * wanted, 0.45 * size_px)
        pixel = rng.uniform(border, size_px - border)
        ray = R @ np.array([*(pixel - size_px / 2) / lens.focal_px, 1.0])  # of unit depth
        depth = lens.focal_px * thing.size_m / wanted
        position = thing.position_enu_m - ray * depth
        pose = CameraPose(position, R)
        depth *= (
            float(pixels_on_target(lens, thing, position, depth)) / wanted
        )  # not all show their full size
        position = thing.position_enu_m - ray * depth
        if MIN_HEIGHT_M <= position[2] <= MAX_HEIGHT_M and not _inside_tree(world, position):
            return CameraPose(position, pose.R_camera_to_enu)


def _empty_view(layout: Layout, rng: np.random.Generator) -> CameraPose:
    """Of ground beside the objects, from any height."""
    height = float(np.exp(rng.uniform(*np.log([3.0, 120.0]))))
    away = 0.75 * layout.columns * layout.spacing_m + 2.5 * height
    angle = rng.uniform(0, 2 * np.pi)
    return CameraPose(np.array([away * np.cos(angle), away * np.sin(angle), height]), _orientation(rng))


def _orientation(rng: np.random.Generator) -> F64:
    tilt = 0.0 if rng.random() < NADIR_SHARE else float(np.radians(rng.uniform(0, MAX_TILT_DEG)))
    return rotation_camera_to_enu(
        float(rng.uniform(-np.pi, np.pi)), tilt - np.pi / 2, float(np.radians(rng.normal(0, 3)))
    )


def _inside_tree(world: World, position: F64) -> bool:
    return any(
        position[2] < t.height_m + 0.5
        and np.hypot(*(position - t.position_enu_m)[:2]) < t.crown_radius_m + 0.5
        for t in world.trees
    )


def _score(world: World, occluders: Occluders, world_index: int, found: Detections, notes: _Notes) -> None:
    """Assign detections to the objects in view; in a picture without objects they are strays."""
    lens, pose = found.lens, found.camera
    places = np.array([o.position_enu_m for o in world.objects])
    centres, depths = project(lens, pose, places)
    pixels = np.array(
        [
            pixels_on_target(lens, o, pose.position_enu_m, z) if z > 0.1 else 0.0
            for o, z in zip(world.objects, depths, strict=True)
        ]
    )
    size_px = np.array([lens.width_px, lens.height_px])
    reach = np.maximum(HIT_RADIUS * pixels, HIT_RADIUS_MIN_PX)
    near = (
        (depths > 0.1)
        & (centres > -2 * reach[:, None]).all(1)
        & (centres < size_px + 2 * reach[:, None]).all(1)
    )
    boxes = found.boxes_xyxy_px
    middles = (boxes[:, :2] + boxes[:, 2:]) / 2
    classes = np.array([CLASSES.index(n) if n in CLASSES else -1 for n in found.class_names], dtype=int)
    if not near.any():
        for k in np.flatnonzero(classes >= 0):
            extent = float((boxes[k, 2:] - boxes[k, :2]).max())
            notes.strays.append((len(notes.altitudes), int(classes[k]), float(found.confidences[k]), extent))
        notes.altitudes.append(float(pose.position_enu_m[2]))
        return
    margin = 0.5 * pixels[:, None]
    whole = near & (centres >= margin).all(1) & (centres <= size_px - margin).all(1)
    for i in np.flatnonzero(whole & (pixels >= PIXELS[0]) & (pixels <= PIXELS[1])):
        thing = world.objects[i]
        if occluders.visible_fraction(pose.position_enu_m, thing) < 1.0:
            continue
        confidences, offsets = np.zeros(len(CLASSES)), np.full((len(CLASSES), 2), np.nan)
        gaps = middles - centres[i]
        for k in np.flatnonzero((classes >= 0) & (np.hypot(gaps[:, 0], gaps[:, 1]) <= reach[i])):
            if found.confidences[k] > confidences[classes[k]]:
                confidences[classes[k]] = found.confidences[k]
                offsets[classes[k]] = gaps[k]
        subject = SUBJECTS.index((thing.kind, thing.pose))
        notes.looks.append((subject, 1000 * world_index + int(i), float(pixels[i]), confidences, offsets))


def _pack(notes: _Notes) -> tuple[Looks, Empties]:
    n, c = len(notes.looks), len(CLASSES)
    looks = Looks(
        np.array([row[0] for row in notes.looks], dtype=int),
        np.array([row[1] for row in notes.looks], dtype=int),
        np.array([row[2] for row in notes.looks], dtype=float),
        np.array([row[3] for row in notes.looks], dtype=float).reshape(n, c),
        np.array([row[4] for row in notes.looks], dtype=float).reshape(n, c, 2),
    )
    empties = Empties(
        np.array(notes.altitudes, dtype=float),
        np.array([s[0] for s in notes.strays], dtype=int),
        np.array([s[1] for s in notes.strays], dtype=int),
        np.array([s[2] for s in notes.strays], dtype=float),
        np.array([s[3] for s in notes.strays], dtype=float),
    )
    return looks, empties


def _join_looks(parts: list[Looks]) -> Looks:
    return Looks(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Looks)))


def _join_empties(parts: list[Empties]) -> Empties:
    starts = np.cumsum([0] + [len(p.altitude_agl_m) for p in parts[:-1]])
    return Empties(
        np.concatenate([p.altitude_agl_m for p in parts]),
        np.concatenate([p.picture + s for p, s in zip(parts, starts, strict=True)]).astype(int),
        np.concatenate([p.class_index for p in parts]),
        np.concatenate([p.confidences for p in parts]),
        np.concatenate([p.pixels for p in parts]),
    )
