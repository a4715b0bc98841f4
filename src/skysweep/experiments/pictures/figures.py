"""Figures of evaluations: precision and recall, and reliability."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from skysweep.detection.training.evaluate import Evaluation
from skysweep.experiments.pictures.curves import calibration_error, precision_recall, reliability
from skysweep.results.reporting.style import (
    GREY,
    PAGE_IN,
    SERIES_COLOURS,
    SERIES_DASHES,
    figure_bytes,
    style,
)


def precision_recall_png(evaluations: Mapping[str, Evaluation]) -> bytes:
    """A panel a class, a curve a detector, and a dot at the threshold of the counts."""
    classes = list(dict.fromkeys(c for e in evaluations.values() for c in e.classes))
    with style():
        figure = Figure(figsize=(PAGE_IN, 2.6), layout="constrained")
        for axis, name in zip(figure.subplots(1, len(classes), squeeze=False)[0], classes, strict=True):
            for k, (label, e) in enumerate(evaluations.items()):
                curve = precision_recall(e, name)
                if curve is None:
                    continue
                colour, dash = SERIES_COLOURS[k % len(SERIES_COLOURS)], SERIES_DASHES[k % len(SERIES_DASHES)]
                words = f"{label}, AP {curve.average_precision:.2f}"
                axis.plot(curve.recall, curve.precision, dash, color=colour, lw=1.4, label=words)
                n = int((curve.confidence >= e.confidence_min).sum())
                if n:
                    axis.plot(curve.recall[n - 1], curve.precision[n - 1], "o", color=colour, ms=4)
            axis.set(title=name, xlabel="Recall", xlim=(0, 1.02), ylim=(0, 1.02))
            axis.grid(lw=0.3, color="0.85")
            if axis.lines:
                axis.legend(frameon=False, fontsize=6.5)
        figure.axes[0].set_ylabel("Precision")
        return figure_bytes(figure, "png")


def reliability_png(evaluations: Mapping[str, Evaluation]) -> bytes:
    """The share of detections that are right over their confidence."""
    with style():
        figure = Figure(figsize=(PAGE_IN / 2, 2.9), layout="constrained")
        axis = figure.subplots()
        axis.plot([0, 1], [0, 1], color=GREY, lw=0.8)
        for k, (label, e) in enumerate(evaluations.items()):
            found = reliability(e)
            if not found:
                continue
            shares = [r.share_right for r in found]
            bars = [[r.share_right - r.low for r in found], [r.high - r.share_right for r in found]]
            words = f"{label}, error {calibration_error(found):.2f}"
            colour = SERIES_COLOURS[k % len(SERIES_COLOURS)]
            axis.errorbar(
                [r.confidence for r in found], shares, bars, fmt="-o", color=colour, ms=3, lw=1, label=words
            )
        axis.set(xlabel="Confidence", ylabel="Share of detections that are right", xlim=(0, 1), ylim=(0, 1))
        axis.grid(lw=0.3, color="0.85")
        axis.legend(frameon=False)
        return figure_bytes(figure, "png")
