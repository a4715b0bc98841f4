"""A picture of the statistical sensor beside what it was fitted to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter
from numpy.typing import NDArray
from scipy.special import expit, logit
from scipy.stats import beta, norm

from skysweep.experiments.sensor_fit import GRID_PX, MISSION_CONFIDENCE_MIN
from skysweep.experiments.sensor_looks import CLASSES, SUBJECTS, Looks
from skysweep.sensing.statistical import KindModel, StatisticalModel

F64 = NDArray[np.float64]

_COLOURS = dict(zip(CLASSES, ("#D55E00", "#0072B2", "#009E73"), strict=True))
_COLUMNS = 4
_TICKS_PX = [5, 10, 20, 50, 100, 200]
_MIN_LOOKS = 5


def draw_fit(looks: Looks, model: StatisticalModel, path: Path) -> None:
    """Rate and confidence of reports over pixels on target, a panel for each kind and pose.

    Dots with bars: measured, with 95 % (Clopper-Pearson) intervals. Lines: what the sensor draws at the
    missions' threshold. Lower panels: confidences of reports; the band is one standard deviation.
    """
    rows = -(-len(SUBJECTS) // _COLUMNS)
    figure = Figure(figsize=(3.1 * _COLUMNS, 3.6 * rows), layout="constrained")
    axes = figure.subplots(2 * rows, _COLUMNS, sharex=True, height_ratios=[1.0, 0.8] * rows, squeeze=False)
    for index, (kind, pose) in enumerate(SUBJECTS):
        row, column = divmod(index, _COLUMNS)
        above, below = axes[2 * row, column], axes[2 * row + 1, column]
        mine = looks.subject == index
        above.set_title(f"{kind}, {pose} ({mine.sum()} looks)", fontsize=9)
        for c, name in enumerate(CLASSES):
            fitted = next(
                (k for k in model.kinds if (k.kind, k.pose, k.reported_as) == (kind, pose, name)), None
            )
            if fitted is not None:
                _measured(above, below, looks.pixels[mine], looks.confidences[mine, c], name)
                _drawn(above, below, fitted, name)
        _decorate(above, below, first=column == 0)
    for spare in range(len(SUBJECTS), rows * _COLUMNS):
        row, column = divmod(spare, _COLUMNS)
        axes[2 * row, column].set_axis_off()
        axes[2 * row + 1, column].set_axis_off()
    figure.suptitle(
        f"Statistical sensor fitted to detector '{model.detector}' on {model.pictures} rendered pictures, "
        f"reports with confidence ≥ {MISSION_CONFIDENCE_MIN:g}",
        fontsize=11,
    )
    handles = [
        above.errorbar([], [], [], fmt="-o", color=colour, markersize=3, label=f"reported as {name}")
        for name, colour in _COLOURS.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def drawn_rates(kind: KindModel, n_offsets: int = 400) -> F64:
    """(G,) share of looks in which the sensor reports this kind, over all its objects."""
    u = norm.ppf((np.arange(n_offsets) + 0.5) / n_offsets)[:, None] * kind.object_logit_std
    p = np.clip(np.array(kind.probability), 1e-12, 1 - 1e-12)
    mean, std = np.array(kind.confidence_logit_mean), np.array(kind.confidence_logit_std)
    above = norm.sf((logit(MISSION_CONFIDENCE_MIN) - mean - u) / std)
    return np.asarray((expit(logit(p) + u) * above).mean(axis=0))


def _measured(above: Axes, below: Axes, pixels: F64, confidences: F64, name: str) -> None:
    edges = np.sqrt(np.array(GRID_PX[1:]) * np.array(GRID_PX[:-1]))
    bins = np.searchsorted(edges, pixels)
    for g in range(len(GRID_PX)):
        inside = confidences[bins == g]
        if len(inside) < _MIN_LOOKS:
            continue
        reports = inside[inside >= MISSION_CONFIDENCE_MIN]
        n, k = len(inside), len(reports)
        x = np.exp(np.log(pixels[bins == g]).mean())
        low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
        high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
        style: Any = {"fmt": "o", "color": _COLOURS[name], "markersize": 3, "linewidth": 0.9}
        above.errorbar([x], [k / n], [[k / n - low], [high - k / n]], **style)
        if k >= _MIN_LOOKS:
            middle = np.median(reports)
            spread = np.abs(np.quantile(reports, [0.16, 0.84]) - middle)[:, None]
            below.errorbar([x], [middle], spread, **style)


def _drawn(above: Axes, below: Axes, kind: KindModel, name: str) -> None:
    rates = drawn_rates(kind)
    above.plot(GRID_PX, rates, color=_COLOURS[name], linewidth=1.3)
    mean = np.array(kind.confidence_logit_mean)
    std = np.hypot(np.array(kind.confidence_logit_std), kind.object_logit_std)
    floor = norm.cdf((logit(MISSION_CONFIDENCE_MIN) - mean) / std)  # what lies below is not reported
    low, middle, high = (expit(mean + std * norm.ppf(floor + (1 - floor) * q)) for q in (0.16, 0.5, 0.84))
    likely = rates >= 0.01
    below.plot(GRID_PX, np.where(likely, middle, np.nan), color=_COLOURS[name], linewidth=1.3)
    below.fill_between(GRID_PX, low, high, where=list(likely), color=_COLOURS[name], alpha=0.18, linewidth=0)


def _decorate(above: Axes, below: Axes, first: bool) -> None:
    for axes in (above, below):
        axes.set_xscale("log")
        axes.set_xlim(4.5, 230)
        axes.set_ylim(-0.03, 1.03)
        axes.grid(alpha=0.25, linewidth=0.5)
        axes.xaxis.set_major_locator(FixedLocator(_TICKS_PX))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.tick_params(labelsize=7, labelbottom=axes is below)
    below.set_ylim(0.2, 1.03)
    below.set_xlabel("pixels on target", fontsize=8)
    if first:
        above.set_ylabel("reported in a look", fontsize=8)
        below.set_ylabel("confidence", fontsize=8)
