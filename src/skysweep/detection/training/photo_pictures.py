"""Pictures of a data set that are made of a user's own photos.

A photo with labels of our classes gives cut-outs around them, with these labels. Any other photo holds no
target, or so its owner says: it gives cut-outs that are empty, and such onto which targets and look-alikes
are rendered (``compositing``). Labels of other classes become look-alikes, and ignored regions grey.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageOps
from PIL.ExifTags import Base

from skysweep.arrays import F64, U8
from skysweep.detection.network import PAD_GREY
from skysweep.detection.photos.exif import taken_of
from skysweep.detection.photos.taken import Taken
from skysweep.detection.training.class_map import refuse_unused
from skysweep.detection.training.compositing import Cutting, Studio, cutting_onto
from skysweep.detection.training.labelled import LabelledImage
from skysweep.detection.training.random_worlds import SIDE_PX, VISIBLE, Split
from skysweep.detection.training.reading import read_photos, with_our_classes
from skysweep.detection.training.rendered_pictures import MIN_BOX_PX, VISIBLE_MIN, write_jpeg
from skysweep.errors import UserError

COMPOSITE_SHARE = 0.65  # of the cut-outs of photos without targets


@dataclass(frozen=True, slots=True)
class Share:
    """How many pictures one photo gives, and the number of the first among those of all photos."""

    photo: LabelledImage
    index: int
    first: int
    count: int


def photos_in(
    folders: Sequence[Path], renames: Mapping[str, str], classes: Sequence[str] = VISIBLE.classes
) -> list[LabelledImage]:
    """The photos of all folders with labels of these classes; those of others are look-alikes.

    Raises UserError if a folder holds no photo, a label is malformed, a photo is broken, too small or too
    large, or no label has a renamed class.
    """
    sets = [read_photos(folder) for folder in folders]
    refuse_unused(renames, [name for data in sets for name in data.class_names])
    photos = [_of(classes, image) for data in sets for image in with_our_classes(data, renames).images]
    for photo in photos:
        with _open(photo.path):
            pass
    return photos


def shares_of(photos: Sequence[LabelledImage], n_pictures: int, seed: int) -> list[Share]:
    """Pictures shared out evenly; where there are fewer than photos, a draw says which photos give one."""
    order = np.random.default_rng([seed, 37]).permutation(len(photos))[:n_pictures]
    counts = [len(part) for part in np.array_split(np.arange(n_pictures), max(len(order), 1))]
    firsts = np.cumsum([0, *counts])
    return [
        Share(photos[index], int(index), int(first), count)
        for index, first, count in zip(order, firsts, counts, strict=False)
    ]


def pictures_of(out: Path, share: Share, first: int, seed: int, split: Split) -> list[LabelledImage]:
    """Write the pictures that one photo gives into ``out/images``, and return them with their labels.

    ``first`` is the number of the first in the data set. Raises UserError if the photo is broken.
    """
    cv2.setNumThreads(1)
    rng = np.random.default_rng([seed, share.index, 43 if split == "train" else 47])
    photo, (image, taken) = share.photo, _upright(share.photo.path)
    images = []
    with closing(Studio(image, split, rng)) as studio:
        for number in range(first, first + share.count):
            path = out / "images" / f"{number:06d}.jpg"
            composite = not photo.class_names and rng.random() < COMPOSITE_SHARE
            view = cutting_onto(image.shape[1::-1], taken, rng) if composite else None
            cutting = _around(photo, image, rng) if view is None else view.cutting
            picture, labelled = _cut(path, photo, image, cutting)
            if view is not None:
                picture, pasted = studio.paste(path, picture, view)
                decoys = np.concatenate([labelled.decoys_xyxy, pasted.decoys_xyxy])
                names = labelled.decoy_names + pasted.decoy_names
                labelled = replace(pasted, decoys_xyxy=decoys, decoy_names=names)
            write_jpeg(path, picture, rng)
            images.append(replace(labelled, altitude_agl_m=photo.altitude_agl_m or taken.over_ground_m))
    return images


def _of(classes: Sequence[str], image: LabelledImage) -> LabelledImage:
    ours = np.array([name in classes for name in image.class_names], dtype=bool)
    others = tuple(name for name, our in zip(image.class_names, ours, strict=True) if not our)
    return replace(
        image,
        boxes_xyxy=image.boxes_xyxy[ours],
        class_names=tuple(name for name, our in zip(image.class_names, ours, strict=True) if our),
        decoys_xyxy=np.concatenate([image.decoys_xyxy, image.boxes_xyxy[~ours]]),
        decoy_names=image.decoy_names + others,
    )


def _open(path: Path) -> Image.Image:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            picture = Image.open(path)
    except (Image.DecompressionBombWarning, Image.DecompressionBombError):
        millions = (Image.MAX_IMAGE_PIXELS or 0) / 1e6
        raise UserError(f"{path}: has more than {millions:.0f} million pixels; save it smaller") from None
    except Exception as error:  # Pillow raises whatever its readers do on damaged files
        raise UserError(f"{path}: not a readable picture; take it out of the folder") from error
    if picture.mode.startswith(("I", "F")):
        picture.close()
        raise UserError(f"{path}: has more than 8 bits a channel; save it as JPEG or 8-bit PNG")
    if min(picture.size) < SIDE_PX:
        width, height = picture.size
        picture.close()
        raise UserError(
            f"{path}: is {width} x {height} pixels; photos need {SIDE_PX} on each side, take it out"
        )
    return picture


def _upright(path: Path) -> tuple[U8, Taken]:
    """A photo (H, W, 3) RGB, upright as labels mean it, and how a camera held upright took it."""
    taken = taken_of(path)
    with _open(path) as stored:
        try:
            picture = ImageOps.exif_transpose(stored)
            if stored.getexif().get(Base.Orientation, 1) != 1:
                taken = replace(taken, roll_deg=0.0)
                if taken.hfov_rad is not None:
                    half_width = math.tan(taken.hfov_rad / 2.0) * picture.width / stored.width
                    taken = replace(taken, hfov_rad=2.0 * math.atan(half_width))
            return np.array(picture.convert("RGB")), taken
        except Exception as error:  # as above
            raise UserError(f"{path}: the picture is damaged; take it out of the folder") from error


def _around(photo: LabelledImage, image: U8, rng: np.random.Generator) -> Cutting:
    """A square of the photo around one of its labels, or anywhere if it has none; never enlarged."""
    height, width = image.shape[:2]
    most = min(width, height) / SIDE_PX
    if len(photo.boxes_xyxy):
        box = photo.boxes_xyxy[int(rng.integers(len(photo.boxes_xyxy)))] * [width, height, width, height]
        pixels = np.exp(rng.uniform(*np.log(VISIBLE.pixels_on_object)))
        scale = float(np.clip((box[2:] - box[:2]).max() / pixels, 1.0, most))
        middle = (box[:2] + box[2:]) / 2
    else:
        scale = float(np.exp(rng.uniform(0.0, np.log(most))))
        middle = rng.uniform(0.0, 1.0, 2) * [width, height]
    return Cutting.with_at(middle, rng.uniform(0.06, 0.94, 2) * SIDE_PX, scale, (width, height))


def _cut(path: Path, photo: LabelledImage, image: U8, cutting: Cutting) -> tuple[U8, LabelledImage]:
    """The cut-out, grey where the labels say nothing, and the labels of what is seen in it."""
    height, width = image.shape[:2]
    size = np.array([width, height] * 2, dtype=float)
    picture = cutting.of(image)
    boxes, seen = _seen(cutting.boxes_px(photo.boxes_xyxy * size))
    decoys, seen_decoys = _seen(cutting.boxes_px(photo.decoys_xyxy * size))
    _grey_out(picture, cutting.boxes_px(photo.crowds_xyxy * size), boxes)
    return picture, LabelledImage(
        path,
        boxes[seen] / SIDE_PX,
        tuple(np.array(photo.class_names, dtype=object)[seen]),
        np.zeros((0, 4)),
        decoys[seen_decoys] / SIDE_PX,
        tuple(np.array(photo.decoy_names, dtype=object)[seen_decoys]),
    )


def _seen(boxes_px: F64) -> tuple[F64, F64]:
    """Boxes cut at the picture's edges, and which of them show enough."""
    cut = np.clip(boxes_px, 0.0, SIDE_PX)
    whole, left = np.prod(boxes_px[:, 2:] - boxes_px[:, :2], axis=1), np.prod(cut[:, 2:] - cut[:, :2], axis=1)
    large = (cut[:, 2:] - cut[:, :2]).max(axis=1, initial=0.0) >= MIN_BOX_PX
    return cut, (left >= VISIBLE_MIN * whole) & (left > 0.0) & large


def _grey_out(picture: U8, crowds_px: F64, boxes_px: F64) -> None:
    """Paint regions grey, in place, except where there is a label."""
    hidden = np.zeros(picture.shape[:2], dtype=bool)
    for regions, value in ((crowds_px, True), (boxes_px, False)):
        for left, top, right, bottom in np.clip(np.rint(regions), 0, SIDE_PX).astype(int).tolist():
            hidden[top:bottom, left:right] = value
    picture[hidden] = PAD_GREY
