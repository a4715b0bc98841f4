"""The detector's view: the pictures of the film, or the scenario rendered from the believed pose."""

from __future__ import annotations

import cv2
import numpy as np

from skysweep.arrays import F64, U8
from skysweep.geometry.camera import Lens, project
from skysweep.results.film import FilmedLooks, Shot, decoded
from skysweep.results.reporting.style import ORANGE
from skysweep.results.video import pen
from skysweep.results.video.pen import Label, rgb
from skysweep.results.video.story import Moment, Story
from skysweep.text import printable
from skysweep.worlds.rendering.renderer import Renderer
from skysweep.worlds.rendering.white_hot import seen

_STALE_S = 3.0  # a look that old no longer belongs to the moment
_WHITE = rgb("white")
_FILMED = "Detector's camera"
_RENDERED = "Detector's view, rendered from the believed pose"
_NO_PICTURES = "Camera's view, rendered: the sensor took no pictures"


class Eye:
    """Draws the view; ``painter`` belongs to it alone, so that its shadows are kept from frame to frame."""

    def __init__(self, story: Story, painter: Renderer, width_px: int, height_px: int) -> None:
        self._story, self._painter = story, painter
        self._looks = FilmedLooks(story.run)
        lens = story.run.scenario.camera.lens
        self._scale = min(width_px / lens.width_px, height_px / lens.height_px)
        size = round(lens.width_px * self._scale), round(lens.height_px * self._scale)
        self._lens = Lens(*size, lens.hfov_rad)
        self._sightings = sorted(story.run.events("sighting"), key=story.run.since_start)

    def draw(self, moment: Moment, scale: float) -> tuple[U8, list[Label], str]:
        """The view with the detector's boxes, its labels, and what it is.

        ``scale`` is that of lines and letters.
        """
        shot = self._looks.at(moment.time_s, pictured=self._looks.has_pictures)
        if shot is not None and moment.time_s - shot.time_s > _STALE_S:
            shot = None
        picture = None if shot is None or shot.picture is None else self._read(shot)
        title = _FILMED if picture is not None else _RENDERED if self._looks.shots else _NO_PICTURES
        if picture is None:
            pose = self._story.camera(moment.time_s if shot is None else shot.exposed_s)
            camera = self._story.run.scenario.camera
            picture = seen(camera, self._painter, self._lens, pose, moment.time_s).copy()
        boxes, words = (
            self._sighted(moment) if shot is None else (shot.boxes_xyxy_px * self._scale, shot.labels)
        )
        labels = []
        for (x0, y0, x1, y1), text in zip(boxes.tolist(), words, strict=True):
            corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
            pen.line(picture, corners, rgb(ORANGE), 2.0 * scale, closed=True)
            labels.append(self._label((x0, y0, x1, y1), text, scale))
        return picture, labels, title

    def _label(self, box: tuple[float, float, float, float], text: str, scale: float) -> Label:
        """Above its box or below, towards the middle of the view, so that it stays within."""
        x0, y0, x1, y1 = box
        gap = 6.0 * scale
        y, upright = (y0 - gap, "s") if y0 > 18.0 * scale else (max(y1, 0.0) + gap, "a")
        if x0 < self._lens.width_px / 2:
            x, side = max(x0, gap), "l"
        else:
            x, side = min(x1, self._lens.width_px - gap), "r"
        return Label(x, y, text, 10 * scale, _WHITE, side + upright, chip=True)

    def _read(self, shot: Shot) -> U8 | None:
        """The picture of a shot in the view's size; None where it is missing or damaged."""
        if (jpeg := shot.jpeg()) is None:
            return None
        size = self._lens.width_px, self._lens.height_px
        return np.asarray(cv2.resize(decoded(jpeg), size, interpolation=cv2.INTER_AREA), np.uint8)

    def _sighted(self, moment: Moment) -> tuple[F64, tuple[str, ...]]:
        """Boxes (N, 4) around what a sensor without pictures has just reported."""
        run = self._story.run
        if self._looks.shots:
            return np.empty((0, 4)), ()
        since_s = moment.time_s - max(
            1.0 / run.scenario.detector.rate_hz, self._story.speed / self._story.fps
        )
        boxes, words = [], []
        for sighting in self._sightings:
            if since_s < run.since_start(sighting) <= moment.time_s:
                (centre,), (depth,) = project(self._lens, moment.camera, sighting["p"])
                if depth > 0:
                    half = self._scale * run.scenario.pixels_on_target(float(depth))
                    boxes.append([*(centre - half), *(centre + half)])
                    name = printable(str(sighting.get("class_name", "")))
                    words.append(f"{name} {sighting['confidence']:.2f}".strip())
        return np.array(boxes).reshape(-1, 4), tuple(words)
