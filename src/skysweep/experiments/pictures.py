"""A few of the pictures that a mission decided on, with the detector's boxes, for the report."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from skysweep.sensing.imaging import ImagingSensor
from skysweep.types import Detections, Frame, VehicleState

MAX_PICTURES = 8
_COLOURS = {"stop sign": (0, 140, 255), "person": (255, 200, 0), "boat": (255, 0, 200)}
_ENLARGE = 2


class PictureBook:
    """Keeps the first picture with a detection of every stretch of SCAN and of CHECK, at most eight.

    It looks at what the sensor looked at last. Finds have pictures of their own, as many as there are.
    """

    def __init__(self, folder: Path, sensor: ImagingSensor) -> None:
        self._folder = folder
        self._sensor = sensor
        self._mode = ""
        self._wanted = False
        self._kept = 0

    def watch(self, state: VehicleState, mode: str, detections: Detections | None) -> None:
        """Show it every step of a mission."""
        if mode != self._mode:
            self._mode, self._wanted = mode, True
        close = mode != "CHECK" or state.velocity_enu_mps[2] > -0.3
        if detections is None or not len(detections) or not self._wanted or not close:
            return
        look = self._sensor.last_look
        if look is None or self._kept == MAX_PICTURES:
            return
        frame, answer = look
        height = f"{state.position_enu_m[2]:.0f}m"
        _write(self._folder / f"{int(frame.time_s):04d}s-{mode.lower()}-{height}.jpg", frame, answer)
        self._wanted = False
        self._kept += 1

    def keep_find(self, candidate: int) -> Path | None:
        """The picture, kept now, in which a candidate was confirmed; None where there is none."""
        path = self._folder / "found" / f"candidate-{candidate}.jpg"
        look = self._sensor.last_look
        return path if look is not None and _write(path, *look) else None


def _write(path: Path, frame: Frame, answer: Detections) -> bool:
    """A frame of a mission flown again is empty: its picture is there. A full disk costs the picture."""
    if not frame.image.size:
        return False
    _, jpeg = cv2.imencode(".jpg", drawn(frame, answer)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(jpeg.tobytes())
    except OSError:
        return False
    return True


def drawn(frame: Frame, detections: Detections) -> np.ndarray:
    """The picture (H, W, 3) RGB, enlarged, with a box, class and confidence for every detection."""
    image = cv2.resize(frame.image, None, fx=_ENLARGE, fy=_ENLARGE, interpolation=cv2.INTER_CUBIC)
    for box, name, confidence in zip(
        detections.boxes_xyxy_px, detections.class_names, detections.confidences, strict=True
    ):
        colour = _COLOURS.get(name, (255, 255, 255))
        x0, y0, x1, y1 = (round(float(v)) for v in box * _ENLARGE)
        cv2.rectangle(image, (x0 - 2, y0 - 2), (x1 + 2, y1 + 2), colour, 2, cv2.LINE_AA)
        place = (max(x0 - 2, 2), y0 - 8 if y0 > 24 else y1 + 20)
        text = f"{name} {confidence:.2f}"
        for shade, thickness in (((0, 0, 0), 3), (colour, 1)):
            cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.55, shade, thickness, cv2.LINE_AA)
    return image
