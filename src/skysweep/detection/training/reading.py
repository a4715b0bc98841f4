"""Labelled pictures in any layout that is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from skysweep.detection.photos.exif import size_px_of, taken_of
from skysweep.detection.photos.pose_table import PoseTable
from skysweep.detection.training.class_map import IGNORED, ours
from skysweep.detection.training.coco_labels import read_coco
from skysweep.detection.training.labelled import LabelledDataset, LabelledImage
from skysweep.detection.training.visdrone_labels import is_visdrone, read_visdrone
from skysweep.detection.training.yolo_labels import names_file, read_yolo
from skysweep.errors import UserError

_LAYOUTS = (
    "a COCO or SeaDronesSee folder (annotations.json and pictures), a YOLO folder (data.yaml, images/, "
    "labels/) or a VisDrone folder (images/, annotations/)"
)


def read_dataset(path: Path) -> LabelledDataset:
    """Read a COCO annotation file, a folder with one, a YOLO folder or a VisDrone folder.

    Raises UserError if there is none, or a label or picture is malformed or missing.
    """
    if path.is_file() and path.suffix == ".json":
        return read_coco(path)
    if not path.is_dir():
        raise UserError(f"{path}: there is no such data set; write the path of {_LAYOUTS}")
    if (path / "annotations.json").is_file():
        return read_coco(path / "annotations.json")
    if (path / "labels").is_dir():
        return read_yolo(path)
    if is_visdrone(path):
        return read_visdrone(path)
    found = sorted([*path.glob("*.json"), *path.glob("annotations/*.json")])
    if len(found) == 1:
        return read_coco(found[0])
    if found:
        listed = ", ".join(str(f.relative_to(path)) for f in found)
        raise UserError(f"{path}: more than one annotation file ({listed}); write the path of one")
    if names_file(path) in (path / "classes.txt", path / "data.yaml"):
        return read_yolo(path)
    raise UserError(f"{path}: neither annotations nor labels are there; write the path of {_LAYOUTS}")


def with_our_classes(data: LabelledDataset, renames: Mapping[str, str]) -> LabelledDataset:
    """The same pictures with our names of the classes; boxes of ignored classes are crowds."""
    names = dict.fromkeys(ours(name, renames) for name in data.class_names)
    return replace(
        data,
        class_names=tuple(name for name in names if name != IGNORED),
        images=tuple(_renamed(image, renames) for image in data.images),
    )


def _renamed(image: LabelledImage, renames: Mapping[str, str]) -> LabelledImage:
    names = [ours(name, renames) for name in image.class_names]
    counts = np.array([name != IGNORED for name in names], dtype=bool)
    return replace(
        image,
        boxes_xyxy=image.boxes_xyxy[counts],
        class_names=tuple(name for name in names if name != IGNORED),
        crowds_xyxy=np.concatenate([image.crowds_xyxy, image.boxes_xyxy[~counts]]),
    )


def with_poses(
    data: LabelledDataset,
    table: PoseTable | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> LabelledDataset:
    """The same with the altitude and ground that the pictures' files say, or before them a table.

    What the labels say already stays.
    """
    images = []
    for number, image in enumerate(data.images, start=1):
        if image.altitude_agl_m is None or image.ground_m2 is None:
            taken = taken_of(image.path)
            if table is not None:
                taken = table.of_file(image.path).filled_from(taken)
            height_m = image.altitude_agl_m if image.altitude_agl_m is not None else taken.over_ground_m
            area_m2 = replace(taken, altitude_agl_m=height_m).ground_m2(*size_px_of(image.path))
            known = image.ground_m2 if image.ground_m2 is not None else area_m2
            image = replace(image, altitude_agl_m=height_m, ground_m2=known)
        images.append(image)
        progress(number, len(data.images))
    return replace(data, images=tuple(images))
