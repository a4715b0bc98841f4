"""Pictures of the statistical sensor beside what it was fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter
from numpy.typing import NDArray
from scipy.special import ndtr
from scipy.stats import binomtest

from skysweep.arrays import I64
from skysweep.experiments.calibration.check import EDGES, THRESHOLDS, Told
from skysweep.experiments.calibration.fit import GRID_PX, MISSION_CONFIDENCE_MIN, is_among, shifts_of
from skysweep.experiments.calibration.looks import CLASSES, SUBJECTS, SURFACES, Background, ScoredLooks
from skysweep.geometry.camera import Lens
from skysweep.scenarios.model import DEFAULT_SIZE_M
from skysweep.sensing.statistical.factors import FACTORS
from skysweep.sensing.statistical.model import BackgroundModel, KindModel, StatisticalModel, score_of
from skysweep.types import F64

_COLOURS = dict(zip(CLASSES, ("#D55E00", "#0072B2", "#009E73"), strict=True))
_COLUMNS = 4
_MIN_LOOKS = 8
_USUAL_LOOKS = 200  # over which the lines average
_NO_SHIFT = np.zeros((1, len(FACTORS) + 1 + len(SURFACES)))
_DISTRACTORS = [kind for kind in DEFAULT_SIZE_M if kind not in CLASSES]


def draw_fit(
    looks: ScoredLooks, background: Background, told: Told, model: StatisticalModel, path: Path
) -> None:
    """Draw everything in one picture.

    Above are two panels for each kind and pose: rate and confidence of reports over pixels on target. Dots
    with bars are measured, with 95 % (Clopper-Pearson) intervals. Lines are what the sensor draws at the
    missions' threshold for usual looks; the band holds two thirds. Below are held-out looks, by factor and by
    their predicted chance. The last panels show reports of nothing and reports of look-alikes over altitude.

    Of a fit to real pictures it shows only what these tell: kinds, pixels, and reports of nothing.
    """
    real = model.pictures
    subjects = [k for k in range(len(SUBJECTS)) if real is None or (looks.subject == k).any()]
    factors = list(EDGES) if real is None else ["pixels"]
    n_checks = len(factors) + (3 if real is None else 2)
    columns = min(_COLUMNS, max(len(subjects), n_checks))
    rows, check_rows = -(-len(subjects) // columns), -(-n_checks // columns)
    heights = [3.3 * rows, 3.3 * check_rows]
    figure = Figure(figsize=(3.1 * columns, sum(heights) + 0.2), layout="constrained")
    above, below = cast("Any", figure.subfigures(2, 1, height_ratios=heights))
    _draw_kinds(above, (rows, columns), subjects, looks, told, model)
    panels = below.subplots(check_rows, columns).ravel()
    _draw_checks(panels, told, factors)
    _draw_background(panels[len(factors) + 1], background, model)
    if real is None:
        _draw_distractors(panels[len(factors) + 2], model)
    for spare in panels[n_checks:]:
        spare.axis("off")
    n_pictures = model.experiment.pictures if real is None else real.pictures
    n_looks = model.experiment.looks if real is None else len(looks.pixels)
    figure.suptitle(
        f"Statistical sensor for detector '{model.detector.name}': {n_pictures} pictures, {n_looks} looks; "
        f"reports with confidence ≥ {MISSION_CONFIDENCE_MIN:g}",
        fontsize=11,
        wrap=True,
    )
    figure.savefig(path, dpi=100)


def _draw_kinds(
    figure: Any,
    shape: tuple[int, int],
    subjects: Sequence[int],
    looks: ScoredLooks,
    told: Told,
    model: StatisticalModel,
) -> None:
    rows, columns = shape
    axes = figure.subplots(2 * rows, columns, sharex=True, height_ratios=[1.0, 0.8] * rows, squeeze=False)
    fits = {(k.kind, k.pose, k.reported_as): k for k in model.kinds}
    for place, index in enumerate(subjects):
        kind, pose = SUBJECTS[index]
        row, column = divmod(place, columns)
        above, below = axes[2 * row, column], axes[2 * row + 1, column]
        mine = looks.where(looks.subject == index)
        what = f"{kind}, {pose}" if model.pictures is None else kind
        above.set_title(f"{what} ({len(mine.pixels)} looks)", fontsize=9)
        usual = _usual_factors(told, index)
        for c, name in enumerate(CLASSES):
            if (kind, pose, name) in fits:
                _measured(above, below, mine.pixels, mine.confidences[:, c], name)
                _drawn(above, below, fits[kind, pose, name], usual, name)
        _decorate(above, below, first=column == 0)
    for spare in range(len(subjects), rows * columns):
        row, column = divmod(spare, columns)
        for axis in axes[2 * row : 2 * row + 2, column]:
            axis.set_axis_off()
    handles = [
        above.errorbar([], [], [], fmt="-o", color=colour, markersize=3, label=f"reported as {name}")
        for name, colour in _COLOURS.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)


def _usual_factors(told: Told, subject: int) -> F64:
    """(G, M, F) of evenly chosen looks from about each size: what stands near has less company in view."""
    factors = told.factors[told.subject == subject]
    if not len(factors):
        return _NO_SHIFT
    bins = _bins(told.values["pixels"][told.subject == subject])
    found = [factors[bins == g] if (bins == g).any() else factors for g in range(len(GRID_PX))]
    return np.stack([f[np.linspace(0, len(f) - 1, _USUAL_LOOKS).astype(int)] for f in found])


def _bins(pixels: F64) -> I64:
    """The nearest node of the grid, on a log scale."""
    edges = np.sqrt(np.array(GRID_PX[1:]) * np.array(GRID_PX[:-1]))
    return np.asarray(np.searchsorted(edges, pixels))


def drawn_rates(kind: KindModel, factors: F64, confidence: float = MISSION_CONFIDENCE_MIN) -> F64:
    """(G,) share of looks in which the sensor reports this kind, over looks with these factors.

    These are the same at every size, (M, F), or others at each, (G, M, F).
    """
    means = np.array(kind.score)[:, None] + factors @ shifts_of(kind)
    above = ndtr((means - score_of(confidence)) / np.array(kind.spread)[:, None])
    lapse = np.where(is_among(factors), *np.array([kind.lapse_among, kind.lapse])[..., None])
    return np.asarray(((1.0 - lapse) * above).mean(axis=1))


def _measured(above: Axes, below: Axes, pixels: F64, confidences: F64, name: str) -> None:
    bins = _bins(pixels)
    for g in range(len(GRID_PX)):
        inside = confidences[bins == g]
        if len(inside) < _MIN_LOOKS:
            continue
        reports = inside[inside >= MISSION_CONFIDENCE_MIN]
        x = np.exp(np.log(pixels[bins == g]).mean())
        _dot(above, float(x), len(reports), len(inside), _COLOURS[name])
        if len(reports) >= _MIN_LOOKS:
            middle = np.median(reports)
            spread = np.abs(np.quantile(reports, [0.16, 0.84]) - middle)[:, None]
            below.errorbar([x], [middle], spread, fmt="o", color=_COLOURS[name], markersize=3, linewidth=0.9)


def _dot(axes: Axes, x: float, k: int, n: int, colour: str) -> None:
    """A measured share with its 95 % interval."""
    low, high = binomtest(k, n).proportion_ci()
    bar = [[k / n - low], [high - k / n]]
    axes.errorbar([x], [k / n], bar, fmt="o", color=colour, markersize=3, linewidth=0.9)


def _drawn(above: Axes, below: Axes, kind: KindModel, factors: F64, name: str) -> None:
    rates = drawn_rates(kind, factors)
    above.plot(GRID_PX, rates, color=_COLOURS[name], linewidth=1.3)
    steps = np.linspace(MISSION_CONFIDENCE_MIN, 0.999, 200)
    share_above = np.array([drawn_rates(kind, factors, step) for step in steps]) / np.maximum(rates, 1e-9)
    quantiles = (0.16, 0.5, 0.84)
    low, middle, high = np.array([np.interp(quantiles, 1.0 - share, steps) for share in share_above.T]).T
    likely = rates >= 0.01
    below.plot(GRID_PX, np.where(likely, middle, np.nan), color=_COLOURS[name], linewidth=1.3)
    below.fill_between(GRID_PX, low, high, where=list(likely), color=_COLOURS[name], alpha=0.18, linewidth=0)


def _decorate(above: Axes, below: Axes, first: bool) -> None:
    for axes in (above, below):
        _log_axis(axes, (3.7, 230), [5, 10, 20, 50, 100, 200])
        axes.set_ylim(-0.03, 1.03)
        axes.grid(alpha=0.25, linewidth=0.5)
        axes.tick_params(labelsize=7, labelbottom=axes is below)
    below.set_ylim(0.2, 1.03)
    below.set_xlabel("pixels on target", fontsize=8)
    if first:
        above.set_ylabel("reported in a look", fontsize=8)
        below.set_ylabel("confidence", fontsize=8)


def _draw_checks(panels: NDArray[Any], told: Told, factors: Sequence[str]) -> None:
    own = told.is_own
    for axes, name in zip(panels, factors, strict=False):
        labels = []
        for k, (low, high) in enumerate(pairwise(EDGES[name])):
            inside = own & (told.values[name] >= low) & (told.values[name] < high)
            labels.append(f"{low:g}-{high:g}")
            if inside.any():
                _dot(axes, k, int(told.reported(0)[inside].sum()), int(inside.sum()), "#444444")
                axes.plot([k - 0.3, k + 0.3], [told.chance[inside, 0].mean()] * 2, color="#D55E00")
        axes.set_xticks(range(len(labels)), labels, fontsize=6)
        _finish(axes, f"targets, held out: {name}", "reported in a look")
        axes.set_ylim(-0.03, 1.03)
    axes = panels[len(factors)]
    for t, (threshold, colour) in enumerate(zip(THRESHOLDS, ("#444444", "#0072B2"), strict=True)):
        which = np.minimum((told.chance[:, t] * 10).astype(int), 9)
        for b in np.unique(which):
            inside = which == b
            if inside.sum() >= _MIN_LOOKS:
                x = float(told.chance[inside, t].mean())
                _dot(axes, x, int(told.reported(t)[inside].sum()), int(inside.sum()), colour)
        axes.plot([], [], "o", color=colour, markersize=3, label=f"confidence ≥ {threshold:g}")
    axes.plot([0, 1], [0, 1], color="#D55E00", linewidth=1)
    axes.legend(fontsize=7, frameon=False)
    axes.set_xlabel("told from other worlds or pictures", fontsize=8)
    _finish(axes, "all looks, held out", "reported in a look")


def _draw_background(axes: Axes, seen: Background, model: StatisticalModel) -> None:
    edges = np.geomspace(2.5, 130.0, 7)
    for c, name in enumerate(CLASSES):
        strong = (seen.class_index == c) & (seen.confidences >= MISSION_CONFIDENCE_MIN)
        counts, _ = np.histogram(seen.altitude_agl_m[seen.picture_of_report[strong]], edges)
        ground, _ = np.histogram(seen.altitude_agl_m, edges, weights=seen.hectares)
        some = (ground > 0) & (counts > 0)
        middles, rates = np.sqrt(edges[1:] * edges[:-1]), counts[some] / ground[some]
        bars = np.sqrt(counts[some]) / ground[some]
        axes.errorbar(middles[some], rates, bars, fmt="o", color=_COLOURS[name], markersize=3, linewidth=0.9)
        fitted = next((b for b in model.background if b.reported_as == name), None)
        if fitted is not None:
            reports = background_reports(fitted, model, seen)
            expected, _ = np.histogram(seen.altitude_agl_m, edges, weights=reports)
            looked = ground > 0
            axes.plot(middles[looked], expected[looked] / ground[looked], color=_COLOURS[name])
    axes.set_ylim(bottom=0.0)
    _finish_altitudes(axes, "reports where nothing is", "a hectare and look")


def _draw_distractors(axes: Axes, model: StatisticalModel) -> None:
    for kind, marker in zip(_DISTRACTORS, "osv^DxPX*", strict=True):
        altitudes, rates = taken_for_targets(model, kind)
        axes.plot(altitudes, rates, marker=marker, markersize=3, linewidth=1, label=kind)
    axes.set_ylim(-0.03, 1.03)
    axes.legend(fontsize=6, frameon=False)
    _finish_altitudes(axes, "look-alikes taken for a target", "in a look")


def background_reports(fitted: BackgroundModel, model: StatisticalModel, seen: Background) -> F64:
    """(M,): predicted reports in each picture at the missions' threshold."""
    at, grid = np.log(seen.altitude_agl_m), np.log(fitted.altitude_agl_m)
    excess = score_of(MISSION_CONFIDENCE_MIN) - score_of(model.experiment.confidence_floor)
    scale = fitted.unit_scale * np.interp(at, grid, fitted.score_scale)
    strong = np.exp(-((excess / scale) ** fitted.score_shape))
    on = np.array([fitted.surfaces[name] for name in SURFACES])[seen.surface]
    of_ground = seen.hectares * np.interp(at, grid, fitted.per_hectare) * on
    of_trees = seen.trees * np.interp(at, grid, fitted.per_tree)
    of_cut_trees = seen.cut_trees * np.interp(at, grid, fitted.per_cut_tree)
    return np.asarray(strong * (of_ground + of_trees + of_cut_trees))


def taken_for_targets(model: StatisticalModel, kind: str) -> tuple[F64, F64]:
    """Altitudes (m) and the chance that a look from there reports this kind as any target.

    The object has the usual size and ground and is seen from straight above through the calibrated lens.
    """
    camera = model.camera
    lens = Lens(camera.width_px, camera.height_px, camera.hfov_rad)
    altitudes = np.array([3.0, 6.0, 12.0, 20.0, 30.0, 50.0, 80.0])
    pixels = lens.pixels_on_target(DEFAULT_SIZE_M[kind], altitudes)
    missed = np.ones(len(altitudes))
    for k in model.kinds:
        if k.kind == kind:
            rates = np.interp(np.log(pixels), np.log(model.pixels), drawn_rates(k, _NO_SHIFT))
            missed *= 1.0 - np.where(pixels < model.pixels[0], 0.0, rates)
    return altitudes, 1.0 - missed


def _finish_altitudes(axes: Axes, title: str, ylabel: str) -> None:
    _log_axis(axes, (2.5, 130), [3, 6, 12, 25, 50, 100])
    axes.set_xlabel("altitude above ground (m)", fontsize=8)
    _finish(axes, title, ylabel)


def _log_axis(axes: Axes, limits: tuple[float, float], ticks: list[int]) -> None:
    axes.set_xscale("log")
    axes.set_xlim(limits)
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))


def _finish(axes: Axes, title: str, ylabel: str) -> None:
    axes.set_title(title, fontsize=9)
    axes.set_ylabel(ylabel, fontsize=8)
    axes.grid(alpha=0.25, linewidth=0.5)
    axes.tick_params(labelsize=7)
