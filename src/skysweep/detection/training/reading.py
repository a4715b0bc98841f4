"""Labelled pictures in any layout that is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from skysweep.detection.photos.exif import size_px_of, taken_of
from skysweep.detection.photos.pose_table import PoseTable
from skysweep.detection.photos.taken import Taken
from skysweep.detection.training.class_map import IGNORED, ours
from skysweep.detection.training.coco_labels import read_coco
from skysweep.detection.training.labelled import LabelledDataset, LabelledImage, boxes_of, pictures_below
from skysweep.detection.training.visdrone_labels import is_visdrone, read_visdrone
from skysweep.detection.training.yolo_labels import names_file, read_yolo, split_folders
from skysweep.errors import UserError

_LAYOUTS = (
    "a COCO or SeaDronesSee folder (annotations.json and pictures), a YOLO folder (data.yaml, images/, "
    "labels/) or a VisDrone folder (images/, annotations/)"
)
_NONE = boxes_of([])


def read_dataset(path: Path) -> LabelledDataset:
    """Read a COCO annotation file, a folder with one, a YOLO folder or a VisDrone folder.

    Raises UserError if there is none, or a label or picture is malformed or missing.
    """
    data = _labelled(path)
    if data is None:
        raise UserError(f"{path}: neither annotations nor labels are there; write the path of {_LAYOUTS}")
    return data


def read_photos(path: Path) -> LabelledDataset:
    """The same, or the pictures below a folder without labels, as empty ones.

    Raises UserError as ``read_dataset``, or if there is no picture.
    """
    if not path.exists():
        raise UserError(f"--photos {path}: is not there; write the path of a folder of photos")
    if path.is_file() and path.suffix != ".json":
        raise UserError(f"--photos {path}: is a file; write the path of the folder that it is in")
    data = _labelled(path)
    if data is None:
        _refuse_labels(path)
        empty = tuple(LabelledImage(f, _NONE, (), _NONE, _NONE, ()) for f in pictures_below(path))
        data = LabelledDataset(path, (), empty, "no labels")
    if not data.images:
        raise UserError(f"--photos {path}: there are no pictures; write the path of a folder of photos")
    return data


def _refuse_labels(path: Path) -> None:
    """Raise UserError if files below a folder look like labels: their targets would be taken for ground."""
    pictures = {picture.stem for picture in pictures_below(path)}
    for file in sorted(path.rglob("*")):
        if file.suffix.lower() in (".txt", ".xml", ".json", ".csv") and (
            file.stem in pictures
            or {"labels", "annotations"} & set(file.parts[len(path.parts) : -1])
            or any(word in file.stem.lower() for word in ("annotation", "label", "instances"))
        ):
            raise UserError(
                f"--photos {path}: {file.relative_to(path)} looks like labels, in a layout that is not read "
                f"from here; write the path of {_LAYOUTS}"
            )


def _labelled(path: Path) -> LabelledDataset | None:
    """What is labelled in a known layout; None for a folder without labels."""
    if path.is_file() and path.suffix == ".json":
        return read_coco(path)
    if not path.is_dir():
        what = "is a file" if path.exists() else "there is no such data set"
        raise UserError(f"{path}: {what}; write the path of {_LAYOUTS}")
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
    if split_folders(path) or names_file(path) in (path / "classes.txt", path / "data.yaml"):
        return read_yolo(path)
    return None


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
    of_crowds = image.crowd_names or ("",) * len(image.crowds_xyxy)
    crowd_names = [name and ours(name, renames) for name in of_crowds] + [IGNORED] * int((~counts).sum())
    return replace(
        image,
        boxes_xyxy=image.boxes_xyxy[counts],
        class_names=tuple(name for name in names if name != IGNORED),
        crowds_xyxy=np.concatenate([image.crowds_xyxy, image.boxes_xyxy[~counts]]),
        crowd_names=tuple("" if name == IGNORED else name for name in crowd_names),
    )


def with_poses(
    data: LabelledDataset,
    table: PoseTable | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> LabelledDataset:
    """The same with the altitude and ground that the pictures' files say, or before them a table.

    What the labels say already stays. Raises UserError as ``PoseTable.of_pictures``.
    """
    paths = [image.path for image in data.images]
    told = [Taken()] * len(paths) if table is None else table.of_pictures(paths, data.path)
    images = []
    for number, (image, row) in enumerate(zip(data.images, told, strict=True), start=1):
        if image.altitude_agl_m is None or image.ground_m2 is None:
            taken = row.filled_from(taken_of(image.path))
            height_m = image.altitude_agl_m if image.altitude_agl_m is not None else taken.over_ground_m
            area_m2 = replace(taken, altitude_agl_m=height_m).ground_m2(*size_px_of(image.path))
            known = image.ground_m2 if image.ground_m2 is not None else area_m2
            image = replace(image, altitude_agl_m=height_m, ground_m2=known)
        images.append(image)
        progress(number, len(data.images))
    return replace(data, images=tuple(images))
