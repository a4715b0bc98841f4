"""Labels in COCO's format, as SeaDronesSee has them too.

An annotation file lists images, annotations and categories (https://cocodataset.org/#format-data). Ours also
have ``decoys``, and the images ``altitude_agl_m`` and ``ground_m2``. SeaDronesSee's images have ``meta`` with
the height above take-off, in metres (https://github.com/Ben93kie/SeaDronesSee).
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from skysweep.arrays import F64
from skysweep.detection.photos.exif import upright_size_px_of
from skysweep.detection.training.labelled import (
    MAX_ANNOTATION_BYTES,
    LabelledDataset,
    LabelledImage,
    boxes_of,
    have_area,
)
from skysweep.errors import UserError
from skysweep.files.reading import read_limited

_HEIGHTS = ("height_above_takeoff(meter)", "altitude")  # in SeaDronesSee's meta


def read_coco(path: Path) -> LabelledDataset:
    """Read an annotation file. Raises UserError if it is malformed or a picture is missing."""
    try:
        data = json.loads(read_limited(path, MAX_ANNOTATION_BYTES))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: not JSON ({error}); write COCO annotations") from error
    try:
        for what in ("categories", "images"):
            if len({entry["id"] for entry in data[what]}) < len(data[what]):
                raise UserError(f"{path}: {what}: two have the same id; number them anew")
        names = {c["id"]: str(c["name"]) for c in data["categories"]}
        boxes: dict[Any, list[dict[str, Any]]] = {i["id"]: [] for i in data["images"]}
        for number, annotation in enumerate(data["annotations"]):
            for field, known, what in (("image_id", boxes, "image"), ("category_id", names, "category")):
                if annotation[field] not in known:
                    at = f"{path}: annotations[{number}].{field}"
                    raise UserError(f"{at} {annotation[field]!r} is no {what}'s id")
            boxes[annotation["image_id"]].append(annotation)
        decoys: dict[Any, list[dict[str, Any]]] = {i["id"]: [] for i in data["images"]}
        for decoy in data.get("decoys", []):
            decoys[decoy["image_id"]].append(decoy)
        images = tuple(_coco_image(path, i, boxes[i["id"]], decoys[i["id"]], names) for i in data["images"])
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise UserError(
            f"{path}: not COCO detection annotations (missing or malformed {error}); write images "
            "(id, file_name, width, height), annotations (image_id, category_id, bbox), categories (id, name)"
        ) from error
    camera = str(data["info"].get("camera", "")) if isinstance(data.get("info"), dict) else ""
    return LabelledDataset(path, tuple(names.values()), images, camera=camera)


def _coco_image(
    path: Path,
    image: dict[str, Any],
    annotations: list[dict[str, Any]],
    decoys: list[dict[str, Any]],
    names: dict[Any, str],
) -> LabelledImage:
    picture = _picture(path, image)
    width, height = _size(path, image, picture)

    def shares(items: list[dict[str, Any]]) -> F64:
        rows = []
        for item in items:
            bbox = item["bbox"]
            at = f"{path}: bbox {bbox} of {image['file_name']}"
            if len(bbox) != 4 or not np.all(np.isfinite(bbox)) or min(bbox[2:]) < 0:
                raise UserError(f"{at}: write x, y, width, height in pixels")
            left, top, right, bottom = bbox[0], bbox[1], bbox[0] + bbox[2], bbox[1] + bbox[3]
            if left >= width or top >= height or right <= 0 or bottom <= 0:
                raise UserError(f"{at}: lies outside the picture of {width:g} x {height:g}; correct it")
            rows.append([left, top, right, bottom])
        return np.asarray(np.clip(boxes_of(rows) / ([width, height] * 2), 0, 1))

    single = [a for a in annotations if not a.get("iscrowd")]
    crowds = [a for a in annotations if a.get("iscrowd")]
    boxes = shares(single)
    real = have_area(boxes)
    return LabelledImage(
        picture,
        boxes[real],
        tuple(names[a["category_id"]] for a, is_real in zip(single, real.tolist(), strict=True) if is_real),
        shares(crowds),
        shares(decoys),
        tuple(str(d["name"]) for d in decoys),
        _altitude_agl_m(image),
        _measure(image.get("ground_m2")),
        tuple(names[a["category_id"]] for a in crowds),
    )


def _picture(path: Path, image: dict[str, Any]) -> Path:
    above = path.parent.parent
    split = above / path.stem.removeprefix("instances_")
    folders = (
        path.parent,
        path.parent / "images",
        above,
        above / "images",
        split,
        above / "images" / split.name,
    )
    for folder in folders:
        picture = folder / str(image["file_name"])
        if picture.is_file():
            return picture
    raise UserError(f"{path}: the picture {image['file_name']} is neither beside the file nor in images/")


def _size(path: Path, image: dict[str, Any], picture: Path) -> tuple[float, float]:
    """Width and height that boxes count in: the upright picture's, or those of it before it was resized."""
    width, height = float(image["width"]), float(image["height"])
    true_width, true_height = upright_size_px_of(picture)
    off = abs(width * true_height - height * true_width)
    if not (min(width, height) > 0 and off <= max(width, height, true_width, true_height)):
        raise UserError(
            f"{path}: {image['file_name']} has width {width:g} and height {height:g}, but the picture is "
            f"{true_width} x {true_height}; write its size, and boxes that count in it"
        )
    return width, height


def _altitude_agl_m(image: dict[str, Any]) -> float | None:
    meta = image.get("meta")
    told = [image.get("altitude_agl_m")]
    told += [meta.get(name) for name in _HEIGHTS] if isinstance(meta, dict) else []
    return next((value for each in told if (value := _measure(each)) is not None), None)


def _measure(value: Any) -> float | None:
    """A finite number from 0 on; None for anything else, as SeaDronesSee's -1 for what was not measured."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number and math.isfinite(value) and value >= 0.0 else None
