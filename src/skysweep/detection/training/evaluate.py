"""Recall, precision and false positives of a detector on labelled pictures, by pixels on target and altitude.

A detection is right when it overlaps a label of its class by an intersection over union of at least
``_IOU_MIN``. The most confident detections choose first; each label is matched once (the COCO and PASCAL VOC
rule). Pixels on target are the longer side of the box; a false positive counts in the bin of its own size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.table import Table

from skysweep.arrays import F64, I64, U8
from skysweep.detection.training.labelled import LabelledDataset, LabelledImage
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.types import Detector, Frame

PIXEL_BINS = (0, 8, 12, 16, 24, 40, 60, 100, np.inf)
ALTITUDE_BINS_M = (0, 3, 6, 12, 25, 50, 100, np.inf)
_IOU_MIN = 0.5
DECOY_IOU_MIN = 0.3
CONFIRMING_CONFIDENCE = 0.6  # the paper's c_t


@dataclass
class Score:
    """Counts of one class in one bin."""

    n_targets: int = 0
    n_found: int = 0
    n_confirming: int = 0  # found with at least CONFIRMING_CONFIDENCE
    n_false: int = 0


@dataclass
class DecoyScore:
    """How often a kind of look-alike in one bin was taken for a target."""

    n: int = 0
    n_taken: int = 0
    n_confirmed: int = 0  # with at least CONFIRMING_CONFIDENCE


@dataclass
class Evaluation:
    """Counts of one detector on one data set. Bins are (from, to) with ``to`` excluded."""

    n_images: int
    confidence_min: float
    classes: tuple[str, ...]
    by_pixels: dict[tuple[str, float], Score] = field(default_factory=dict)  # (class, bin's lower edge)
    by_altitude: dict[tuple[str, float], Score] = field(default_factory=dict)
    decoys: dict[tuple[str, float], DecoyScore] = field(default_factory=dict)  # (kind, bin's lower edge)


def evaluate(
    detector: Detector,
    dataset: LabelledDataset,
    *,
    confidence_min: float = 0.25,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Evaluation:
    """Run a detector over a data set and count, for the classes whose names both know.

    Raises UserError if they share no class, the set is empty, or a picture cannot be read.
    """
    classes = tuple(c for c in dataset.class_names if c in detector.class_names)
    if not classes:
        raise UserError(
            f"{dataset.path}: its classes ({', '.join(dataset.class_names)}) are none of the detector's "
            f"({', '.join(detector.class_names)}); name them alike"
        )
    if not dataset.images:
        raise UserError(f"{dataset.path}: the data set has no pictures")
    result = Evaluation(len(dataset.images), confidence_min, classes)
    for number, image in enumerate(dataset.images, start=1):
        _count(result, detector, image)
        progress(number, len(dataset.images))
    return result


def _count(result: Evaluation, detector: Detector, image: LabelledImage) -> None:
    picture = read_picture(image.path)
    height, width = picture.shape[:2]
    size = np.array([width, height] * 2, dtype=float)
    found = detector.detect(Frame(0.0, picture, _NOWHERE, Lens(width, height, 1.0)))
    altitude, names = image.altitude_agl_m, np.array(found.class_names, dtype=object)
    sure = found.confidences >= result.confidence_min
    for name in result.classes:
        keep = sure & (names == name)
        boxes, confidences = found.boxes_xyxy_px[keep], found.confidences[keep]
        labels = image.boxes_xyxy[[c == name for c in image.class_names]] * size
        matched = match(boxes, confidences, labels, _IOU_MIN)
        in_crowd = np.any(intersection_shares(boxes, image.crowds_xyxy * size) > 0.5, axis=1)
        for label, detection in zip(labels, matched, strict=True):
            for score in _scores(result, name, _pixels(label), altitude):
                score.n_targets += 1
                score.n_found += bool(detection >= 0)
                score.n_confirming += bool(detection >= 0 and confidences[detection] >= CONFIRMING_CONFIDENCE)
        for index in set(range(len(boxes))) - set(matched.tolist()):
            if not in_crowd[index]:
                for score in _scores(result, name, _pixels(boxes[index]), altitude):
                    score.n_false += 1
    wanted = sure & np.array([c in result.classes for c in names], dtype=bool)
    overlaps = iou(image.decoys_xyxy * size, found.boxes_xyxy_px[wanted]) >= DECOY_IOU_MIN
    for kind, box, taken in zip(image.decoy_names, image.decoys_xyxy * size, overlaps, strict=True):
        decoy = result.decoys.setdefault((kind, bin_of(_pixels(box), PIXEL_BINS)), DecoyScore())
        decoy.n += 1
        decoy.n_taken += bool(taken.any())
        decoy.n_confirmed += bool((found.confidences[wanted][taken] >= CONFIRMING_CONFIDENCE).any())


_NOWHERE = CameraPose(np.zeros(3), np.eye(3))


def _scores(result: Evaluation, name: str, pixels: float, altitude_agl_m: float | None) -> list[Score]:
    scores = [result.by_pixels.setdefault((name, bin_of(pixels, PIXEL_BINS)), Score())]
    if altitude_agl_m is not None:
        key = (name, bin_of(altitude_agl_m, ALTITUDE_BINS_M))
        scores.append(result.by_altitude.setdefault(key, Score()))
    return scores


def read_picture(path: Path) -> U8:
    """A picture (H, W, 3) RGB. Raises UserError if the file is no picture."""
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise UserError(f"{path}: not a readable picture")
    return np.ascontiguousarray(picture[..., ::-1], dtype=np.uint8)


def _pixels(box: F64) -> float:
    return float(max(box[2] - box[0], box[3] - box[1]))


def bin_of(value: float, edges: Sequence[float]) -> float:
    """The lower edge of the bin that holds ``value``."""
    return float(edges[max(int(np.searchsorted(edges, value, side="right")) - 1, 0)])


def _intersections(a: F64, b: F64) -> F64:
    corner = np.maximum(a[:, None, :2], b[None, :, :2])
    extent = np.clip(np.minimum(a[:, None, 2:], b[None, :, 2:]) - corner, 0, None)
    return np.asarray(extent.prod(axis=2))


def _areas(boxes: F64) -> F64:
    return np.asarray((boxes[:, 2:] - boxes[:, :2]).prod(axis=1))


def iou(a: F64, b: F64) -> F64:
    """Intersection over union (N, M) of boxes (N, 4) and (M, 4)."""
    shared = _intersections(a, b)
    return shared / np.maximum(_areas(a)[:, None] + _areas(b)[None] - shared, 1e-12)


def intersection_shares(a: F64, b: F64) -> F64:
    """Share (N, M) of each box of ``a`` that lies in each box of ``b``."""
    return _intersections(a, b) / np.maximum(_areas(a)[:, None], 1e-12)


def match(boxes: F64, confidences: F64, labels: F64, iou_min: float) -> I64:
    """For each label (M, 4) the index of its detection, or -1. The most confident detections choose first."""
    matched = np.full(len(labels), -1, dtype=np.int64)
    overlap = iou(boxes, labels)
    for index in np.argsort(-confidences, kind="stable"):
        free = np.where(matched < 0, overlap[index], 0.0)
        if len(free) and free.max() >= iou_min:
            matched[free.argmax()] = index
    return matched


def _bin_label(lower: float, edges: Sequence[float]) -> str:
    upper = edges[list(edges).index(lower) + 1]
    return f">= {lower:g}" if np.isinf(upper) else f"{lower:g} to {upper:g}"


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.2f}" if whole else "-"


def scores_json(evaluation: Evaluation) -> dict[str, Any]:
    """The counts of an evaluation, as JSON has them. Bins are ``from`` to ``to``, null without an end."""
    return {
        "n_images": evaluation.n_images,
        "confidence_min": evaluation.confidence_min,
        "by_pixels": _counts_json(evaluation.by_pixels, PIXEL_BINS),
        "by_altitude": _counts_json(evaluation.by_altitude, ALTITUDE_BINS_M),
        "look_alikes": _counts_json(evaluation.decoys, PIXEL_BINS),
    }


def _counts_json(
    counts: Mapping[tuple[str, float], Score | DecoyScore], edges: Sequence[float]
) -> list[dict[str, Any]]:
    ends = [None if np.isinf(edge) else float(edge) for edge in edges]
    upper = dict(zip(map(float, edges), ends[1:], strict=False))
    return [
        {"class": name, "from": lower, "to": upper[lower], **asdict(counted)}
        for (name, lower), counted in sorted(counts.items(), key=lambda item: item[0])
    ]


def tables(evaluations: Mapping[str, Evaluation]) -> list[Table]:
    """Tables with the detectors (by label) side by side: by pixels on target, altitude and look-alike."""
    first = next(iter(evaluations.values()))
    made = []
    for title, attribute, edges, unit in (
        ("By pixels on target", "by_pixels", PIXEL_BINS, "px"),
        ("By altitude", "by_altitude", ALTITUDE_BINS_M, "m AGL"),
    ):
        if not getattr(first, attribute):
            continue
        table = Table("class", unit, "targets", title=f"{title} ({first.n_images} pictures)")
        for label in evaluations:
            confirming = f"at >= {CONFIRMING_CONFIDENCE:g}"
            for header in (f"{label}\nrecall", confirming, "precision", "false / picture"):
                table.add_column(header, justify="right")
        for name in dict.fromkeys(c for e in evaluations.values() for c in e.classes):
            for lower in edges[:-1]:
                scores = [
                    getattr(e, attribute).get((name, float(lower)), Score()) for e in evaluations.values()
                ]
                if any(s.n_targets or s.n_false for s in scores):
                    cells = [
                        cell
                        for s in scores
                        for cell in (
                            _share(s.n_found, s.n_targets),
                            _share(s.n_confirming, s.n_targets),
                            _share(s.n_found, s.n_found + s.n_false),
                            f"{s.n_false / first.n_images:.3f}",
                        )
                    ]
                    n_targets = max(s.n_targets for s in scores)
                    table.add_row(name, _bin_label(lower, edges), str(n_targets), *cells)
            table.add_section()
        made.append(table)
    if first.decoys:
        table = Table("look-alike", "px", "seen", title="Look-alikes taken for a target")
        for label, evaluation in evaluations.items():
            table.add_column(f"{label}\n>= {evaluation.confidence_min:g}", justify="right")
            table.add_column(f">= {CONFIRMING_CONFIDENCE:g}", justify="right")
        for kind in sorted({k for k, _ in first.decoys}):
            for lower in PIXEL_BINS[:-1]:
                counts = [e.decoys.get((kind, float(lower)), DecoyScore()) for e in evaluations.values()]
                if counts[0].n:
                    cells = [c for d in counts for c in (_share(d.n_taken, d.n), _share(d.n_confirmed, d.n))]
                    table.add_row(kind, _bin_label(lower, PIXEL_BINS), str(counts[0].n), *cells)
            table.add_section()
        made.append(table)
    return made
