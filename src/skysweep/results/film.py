"""The looks of a mission's detector, with the pictures that its film kept of them."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skysweep.arrays import U8
from skysweep.results.picture_files import read_picture
from skysweep.results.run_folder import FILM, Record, Run
from skysweep.text import printable
from skysweep.types import F64

_SAME_LOOK_S = 0.01


@dataclass(frozen=True, slots=True)
class Shot:
    """One look of the detector, with its picture where the film has it. Times count from the take-off."""

    time_s: float  # when its answer came
    exposed_s: float
    boxes_xyxy_px: F64  # (N, 4)
    labels: tuple[str, ...]  # (N,) class and confidence
    picture: Path | None

    def jpeg(self) -> bytes | None:
        """The picture; None where there is none, or none that is as it was written."""
        try:
            return None if self.picture is None else read_picture(self.picture)
        except OSError:
            return None


class FilmedLooks:
    """All looks of a mission, in order. Pictures are named by the times of their lines: ``12.4000.jpg``."""

    def __init__(self, run: Run) -> None:
        pictures = _pictures(run)
        names_s = np.array([time_s for time_s, _ in pictures])
        self.shots = tuple(_shot(run, look, pictures, names_s) for look in run.events("look"))
        self._lens = run.scenario.camera.lens
        self._times_s = [shot.time_s for shot in self.shots]

    @cached_property
    def has_pictures(self) -> bool:
        return any(shot.picture is not None for shot in self.shots)

    @cached_property
    def picture_scale(self) -> float:
        """Width of the pictures over that of the camera: large ones are kept smaller. 1 without pictures."""
        for shot in self.shots:
            if (jpeg := shot.jpeg()) is not None:
                return float(decoded(jpeg).shape[1] / self._lens.width_px)
        return 1.0

    def at(self, time_s: float, pictured: bool = False) -> Shot | None:
        """The newest look that was answered by then, only those with a picture if so wished; None: none."""
        for k in range(bisect_right(self._times_s, time_s) - 1, -1, -1):
            if not pictured or self.shots[k].picture is not None:
                return self.shots[k]
        return None


def decoded(jpeg: bytes) -> U8:
    """A picture (H, W, 3) in RGB."""
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.ascontiguousarray(image[..., ::-1], dtype=np.uint8)


def _pictures(run: Run) -> list[tuple[float, Path]]:
    """The pictures by the journal's time."""
    found = []
    for path in (run.folder / FILM).glob("*.jpg") if run.folder is not None else ():
        try:
            found.append((float(path.stem), path))
        except ValueError:
            continue  # not one of ours
    return sorted(found)


def _shot(run: Run, look: Record, pictures: list[tuple[float, Path]], names_s: Any) -> Shot:
    time_s = run.since_start(look)
    k = int(np.searchsorted(names_s, look["t"] - _SAME_LOOK_S))
    of_it = k < len(pictures) and abs(names_s[k] - look["t"]) <= _SAME_LOOK_S
    words = zip(look.get("class_names", ()), look.get("confidences", ()), strict=True)
    return Shot(
        time_s,
        time_s - run.scenario.camera.latency_s,
        np.array(look.get("boxes_xyxy_px", []), dtype=float).reshape(-1, 4),
        tuple(f"{printable(str(name))} {confidence:.2f}" for name, confidence in words),
        pictures[k][1] if of_it else None,
    )
