"""Curves over all confidences of an evaluation: precision and recall, and how true confidences are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

from skysweep.arrays import F64
from skysweep.detection.training.evaluate import Evaluation

_BINS = 10  # of confidences


class PrecisionRecall(NamedTuple):
    """At falling thresholds (T,)."""

    confidence: F64
    precision: F64
    recall: F64

    @property
    def average_precision(self) -> float:
        """Area below the curve whose precision never rises again (PASCAL VOC 2010)."""
        best = np.maximum.accumulate(self.precision[::-1])[::-1]
        return float((np.diff(self.recall, prepend=0.0) * best).sum())


class Reliable(NamedTuple):
    """The detections of one range of confidences."""

    confidence: float  # their mean
    n: int
    share_right: float
    low: float  # of the share's 95 % (Clopper-Pearson) interval
    high: float


def precision_recall(evaluation: Evaluation, class_name: str) -> PrecisionRecall | None:
    """The curve of one class; None without a label or a detection."""
    reports = [r for r in evaluation.reports if r.class_name == class_name]
    n_labels = sum(label.class_name == class_name for label in evaluation.labels)
    if not reports or not n_labels:
        return None
    confidence = np.array([r.confidence for r in reports])
    order = np.argsort(-confidence, kind="stable")
    right = np.cumsum(np.array([r.label is not None for r in reports])[order])
    falling = confidence[order]
    last = np.append(falling[1:] < falling[:-1], True)  # of equal ones: a threshold takes all of them
    return PrecisionRecall(
        falling[last], (right / np.arange(1, len(order) + 1))[last], right[last] / n_labels
    )


def reliability(evaluation: Evaluation) -> list[Reliable]:
    """Ranges of confidence, ascending, of detections of all classes."""
    confidence = np.array([r.confidence for r in evaluation.reports])
    right = np.array([r.label is not None for r in evaluation.reports], dtype=bool)
    which = np.minimum((confidence * _BINS).astype(int), _BINS - 1)
    found = []
    for b in np.unique(which).tolist():
        inside = which == b
        k, n = int(right[inside].sum()), int(inside.sum())
        low, high = binomtest(k, n).proportion_ci()
        found.append(Reliable(float(confidence[inside].mean()), n, k / n, float(low), float(high)))
    return found


def calibration_error(reliable: list[Reliable]) -> float | None:
    """Mean distance of confidence and share right, weighted by detections; None without one."""
    n = sum(r.n for r in reliable)
    return sum(r.n * abs(r.confidence - r.share_right) for r in reliable) / n if n else None
