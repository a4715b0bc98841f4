"""Two detectors on the same pictures: the difference, with an interval over the pictures.

Labels of one picture share its light, ground and camera, so whole pictures are resampled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skysweep.arrays import F64
from skysweep.detection.training.evaluate import Evaluation, Label
from skysweep.results.reporting.html import Grid
from skysweep.results.reporting.statistics import Estimate, estimate, ratio_of_means

TOLD_FROM = 2  # pictures with labels of a class


class Difference(NamedTuple):
    """The second detector less the first, of one class."""

    class_name: str
    n_only_first: int  # labels that the first alone found
    n_only_second: int
    recall: Estimate | None  # None: too few pictures have labels
    false_per_picture: Estimate


def differences(first: Evaluation, second: Evaluation) -> list[Difference]:
    """For every class that both know."""
    return [_difference(first, second, name) for name in first.classes if name in second.classes]


def _difference(first: Evaluation, second: Evaluation, name: str) -> Difference:
    (labels, found_first, false_first), (_, found_second, false_second) = (
        _by_picture(e, name) for e in (first, second)
    )
    at = first.confidence_min
    pairs = [
        (a.confidence >= at, b.confidence >= at)
        for a, b in zip(_labels(first, name), _labels(second, name), strict=True)
    ]
    some = labels > 0
    recall = None
    if some.sum() >= TOLD_FROM:
        recall = ratio_of_means((found_second - found_first)[some], labels[some])
    return Difference(
        name,
        sum(a and not b for a, b in pairs),
        sum(b and not a for a, b in pairs),
        recall,
        estimate(false_second - false_first),
    )


def _labels(evaluation: Evaluation, name: str) -> list[Label]:
    return [label for label in evaluation.labels if label.class_name == name]


def _by_picture(evaluation: Evaluation, name: str) -> tuple[F64, F64, F64]:
    """Labels, found labels and false reports in each picture."""
    labels, found, false = (np.zeros(evaluation.n_images) for _ in range(3))
    for label in evaluation.labels:
        if label.class_name == name:
            labels[label.picture] += 1
            found[label.picture] += label.confidence >= evaluation.confidence_min
    for report in evaluation.reports:
        if report.class_name == name and report.label is None:
            false[report.picture] += report.confidence >= evaluation.confidence_min
    return labels, found, false


def paired_grid(first_name: str, second_name: str, found: list[Difference]) -> Grid:
    """A row a class."""
    header = (
        "class",
        f"only {first_name}",
        f"only {second_name}",
        "recall",
        "95 %",
        "false / picture",
        "95 %",
    )
    rows = [
        (
            d.class_name,
            str(d.n_only_first),
            str(d.n_only_second),
            *(("-", "-") if d.recall is None else _cells(d.recall)),
            *_cells(d.false_per_picture),
        )
        for d in found
    ]
    return Grid(header, rows, f"{second_name} less {first_name}, on the same pictures")


def _cells(of: Estimate) -> tuple[str, str]:
    return f"{of.mean:+.3f}", f"{of.low:+.3f} to {of.high:+.3f}" if np.isfinite(of.low) else "-"


def paired_json(found: list[Difference]) -> list[dict[str, object]]:
    """The same as plain data."""

    def told(of: Estimate | None) -> dict[str, float] | None:
        return None if of is None else {"mean": of.mean, "low": of.low, "high": of.high}

    return [
        {
            "class": d.class_name,
            "only_first": d.n_only_first,
            "only_second": d.n_only_second,
            "recall": told(d.recall),
            "false_per_picture": told(d.false_per_picture),
        }
        for d in found
    ]
