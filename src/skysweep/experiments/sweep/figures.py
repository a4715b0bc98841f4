"""The figures of a sweep, each with its data: Pareto front, POS over time, effects of parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from skysweep.experiments.sweep.analysis import Analysis, Curve, Member
from skysweep.experiments.sweep.missions import (
    FALSE_POSITIVES,
    FALSE_SCANS,
    MISSION_TIME,
    RECALL,
    Metric,
    Value,
)
from skysweep.results.reporting.statistics import Estimate, pointwise_band
from skysweep.results.reporting.style import (
    BLUE,
    PAGE_IN,
    SERIES_COLOURS,
    SERIES_DASHES,
    draw_pos_axis,
    save_figures,
    step_values,
    style,
)
from skysweep.results.reporting.symbols import field_title, field_unit, value_text
from skysweep.results.reporting.tables import math_text

POS_STEPS = 200
MOST_POS_CURVES = 6
_MOST_NAMED = 12
_MARKERS = ("o", "s", "^", "D", "v", "P")


def draw_pareto(analysis: Analysis, stem: Path) -> Path:
    """Mean recall and false positives over mean mission time, with the front's members numbered and named.

    Returns the SVG, and writes ``stem.pdf`` and ``stem.csv`` beside it, as the other figures do.
    """
    below = [m for m in (RECALL, FALSE_POSITIVES) if m in analysis.metrics]
    flown = [m for m in analysis.members if m.flown.n]
    front = sorted((m for m in flown if m.on_front), key=lambda m: m.mean(MISSION_TIME))
    others = [m for m in flown if not m.on_front]
    on_front: dict[str, Any] = {"marker": "o", "ls": "", "ms": 5, "color": BLUE}
    off_it: dict[str, Any] = {"marker": "x", "ls": "", "ms": 4, "color": "0.6"}
    with style():
        named = front[:_MOST_NAMED]
        height = 2.6 + 0.15 * math.ceil((len(named) + 2) / 3)
        figure = Figure(figsize=(PAGE_IN, height), layout="constrained")
        axes = figure.subplots(1, len(below), squeeze=False)[0]
        for axis, metric in zip(axes, below, strict=True):
            for member in [*others, *front]:
                look = on_front | {"zorder": 3} if member.on_front else off_it | {"zorder": 2}
                x, y = member.estimates[MISSION_TIME.key], member.estimates[metric.key]
                axis.errorbar(x.mean, y.mean, xerr=_bars(x), yerr=_bars(y), elinewidth=0.7, **look)
            bold: Any = {"fontsize": 7.5, "fontweight": "bold", "zorder": 4}
            for place, numbers in _numbered(named, metric).items():
                axis.annotate(", ".join(numbers), place, (4, 4), textcoords="offset points", **bold)
            axis.set(xlabel="Mean mission time (s)", ylabel=f"Mean {metric.name.lower()}")
            axis.grid(lw=0.3, color="0.85")
            axis.margins(0.08)
            _end_recall_at_1(axis, metric)
        axes[0].plot([], [], label="on the Pareto front", **on_front)
        if others:
            axes[0].plot([], [], label="not on it", **off_it)
        for number, member in enumerate(named, 1):
            axes[0].plot([], [], " ", label=f"{number}: {math_text(member.label)}")
        figure.legend(loc="outside lower center", ncols=3, frameon=False, handlelength=1.2)
        _, path = save_figures(figure, stem, ".pdf", ".svg")
    rows = []
    for member in analysis.members:
        row = {"configuration": member.label, "on_front": member.on_front, "front_share": member.front_share}
        for metric in (MISSION_TIME, *below):
            e = member.estimates[metric.key]
            row |= {f"{metric.key}_{part}": getattr(e, part) for part in ("mean", "low", "high")}
        rows.append(row)
    write_csv(rows, stem.with_suffix(".csv"))
    return path


def _end_recall_at_1(axis: Axes, metric: Metric) -> None:
    """End the axis of recall at 1, with marks at 1 drawn whole."""
    if metric is RECALL:
        axis.set_ylim(top=1.0)
        axis.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))  # 1 is a multiple of each
        for line in axis.lines:
            line.set_clip_on(not np.size(line.get_xdata()))


def _numbered(named: Sequence[Member], metric: Metric) -> dict[tuple[float, float], list[str]]:
    """Point of the figure -> the numbers of the members on it."""
    places: dict[tuple[float, float], list[str]] = {}
    for number, member in enumerate(named, 1):
        place = round(member.mean(MISSION_TIME), 6), round(member.mean(metric), 6)
        places.setdefault(place, []).append(str(number))
    return places


def draw_pos(analysis: Analysis, stem: Path) -> Path | None:
    """POS(t): mean share of targets confirmed, with the pointwise 95 % bootstrap band over the seeds.

    It shows at most ``MOST_POS_CURVES`` configurations, the best and those of the Pareto front first. The CSV
    has all. Returns None where no mission has a curve.
    """
    members = [m for m in analysis.members if m.flown.pos]
    if not members:
        return None
    end_s = max(steps[-1, 0] for m in members for steps in m.flown.pos)
    time_s = np.linspace(0.0, end_s, POS_STEPS + 1)
    ranked = [analysis.members[k] for k in analysis.ranking]
    wanted = [*ranked[:2], *(m for m in members if m.on_front), *ranked, *members]
    drawn = [m for m in dict.fromkeys(wanted) if m.flown.pos][:MOST_POS_CURVES]
    frames, bands = [], []
    for member in [*drawn, *(m for m in members if m not in drawn)]:
        curves = np.array([step_values(steps, time_s) for steps in member.flown.pos])
        mean, (low, high) = curves.mean(axis=0), pointwise_band(curves)
        told = {"configuration": member.label, "n": len(curves), "time_s": time_s}
        frames.append(pl.DataFrame(told | {"pos_mean": mean, "pos_low": low, "pos_high": high}))
        bands.append((math_text(member.label), mean, low, high))
    with style():
        figure = Figure(figsize=(PAGE_IN, 2.8), layout="constrained")
        axis = figure.subplots()
        draw_pos_axis(axis, time_s, bands[: len(drawn)])
        axis.legend(frameon=False, loc="lower right" if len(drawn) <= 3 else "best")
        _, path = save_figures(figure, stem, ".pdf", ".svg")
    _write_frame(pl.concat(frames), stem.with_suffix(".csv"))
    return path


def draw_sensitivity(curves: Sequence[Curve], field: str, stem: Path) -> Path:
    """Means and 95 % intervals of mission time, recall, false scans and false positives over one parameter.

    Numbers are drawn to scale, infinity is a category of its own at the right, words stand side by side.
    """
    metrics = [
        m
        for m in (MISSION_TIME, RECALL, FALSE_SCANS, FALSE_POSITIVES)
        if any(any(e.n for e in c.estimates.get(m.key, ())) for c in curves)
    ]
    values = list(dict.fromkeys(v for c in curves for v in c.values))
    places = _places(values)
    shift = 0.02 * (max(places.values()) - min(places.values()))
    with style():
        rows = math.ceil(len(metrics) / 2)
        named = len(curves) > 1
        figure = Figure(figsize=(PAGE_IN, 1.9 * rows + (0.3 if named else 0.1)), layout="constrained")
        axes = figure.subplots(rows, 2, squeeze=False).ravel()
        for axis, metric in zip(axes, metrics, strict=False):
            for k, curve in enumerate(curves):
                if metric.key in curve.estimates:
                    _curve(axis, curve, metric, places, shift * (k - (len(curves) - 1) / 2), k)
            _value_axis(axis, places, field)
            axis.set_ylabel(metric.title)
            _end_recall_at_1(axis, metric)
            axis.grid(lw=0.3, color="0.85")
        for spare in axes[len(metrics) :]:
            spare.set_axis_off()
        if named:
            handles, labels = axes[0].get_legend_handles_labels()
            columns = 4 if len(curves) == 4 else 3
            figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
        _, path = save_figures(figure, stem, ".pdf", ".svg")
    records = [
        {
            "curve": curve.label,
            "configurations_averaged": curve.averaged_over,
            field: float(v) if isinstance(v, (int, float)) and not isinstance(v, bool) else str(v),
            "metric": metric,
            **{part: getattr(e, part) for part in ("n", "mean", "low", "high")},
        }
        for curve in curves
        for metric, estimates in curve.estimates.items()
        for v, e in zip(curve.values, estimates, strict=True)
    ]
    write_csv(records, stem.with_suffix(".csv"))
    return path


def _places(values: Sequence[Value]) -> dict[Value, float]:
    """Places of values on the axis: numbers to scale (logarithmic over more than a decade), others apart."""
    numbers = sorted(v for v in values if not isinstance(v, (str, bool)) and math.isfinite(v))
    if len(numbers) + any(v == math.inf for v in values) < len(values):
        return {v: float(k) for k, v in enumerate(values)}
    logarithmic = len(numbers) > 2 and numbers[0] > 0 and numbers[-1] > 10 * numbers[0]
    places: dict[Value, float] = {v: math.log(v) if logarithmic else float(v) for v in numbers}
    if len(numbers) < len(values):
        span = places[numbers[-1]] - places[numbers[0]] if numbers else 0.0
        places[math.inf] = places[numbers[-1]] + (0.2 * span or 1.0) if numbers else 0.0
    return places


def _curve(
    axis: Axes, curve: Curve, metric: Metric, places: dict[Value, float], shift: float, k: int
) -> None:
    """Means joined by a line with their band, or with bars, moved aside by ``shift``, where not joined."""
    colour, marker = SERIES_COLOURS[k % len(SERIES_COLOURS)], _MARKERS[k % len(_MARKERS)]
    dash = SERIES_DASHES[k % len(SERIES_DASHES)]
    estimates = curve.estimates[metric.key]
    mean, low, high = (np.array([getattr(e, part) for e in estimates]) for part in ("mean", "low", "high"))
    joined = np.array([isinstance(v, (int, float)) and math.isfinite(v) for v in curve.values])
    joined &= joined.sum() > 1
    apart = ~joined
    x = np.array([places[v] for v in curve.values]) + np.where(joined, 0.0, shift)
    look: dict[str, Any] = {"color": colour, "marker": marker, "ms": 3.5}
    axis.plot(x[joined], mean[joined], ls=dash, lw=1.2, label=math_text(curve.label), zorder=3, **look)
    axis.fill_between(x[joined], low[joined], high[joined], color=colour, alpha=0.15, lw=0)
    bars = np.abs(np.stack([mean - low, high - mean]))[:, apart]
    axis.errorbar(x[apart], mean[apart], yerr=bars, ls="", elinewidth=0.9, capsize=2, **look)
    if apart.any() and not isinstance(curve.values[0], str):
        axis.plot(x[-2:], mean[-2:], color=colour, lw=0.6, ls=":", alpha=0.8)


def _value_axis(axis: Axes, places: dict[Value, float], field: str) -> None:
    """Ticks at the values flown, without those that would overlap."""
    span = max(places.values()) - min(places.values())
    kept: list[Value] = []
    for value in sorted(places, key=lambda v: places[v]):
        if not kept or places[value] - places[kept[-1]] > 0.04 * span:
            kept.append(value)
    axis.set_xticks([places[v] for v in kept], [_tick(field, v) for v in kept])
    axis.set_xlabel(math_text(field_title(field)))
    axis.yaxis.set_major_locator(MaxNLocator(5))
    if math.inf in places and len(places) > 1:
        last, infinite = sorted(places.values())[-2:]
        axis.axvline((last + infinite) / 2, color="0.6", lw=0.6, ls=(0, (2, 2)))


def _tick(field: str, value: Value) -> str:
    return value_text(field, value).removesuffix(f" {field_unit(field)}" if field_unit(field) else "")


def _bars(e: Estimate) -> list[list[float]] | None:
    """Lengths of an error bar down and up, or None without an interval."""
    return [[e.mean - e.low], [e.high - e.mean]] if math.isfinite(e.low) else None


def write_csv(records: Sequence[Mapping[str, object]], path: Path) -> None:
    """Records as CSV. Unknown values stay empty."""
    _write_frame(pl.DataFrame(records, infer_schema_length=None), path)


def _write_frame(frame: pl.DataFrame, path: Path) -> None:
    floats = [name for name, kind in frame.schema.items() if kind.is_float()]
    frame.with_columns(pl.col(floats).fill_nan(None)).write_csv(path)
