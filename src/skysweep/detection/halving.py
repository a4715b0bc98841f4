"""Pictures from low altitudes are given to the detector at half of their size, or less.

A detector misses what spans more pixels than it learned from, and a small picture takes less time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from skysweep.scenarios.model import CameraModel, DetectorModel
from skysweep.types import Detections, Detector, Frame

LEAST_SIDE_PX = 640  # of a halved picture's longer side


def halved_below_m(camera: CameraModel, detector: DetectorModel, smallest_m: float) -> tuple[float, ...]:
    """Heights below which a model that takes any size gets pictures halved once, twice and so on.

    The highest comes first. A picture is halved while the smallest target, of ``smallest_m``, is longer than
    ``detector.halve_above_px`` in its middle, over level ground. What is looked at in tiles is not halved.
    """
    lens, depression_rad = camera.lens, -camera.gimbal.pitch_rad
    most = max(lens.width_px, lens.height_px) // LEAST_SIDE_PX
    once_m = lens.focal_px * smallest_m / detector.halve_above_px * math.sin(depression_rad)
    if detector.tiles > 1 or once_m <= 0.0:
        return ()
    return tuple(once_m / 2**k for k in range(most.bit_length() - 1))


def n_halvings(below_m: Sequence[float], height_agl_m: float) -> int:
    """How often a picture from this height is halved."""
    return sum(height_agl_m < limit_m for limit_m in below_m)


class HalvingDetector:
    """Gives another detector its pictures, those from below the heights ``below_m`` halved.

    ``ground_at_m`` tells the ground's height (ENU) at x and y. Implements ``types.Detector``.
    """

    def __init__(
        self, detector: Detector, below_m: Sequence[float], ground_at_m: Callable[[float, float], float]
    ) -> None:
        self._detector, self._below_m, self._ground_at_m = detector, below_m, ground_at_m
        self.class_names = detector.class_names

    def detect(self, frame: Frame) -> Detections:
        """Boxes in the whole frame's pixels."""
        x, y, z = frame.camera.position_enu_m.tolist()
        halvings = n_halvings(self._below_m, z - self._ground_at_m(x, y))
        if not halvings:
            return self._detector.detect(frame)
        height, width = frame.image.shape[:2]
        size_px = width >> halvings, height >> halvings
        small = np.asarray(cv2.resize(frame.image, size_px, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        found = self._detector.detect(replace(frame, image=small))
        whole = np.array([width, height] * 2) / np.array(size_px * 2)
        return replace(found, boxes_xyxy_px=found.boxes_xyxy_px * whole)

    def interrupt(self) -> None:
        """Break off a look in another thread, where the detector can."""
        if (interrupt := getattr(self._detector, "interrupt", None)) is not None:
            interrupt()
