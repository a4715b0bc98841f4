"""Labels of VisDrone's detection task: ``annotations/`` with a text file a picture in ``images/``.

A line is  left, top, width, height, score, category, truncation, occlusion  in pixels. A score of 0 marks
what the evaluation leaves out, as the categories "ignored regions" and "others" do, with what lies in it
(https://github.com/VisDrone/VisDrone2018-DET-toolkit).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from skysweep.detection.photos.exif import upright_size_px_of
from skysweep.detection.training.class_map import IGNORED, ours
from skysweep.detection.training.labelled import (
    MAX_LABEL_BYTES,
    LabelledDataset,
    LabelledImage,
    boxes_of,
    have_area,
    pictures_below,
    refuse_orphans,
)
from skysweep.detection.training.matching import intersection_shares
from skysweep.errors import UserError
from skysweep.files.reading import read_text_limited

CATEGORIES = (
    "ignored regions", "pedestrian", "people", "bicycle", "car", "van", "truck", "tricycle",
    "awning-tricycle", "bus", "motor", "others",
)  # fmt: skip
_ROW = re.compile(r"(-?\d+(\.\d+)?,){7}-?\d+(\.\d+)?,?")


def is_visdrone(path: Path) -> bool:
    """Whether a folder has such annotations: the first line of text in them has eight numbers."""
    for label in sorted((path / "annotations").rglob("*.txt"))[:20]:
        text = read_text_limited(label, MAX_LABEL_BYTES).strip()
        if text:
            return _ROW.fullmatch(text.splitlines()[0].replace(" ", "")) is not None
    return False


def read_visdrone(path: Path) -> LabelledDataset:
    """Read a folder with ``images/`` and ``annotations/``. Raises UserError if a label is malformed."""
    pictures = pictures_below(path / "images")
    if not pictures:
        raise UserError(f"{path / 'images'}: there are no pictures; VisDrone has images/ and annotations/")
    refuse_orphans(path / "annotations", path / "images", pictures)
    names = tuple(name for name in CATEGORIES if ours(name) != IGNORED)
    return LabelledDataset(path, names, tuple(_image(path, picture) for picture in pictures), "VisDrone")


def _image(path: Path, picture: Path) -> LabelledImage:
    label = path / "annotations" / picture.relative_to(path / "images").with_suffix(".txt")
    boxes, classes, left_out = [], [], []
    lines = read_text_limited(label, MAX_LABEL_BYTES).splitlines() if label.is_file() else []
    for number, line in enumerate(lines, start=1):
        plain = line.replace(" ", "")
        if not plain:
            continue
        if not _ROW.fullmatch(plain):
            raise UserError(
                f"{label}: line {number}: write left,top,width,height,score,category,truncation,occlusion"
            )
        left, top, width, height, score, category, *_ = map(float, plain.rstrip(",").split(","))
        if category not in range(len(CATEGORIES)):
            raise UserError(
                f"{label}: line {number}: category {category:g} is none of 0 to {len(CATEGORIES) - 1}"
            )
        name, box = CATEGORIES[int(category)], [left, top, left + width, top + height]
        if score == 0 or ours(name) == IGNORED:
            left_out.append(box)
        else:
            boxes.append(box)
            classes.append(name)
    size = np.array(upright_size_px_of(picture) * 2, dtype=float)
    shares, crowds = (np.clip(boxes_of(rows) / size, 0, 1) for rows in (boxes, left_out))
    counts = have_area(shares) & ~(intersection_shares(shares, crowds) > 0.5).any(axis=1)
    named = tuple(name for name, one in zip(classes, counts.tolist(), strict=True) if one)
    return LabelledImage(picture, shares[counts], named, crowds, boxes_of([]), ())
