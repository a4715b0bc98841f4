"""Labelled pictures: read from COCO or YOLO folders, written as both."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.files.plain_yaml import parse_foreign_yaml
from skysweep.files.reading import read_limited, read_text_limited

MAX_ANNOTATION_BYTES = 250_000_000
MAX_LABEL_BYTES = 5_000_000
PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")
_LAYOUTS = "a COCO folder (annotations.json and pictures) or a YOLO folder (data.yaml, images/, labels/)"


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """One picture and the boxes in it, as shares of its width and height.

    ``decoys`` are boxes of known look-alikes, named by their kind; crowds are regions where neither a hit
    nor a miss counts. Both are empty if the data set has none.
    """

    path: Path
    boxes_xyxy: F64  # (N, 4) 0..1
    class_names: tuple[str, ...]  # (N,)
    crowds_xyxy: F64  # (M, 4) 0..1
    decoys_xyxy: F64  # (D, 4) 0..1
    decoy_names: tuple[str, ...]  # (D,)
    altitude_agl_m: float | None = None


@dataclass(frozen=True, slots=True)
class LabelledDataset:
    """Labelled pictures and every class that their labels may use."""

    path: Path
    class_names: tuple[str, ...]
    images: tuple[LabelledImage, ...]


def read_dataset(path: Path) -> LabelledDataset:
    """Read a COCO annotation file, a folder with one, or a YOLO folder.

    Raises UserError if there is none, or a label or picture is malformed or missing.
    """
    if path.is_file() and path.suffix == ".json":
        return _read_coco(path)
    if not path.is_dir():
        raise UserError(f"{path}: there is no such data set; write the path of {_LAYOUTS}")
    if (path / "annotations.json").is_file():
        return _read_coco(path / "annotations.json")
    if (path / "labels").is_dir():
        return _read_yolo(path)
    found = sorted([*path.glob("*.json"), *path.glob("annotations/*.json")])
    if len(found) == 1:
        return _read_coco(found[0])
    if found:
        listed = ", ".join(str(f.relative_to(path)) for f in found)
        raise UserError(f"{path}: more than one annotation file ({listed}); write the path of one")
    raise UserError(f"{path}: neither annotations nor labels are there; write the path of {_LAYOUTS}")


def _boxes(rows: Sequence[Sequence[float]]) -> F64:
    return np.array(rows, dtype=float).reshape(-1, 4)


def _read_coco(path: Path) -> LabelledDataset:
    try:
        data = json.loads(read_limited(path, MAX_ANNOTATION_BYTES))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: not JSON ({error}); write COCO annotations") from error
    try:
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
    return LabelledDataset(path, tuple(names.values()), images)


def _coco_image(
    path: Path,
    image: dict[str, Any],
    annotations: list[dict[str, Any]],
    decoys: list[dict[str, Any]],
    names: dict[Any, str],
) -> LabelledImage:
    size = np.array([image["width"], image["height"]] * 2, dtype=float)

    def shares(items: list[dict[str, Any]]) -> F64:
        rows = []
        for item in items:
            bbox = item["bbox"]
            if len(bbox) != 4 or not np.all(np.isfinite(bbox)) or min(bbox[2:]) < 0:
                raise UserError(
                    f"{path}: bbox {bbox} of {image['file_name']}: write x, y, width, height in pixels"
                )
            rows.append([bbox[0], bbox[1], bbox[0] + bbox[2], bbox[1] + bbox[3]])
        return np.asarray(np.clip(_boxes(rows) / size, 0, 1))

    single = [a for a in annotations if not a.get("iscrowd")]
    above = path.parent.parent
    split = above / path.stem.removeprefix("instances_")
    folders = path.parent, path.parent / "images", above, above / "images", split
    picture = next((f / image["file_name"] for f in folders if (f / image["file_name"]).is_file()), None)
    if picture is None:
        raise UserError(f"{path}: the picture {image['file_name']} is neither beside the file nor in images/")
    return LabelledImage(
        picture,
        shares(single),
        tuple(names[a["category_id"]] for a in single),
        shares([a for a in annotations if a.get("iscrowd")]),
        shares(decoys),
        tuple(str(d["name"]) for d in decoys),
        image.get("altitude_agl_m"),
    )


def _read_yolo(path: Path) -> LabelledDataset:
    names = _yolo_names(path)
    pictures = sorted(f for f in (path / "images").rglob("*") if f.suffix.lower() in PICTURE_SUFFIXES)
    if not pictures:
        raise UserError(f"{path / 'images'}: there are no pictures; a YOLO folder has images/ and labels/")
    images = []
    for picture in pictures:
        label = path / "labels" / picture.relative_to(path / "images").with_suffix(".txt")
        boxes, classes = _yolo_boxes(label, names) if label.is_file() else (_boxes([]), ())
        images.append(LabelledImage(picture, boxes, classes, _boxes([]), _boxes([]), ()))
    return LabelledDataset(path, names, tuple(images))


def _yolo_names(path: Path) -> tuple[str, ...]:
    listed = path / "classes.txt"
    if listed.is_file():
        lines = read_text_limited(listed, MAX_LABEL_BYTES).splitlines()
        return tuple(line.strip() for line in lines if line.strip())
    described = path / "data.yaml"
    if not described.is_file():
        raise UserError(
            f"{path}: class names are unknown; write data.yaml with names, or classes.txt, beside labels/"
        )
    try:
        names = parse_foreign_yaml(read_text_limited(described, MAX_LABEL_BYTES), str(described))["names"]
    except (KeyError, TypeError) as error:
        raise UserError(
            f"{described}: names is missing; write  names: [first class, second class]"
        ) from error
    if isinstance(names, dict):
        names = [names[key] for key in sorted(names)]
    if not isinstance(names, list):
        raise UserError(f"{described}: names is no list; write  names: [first class, second class]")
    return tuple(str(name) for name in names)


def _yolo_boxes(label: Path, names: tuple[str, ...]) -> tuple[F64, tuple[str, ...]]:
    rows, classes = [], []
    for number, line in enumerate(read_text_limited(label, MAX_LABEL_BYTES).splitlines(), start=1):
        if not line.strip():
            continue
        try:
            index, cx, cy, width, height = (float(part) for part in line.split())
        except ValueError as error:
            raise UserError(f"{label}: line {number}: write  class centre_x centre_y width height") from error
        if not (0 <= cx <= 1 and 0 <= cy <= 1 and 0 <= width <= 1 and 0 <= height <= 1):
            raise UserError(f"{label}: line {number}: boxes are shares of the picture, 0..1, not pixels")
        if index != int(index) or not 0 <= index < len(names):
            raise UserError(f"{label}: line {number}: class {index:g} is none of the {len(names)} named ones")
        rows.append([cx - width / 2, cy - height / 2, cx + width / 2, cy + height / 2])
        classes.append(names[int(index)])
    return np.clip(_boxes(rows), 0, 1), tuple(classes)


def write_labels(
    out: Path,
    class_names: Sequence[str],
    images: Sequence[LabelledImage],
    size_px: tuple[int, int],
    info: dict[str, Any],
) -> None:
    """Write ``annotations.json`` (COCO, with decoys and altitudes), ``labels/`` and ``data.yaml`` (YOLO).

    The pictures are in ``out/images`` already, all of ``size_px`` (width, height).
    """
    width, height = size_px
    size = np.array([width, height] * 2, dtype=float)
    ids = {name: i for i, name in enumerate(class_names)}
    coco: dict[str, Any] = {
        "info": info,
        "categories": [{"id": i, "name": name} for name, i in ids.items()],
        "images": [],
        "annotations": [],
        "decoys": [],
    }

    def corner_and_size_px(box: F64) -> list[float]:
        return [round(float(v), 2) for v in np.concatenate([box[:2], box[2:] - box[:2]]) * size]

    (out / "labels").mkdir(exist_ok=True)
    for number, image in enumerate(images):
        described = {"id": number, "file_name": f"images/{image.path.name}", "width": width, "height": height}
        coco["images"].append(described | {"altitude_agl_m": image.altitude_agl_m})
        lines = []
        for box, name in zip(image.boxes_xyxy, image.class_names, strict=True):
            bbox = corner_and_size_px(box)
            annotation: dict[str, Any] = {
                "id": len(coco["annotations"]),
                "image_id": number,
                "category_id": ids[name],
            }
            annotation |= {"bbox": bbox, "area": round(bbox[2] * bbox[3], 2), "iscrowd": 0}
            coco["annotations"].append(annotation)
            extent = box[2:] - box[:2]
            shares = np.concatenate([box[:2] + extent / 2, extent])
            lines.append(" ".join([str(ids[name]), *(f"{v:.6f}" for v in shares)]) + "\n")
        for box, name in zip(image.decoys_xyxy, image.decoy_names, strict=True):
            coco["decoys"].append({"image_id": number, "name": name, "bbox": corner_and_size_px(box)})
        (out / "labels" / image.path.with_suffix(".txt").name).write_text("".join(lines))
    (out / "annotations.json").write_text(json.dumps(coco))
    description = {"path": ".", "train": "images", "val": "images", "names": dict(enumerate(class_names))}
    (out / "data.yaml").write_text(yaml.safe_dump(description, sort_keys=False))
