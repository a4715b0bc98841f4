"""What the detector saw of a candidate, cut out of its picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from skysweep.results.picture_files import SAME_LOOK_S, told_by_name
from skysweep.results.run_folder import Record, Run

_AROUND = 2.0  # times the box, on each side of its middle
_LEAST_SHARE = 0.1  # of the picture's width, on each side of the box's middle


def picture_of(run: Run, candidate: int) -> Path | None:
    """The newest picture that the run folder keeps of a candidate."""
    named = ((told, path) for path in run.pictures if (told := told_by_name(path)) is not None)
    times_s = {path: time_s for (of, time_s), path in named if of == candidate}
    return max(times_s, key=times_s.__getitem__, default=None)


def crop_of(run: Run, candidate: int) -> bytes | None:
    """The part around the candidate's box as JPEG; the whole picture where it was not found in that look.

    None without a picture.
    """
    path = picture_of(run, candidate)
    told = None if path is None else told_by_name(path)
    image = None if path is None else cv2.imread(str(path))
    if told is None or image is None:
        return None
    box = _box_of(run, candidate, told[1])
    if box is not None:
        height, width = image.shape[:2]
        scale = width / run.scenario.camera.width_px
        x0, y0, x1, y1 = (scale * side for side in box)
        half = max(_AROUND * (x1 - x0) / 2, _AROUND * (y1 - y0) / 2, _LEAST_SHARE * width)
        left, right = _clipped((x0 + x1) / 2, half, width)
        top, bottom = _clipped((y0 + y1) / 2, half, height)
        image = image[top:bottom, left:right]
    _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return jpeg.tobytes()


def _clipped(middle: float, half: float, end: int) -> tuple[int, int]:
    """A range of pixels of the same length around a middle, moved into the picture."""
    length = min(round(2 * half), end)
    first = min(max(round(middle - half), 0), end - length)
    return first, first + length


def _box_of(run: Run, candidate: int, time_s: float) -> Sequence[float] | None:
    """Its box in the detector's answer to the picture of that time, from the look that told the sighting."""
    look: Record | None = None
    for record in run.records:
        if record["kind"] == "look":
            look = record
        elif (
            record["kind"] == "sighting"
            and record["candidate"] == candidate
            and abs(record["t"] - time_s) < SAME_LOOK_S
            and look is not None
            and look.get("confidences")
        ):
            nearest = int(np.argmin(np.abs(np.array(look["confidences"]) - record["confidence"])))
            return list(look["boxes_xyxy_px"][nearest])
    return None
