"""What a detector makes of labelled pictures: every label, every detection, and counts of both.

A detection is right when it overlaps a label of its class by an intersection over union of at least
``_IOU_MIN``; one that lies in a crowd or an ignored region by more than half is neither right nor false.
Pixels on target are the longer side of the box; a false positive counts in the bin of its own size. All is
kept from ``CONFIDENCE_FLOOR`` on. The most confident detections choose first, so what is matched at a higher
threshold is what is matched here with that confidence. A false detection on a look-alike or a label of
another class (by at least ``_DECOY_IOU_MIN``) says what was taken for what.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from skysweep.arrays import F64
from skysweep.detection.photos.pixels import read_picture
from skysweep.detection.training.class_map import ours, with_our_names
from skysweep.detection.training.labelled import LabelledDataset, LabelledImage
from skysweep.detection.training.matching import intersection_shares, iou, match
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.types import Detections, Detector, Frame

PIXEL_BINS = (0, 8, 12, 16, 24, 40, 60, 100, np.inf)
ALTITUDE_BINS_M = (0, 3, 6, 12, 25, 50, 100, np.inf)
LIGHT_BINS = (0, 50, 90, 130, 170, np.inf)  # mean brightness of the picture, 0..255
CONFIDENCE_FLOOR = 0.05
CONFIRMING_CONFIDENCE = 0.6  # the paper's c_t
_IOU_MIN = 0.5
_SAME_IOU = 0.5  # detections of two classes that are one of ours are of one thing from there on
_DECOY_IOU_MIN = 0.3
_NOWHERE = CameraPose(np.zeros(3), np.eye(3))

Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture that was looked at."""

    path: Path
    altitude_agl_m: float | None
    ground_m2: float | None
    brightness: float  # mean, 0..255


@dataclass(frozen=True, slots=True)
class Label:
    """A label, and how confidently it was found."""

    picture: int
    class_name: str
    box_xyxy_px: Box
    confidence: float  # of the detection that is right; 0: there is none

    @property
    def pixels(self) -> float:
        """The longer side."""
        return _pixels(self.box_xyxy_px)


@dataclass(frozen=True, slots=True)
class Report:
    """A detection that is right or false."""

    picture: int
    class_name: str
    box_xyxy_px: Box
    confidence: float
    label: int | None  # that it is right about

    @property
    def pixels(self) -> float:
        """The longer side."""
        return _pixels(self.box_xyxy_px)


@dataclass(frozen=True, slots=True)
class Decoy:
    """A look-alike or a label, and the most confident false detection of another class on it."""

    kind: str
    pixels: float
    confidence: float  # 0: none
    taken_for: str | None  # the class of that detection


@dataclass
class Score:
    """Counts of one class in one bin."""

    n_targets: int = 0
    n_found: int = 0
    n_confirming: int = 0  # found with at least CONFIRMING_CONFIDENCE
    n_false: int = 0

    def __add__(self, other: Score) -> Score:
        return Score(
            self.n_targets + other.n_targets,
            self.n_found + other.n_found,
            self.n_confirming + other.n_confirming,
            self.n_false + other.n_false,
        )


@dataclass
class DecoyScore:
    """How often a kind of look-alike or label in one bin was taken for something else."""

    n: int = 0
    n_taken: int = 0
    n_confirmed: int = 0  # with at least CONFIRMING_CONFIDENCE
    taken_for: dict[str, int] = field(default_factory=dict)  # how often for which class


Scores = dict[
    tuple[str, float], Score
]  # by class and the bin's lower edge; bins are (from, to), ``to`` excluded


@dataclass
class Evaluation:
    """One detector on one data set. The counts are of detections from ``confidence_min`` on."""

    confidence_min: float
    classes: tuple[str, ...]
    pictures: list[Picture] = field(default_factory=list)
    labels: list[Label] = field(default_factory=list)
    reports: list[Report] = field(default_factory=list)
    seen_decoys: list[Decoy] = field(default_factory=list)

    @property
    def n_images(self) -> int:
        """The number of pictures."""
        return len(self.pictures)

    @property
    def hectares(self) -> float | None:
        """Ground in the pictures of which it is known; None where it is of none."""
        known = [p.ground_m2 for p in self.pictures if p.ground_m2]
        return sum(known) / 1e4 if known else None

    @property
    def by_pixels(self) -> Scores:
        """By the size of labels and detections."""
        return self._scores(lambda each: each.pixels, PIXEL_BINS)

    @property
    def by_altitude(self) -> Scores:
        """By the altitude of the pictures whose it is known."""
        return self._scores(lambda each: self.pictures[each.picture].altitude_agl_m, ALTITUDE_BINS_M)

    @property
    def by_light(self) -> Scores:
        """By the mean brightness of the pictures."""
        return self._scores(lambda each: self.pictures[each.picture].brightness, LIGHT_BINS)

    @property
    def decoys(self) -> dict[tuple[str, float], DecoyScore]:
        """By kind and size."""
        found: dict[tuple[str, float], DecoyScore] = {}
        for decoy in self.seen_decoys:
            score = found.setdefault((decoy.kind, bin_of(decoy.pixels, PIXEL_BINS)), DecoyScore())
            score.n += 1
            if decoy.taken_for is not None and decoy.confidence >= self.confidence_min:
                score.n_taken += 1
                score.taken_for[decoy.taken_for] = score.taken_for.get(decoy.taken_for, 0) + 1
            score.n_confirmed += decoy.confidence >= CONFIRMING_CONFIDENCE
        return found

    def total(self, class_name: str) -> Score:
        """Of one class, over all sizes."""
        return sum((s for (name, _), s in self.by_pixels.items() if name == class_name), Score())

    def false_per_hectare(self, class_name: str) -> float | None:
        """In the pictures whose ground is known; None where it is of none."""
        if self.hectares is None:
            return None
        false = [r for r in self.reports if r.class_name == class_name and r.label is None]
        counted = [
            r for r in false if r.confidence >= self.confidence_min and self.pictures[r.picture].ground_m2
        ]
        return len(counted) / self.hectares

    def _scores(self, value_of: Callable[[Label | Report], float | None], edges: Sequence[float]) -> Scores:
        scores: Scores = {}
        for label in self.labels:
            if (value := value_of(label)) is not None:
                score = scores.setdefault((label.class_name, bin_of(value, edges)), Score())
                score.n_targets += 1
                score.n_found += label.confidence >= self.confidence_min
                score.n_confirming += label.confidence >= CONFIRMING_CONFIDENCE
        for report in self.reports:
            value = value_of(report)
            if report.label is None and report.confidence >= self.confidence_min and value is not None:
                scores.setdefault((report.class_name, bin_of(value, edges)), Score()).n_false += 1
        return scores


def evaluate(
    detector: Detector,
    dataset: LabelledDataset,
    *,
    confidence_min: float = 0.25,
    renames: Mapping[str, str] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Evaluation:
    """Run a detector over a data set whose classes have our names, for those that both know.

    The detector's names become ours, as ``class_map.ours`` has them with ``renames``. Give it a threshold of
    ``CONFIDENCE_FLOOR``, for curves over all thresholds.

    Raises UserError if they share no class, the set is empty, or a picture cannot be read.
    """
    known = {ours(name, renames) for name in detector.class_names}
    classes = tuple(c for c in dataset.class_names if c in known)
    if not classes:
        raise UserError(
            f"{dataset.path}: its classes ({', '.join(dataset.class_names)}) are none of the detector's "
            f"({', '.join(detector.class_names)}); name them alike, such as --class boat=ship"
        )
    if not dataset.images:
        raise UserError(f"{dataset.path}: the data set has no pictures")
    result = Evaluation(confidence_min, classes)
    for number, image in enumerate(dataset.images, start=1):
        _judge(result, detector, image, renames)
        progress(number, len(dataset.images))
    return result


def _judge(
    result: Evaluation, detector: Detector, image: LabelledImage, renames: Mapping[str, str] | None
) -> None:
    picture = read_picture(image.path)
    height, width = picture.shape[:2]
    size = np.array([width, height] * 2, dtype=float)
    found = detector.detect(Frame(0.0, picture, _NOWHERE, Lens(width, height, 1.0)))
    number, n_before = len(result.pictures), len(result.reports)
    brightness = float(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).mean())
    result.pictures.append(Picture(image.path, image.altitude_agl_m, image.ground_m2, brightness))
    found = with_our_names(found, renames)
    of_class = {name: _of_class(found, name) for name in result.classes}
    for name, (boxes, confidences) in of_class.items():
        labels = image.boxes_xyxy[[c == name for c in image.class_names]] * size
        matched = match(boxes, confidences, labels, _IOU_MIN).tolist()
        excused = np.any(intersection_shares(boxes, image.crowds_of(name) * size) > 0.5, axis=1)
        numbers = {}
        for box, k in zip(labels, matched, strict=True):
            numbers[k] = len(result.labels)
            confidence = float(confidences[k]) if k >= 0 else 0.0
            result.labels.append(Label(number, name, _box(box), confidence))
        for k, (box, sure) in enumerate(zip(boxes, confidences.tolist(), strict=True)):
            if k in numbers or not excused[k]:
                result.reports.append(Report(number, name, _box(box), sure, numbers.get(k)))
    false = [report for report in result.reports[n_before:] if report.label is None]
    things = np.concatenate([image.decoys_xyxy, image.boxes_xyxy]) * size
    overlaps = iou(things, np.array([r.box_xyxy_px for r in false]).reshape(-1, 4)) >= _DECOY_IOU_MIN
    for kind, box, on_it in zip(image.decoy_names + image.class_names, things, overlaps, strict=True):
        others = (r for r, on in zip(false, on_it, strict=True) if on and r.class_name != kind)
        worst = max(others, key=lambda r: r.confidence, default=None)
        confidence, taken_for = (worst.confidence, worst.class_name) if worst else (0.0, None)
        result.seen_decoys.append(Decoy(kind, _pixels(_box(box)), confidence, taken_for))


def _of_class(found: Detections, name: str) -> tuple[F64, F64]:
    """Boxes (N, 4) and confidences (N,) of one class."""
    own = np.array([n == name for n in found.class_names], dtype=bool)
    return found.boxes_xyxy_px[own], found.confidences[own]


def _box(box: F64) -> Box:
    left, top, right, bottom = box.tolist()
    return left, top, right, bottom


def _pixels(box: Box) -> float:
    return max(box[2] - box[0], box[3] - box[1])


def bin_of(value: float, edges: Sequence[float]) -> float:
    """The lower edge of the bin that holds ``value``."""
    return float(edges[max(int(np.searchsorted(edges, value, side="right")) - 1, 0)])
