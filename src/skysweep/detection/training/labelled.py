"""Labelled pictures, and how ours are written: as COCO and as YOLO."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.errors import UserError

MAX_ANNOTATION_BYTES = 250_000_000
MAX_LABEL_BYTES = 5_000_000
PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """One picture and the boxes in it, as shares of its width and height.

    ``decoys`` are boxes of known look-alikes, named by their kind; crowds are regions where neither a hit
    nor a miss of the class counts, or of any class. Both are empty if the data set has none.
    """

    path: Path
    boxes_xyxy: F64  # (N, 4) 0..1
    class_names: tuple[str, ...]  # (N,)
    crowds_xyxy: F64  # (M, 4) 0..1
    decoys_xyxy: F64  # (D, 4) 0..1
    decoy_names: tuple[str, ...]  # (D,)
    altitude_agl_m: float | None = None
    ground_m2: float | None = None  # of level ground in the picture, as ``Lens.seen_ground_m2``
    crowd_names: tuple[str, ...] = ()  # (M,) classes, "" for any; empty: all of them for any

    def crowds_of(self, name: str) -> F64:
        """The crowds (K, 4) that count for a class."""
        if not self.crowd_names:
            return self.crowds_xyxy
        return self.crowds_xyxy[[of in ("", name) for of in self.crowd_names]]


@dataclass(frozen=True, slots=True)
class LabelledDataset:
    """Labelled pictures and every class that their labels may use."""

    path: Path
    class_names: tuple[str, ...]
    images: tuple[LabelledImage, ...]
    layout: str = "COCO"  # what was recognised: COCO, YOLO or VisDrone
    camera: str = ""  # its kind, where the labels tell


def boxes_of(rows: Sequence[Sequence[float]]) -> F64:
    """Rows of four numbers as an array (N, 4), also where there are none."""
    return np.array(rows, dtype=float).reshape(-1, 4)


def have_area(boxes: F64) -> NDArray[np.bool_]:
    """Which of the boxes (N, 4) are more than a line or a point."""
    return np.asarray(((boxes[:, 2:] - boxes[:, :2]) > 0.0).all(axis=1))


def pictures_below(folder: Path) -> list[Path]:
    """The pictures in a folder and the folders in it, in the order of their names."""
    return sorted(f for f in folder.rglob("*") if f.suffix.lower() in PICTURE_SUFFIXES and f.is_file())


def refuse_orphans(labels_in: Path, images_in: Path, pictures: Iterable[Path]) -> None:
    """Raises UserError if a label file below a folder belongs to none of the pictures below another."""
    known = {picture.relative_to(images_in).with_suffix("") for picture in pictures}
    for label in sorted(labels_in.rglob("*.txt")):
        stem = label.relative_to(labels_in).with_suffix("")
        if stem not in known and label.name != "classes.txt":
            raise UserError(
                f"{label}: there is no picture {images_in / stem}.*; add it, or take the label out"
            )


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
        known = {"altitude_agl_m": image.altitude_agl_m, "ground_m2": image.ground_m2}
        coco["images"].append(described | known)
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
