"""Rendered targets in a photo: where they would stand, how large, and how the photo would show them.

The ground of a photo is taken for level. A camera that looks along the cut-out renders the targets, at the
height and pitch at which the photo was taken; what is not known of that is drawn. The photo then takes their
shadow, and they take its darkest and lightest tones, its saturation, its blur and its noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from skysweep.arrays import F32, F64, U8
from skysweep.detection.photos.taken import Taken
from skysweep.detection.training.labelled import LabelledImage
from skysweep.detection.training.random_worlds import (
    DECOY_SHARE,
    NADIR_SHARE,
    SEPARATION_M,
    SIDE_PX,
    VISIBLE,
    Split,
    random_object,
)
from skysweep.detection.training.rendered_pictures import ID_MARGIN_PX, labels_of
from skysweep.geometry.camera import FLATTEST_RAD, CameraPose, Lens, rays_enu
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import DEFAULT_SIZE_M, Light, TargetClass
from skysweep.worlds.meshes import tilt_rotation
from skysweep.worlds.rendering.renderer import Renderer, make_renderer
from skysweep.worlds.world import HELD_OUT_VARIANTS, TerrainSurface, World, WorldObject

DRAWN_HEIGHT_M = (12.0, 100.0)
DRAWN_HFOV_DEG = (55.0, 84.0)
DRAWN_PITCH_DEG = (-90.0, -40.0)
LEAST_HEIGHT_M = 2.0  # a picture from below was not taken in flight
WATER_SHARE = 0.3
MOST_THINGS = 3
REACH_M = 25.0  # ground around the first thing that holds the others
FINER = 2  # rendered pixels a side for one of the picture
RENDERED_SATURATION = 75.0  # of usual renders: the mean of HSV's, 0..255
SLOPE_BLUR = 0.77  # pixels, by which the difference of a pixel's neighbours blurs an edge itself
MOST_BLUR_PX = 3.0
GREY_SATURATION = 4.0  # below, as in a thermal picture, there are no colours
LEAST_SHADOW_BLUR_PX = 0.6
SHARPEST_PX = 0.45  # blur of a rendered edge
_TRIES = 30


@dataclass(frozen=True, slots=True)
class Cutting:
    """A square of a photo that becomes a picture of ``SIDE_PX``."""

    corner_px: F64  # (2,) left and top in the photo
    scale: float  # pixels of the photo for one of the picture, from 1 on

    @classmethod
    def with_at(cls, point_px: F64, at_px: F64, scale: float, size_px: tuple[int, int]) -> Cutting:
        """A cut-out of a photo of ``size_px`` with one of its points at a place, as far as its edges let."""
        most = np.array(size_px) - scale * SIDE_PX
        return cls(np.clip(point_px - scale * at_px, 0.0, np.maximum(most, 0.0)), scale)

    def of(self, photo: U8) -> U8:
        """The picture (SIDE_PX, SIDE_PX, 3)."""
        left, top = np.rint(self.corner_px).astype(int)
        side = round(self.scale * SIDE_PX)
        part = photo[top : top + side, left : left + side]
        return np.asarray(cv2.resize(part, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA), np.uint8)

    def boxes_px(self, boxes_px: F64) -> F64:
        """Boxes (N, 4) of the photo in the picture."""
        return (boxes_px - np.tile(self.corner_px, 2)) / self.scale

    @property
    def middle_px(self) -> F64:
        return self.corner_px + self.scale * SIDE_PX / 2


@dataclass(frozen=True, slots=True)
class View:
    """A cut-out that shows ground on which a thing can be, and the camera that sees it so."""

    cutting: Cutting
    lens: Lens
    pose: CameraPose  # in ENU about the thing, on level ground
    thing: str
    water: bool


def cutting_onto(size_px: tuple[int, int], taken: Taken, rng: np.random.Generator) -> View | None:
    """A cut-out around the place of a drawn thing; None where the photo shows no ground near enough.

    The thing spans a log-uniform number of pixels. Height, pitch and lens that ``taken`` does not tell are
    drawn.
    """
    if (taken.over_ground_m or 0.0) < LEAST_HEIGHT_M:
        taken = replace(taken, altitude_agl_m=None, height_m=None)
    water = bool(rng.random() < WATER_SHARE)
    thing = _kind(water, rng)
    for _ in range(_TRIES):
        camera, lens = _camera(taken.filled_from(_drawn(rng)), size_px)
        pixel = rng.uniform(0.05, 0.95, 2) * size_px
        ray = rays_enu(lens, camera, pixel)[0]
        if -ray[2] < math.sin(FLATTEST_RAD):
            continue
        distance_m = float(camera.position_enu_m[2]) / -ray[2]
        extent_px = lens.focal_px * DEFAULT_SIZE_M[thing] / distance_m
        low = max(1.0, extent_px / VISIBLE.pixels_on_object[1])
        high = min(min(size_px) / SIDE_PX, extent_px / VISIBLE.pixels_on_object[0])
        if low > high:
            continue
        scale = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        cutting = Cutting.with_at(pixel, rng.uniform(0.1, 0.9, 2) * SIDE_PX, scale, size_px)
        return _view(cutting, lens, camera, camera.position_enu_m + distance_m * ray, thing, water)
    return None


def _camera(taken: Taken, size_px: tuple[int, int]) -> tuple[CameraPose, Lens]:
    """A camera above the origin, looking north."""
    height_m = taken.over_ground_m
    assert height_m is not None
    assert taken.pitch_deg is not None
    assert taken.hfov_rad is not None
    R = rotation_camera_to_enu(
        math.pi / 2, math.radians(taken.pitch_deg), math.radians(taken.roll_deg or 0.0)
    )
    return CameraPose(np.array([0.0, 0.0, height_m]), R), Lens(*size_px, taken.hfov_rad)


def _drawn(rng: np.random.Generator) -> Taken:
    straight_down = rng.random() < NADIR_SHARE
    return Taken(
        height_m=float(np.exp(rng.uniform(*np.log(DRAWN_HEIGHT_M)))),
        pitch_deg=-90.0 if straight_down else float(rng.uniform(*DRAWN_PITCH_DEG)),
        roll_deg=0.0,
        hfov_rad=math.radians(float(rng.uniform(*DRAWN_HFOV_DEG))),
    )


def _kind(water: bool, rng: np.random.Generator) -> str:
    shares = VISIBLE.on_water if water else VISIBLE.on_land
    wanted = rng.random() >= DECOY_SHARE
    kinds = [kind for kind in shares if (kind in get_args(TargetClass)) == wanted]
    weights = np.array([shares[kind] for kind in kinds])
    return kinds[int(rng.choice(len(kinds), p=weights / weights.sum()))]


def _view(cutting: Cutting, lens: Lens, camera: CameraPose, place: F64, thing: str, water: bool) -> View:
    """The camera turned to the middle of the cut-out, which a part of a picture cannot be told from."""
    x, y = (cutting.middle_px - [lens.width_px / 2, lens.height_px / 2]) / lens.focal_px
    ahead = np.array([x, y, 1.0]) / math.sqrt(x * x + y * y + 1.0)
    focal_px = lens.focal_px / ahead[2] / cutting.scale
    pose = CameraPose(camera.position_enu_m - place, camera.R_camera_to_enu @ tilt_rotation(ahead))
    return View(cutting, _square(SIDE_PX, focal_px), pose, thing, water)


def _square(side_px: int, focal_px: float) -> Lens:
    return Lens(side_px, side_px, 2.0 * math.atan(side_px / 2.0 / focal_px))


class Studio:
    """Renders targets for one photo, under one sun. Close it when the photo is done."""

    def __init__(self, photo: U8, split: Split, rng: np.random.Generator) -> None:
        self._split: Split = split
        self._rng = rng
        self._tones = _Tones.of(photo)
        self._shade = float(rng.uniform(0.3, 1.0))
        self._light = Light(
            sun_elevation_deg=float(rng.uniform(20, 80)),
            sun_heading_deg=float(rng.uniform(0, 360)),
            visibility_m=6000.0,
        )
        self._bare: Renderer | None = None  # of land without things

    def close(self) -> None:
        if self._bare is not None:
            self._bare.close()

    def paste(self, path: Path, picture: U8, view: View) -> tuple[U8, LabelledImage]:
        """The cut-out with targets and look-alikes rendered into it, and their labels."""
        world = self._world(view)
        renderer = make_renderer(world)
        try:
            side_px = SIDE_PX + 2 * ID_MARGIN_PX
            wide = _square(side_px, view.lens.focal_px)
            seen, whole = (renderer.render_ids(wide, view.pose, occluders=o) for o in (True, False))
            fine = _square(FINER * SIDE_PX, FINER * view.lens.focal_px)
            shown = (renderer.render_ids(fine, view.pose) > 0)[..., None]
            rendered = renderer.render(fine, view.pose)
        finally:
            renderer.close()
        covered = _coarse(shown)
        things = self._tones.given_to(_coarse(rendered * shown) / np.maximum(covered, 1e-6))
        blur_px = math.sqrt(max(blur_of(picture) ** 2 - SHARPEST_PX**2, 0.0))
        lit = self._lit(view, fine, rendered, shown)
        alpha = _blurred(covered, blur_px)
        noise = noise_of(picture) * self._rng.standard_normal((SIDE_PX, SIDE_PX, 1))
        mixed = picture * _blurred(lit, max(blur_px, LEAST_SHADOW_BLUR_PX)) * (1.0 - alpha)
        mixed = mixed + _blurred(things * covered, blur_px) + noise * alpha
        return np.clip(np.rint(mixed), 0, 255).astype(np.uint8), labels_of(path, world, seen, whole)

    def _lit(self, view: View, fine: Lens, rendered: U8, shown: NDArray[np.bool_]) -> F64:
        """(H, W, 1): 1 in the sun, less in the shadows of the things; water shows none."""
        if view.water:
            return np.ones((SIDE_PX, SIDE_PX, 1))
        if self._bare is None:
            self._bare = make_renderer(_ground(False, (), self._light))
        bare = self._bare.render(fine, view.pose)
        dark, light = (_coarse(image * ~shown).mean(axis=2, keepdims=True) for image in (rendered, bare))
        return np.asarray(1.0 - self._shade * (1.0 - np.clip((dark + 1.0) / (light + 1.0), 0.25, 1.0)))

    def _world(self, view: View) -> World:
        """The first thing at the origin, others on the ground in sight."""
        rng, first = self._rng, 0 if self._split == "train" else HELD_OUT_VARIANTS

        def thing(kind: str, place: F64) -> WorldObject:
            return random_object(kind, place, view.water, first + int(rng.integers(HELD_OUT_VARIANTS)), rng)

        objects = [thing(view.thing, np.zeros(3))]
        for _ in range(int(rng.integers(MOST_THINGS))):
            ray = rays_enu(view.lens, view.pose, rng.uniform(0.0, 1.0, 2) * SIDE_PX)[0]
            if -ray[2] < math.sin(FLATTEST_RAD):
                continue
            place = view.pose.position_enu_m - ray * view.pose.position_enu_m[2] / ray[2]
            gaps = [float(np.hypot(*(place - o.position_enu_m)[:2])) for o in objects]
            if min(gaps) > SEPARATION_M and gaps[0] < REACH_M:
                objects.append(thing(_kind(view.water, rng), place * [1.0, 1.0, 0.0]))
        return _ground(view.water, tuple(objects), self._light)


def _ground(water: bool, objects: tuple[WorldObject, ...], light: Light) -> World:
    bounds = (-REACH_M, -REACH_M, REACH_M, REACH_M)
    terrain = TerrainSurface(np.zeros((2, 2)), bounds, "water" if water else "grass")
    return World(terrain, objects, (), (), light, seed=0)


@dataclass(frozen=True, slots=True)
class _Tones:
    """What a photo makes of colours."""

    darkest: F64  # (3,) 0..255
    lightest: F64  # (3,)
    saturation: float  # a share of that of renders

    @classmethod
    def of(cls, photo: U8) -> _Tones:
        small = cv2.resize(photo, (256, 256), interpolation=cv2.INTER_AREA)
        mean = float(cv2.cvtColor(small, cv2.COLOR_RGB2HSV)[..., 1].mean())
        share = 0.0 if mean < GREY_SATURATION else float(np.clip(mean / RENDERED_SATURATION, 0.45, 1.1))
        low, high = np.quantile(small.reshape(-1, 3), (0.01, 0.99), axis=0)
        low, high = (0.5 * (level + level.mean()) for level in (low, high))  # half of a cast is the ground's
        return cls(low, high, share)

    def given_to(self, things: F64) -> F64:
        """Rendered colours (H, W, 3) as the photo would show them."""
        grey = things.mean(axis=2, keepdims=True)
        colours = np.clip(grey + self.saturation * (things - grey), 0.0, 255.0)
        return np.asarray(self.darkest + colours / 255.0 * (self.lightest - self.darkest))


def _coarse(fine: ArrayLike) -> F64:
    """Means (H, W, C) over the finer pixels of each pixel."""
    pixels = np.asarray(fine, dtype=float).reshape(SIDE_PX, FINER, SIDE_PX, FINER, -1)
    return np.asarray(pixels.mean(axis=(1, 3)))


def _blurred(image: F64, sigma_px: float) -> F64:
    if sigma_px < 0.2:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), dtype=float).reshape(image.shape)


def blur_of(picture: U8) -> float:
    """Standard deviation in pixels of the blur of the sharpest edges, after Zhuo and Sim (2011).

    An edge blurred once more by 1 pixel has its gradient divided by sqrt(1 + 1 / blur**2).
    """
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    once, twice = (_slopes(image) for image in (grey, cv2.GaussianBlur(grey, (0, 0), 1.0)))
    steep = once >= np.quantile(once, 0.98)
    ratio = float(np.median(once[steep] / np.maximum(twice[steep], 1e-3)))
    return math.sqrt(min(max(1.0 / max(ratio**2 - 1.0, 1e-2) - SLOPE_BLUR**2, 0.0), MOST_BLUR_PX**2))


def _slopes(grey: ArrayLike) -> F32:
    image = np.asarray(grey, np.float32)
    return np.asarray(np.hypot(cv2.Sobel(image, -1, 1, 0), cv2.Sobel(image, -1, 0, 1)), np.float32)


def noise_of(picture: U8) -> float:
    """Standard deviation of the noise, after Immerkær (1996), where the picture is quietest."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    rough = np.abs(cv2.filter2D(grey, -1, kernel)).reshape(SIDE_PX // 16, 16, SIDE_PX // 16, 16)
    return float(math.sqrt(math.pi / 2) / 6 * np.quantile(rough.mean(axis=(1, 3)), 0.1))
