"""Data sets to train and test detectors on: rendered pictures, and pictures made of a user's own photos."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from skysweep.detection.training.labelled import LabelledImage, write_labels
from skysweep.detection.training.photo_pictures import photos_in, pictures_of, shares_of
from skysweep.detection.training.random_worlds import SIDE_PX, Split, recipe_for
from skysweep.detection.training.rendered_pictures import PICTURES_PER_WORLD, render_world
from skysweep.errors import UserError
from skysweep.files.writing import UNFINISHED, whole_files
from skysweep.scenarios.model import CameraKind

PHOTO_SHARE = 0.5  # of the pictures, where there are photos

Job = tuple[Callable[..., list[LabelledImage]], tuple[Any, ...]]


def render_dataset(
    out: Path,
    n_images: int,
    *,
    seed: int = 0,
    split: Split = "train",
    camera: CameraKind = "visible",
    clutter: bool = False,
    photos: Sequence[Path] = (),
    renames: Mapping[str, str] | None = None,
    workers: int | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Path:
    """Make labelled pictures of random worlds, and of photos, as a COCO and YOLO data set.

    Writes ``images/``, ``labels/``, ``data.yaml`` and ``annotations.json`` (with each picture's altitude and
    the boxes of look-alikes). A label is the box of an object's visible pixels; objects of which less than
    35 % is visible have none. The same arguments give the same data set, whatever the number of workers.

    Args:
        out: a folder that does not exist yet, or is empty.
        n_images: how many pictures.
        seed: seeds worlds, views and what is made of the photos.
        split: "train" or "held-out" assets.
        camera: "visible", or "thermal" for white-hot pictures of persons and animals, among warm rocks.
        clutter: fields, roads, houses, jetties and more, in pictures as different as those of cameras. Cars
            and animals are labelled, too.
        photos: folders of photos, of which half of the pictures are made; see ``photo_pictures``.
        renames: our names of the classes in the photos' labels, as for ``class_map.ours``.
        workers: processes; default: one per CPU.
        progress: called with the number of pictures done.

    Raises:
        UserError: ``out`` is not empty or cannot be written to, or photos or labels cannot be used, or
            there are too few pictures to make one of a photo.
    """
    if n_images < 1:
        raise UserError(f"n_images: {n_images} is too few; write at least 1")
    if out.is_dir() and (inside := [path.name for path in out.iterdir()]):
        rest = all(name.startswith(UNFINISHED) for name in inside)
        what = f"holds a data set that is not finished ({inside[0]}); delete it" if rest else "not empty"
        raise UserError(f"{out}: {what}, or write the path of a new folder")
    if camera != "visible" and (clutter or photos):
        what = "clutter" if clutter else "photos"
        raise UserError(f"{what}: are for visible cameras only; leave them out, or the thermal camera")
    if photos and n_images < 2:
        raise UserError(f"--pictures {n_images}: half of them are made of photos; write at least 2")
    classes = recipe_for(camera, clutter).classes
    backgrounds = photos_in(photos, renames or {}, classes)
    n_of_photos = round(PHOTO_SHARE * n_images) if backgrounds else 0
    with whole_files(out) as unfinished:
        (unfinished / "images").mkdir()
        jobs = _render_jobs(unfinished, n_images - n_of_photos, seed, split, camera, clutter)
        first = n_images - n_of_photos
        for share in shares_of(backgrounds, n_of_photos, seed):
            jobs.append((pictures_of, (unfinished, share, first + share.first, seed, split)))
        images = _done(jobs, workers, progress)
        info: dict[str, Any] = {"description": "rendered by skysweep dataset", "split": split, "seed": seed}
        if camera != "visible":
            info["camera"] = camera
        if clutter:
            info["clutter"] = True
        if backgrounds:
            info["photos"] = len(backgrounds)
        write_labels(unfinished, classes, images, (SIDE_PX, SIDE_PX), info)
    return out


def _render_jobs(
    out: Path, n_pictures: int, seed: int, split: Split, camera: CameraKind, clutter: bool
) -> list[Job]:
    starts = range(0, n_pictures, PICTURES_PER_WORLD)
    return [
        (render_world, (out, k, min(PICTURES_PER_WORLD, n_pictures - start), seed, split, camera, clutter))
        for k, start in enumerate(starts)
    ]


def _done(jobs: Sequence[Job], workers: int | None, progress: Callable[[int], None]) -> list[LabelledImage]:
    """The pictures of all jobs, in their order."""
    images: dict[int, list[LabelledImage]] = {}
    n_workers = min(workers or os.cpu_count() or 1, len(jobs))
    with ProcessPoolExecutor(n_workers, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(job, *arguments): k for k, (job, arguments) in enumerate(jobs)}
        try:
            for future in as_completed(futures):
                images[futures[future]] = future.result()
                progress(sum(map(len, images.values())))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return [image for index in sorted(images) for image in images[index]]
