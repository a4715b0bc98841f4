"""Rendered pictures of a data set: random worlds, random views, labels from what each pixel shows.

Targets span 8 pixels to half the picture (log-uniform), on every surface and in every pose, in all light,
among trees, buildings and look-alikes; some pictures hold nothing to find. Training worlds use asset variants
below ``HELD_OUT_VARIANTS``, held-out worlds those from there on, as missions do, and other ground textures.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from skysweep.arrays import F32, F64, I32, U8
from skysweep.detection.training.camera_looks import sharpened, toned
from skysweep.detection.training.clutter import with_clutter
from skysweep.detection.training.labelled import LabelledImage
from skysweep.detection.training.random_worlds import (
    SIDE_PX,
    Split,
    class_of,
    random_view,
    random_world,
    recipe_for,
)
from skysweep.geometry.camera import Lens
from skysweep.scenarios.model import CameraKind
from skysweep.worlds.rendering.renderer import make_renderer
from skysweep.worlds.rendering.white_hot import grey_rgb, white_hot
from skysweep.worlds.world import HELD_OUT_VARIANTS, World

PICTURES_PER_WORLD = 40
VISIBLE_MIN = 0.35
MIN_BOX_PX = 5.0
PLAIN_SHARE = 0.3  # of worlds of a data set with clutter are as missions show them
ID_MARGIN_PX = 96  # seen beyond the picture's edges, to know how much of an object they cut off
QUALITIES, QUALITIES_OF_CAMERAS = (60, 98), (30, 98)  # of JPEG
LEAST_CONTRAST, LEAST_SHARE = 8.0, 0.1  # grey levels, and of a box, by which a warm body stands out
NETD_K = (0.02, 0.15)  # of thermal cameras


def render_world(
    out: Path, index: int, n_pictures: int, seed: int, split: Split, camera: CameraKind, clutter: bool
) -> list[LabelledImage]:
    """Write the pictures of one random world into ``out/images``, and return them with their labels."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng([seed, index, 29 if split == "train" else 31])
    recipe = recipe_for(camera, clutter)
    world = random_world(rng, split, recipe)
    lived_in = clutter and rng.random() >= PLAIN_SHARE
    if lived_in:
        world = with_clutter(world, 0 if split == "train" else HELD_OUT_VARIANTS, rng)
    renderer = make_renderer(world)
    images: list[LabelledImage] = []
    while len(images) < n_pictures:
        view = random_view(world, rng, recipe)
        if view is None:
            continue
        lens, pose = view
        number = index * PICTURES_PER_WORLD + len(images)
        time_s = float(rng.uniform(0, 60))
        if camera == "thermal":
            picture = develop_heat(renderer.render_heat_c(lens, pose, time_s), rng)
        else:
            picture = renderer.render(lens, pose, time_s)
            picture = sharpened(develop(toned(picture, rng), rng), rng) if lived_in else develop(picture, rng)
        side_px = SIDE_PX + 2 * ID_MARGIN_PX
        wide = Lens(side_px, side_px, 2 * np.arctan(side_px / 2 / lens.focal_px))
        seen, whole = renderer.render_ids(wide, pose), renderer.render_ids(wide, pose, occluders=False)
        path = out / "images" / f"{number:06d}.jpg"
        labelled = labels_of(path, world, seen, whole)
        if camera == "thermal" and not _stand_out(picture, labelled):
            continue
        write_jpeg(path, picture, rng, QUALITIES_OF_CAMERAS if lived_in else QUALITIES)
        height_m = float(pose.position_enu_m[2])
        ground_m2 = round(lens.seen_ground_m2(pose, height_m), 2)
        images.append(replace(labelled, altitude_agl_m=round(height_m, 2), ground_m2=ground_m2))
    return images


def _stand_out(picture: U8, labelled: LabelledImage) -> bool:
    """Whether every labelled thing differs from what is around it; a body as warm as the ground does not."""
    grey = picture[..., 0].astype(float)
    for box in labelled.boxes_xyxy * SIDE_PX:
        left, top, right, bottom = np.rint(box).astype(int).tolist()
        pad = max(4, (right - left + bottom - top) // 4)
        around = grey[max(top - pad, 0) : bottom + pad, max(left - pad, 0) : right + pad]
        inside = grey[top:bottom, left:right]
        low, high = np.percentile(around, [15, 85])
        if np.mean((inside < low - LEAST_CONTRAST) | (inside > high + LEAST_CONTRAST)) < LEAST_SHARE:
            return False
    return True


def write_jpeg(
    path: Path, picture: U8, rng: np.random.Generator, qualities: tuple[int, int] = QUALITIES
) -> None:
    """Write a picture (H, W, 3) RGB in a drawn quality."""
    quality = int(rng.integers(*qualities))
    _, jpeg = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    path.write_bytes(jpeg.tobytes())


def labels_of(path: Path, world: World, seen: I32, whole: I32) -> LabelledImage:
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
        name = class_of(thing.kind) if thing.is_target else thing.kind
        (targets if thing.is_target else decoys).append((box / SIDE_PX, name))
    return LabelledImage(
        path,
        np.array([b for b, _ in targets]).reshape(-1, 4),
        tuple(k for _, k in targets),
        np.zeros((0, 4)),
        np.array([b for b, _ in decoys]).reshape(-1, 4),
        tuple(k for _, k in decoys),
    )


def develop(picture: U8, rng: np.random.Generator) -> U8:
    """Add motion blur, defocus, exposure and noise, drawn more widely than those of any single camera."""
    p = _shaken(picture.astype(np.float32), rng)
    p *= np.float32(np.exp(rng.normal(0, 0.15)))
    p += rng.standard_normal(p.shape, dtype=np.float32) * np.float32(abs(rng.normal(0, 3)))
    return np.clip(np.rint(p), 0, 255).astype(np.uint8)


def develop_heat(heat_c: F32, rng: np.random.Generator) -> U8:
    """A white-hot picture (H, W, 3) of temperatures (H, W), with blur, noise and gain as ``develop``."""
    soft = cv2.GaussianBlur(heat_c, (0, 0), float(rng.uniform(0.3, 0.9)))
    p = _shaken(np.asarray(soft, np.float32), rng)
    netd_k = np.float32(np.exp(rng.uniform(*np.log(NETD_K))))
    p = p + rng.standard_normal(p.shape, dtype=np.float32) * netd_k
    p += rng.standard_normal((1, p.shape[1]), dtype=np.float32) * netd_k * np.float32(rng.uniform(0, 0.5))
    grey = white_hot(p).astype(np.float32) / 255.0
    if rng.random() < 0.5:  # cameras differ in their gain
        grey = grey ** np.exp(rng.normal(0, 0.3)) * rng.uniform(0.7, 1.1) + rng.uniform(-0.05, 0.1)
    return grey_rgb(np.rint(255.0 * np.clip(grey, 0, 1)).astype(np.uint8))


def _shaken(p: F32, rng: np.random.Generator) -> F32:
    """With motion blur and defocus, or without."""
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
    return p
