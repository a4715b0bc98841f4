"""Keeps the best picture of every candidate as evidence."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from skysweep.geometry.camera import Lens
from skysweep.mission.journal import Journal
from skysweep.results.picture_files import SAME_LOOK_S, picture_name, told_by_name, write_picture
from skysweep.results.reporting.wording import clock
from skysweep.types import Detections, EventKind, Frame

Image = NDArray[np.uint8]
Box = tuple[int, int, int, int]  # left, top, right, bottom

_BETTER = 1.2  # times the score of the kept picture, then another one replaces it
_LABEL_WIDTH_PX = 1280  # smaller pictures are enlarged to about this, for readable labels
_COLOURS = {"stop sign": (0, 140, 255), "person": (255, 200, 0), "boat": (255, 0, 200)}
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_GAP_PX = 6  # between a label and its box
_EDGE_PX = 2.0  # a box this near to the edge of the picture is cut off
_CUT_OFF = 0.3  # factor on the score of a cut-off candidate
_OWN = 1000.0  # weight of its pixels against those of others, which words should not hide either


class Looking(Protocol):
    """What looks: ``last_look`` is the newest picture that was answered, with the answer."""

    last_look: tuple[Frame, Detections] | None


class PictureBook:
    """A journal that keeps the best picture of every candidate in ``folder``.

    Confidence and a low camera raise the score of a picture; cutting the candidate off lowers it. That with
    which a confirmed one was announced stays; a better one of later is kept beside it. A candidate rejected
    without a detection from low altitude is shown as seen at the rejection. ``before`` are the lines of an
    earlier part of the flight. Implements ``mission.journal.Journal``.
    """

    def __init__(
        self,
        journal: Journal,
        folder: Path,
        sensor: Looking,
        ground_at_m: Callable[[float, float], float],
        before: Iterable[Mapping[str, Any]] = (),
    ) -> None:
        self._journal, self._folder, self._sensor, self._ground_at_m = journal, folder, sensor, ground_at_m
        self._best: dict[int, tuple[float, float]] = {}  # score, altitude above ground
        self._announced: dict[int, Path | None] = {}  # of confirmed candidates
        for record in before:
            if record["kind"] == "sighting":
                self._is_better(**record, whole=True)
            elif record["kind"] == EventKind.CONFIRMED:
                self._announced[record["candidate"]] = self.picture_of(record["candidate"], record["t"])

    @property
    def failed(self) -> str | None:
        return self._journal.failed

    def write(self, time_s: float, kind: str, **fields: Any) -> None:
        self._journal.write(time_s, kind, **fields)
        if kind == EventKind.CONFIRMED:
            self._announced[fields["candidate"]] = self.picture_of(fields["candidate"], time_s)
        if self._sensor.last_look is None or kind not in ("sighting", EventKind.REJECTED):
            return
        frame, found = self._sensor.last_look
        candidate = fields["candidate"]
        if "by" in fields:  # decided from anywhere
            return
        if kind == EventKind.REJECTED:
            _, altitude_agl_m = self._best.get(candidate, (0.0, np.inf))
            if altitude_agl_m > 2.0 * self._altitude_agl_m(frame):
                self._save(candidate, frame, found, None)
        elif frame.time_s == time_s:
            box = int(np.argmin(np.abs(found.confidences - fields["confidence"])))
            if self._is_better(**fields, whole=_is_whole(found.boxes_xyxy_px[box], frame.lens)):
                self._save(candidate, frame, found, box)

    def picture_of(self, candidate: int, until_s: float = np.inf) -> Path | None:
        """The newest picture of a candidate, up to a mission time; None if there is none."""
        times_s = self._times_s(candidate, until_s)
        return max(times_s, key=times_s.__getitem__, default=None)

    def _times_s(self, candidate: int, until_s: float) -> dict[Path, float]:
        """Of the pictures of a candidate, up to a mission time."""
        paths = self._folder.glob(f"candidate-{candidate}-*.jpg")
        times_s = {path: told[1] for path in paths if (told := told_by_name(path)) is not None}
        return {path: time_s for path, time_s in times_s.items() if time_s <= until_s + SAME_LOOK_S}

    def _is_better(
        self, candidate: int, confidence: float, altitude_agl_m: float, whole: bool, **_: Any
    ) -> bool:
        score = confidence / max(altitude_agl_m, 1.0) * (1.0 if whole else _CUT_OFF)
        better = score > _BETTER * self._best.get(candidate, (0.0, np.inf))[0]
        if better:
            self._best[candidate] = score, altitude_agl_m
        return better

    def _altitude_agl_m(self, frame: Frame) -> float:
        x, y, z = frame.camera.position_enu_m.tolist()
        return float(z - self._ground_at_m(x, y))

    def _save(self, candidate: int, frame: Frame, found: Detections, box: int | None) -> None:
        """Frames of a mission flown again are empty: their pictures exist, as do better ones of later.

        A full disk costs the picture.
        """
        path = self._folder / picture_name(candidate, frame.time_s)
        with suppress(OSError):
            if frame.image.size:
                words = f"{self._altitude_agl_m(frame):.1f} m above ground, {clock(frame.time_s)}"
                image = labelled(frame.image, found, box, words)
                _, jpeg = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
                self._folder.mkdir(exist_ok=True)
                write_picture(path, jpeg.tobytes())
            if path.exists():
                kept = {path, self._announced.get(candidate)}
                for worse in set(self._times_s(candidate, frame.time_s)) - kept:
                    worse.unlink()


def _is_whole(box_xyxy_px: NDArray[np.float64], lens: Lens) -> bool:
    x0, y0, x1, y1 = box_xyxy_px.tolist()
    within_x = x0 > _EDGE_PX and x1 < lens.width_px - _EDGE_PX
    return bool(within_x and y0 > _EDGE_PX and y1 < lens.height_px - _EDGE_PX)


def labelled(picture: Image, found: Detections, own: int | None, words: str) -> Image:
    """The picture (H, W, 3) RGB with every detection, and ``words`` in a corner; enlarged if small.

    Detections have box, class and confidence; the one with index ``own`` is bold, and the words are in the
    corner where they hide least of it, and of the others.
    """
    scale = max(1, round(_LABEL_WIDTH_PX / picture.shape[1]))
    image: Any = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    shown: list[tuple[float, Box]] = []
    for k, (box, name, confidence) in enumerate(
        zip(found.boxes_xyxy_px * scale, found.class_names, found.confidences, strict=True)
    ):
        colour = _COLOURS.get(name, (255, 255, 255))
        x0, y0, x1, y1 = (round(float(v)) for v in box)
        cv2.rectangle(image, (x0 - 2, y0 - 2), (x1 + 2, y1 + 2), colour, 5 if k == own else 2, cv2.LINE_AA)
        label = _write(image, f"{name} {confidence:.2f}", (x0, y0, x1, y1))
        weight = _OWN if k == own else 1.0
        shown += [(weight, (x0, y0, x1, y1)), (weight, label)]
    if words:
        height, width = image.shape[:2]
        corners = [(x, y, x, y) for y in (height, -height) for x in (0, width)]
        _write(image, words, min(corners, key=lambda at: _hidden(_label_box(image, words, at), shown)))
    return np.asarray(image, dtype=np.uint8)


def _hidden(by: Box, shown: list[tuple[float, Box]]) -> float:
    """Pixels of boxes that another one hides, weighted."""
    pixels = 0.0
    for weight, (x0, y0, x1, y1) in shown:
        across, along = min(x1, by[2]) - max(x0, by[0]), min(y1, by[3]) - max(y0, by[1])
        pixels += weight * max(across, 0) * max(along, 0)
    return pixels


def label_place(box_xyxy_px: Box, label_px: tuple[int, int], picture_px: tuple[int, int]) -> tuple[int, int]:
    """Left and upper pixel of a label (width, height): above its box or below, always in the picture."""
    x0, y0, _, y1 = box_xyxy_px
    (width, height), (picture_width, picture_height) = label_px, picture_px
    above, below = y0 - _GAP_PX - height, y1 + _GAP_PX
    top = above if above >= 0 else below
    return max(0, min(x0, picture_width - width)), max(0, min(top, picture_height - height))


def _label_box(image: Image, text: str, box: Box) -> Box:
    """Where a label of a box is written."""
    (width, up), down = cv2.getTextSize(text, _FONT, _font_size(image), 3)
    x, y = label_place(box, (width, up + down), (image.shape[1], image.shape[0]))
    return x, y, x + width, y + up + down


def _write(image: Image, text: str, box: Box) -> Box:
    x0, y0, x1, y1 = place = _label_box(image, text, box)
    _, down = cv2.getTextSize(text, _FONT, _font_size(image), 3)
    cv2.rectangle(image, (x0, y0), (x1, y1), (0, 0, 0), cv2.FILLED)
    cv2.putText(image, text, (x0, y1 - down), _FONT, _font_size(image), (255, 255, 255), 3, cv2.LINE_AA)
    return place


def _font_size(image: Image) -> float:
    return 1.5 * float(image.shape[1]) / _LABEL_WIDTH_PX
