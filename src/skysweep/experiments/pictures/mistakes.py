"""The worst mistakes of a detector, cut out of their pictures."""

from __future__ import annotations

from collections.abc import Iterable

import cv2

from skysweep.detection.photos.pixels import read_picture
from skysweep.detection.training.evaluate import Evaluation, Label, Report
from skysweep.results.reporting.html import Picture, data_uri

SHOWN = 12  # of each sort
_AROUND = 3.0  # times the box
_SIDE_PX = 360
_LEAST_PX = 48.0  # around a small box
_LINE_BGR = (0, 94, 213)


def false_reports(evaluation: Evaluation) -> list[Picture]:
    """The most confident detections of nothing."""
    false = (r for r in evaluation.reports if r.label is None and r.confidence >= evaluation.confidence_min)
    worst = sorted(false, key=lambda r: -r.confidence)[:SHOWN]
    return [_cut_out(evaluation, r, f"{r.class_name} {r.confidence:.2f} where none is") for r in worst]


def missed_labels(evaluation: Evaluation) -> list[Picture]:
    """The largest labels that were not found."""
    missed = (label for label in evaluation.labels if label.confidence < evaluation.confidence_min)
    worst = sorted(missed, key=lambda label: -label.pixels)[:SHOWN]
    return [_cut_out(evaluation, label, f"{label.class_name} not found") for label in worst]


def _cut_out(evaluation: Evaluation, of: Label | Report, words: str) -> Picture:
    path = evaluation.pictures[of.picture].path
    image = cv2.cvtColor(read_picture(path), cv2.COLOR_RGB2BGR)
    height, width = image.shape[:2]
    left, top, right, bottom = of.box_xyxy_px
    half = max(_AROUND * of.pixels, _LEAST_PX) / 2
    x, y = (left + right) / 2, (top + bottom) / 2
    x0, y0 = max(int(x - half), 0), max(int(y - half), 0)
    x1, y1 = min(int(x + half) + 1, width), min(int(y + half) + 1, height)
    scale = _SIDE_PX / max(x1 - x0, y1 - y0, 1)
    part = cv2.resize(image[y0:y1, x0:x1], None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    upper_left, lower_right = (
        (round((u - x0) * scale), round((v - y0) * scale)) for u, v in ((left, top), (right, bottom))
    )
    cv2.rectangle(part, upper_left, lower_right, _LINE_BGR, 2, cv2.LINE_AA)
    _, jpeg = cv2.imencode(".jpg", part, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return Picture(data_uri(jpeg.tobytes(), "image/jpeg"), f"{words}, {of.pixels:.0f} px, {path.name}")


def worst_pictures(evaluations: Iterable[tuple[str, Evaluation]]) -> list[tuple[str, list[Picture]]]:
    """A title and pictures for each sort of mistake of each detector."""
    found = []
    for label, evaluation in evaluations:
        found.append((f"{label}: the most confident false reports", false_reports(evaluation)))
        found.append((f"{label}: the largest that were missed", missed_labels(evaluation)))
    return [(title, pictures) for title, pictures in found if pictures]
