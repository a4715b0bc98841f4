"""Labels in YOLO's format: a text file a picture, with class number and box as shares of the picture.

Outlines, as of segmentation and of oriented boxes, count as the boxes around them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skysweep.arrays import F64
from skysweep.detection.training.labelled import (
    MAX_LABEL_BYTES,
    LabelledDataset,
    LabelledImage,
    boxes_of,
    have_area,
    pictures_below,
    refuse_orphans,
)
from skysweep.errors import UserError
from skysweep.files.plain_yaml import parse_foreign_yaml
from skysweep.files.reading import read_text_limited


def read_yolo(path: Path) -> LabelledDataset:
    """Read a folder with ``images/`` and ``labels/``, with such folders, or with text files beside pictures.

    Raises UserError if a label is malformed, no picture has one, or the names of the classes are missing.
    """
    splits = split_folders(path)
    if splits and not (path / "labels").is_dir():
        parts = [_read_folder(split) for split in splits]
        names = dict.fromkeys(name for part in parts for name in part.class_names)
        return LabelledDataset(path, tuple(names), tuple(i for part in parts for i in part.images), "YOLO")
    return _read_folder(path)


def split_folders(path: Path) -> list[Path]:
    """The folders in a folder that have ``labels/``: train, valid and test."""
    return sorted(labels.parent for labels in path.glob("*/labels") if labels.is_dir())


def _read_folder(path: Path) -> LabelledDataset:
    images_in, labels_in = (path / "images", path / "labels") if (path / "labels").is_dir() else (path, path)
    names = _yolo_names(path)
    pictures = pictures_below(images_in)
    if not pictures:
        raise UserError(f"{images_in}: there are no pictures; a YOLO folder has images/ and labels/")
    if labels_in != images_in:
        refuse_orphans(labels_in, images_in, pictures)
    labels = [_label_of(labels_in / picture.relative_to(images_in)) for picture in pictures]
    if not any(label.is_file() for label in labels):
        raise UserError(
            f"{path}: no picture has a label file, such as {labels[0]}; write the path of a folder with "
            "images/ and labels/, with an empty label file for a picture without objects"
        )
    images = []
    for picture, label in zip(pictures, labels, strict=True):
        boxes, classes = _yolo_boxes(label, names) if label.is_file() else (boxes_of([]), ())
        images.append(LabelledImage(picture, boxes, classes, boxes_of([]), boxes_of([]), ()))
    return LabelledDataset(path, names, tuple(images), "YOLO")


def _label_of(place: Path) -> Path:
    """The label file of a picture's name in the folder of labels."""
    label, upper = place.with_suffix(".txt"), place.with_suffix(".TXT")
    return upper if upper.is_file() and not label.is_file() else label


def names_file(path: Path) -> Path | None:
    """The file that names the classes: in the folder, or in the one above, where the folder is one split."""
    places = (folder / name for folder in (path, path.parent) for name in ("classes.txt", "data.yaml"))
    return next((place for place in places if place.is_file()), None)


def _yolo_names(path: Path) -> tuple[str, ...]:
    described = names_file(path)
    if described is None:
        raise UserError(
            f"{path}: class names are unknown; write data.yaml with names, or classes.txt, beside labels/"
        )
    if described.suffix == ".txt":
        names = read_text_limited(described, MAX_LABEL_BYTES).rstrip().splitlines()
        for number, name in enumerate(names, start=1):
            if not name.strip():
                raise UserError(f"{described}: line {number} is empty; labels count lines, so write a name")
        return tuple(name.strip() for name in names)
    try:
        content = parse_foreign_yaml(read_text_limited(described, MAX_LABEL_BYTES), str(described))
        names = content["names"]
        if "kpt_shape" in content:
            raise UserError(
                f"{described}: the labels hold key points (kpt_shape), which are no outlines; write labels "
                "of boxes, and delete kpt_shape"
            )
    except (KeyError, TypeError) as error:
        raise UserError(
            f"{described}: names is missing; write  names: [first class, second class]"
        ) from error
    if isinstance(names, dict):
        if set(names) != set(range(len(names))):
            numbers = ", ".join(str(key) for key in names)
            raise UserError(
                f"{described}: names has the numbers {numbers}; write every number from 0 on, as the labels "
                "count them"
            )
        names = [names[number] for number in range(len(names))]
    if not isinstance(names, list):
        raise UserError(f"{described}: names is no list; write  names: [first class, second class]")
    return tuple(str(name) for name in names)


def _corners(shares: list[float]) -> list[float]:
    """Left, top, right and bottom of a box by centre and size, or of the box around an outline."""
    if len(shares) > 4:
        xs, ys = shares[::2], shares[1::2]
        return [min(xs), min(ys), max(xs), max(ys)]
    cx, cy, width, height = shares
    return [cx - width / 2, cy - height / 2, cx + width / 2, cy + height / 2]


def _yolo_boxes(label: Path, names: tuple[str, ...]) -> tuple[F64, tuple[str, ...]]:
    rows, classes = [], []
    for number, line in enumerate(read_text_limited(label, MAX_LABEL_BYTES).splitlines(), start=1):
        if not line.strip():
            continue
        try:
            index, *shares = (float(part) for part in line.split())
        except ValueError:
            index, shares = -1.0, []
        if len(shares) != 4 and (len(shares) < 6 or len(shares) % 2):
            raise UserError(
                f"{label}: line {number}: write  class centre_x centre_y width height, or class and the "
                "corners x y of an outline, and nothing else"
            )
        if not all(0 <= share <= 1 for share in shares):
            raise UserError(f"{label}: line {number}: boxes are shares of the picture, 0..1, not pixels")
        if not 0 <= index < len(names) or index != int(index):
            raise UserError(f"{label}: line {number}: class {index:g} is none of the {len(names)} named ones")
        rows.append(_corners(shares))
        classes.append(names[int(index)])
    boxes = np.clip(boxes_of(rows), 0, 1)
    real = have_area(boxes)
    return boxes[real], tuple(name for name, is_real in zip(classes, real.tolist(), strict=True) if is_real)
