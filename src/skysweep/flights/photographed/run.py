"""Looks at the pictures of a flight with a detector, and writes what it found as a run folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from skysweep.detection.model_files import existing_model_file, sha256_of
from skysweep.detection.photos.pose_table import read_poses
from skysweep.detection.training.class_map import ours
from skysweep.detection.yolo import YoloDetector
from skysweep.errors import UserError
from skysweep.files.writing import make_folder
from skysweep.flights.photographed.answers import ANSWERS_FILE, answers_of
from skysweep.flights.photographed.places import scenario_of
from skysweep.flights.photographed.shots import Problem, shots_of
from skysweep.flights.photographed.telling import tell
from skysweep.results.pictures_report import detections_left_out
from skysweep.results.run_folder import load_flown, refuse_links
from skysweep.results.writing import write_results
from skysweep.scenarios.model import TargetClass
from skysweep.worlds.world import build_world


@dataclass(frozen=True, slots=True)
class Options:
    """How a flight's pictures are looked at."""

    model: str = "skysweep"
    classes: tuple[str, ...] = ()  # ours, to report; empty: those that missions search for
    confidence_min: float = 0.25
    tiles: int = 1
    boxes: Any = None  # as ``YoloDetector`` has them
    pixels: Any = None
    channels: Any = None
    poses: Path | None = None
    dem: Path | None = None
    hfov_deg: float | None = None
    every_s: float = 1.0  # of a video


@dataclass(frozen=True, slots=True)
class Looked:
    """What came of it."""

    n_pictures: int
    n_candidates: int
    left_out: tuple[Problem, ...]
    detections_left_out: dict[str, int]  # by class; of a size that it has not, or on no ground


def look_at_flight(
    source: Path,
    out: Path,
    options: Options,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Looked:
    """Detect in every picture, put what was found on the map and write the results of a mission into ``out``.

    An interrupted call goes on where it was when it is repeated. ``progress`` is called with the number of
    pictures that are done, and of all. Raises UserError where nothing can be done.
    """
    _refuse_others(source, out)
    table = None if options.poses is None else read_poses(options.poses)
    hfov_rad = None if options.hfov_deg is None else math.radians(options.hfov_deg)
    shots, problems = shots_of(source, table, hfov_rad, options.every_s, options.dem is not None)
    detector = YoloDetector(
        options.model,
        confidence_min=options.confidence_min,
        tiles=options.tiles,
        threads=2,
        boxes=options.boxes,
        pixels=options.pixels,
        channels=options.channels,
    )
    classes = _classes(detector.class_names, options)
    made_with = {
        "model": options.model,
        "confidence_min": options.confidence_min,
        "tiles": options.tiles,
        "boxes": options.boxes,
        "pixels": options.pixels,
        "channels": options.channels,
    }
    scenario = scenario_of(shots, source.resolve().name, made_with, options.dem)
    world = build_world(scenario, 0)
    make_folder(out)
    refuse_links(out)
    setup = {
        **made_with,
        "sha256": sha256_of(existing_model_file(options.model)),
        "classes": list(classes),
        "source": str(source.resolve()),
    }
    answers = answers_of(shots, detector, classes, out, setup, progress)
    n = tell(out, scenario, world, shots, answers, problems)
    damaged = [Problem(s.name, a.failure) for s, a in zip(shots, answers, strict=True) if a.failure]
    run = load_flown(out)
    write_results(run, out)
    return Looked(len(shots) - len(damaged), n, (*problems, *damaged), detections_left_out(run))


def _refuse_others(source: Path, out: Path) -> None:
    """Raises UserError where ``out`` holds anything that this command did not write, or shares a folder."""
    pictures, results = source.resolve(), out.resolve()
    if pictures.is_relative_to(results) or results.is_relative_to(pictures):
        raise UserError(f"--out {out}: the pictures are kept there; write a folder apart from {source}")
    if not out.exists() or (out / ANSWERS_FILE).is_file():
        return
    if not out.is_dir() or any(out.iterdir()):
        raise UserError(f"--out {out}: holds something else; write a new folder")


def _classes(known: Sequence[str], options: Options) -> tuple[str, ...]:
    """Ours, of those that the detector knows."""
    names = dict.fromkeys(ours(name) for name in known)
    wanted = options.classes or get_args(TargetClass)
    found = tuple(name for name in wanted if name in names)
    missing = [name for name in options.classes if name not in names]
    if missing or not found:
        what = f"has no class {missing[0]!r}" if missing else f"has none of {', '.join(wanted)}"
        raise UserError(f"--find: the model {what}; write some of {', '.join(names)}")
    return found
