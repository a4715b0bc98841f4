"""Detectors without a mission."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skysweep.detection.layouts import BoxUnit, Channels, PixelRange
from skysweep.detection.yolo import YoloDetector
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.types import Detections, Frame


def load_detector(
    model: str | Path = "skysweep",
    classes: Sequence[str] | None = None,
    *,
    confidence_min: float = 0.25,
    tiles: int = 1,
    threads: int = 1,
    boxes: BoxUnit | None = None,
    pixels: PixelRange | None = None,
    channels: Channels | None = None,
) -> ImageDetector:
    """The shipped detector, or an ONNX file of the YOLO family.

    Args:
        model: "skysweep" or the path of an ONNX file.
        classes: names to keep; None keeps all.
        confidence_min: weaker detections are dropped, 0..1.
        tiles: split each picture into ``tiles`` x ``tiles`` enlarged parts, which finds smaller things at
            ``tiles**2`` times the cost.
        threads: CPU threads.
        boxes: what the model's boxes are measured in, where its file leaves that open.
        pixels: what pixel values the model takes, if not those of its family's exports.
        channels: the order of their channels, likewise.

    Raises:
        UserError: the file is missing or broken, has no such class, or leaves one of the last three open.
    """
    if isinstance(classes, str):
        raise UserError(f"classes: is '{classes}'; write a list, such as ['{classes}']")
    return ImageDetector(
        YoloDetector(
            model,
            classes,
            confidence_min=confidence_min,
            tiles=tiles,
            threads=threads,
            boxes=boxes,
            pixels=pixels,
            channels=channels,
        )
    )


class ImageDetector:
    """A detector for plain images. It also takes frames, so that a mission can use it."""

    def __init__(self, detector: YoloDetector) -> None:
        self._detector = detector
        self.class_names = detector.class_names

    def detect(self, image: Any) -> Detections:
        """Boxes, confidences and class names in an image (H, W, 3) RGB of bytes, or in a ``Frame``.

        Raises UserError if ``image`` is neither.
        """
        return self._detector.detect(image if isinstance(image, Frame) else _frame_of(image))

    def interrupt(self) -> None:
        """Break off a look in another thread."""
        self._detector.interrupt()


def _frame_of(image: Any) -> Frame:
    pixels = np.asarray(image)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8 or not pixels.size:
        raise UserError(
            f"image: is an array {pixels.shape} of {pixels.dtype}; give (height, width, 3) of uint8, RGB"
        )
    height, width, _ = pixels.shape
    return Frame(0.0, pixels, CameraPose(np.zeros(3), np.eye(3)), Lens(width, height, 1.0))
