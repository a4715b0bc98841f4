"""The designed experiment behind the statistical sensor: known objects, rendered, shown to the real detector.

Each world has one kind of ground, one light and objects of held-out looks on a loose grid, many of them
beside trees that hide a part of them. Each pass is aimed at one object at a chosen number of pixels and takes
two looks, the second a chosen step further on. The camera moves so that the picture is blurred by a chosen
length. All other objects in view are scored as well. Some worlds are seen through longer lenses: the
same pixels on target from farther away. Reports on no object are background. They are rare, so the last third
of the pictures shows background alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields, replace
from typing import get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import I64
from skysweep.detection.training.random_worlds import THERMAL, Sky
from skysweep.detection.yolo import YoloDetector
from skysweep.errors import UserError
from skysweep.experiments.workers import run_jobs
from skysweep.geometry.camera import CameraPose, Lens, project, rays_enu
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import (
    DEFAULT_SIZE_M,
    OWN_DETECTORS,
    CameraKind,
    CameraModel,
    Light,
    TargetClass,
)
from skysweep.sensing.cameras.exposing import exposing
from skysweep.sensing.statistical.factors import (
    BLUR_MAX,
    COMPANY_PX,
    CUT_MIN,
    HIDDEN_MAX,
    LENS_OCTAVES,
    VIEW_MAX,
)
from skysweep.types import F64, U8, Detections, Frame
from skysweep.worlds.occlusion import Occluders, middle_enu_m, pixels_on_target, shape_of
from skysweep.worlds.rendering.renderer import Renderer, make_renderer, refuse_unrenderable
from skysweep.worlds.rendering.white_hot import seen
from skysweep.worlds.world import HELD_OUT_VARIANTS, TerrainSurface, World, WorldObject, WorldTree

CONFIDENCE_FLOOR = 0.1  # weaker detections are ignored
PASS_LOOKS = 2  # successive looks from nearly one place
PASSES_PER_WORLD = 20
PICTURES_PER_WORLD = PASS_LOOKS * PASSES_PER_WORLD
EMPTY_SHARE = 0.3  # of the passes show no object
BACKGROUND_SHARE = 1 / 3  # of the pictures, the last ones, come from passes without objects alone
LENS_SHARE = 0.25  # of the worlds with objects, seen through another lens
EDGE_SHARE = 0.4  # of the other passes begin with an object cut by the picture's edge
PIXELS = (4.0, 220.0)
STEP_PX = (0.5, 240.0)  # by which the picture shifts between two looks of a pass
BLUR_PX = (0.05, 6.0)
MIN_HEIGHT_M = 1.2
MAX_HEIGHT_M = 250.0
MAX_HEIGHT_OF_LENSES_M = 120.0  # through others than the calibrated one, as high as they are flown
MAX_TILT_DEG = 35.0
NADIR_SHARE = 0.6
HIT_RADIUS = 0.6  # of the object's pixels
HIT_RADIUS_MIN_PX = 6.0
CLASSES: tuple[str, ...] = get_args(TargetClass)
SURFACES = ("grass", "forest floor", "rock", "sand", "snow", "asphalt", "water")

_IOU_MAX = 0.5
_TREE_SHARE = 0.5  # of the worlds on land have bushes and trees
_BESIDE_SHARE = 0.6  # of the objects in these stand beside one
_TREE_M, _BUSH_M = (3.0, 16.0), (0.6, 1.5)  # heights
_TREES_AROUND = 1900  # 30 a hectare
_COLUMNS_MIN = 4  # of a grid
_TREE_PARTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of its height: a report near one of them is of the tree
_FAR_M = 400.0
_LOOK_PERIOD_S = 0.4
_CONTRAST_MIN_PX = 8.0  # the colour of smaller objects is not measured
_AGAIN_PX = 12.0  # reports this near to the same place on the ground are of the same thing
_CUT_WITHIN_PX = 3.0  # so near to an edge of the picture ends a box that it cuts
_CLEAR_SIZES, _CLEAR_MIN_M = 1.5, 2.0  # background begins this far from every object, beyond its shadow


@dataclass(frozen=True, slots=True)
class WorldLayout:
    """The contents of a world, on a grid so wide that neighbours stay apart in every picture.

    Some worlds have a wide grid, because the detector reports what stands alone in a picture more often.
    """

    subjects: tuple[tuple[str, str], ...]  # kind and pose; a subject listed twice is seen twice as often
    surfaces: tuple[str, ...]
    spacing_m: tuple[float, float]  # of the grid, log-uniform
    grid_m: float  # about how wide it is, but for the fewest columns
    share: float  # of the worlds


_APART_M, _GRID_M = (5.5, 40.0), 88.0
LAYOUTS = (  # look-alikes are listed twice because they are rarely reported
    WorldLayout(
        (
            ("stop sign", "face-up"),
            ("stop sign", "standing"),
            ("person", "lying"),
            ("person", "standing"),
            *2 * (("red bucket", "face-up"), ("red round sign", "face-up"), ("rock", "face-up")),
            ("stump", "face-up"),
            ("clothing", "face-up"),
        ),
        ("grass", "forest floor", "rock", "sand", "snow", "asphalt"),
        _APART_M,
        _GRID_M,
        0.56,
    ),
    WorldLayout(
        (
            ("person", "floating"),
            ("buoy", "face-up"),
            ("clothing", "face-up"),
            *2 * (("red bucket", "face-up"), ("rock", "face-up")),
        ),
        ("water",),
        _APART_M,
        _GRID_M,
        0.14,
    ),
    WorldLayout((("boat", "face-up"),), ("water",), (26.0, 80.0), 156.0, 0.1),
    WorldLayout(
        (
            ("person", "sitting"),
            ("person", "crouching"),
            ("person", "walking"),
            ("person", "waving"),
            ("sheep", "face-up"),
            ("deer", "face-up"),
            ("dog", "face-up"),
        ),
        ("grass", "forest floor", "rock", "sand", "snow", "asphalt"),
        _APART_M,
        _GRID_M,
        0.2,
    ),
)
SUBJECTS = tuple(dict.fromkeys(subject for layout in LAYOUTS for subject in layout.subjects))


@dataclass(frozen=True, slots=True)
class ScoredLooks:
    """Every object in every picture: N looks, C classes. Looks of one pass follow one another."""

    subject: I64  # (N,) index in SUBJECTS
    instance: I64  # (N,) which object
    world: I64  # (N,)
    surface: I64  # (N,) index in SURFACES
    picture: I64  # (N,) number of the picture within its world; a pass is PASS_LOOKS of them
    pixels: F64  # (N,) on target
    sight: F64  # (N, 3) from the object to the camera, in ENU, of length 1
    lens_octaves: F64  # (N,) log2 of the focal length over the calibrated camera's
    view: F64  # (N,) factors as in ``statistical_model.KindModel``
    front: F64  # (N,)
    hidden: F64  # (N,)
    cut: F64  # (N,)
    edge_y: F64  # (N,) 1 where the upper or lower edge cuts it, else 0
    beside: F64  # (N,)
    shade: F64  # (N,)
    blur_px: F64  # (N,)
    others: F64  # (N,) other objects in the picture that span COMPANY_PX
    colour: F64  # (N,) difference to the ground (CIE76), the object's mean; NaN where not measured
    confidences: F64  # (N, C) of the best detection of a class on the object; 0 for none
    offsets_px: F64  # (N, C, 2) of that detection's centre from the object's; NaN for none

    def where(self, chosen: NDArray[np.bool_] | I64) -> ScoredLooks:
        return ScoredLooks(*(getattr(self, f.name)[chosen] for f in fields(ScoredLooks)))


_SHAPES = {"sight": (3,), "confidences": (len(CLASSES),), "offsets_px": (len(CLASSES), 2)}
_LOOK = [  # name, type and shape of each field of one look
    (f.name, int if f.type == "I64" else float, _SHAPES.get(f.name, ())) for f in fields(ScoredLooks)
]


@dataclass(frozen=True, slots=True)
class Background:
    """M pictures and the K reports in them that lie away from every object."""

    altitude_agl_m: F64  # (M,)
    hectares: F64  # (M,) of ground in the picture, away from objects
    world: I64  # (M,)
    surface: I64  # (M,) index into SURFACES
    trees: F64  # (M,) how many trees and bushes have their middle in the picture
    cut_trees: F64  # (M,) how many have a crown that an edge of the picture cuts
    picture_of_report: I64  # (K,) row of the M
    class_index: I64  # (K,)
    confidences: F64  # (K,)
    pixels: F64  # (K,) longer side of the box
    again: F64  # (K,) confidence of a report at the same place in the next look; 0 none, NaN no such look
    of_tree: NDArray[np.bool_]  # (K,) it lies on a tree or bush
    is_cut: NDArray[np.bool_]  # (K,) the box reaches an edge of the picture


@dataclass(frozen=True, slots=True)
class WorldJob:
    """Pictures of one world."""

    model_path: str
    camera: CameraModel
    lens_octaves: float  # of its focal length over the calibrated camera's
    layout: WorldLayout
    empty_share: float
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
    without: Collection[tuple[str, str]] = (),
) -> tuple[ScoredLooks, Background]:
    """Render and detect. The same arguments give the same looks, whatever the number of workers.

    ``without`` are kinds and poses that need no look; where there are any, nor does the background.
    ``progress`` is called with pictures done and total. Raises UserError when the model cannot be used.
    """
    if model_path in OWN_DETECTORS.values() and model_path != OWN_DETECTORS[camera.kind]:
        raise UserError(
            f"--model {model_path}: does not know the pictures of a {camera.kind} camera; write "
            f"{OWN_DETECTORS[camera.kind]} or the path of an ONNX file"
        )
    YoloDetector(model_path)  # raises an error once, before anything is rendered
    refuse_unrenderable(camera)
    looks, backgrounds, done = dict[int, ScoredLooks](), dict[int, Background](), 0
    for job, result in run_jobs(look_around, plan_jobs(model_path, camera, pictures, seed, without), workers):
        looks[job.index], background = result
        if not job.lens_octaves:
            backgrounds[job.index] = background
        done += job.n_pictures
        progress(done, pictures)
    in_order = [looks[index] for index in sorted(looks)]
    return _join_looks(in_order), _join_background([backgrounds[index] for index in sorted(backgrounds)])


def plan_jobs(
    model_path: str, camera: CameraModel, pictures: int, seed: int, without: Collection[tuple[str, str]] = ()
) -> list[WorldJob]:
    """Worlds in a fixed order, with layouts by their share. Those for the background come last."""
    left_over = [tuple(s for s in layout.subjects if s not in without) for layout in LAYOUTS]
    layouts = [replace(layout, subjects=s) for layout, s in zip(LAYOUTS, left_over, strict=True) if s]
    whole = sum(layout.share for layout in layouts)
    jobs: list[WorldJob] = []
    counts = [0] * len(layouts)
    left = pictures
    while left > 0:
        owed = [n.share / whole * (len(jobs) + 1) - count for n, count in zip(layouts, counts, strict=True)]
        chosen = int(np.argmax(owed))
        counts[chosen] += 1
        n = min(left, PICTURES_PER_WORLD)
        empty_share = EMPTY_SHARE if left > BACKGROUND_SHARE * pictures else 1.0
        empty_share = 0.0 if without else empty_share
        octaves = _lens_octaves(len(jobs), seed) if empty_share < 1.0 else 0.0
        empty_share = 0.0 if octaves else empty_share
        through = _with_lens(camera, octaves)
        jobs.append(WorldJob(model_path, through, octaves, layouts[chosen], empty_share, len(jobs), n, seed))
        left -= n
    return jobs


def _lens_octaves(index: int, seed: int) -> float:
    """Of the lens through which a world is seen, 0 for the calibrated one, which the first world has."""
    rng = np.random.default_rng([seed, index, 71])
    return float(rng.uniform(*LENS_OCTAVES)) if index and rng.random() < LENS_SHARE else 0.0


def _with_lens(camera: CameraModel, octaves: float) -> CameraModel:
    """The camera with a focal length so many octaves longer."""
    half = math.atan(math.tan(camera.hfov_rad / 2.0) * 2.0**-octaves)
    return camera.model_copy(update={"hfov_rad": 2.0 * half}) if octaves else camera


def look_around(job: WorldJob) -> tuple[ScoredLooks, Background]:
    """All pictures of one world."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng([job.seed, job.index, 53])
    world = make_world(job.layout, rng, job.camera.kind)
    lens, c = job.camera.lens, job.camera
    renderer = make_renderer(world)
    expose = exposing(c, renderer, int(rng.integers(2**31)))
    detector = YoloDetector(job.model_path, None, confidence_min=CONFIDENCE_FLOOR, iou_max=_IOU_MAX)
    scorer = Scorer(world, lens, c.exposure_s, job.lens_octaves)
    number = 0
    while number < job.n_pictures:
        poses, velocity = _pass(world, job, rng)
        start_s = float(rng.uniform(0, 60))
        for k, pose in enumerate(poses[: job.n_pictures - number]):
            rates = rng.normal(0, 0.05, 3)
            time_s = start_s + k * _LOOK_PERIOD_S
            if k == 0:
                scorer.measure_colours(renderer, seen(c, renderer, lens, pose, time_s), pose)
            image = expose(number, pose, time_s, velocity, rates, float(pose.position_enu_m[2]))
            found = detector.detect(Frame(0.0, image, pose, lens))
            motion = pose.R_camera_to_enu.T @ velocity, pose.R_camera_to_enu.T @ rates
            scorer.score(number, k > 0, found, *motion)
            number += 1
    renderer.close()
    return scorer.packed(job)


def make_world(layout: WorldLayout, rng: np.random.Generator, camera: CameraKind) -> World:
    """A world of a layout, with its ground, its light and perhaps trees."""
    spacing_m = float(np.exp(rng.uniform(*np.log(layout.spacing_m))))
    columns = max(round(layout.grid_m / spacing_m), _COLUMNS_MIN)
    half = columns * spacing_m / 2
    bounds = (-_FAR_M, -_FAR_M, _FAR_M, _FAR_M)
    n = columns**2
    kinds = rng.permutation(np.arange(n) % len(layout.subjects))
    cells = np.stack(np.meshgrid(np.arange(columns), np.arange(columns)), -1).reshape(-1, 2)
    middles = (cells + 0.5) * spacing_m - half
    jitter = rng.uniform(-0.15, 0.15, (n, 2)) * spacing_m
    objects = []
    for k in range(n):
        kind, pose = layout.subjects[kinds[k]]
        x, y = middles[k] + jitter[k]
        low, high = (0.85, 1.12) if kind == "person" else (0.7, 1.3)
        yaw_rad = float(rng.uniform(0, 2 * np.pi))
        size_m = DEFAULT_SIZE_M[kind] * float(rng.uniform(low, high))
        variant = HELD_OUT_VARIANTS + int(rng.integers(1000))
        place = np.array([x, y, 0.0])
        objects.append(WorldObject(kind, place, yaw_rad, size_m, pose, kind in CLASSES, variant))
    surface = str(rng.choice(layout.surfaces))
    has_trees = surface != "water" and rng.random() < _TREE_SHARE
    trees = _trees(objects, half, 1.2 * spacing_m, rng) if has_trees else ()
    sky = _daylight(rng) if camera == "visible" else THERMAL.sky(rng)
    terrain = TerrainSurface(np.zeros((2, 2)), bounds, surface)
    return World(
        terrain,
        tuple(objects),
        trees,
        (),
        sky.light,
        int(rng.integers(2**31)),
        wind_mps=sky.wind_mps,
        latitude_deg=sky.latitude_deg,
    )


def _daylight(rng: np.random.Generator) -> Sky:
    light = Light(
        sun_elevation_deg=float(rng.uniform(25, 75)),
        sun_heading_deg=float(rng.uniform(0, 360)),
        visibility_m=3000.0,
    )
    return Sky(light, 2.0, 60.0)


def _trees(
    objects: list[WorldObject], half_m: float, highest_m: float, rng: np.random.Generator
) -> tuple[WorldTree, ...]:
    """Trees around the objects, and beside many of them some that leave their neighbours in sight."""
    around = rng.uniform(-_FAR_M, _FAR_M, (_TREES_AROUND, 2))
    places: list[tuple[F64, WorldObject | None]]
    places = [(xy, None) for xy in around if np.abs(xy).max() > half_m + 5.0]
    places += [(o.position_enu_m[:2], o) for o in objects if rng.random() < _BESIDE_SHARE]
    trees = []
    for place, beside in places:
        kind = str(rng.choice(["broadleaf", "conifer", "bush"]))
        least, most = _BUSH_M if kind == "bush" else _TREE_M
        height = float(rng.uniform(least, most if beside is None else np.clip(highest_m, 1.5 * least, most)))
        radius = height * float(rng.uniform(0.2, 0.35))
        xy = np.array(place)
        if beside is not None:
            angle = rng.uniform(0, 2 * np.pi)
            away = radius * rng.uniform(0.6, 1.3) + 0.5 * beside.size_m
            xy = xy + away * np.array([np.cos(angle), np.sin(angle)])
        trees.append(WorldTree(np.array([*xy, 0.0]), height, radius, kind, int(rng.integers(1000))))
    return tuple(trees)


def _pass(world: World, job: WorldJob, rng: np.random.Generator) -> tuple[list[CameraPose], F64]:
    """The camera poses of a pass and the velocity that blurs its pictures."""
    lens, exposure_s = job.camera.lens, job.camera.exposure_s
    empty = rng.random() < job.empty_share
    highest_m = MAX_HEIGHT_OF_LENSES_M if job.lens_octaves else MAX_HEIGHT_M
    first, distance = _empty_view(world, rng) if empty else _view(world, lens, highest_m, rng)
    step_px = float(np.exp(rng.uniform(*np.log(STEP_PX))))
    direction = rng.normal(size=3) * [1.0, 1.0, 0.5]
    step = direction / np.linalg.norm(direction) * step_px * distance / lens.focal_px
    poses = [first]
    while len(poses) < PASS_LOOKS:
        position = poses[-1].position_enu_m + step
        position[2] = max(position[2], MIN_HEIGHT_M)
        shaken = rotation_camera_to_enu(float(rng.normal(0, 0.005)), 0.0, float(rng.normal(0, 0.005)))
        level = rotation_camera_to_enu(0.0, 0.0, 0.0)
        poses.append(CameraPose(position, shaken @ level.T @ first.R_camera_to_enu))
    blur_px = float(np.exp(rng.uniform(*np.log(BLUR_PX))))
    across = first.R_camera_to_enu @ np.array([*rng.normal(size=2), 0.0])
    return poses, across / np.linalg.norm(across) * blur_px * distance / (lens.focal_px * exposure_s)


def _view(world: World, lens: Lens, highest_m: float, rng: np.random.Generator) -> tuple[CameraPose, float]:
    """A pose from which an object spans a log-uniform number of pixels, and the object's depth in metres."""
    while True:
        thing = world.objects[int(rng.integers(len(world.objects)))]
        wanted = float(np.exp(rng.uniform(*np.log(PIXELS))))
        R = _orientation(rng)
        size_px = np.array([lens.width_px, lens.height_px], dtype=float)
        border = np.minimum(rng.uniform(0.1, 0.5) * wanted, 0.45 * size_px)
        pixel = rng.uniform(border, size_px - border)
        if rng.random() < EDGE_SHARE:
            axis = int(rng.integers(2))
            within = rng.uniform(0.5 - HIDDEN_MAX, 0.5) * min(wanted, size_px[axis])
            pixel[axis] = rng.choice([within, size_px[axis] - within])
        ray = R @ np.array([*(pixel - size_px / 2) / lens.focal_px, 1.0])  # of unit depth
        depth = lens.focal_px * thing.size_m / wanted
        middle = middle_enu_m(thing)
        east, north, up = ray * depth
        shows_px = pixels_on_target(lens.focal_px, shape_of(thing), thing.size_m, east, north, up, depth)
        depth *= shows_px / wanted  # not all of it shows
        position = middle - ray * depth
        if MIN_HEIGHT_M <= position[2] <= highest_m and not _inside_tree(world, position):
            return CameraPose(position, R), float(depth)


def _empty_view(world: World, rng: np.random.Generator) -> tuple[CameraPose, float]:
    """A view of ground beside the objects, and its height in metres."""
    height = float(np.exp(rng.uniform(*np.log([3.0, 120.0]))))
    away = 1.5 * max(float(np.abs(o.position_enu_m[:2]).max()) for o in world.objects) + 2.5 * height
    while True:
        angle = rng.uniform(0, 2 * np.pi)
        position = np.array([away * np.cos(angle), away * np.sin(angle), height])
        if not _inside_tree(world, position):
            return CameraPose(position, _orientation(rng)), height


def _orientation(rng: np.random.Generator) -> F64:
    tilt = 0.0 if rng.random() < NADIR_SHARE else float(np.radians(rng.uniform(0, MAX_TILT_DEG)))
    return rotation_camera_to_enu(
        float(rng.uniform(-np.pi, np.pi)), tilt - np.pi / 2, float(np.radians(rng.normal(0, 3)))
    )


def _inside_tree(world: World, position: F64) -> bool:
    x, y, z = position
    return any(
        z < t.height_m + 0.5
        and math.hypot(x - t.position_enu_m[0], y - t.position_enu_m[1]) < t.crown_radius_m + 0.5
        for t in world.trees
    )


class Scorer:
    """Assigns reports to the objects in view of one world. Reports on no object are background."""

    def __init__(self, world: World, lens: Lens, exposure_s: float, lens_octaves: float) -> None:
        self._world, self._lens, self._exposure_s = world, lens, exposure_s
        self._lens_octaves = lens_octaves
        self._occluders = Occluders(world)
        around = [self._occluders.around(middle_enu_m(o), o.size_m) for o in world.objects]
        self._beside, self._shades = zip(*around, strict=True)
        self._places = np.array([middle_enu_m(o) for o in world.objects])
        self._feet = np.array([o.position_enu_m for o in world.objects])
        self._sizes_m = np.array([o.size_m for o in world.objects])
        self._clear_m = np.maximum(_CLEAR_SIZES * self._sizes_m, _CLEAR_MIN_M)
        self._size_px = np.array([lens.width_px, lens.height_px], dtype=float)
        self._surface = SURFACES.index(world.terrain.surface)
        self._looks: list[tuple[object, ...]] = []
        self._colours: dict[int, list[float]] = {}  # object -> differences to the ground
        self._crowns = Crowns(world, lens)
        self._pictures: list[tuple[float, float, int, int]] = []  # altitude in m, hectares, trees, cut trees
        # class, picture, confidence, pixels, confidence in the next look, 1 on a tree, 1 cut by an edge
        self._strays: list[list[float]] = []
        self._last: list[list[float]] = []  # strays of the last picture: index, ground x, y

    def measure_colours(self, renderer: Renderer, clean: U8, pose: CameraPose) -> None:
        """The differences in colour between the objects and the ground around them."""
        ids = renderer.render_ids(self._lens, pose)
        lab = cv2.cvtColor(clean.astype(np.float32) / 255.0, cv2.COLOR_RGB2LAB)
        centres, depths = project(self._lens, pose, self._places)
        for i in (np.unique(ids[ids > 0]) - 1).tolist():
            if depths[i] <= 0.1:
                continue
            pixels = self._pixels(i, pose, depths[i])
            if not _CONTRAST_MIN_PX <= pixels <= PIXELS[1]:
                continue
            low = np.maximum(centres[i] - 0.8 * pixels - 2, 0).astype(int)
            high = np.minimum(centres[i] + 0.8 * pixels + 3, self._size_px).astype(int)
            window = np.s_[max(low[1], 0) : max(high[1], 0), max(low[0], 0) : max(high[0], 0)]
            own, ground = ids[window] == i + 1, ids[window] == 0
            if own.sum() >= 12 and ground.sum() >= 12:
                gap = lab[window][own].mean(axis=0) - lab[window][ground].mean(axis=0)
                self._colours.setdefault(i, []).append(float(np.linalg.norm(gap)))

    def _pixels(self, i: int, pose: CameraPose, depth_m: float) -> float:
        thing, focal_px = self._world.objects[i], self._lens.focal_px
        east, north, up = self._places[i] - pose.position_enu_m
        return float(pixels_on_target(focal_px, shape_of(thing), thing.size_m, east, north, up, depth_m))

    def score(self, number: int, follows: bool, found: Detections, velocity: F64, rates: F64) -> None:
        """One picture, which may follow another of the same pass. Motion is in the camera's axes."""
        lens, pose = self._lens, found.camera
        centres, depths = project(lens, pose, self._places)
        before = depths > 0.1
        pixels = np.zeros(len(depths))
        for i in np.flatnonzero(before).tolist():
            pixels[i] = self._pixels(i, pose, depths[i])
        low = np.clip(centres - pixels[:, None] / 2, 0, self._size_px)
        high = np.clip(centres + pixels[:, None] / 2, 0, self._size_px)
        inside = np.minimum((high - low) / np.maximum(pixels, 1e-9)[:, None], 1.0)
        seen_middles = (low + high) / 2
        reach = np.maximum(HIT_RADIUS * pixels, HIT_RADIUS_MIN_PX)
        boxes = found.boxes_xyxy_px
        middles = (boxes[:, :2] + boxes[:, 2:]) / 2
        classes = np.array([CLASSES.index(n) if n in CLASSES else -1 for n in found.class_names], dtype=int)
        gaps = np.linalg.norm(middles[:, None] - seen_middles[None], axis=2)
        near = before & (inside > 0).all(axis=1)
        is_company = before & ((centres >= 0) & (centres <= self._size_px)).all(axis=1)
        is_company &= lens.focal_px * self._sizes_m >= COMPANY_PX * depths
        others = float(is_company.sum())
        clear = np.maximum(self._clear_m * lens.focal_px / np.maximum(depths, 0.1), reach)
        feet, _ = project(lens, pose, self._feet)
        gaps_to_feet = np.linalg.norm(middles[:, None] - feet[None], axis=2)
        beside_object = ((np.minimum(gaps, gaps_to_feet) <= clear) & before).any(axis=1)
        covered = float((np.pi * self._clear_m**2)[near].sum())
        self._note_strays(found, classes, middles, ~beside_object & (classes >= 0), follows, covered)
        for i in np.flatnonzero(near & (pixels >= PIXELS[0]) & (pixels <= PIXELS[1])).tolist():
            thing = self._world.objects[i]
            hidden = 1.0 - float(self._occluders.visible_fraction(pose.position_enu_m, thing))
            cut = 1.0 - float(inside[i].prod())
            x, y, z = pose.position_enu_m - self._places[i]
            away = math.sqrt(x * x + y * y + z * z)
            sight, view = np.array([x, y, z]) / away, (x * x + y * y) / away**2
            front = (math.cos(thing.yaw_rad) * x + math.sin(thing.yaw_rad) * y) / away
            shift = np.array([-velocity[0] / depths[i] - rates[1], -velocity[1] / depths[i] + rates[0]])
            blur_px = float(lens.focal_px * self._exposure_s * np.linalg.norm(shift))
            unseen = 1.0 - (1.0 - hidden) * (1.0 - cut)
            if unseen > HIDDEN_MAX or view > VIEW_MAX or blur_px > BLUR_MAX * pixels[i]:
                continue
            confidences, offsets = np.zeros(len(CLASSES)), np.full((len(CLASSES), 2), np.nan)
            for k in np.flatnonzero((classes >= 0) & (gaps[:, i] <= reach[i])):
                if found.confidences[k] > confidences[classes[k]]:
                    confidences[classes[k]] = found.confidences[k]
                    offsets[classes[k]] = middles[k] - seen_middles[i]
            subject, edge_y = SUBJECTS.index((thing.kind, thing.pose)), inside[i, 1] < 1.0 - CUT_MIN
            self._looks.append(  # the world and the colour are known at the end
                (
                    *(subject, i, -1, self._surface, number, pixels[i], sight, self._lens_octaves, view),
                    *(
                        front,
                        hidden,
                        cut,
                        edge_y,
                        self._beside[i],
                        self._shades[i],
                        blur_px,
                        others - is_company[i],
                        np.nan,
                    ),
                    *(confidences, offsets),
                )
            )

    def _note_strays(
        self,
        found: Detections,
        classes: I64,
        middles: F64,
        stray: NDArray[np.bool_],
        follows: bool,
        covered_m2: float,
    ) -> None:
        pose, size = found.camera, self._size_px
        height = float(pose.position_enu_m[2])
        corners = _on_ground(self._lens, pose, np.array([[0, 0], [size[0], 0], [*size], [0, size[1]]]))
        x, y = corners.T
        area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
        on_tree = self._crowns.lie_on(pose, middles)
        hectares = max(area - covered_m2, 0.05 * area) / 1e4
        self._pictures.append((height, hectares, *self._crowns.in_picture(pose)))
        if follows:
            for index, gx, gy in self._last:
                stray_row = self._strays[int(index)]
                place, depth = project(self._lens, pose, [[gx, gy, 0.0]])
                if depth[0] > 0.1 and ((place[0] >= 0) & (place[0] <= size)).all():
                    gap = np.linalg.norm(middles - place[0], axis=1)
                    same = (gap <= _AGAIN_PX) & (classes == stray_row[0])
                    stray_row[4] = float(found.confidences[same].max()) if same.any() else 0.0
        self._last = []
        row = len(self._pictures) - 1
        for k in np.flatnonzero(stray):
            low, high = found.boxes_xyxy_px[k, :2], found.boxes_xyxy_px[k, 2:]
            extent, is_cut = float((high - low).max()), np.minimum(low, size - high).min() < _CUT_WITHIN_PX
            ground = _on_ground(self._lens, pose, middles[k : k + 1])[0]
            self._last.append([len(self._strays), *ground])
            reported = float(classes[k]), row, float(found.confidences[k])
            self._strays.append([*reported, extent, np.nan, float(on_tree[k]), float(is_cut)])

    def packed(self, job: WorldJob) -> tuple[ScoredLooks, Background]:
        looks = np.array(self._looks, dtype=_LOOK)
        looks["colour"] = [np.mean(self._colours.get(i, [np.nan])) for i in looks["instance"].tolist()]
        looks["instance"] += 1000 * job.index
        looks["world"] = job.index
        altitude_agl_m, hectares, trees, cut = np.array(self._pictures, dtype=float).reshape(-1, 4).T
        class_index, picture, *reports = np.array(self._strays, dtype=float).reshape(-1, 7).T
        confidences, pixels, again, on_tree, is_cut = reports
        m = len(hectares)
        return ScoredLooks(*(looks[f.name].copy() for f in fields(ScoredLooks))), Background(
            altitude_agl_m,
            hectares,
            np.full(m, job.index),
            np.full(m, self._surface),
            trees,
            cut,
            picture.astype(int),
            class_index.astype(int),
            confidences,
            pixels,
            again,
            on_tree > 0.0,
            is_cut > 0.0,
        )


class Crowns:
    """The trees and bushes of a world, and where a picture shows them."""

    def __init__(self, world: World, lens: Lens) -> None:
        self._lens, self._size_px = lens, np.array([lens.width_px, lens.height_px], dtype=float)
        trees = world.trees
        feet = np.array([t.position_enu_m for t in trees], dtype=float).reshape(-1, 3)
        self._radii_m = np.array([t.crown_radius_m for t in trees], dtype=float)
        heights_m = np.array([t.height_m for t in trees], dtype=float)
        self._parts = [feet + [0.0, 0.0, 1.0] * (share * heights_m)[:, None] for share in _TREE_PARTS]

    def in_picture(self, pose: CameraPose) -> tuple[int, int]:
        """How many have their middle in the picture, and of how many an edge of it cuts the crown."""
        pixels, reach = self._seen(pose, self._parts[len(self._parts) // 2])
        inside = np.minimum(pixels, self._size_px - pixels).min(axis=1, initial=np.inf)
        return int((inside >= 0.0).sum()), int((np.abs(inside) < reach).sum())

    def lie_on(self, pose: CameraPose, places_px: F64) -> NDArray[np.bool_]:
        """Which places (N, 2) in the picture lie on one."""
        is_on = np.zeros(len(places_px), dtype=np.bool_)
        for part in self._parts:
            pixels, reach = self._seen(pose, part)
            gaps = np.linalg.norm(places_px[:, None] - pixels[None], axis=2)
            is_on |= (gaps <= reach).any(axis=1)
        return is_on

    def _seen(self, pose: CameraPose, part: F64) -> tuple[F64, F64]:
        """Where (N, 2) the picture shows a part of those before the camera, and their radii (N,) there."""
        pixels, depths = project(self._lens, pose, part)
        ahead = depths > 0.1
        return pixels[ahead], self._lens.focal_px * self._radii_m[ahead] / depths[ahead]


def _on_ground(lens: Lens, pose: CameraPose, pixels: F64) -> F64:
    """East and north (N, 2) of level ground at pixels. Flat rays are taken to fall a little."""
    rays = rays_enu(lens, pose, pixels)
    fall = np.maximum(-rays[:, 2], 0.2)
    return np.asarray(pose.position_enu_m[:2] + rays[:, :2] * (pose.position_enu_m[2] / fall)[:, None])


def _join_looks(parts: Sequence[ScoredLooks]) -> ScoredLooks:
    return ScoredLooks(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(ScoredLooks)))


def _join_background(parts: Sequence[Background]) -> Background:
    joined = Background(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Background)))
    before = np.cumsum([0] + [len(p.world) for p in parts[:-1]])
    return replace(
        joined,
        picture_of_report=joined.picture_of_report + np.repeat(before, [len(p.class_index) for p in parts]),
    )
