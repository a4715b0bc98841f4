"""Keeps pictures of the detector's camera, for the live page, the replay and the video."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2

from skysweep.mission.journal import Journal
from skysweep.results.picture_files import write_picture
from skysweep.types import PictureSensor

PERIOD_S = 0.4  # between pictures: every look at the detector's usual rate
_WIDEST_PX = 1280
_QUALITY = 70
_TOLERANCE_S = 1e-6
_LEFT_FREE_BYTES = 64 << 20  # for the journal and the results


class Film:
    """A journal that keeps one picture of ``PERIOD_S`` in ``folder``, named by the time of its ``look`` line.

    Frames of a mission flown again are empty: their pictures exist. A disk that is nearly full costs the
    picture, so that the journal has room. Implements ``mission.journal.Journal``.
    """

    def __init__(self, journal: Journal, folder: Path, sensor: PictureSensor) -> None:
        self._journal, self._folder, self._sensor = journal, folder, sensor
        self._due_s = 0.0

    @property
    def failed(self) -> str | None:
        return self._journal.failed

    def write(self, time_s: float, kind: str, **fields: Any) -> None:
        self._journal.write(time_s, kind, **fields)
        if kind != "look" or "failure" in fields or time_s < self._due_s - _TOLERANCE_S:
            return
        self._due_s = time_s + PERIOD_S
        assert self._sensor.last_look is not None
        image, path = self._sensor.last_look[0].image, self._folder / film_name(time_s)
        with suppress(OSError):
            has_room = shutil.disk_usage(self._folder.parent).free > _LEFT_FREE_BYTES
            if image.size and not path.exists() and has_room:
                self._folder.mkdir(exist_ok=True)
                write_picture(path, _jpeg(image))


def film_name(time_s: float) -> str:
    """File name of the picture of the ``look`` line at ``time_s``."""
    return f"{time_s:.4f}.jpg"


def _jpeg(image: Any) -> bytes:
    """A picture (H, W, 3) RGB, made smaller if it is large."""
    height, width = image.shape[:2]
    if width > _WIDEST_PX:
        size = _WIDEST_PX, round(height * _WIDEST_PX / width)
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return jpeg.tobytes()
