"""Figures of a tuning: what the search tried, and when n_c and d_c matter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skysweep.experiments.tune.validate import Cell
from skysweep.results.reporting.style import (
    GREEN,
    GREY,
    ORANGE,
    PAGE_IN,
    PURPLE,
    VERMILLION,
    save_figure,
    style,
)
from skysweep.results.reporting.symbols import number
from skysweep.results.reporting.tables import math_text
from skysweep.types import F64

_COLUMNS = 4
_BLUE = "#0072B2"
_LINES = ((_BLUE, "o"), (VERMILLION, "s"), (GREEN, "^"), (PURPLE, "D"), (ORANGE, "v"), (GREY, "P"))


def draw_search(table: pl.DataFrame, fields: Sequence[str], symbols: Mapping[str, str], path: Path) -> None:
    """Time against false positives with the Pareto front, then cost over every parameter; PNG and SVG."""
    rows = -(-(len(fields) + 1) // _COLUMNS)
    kinds = (
        ("dropped early", pl.col("dropped").is_not_null(), {"marker": "x", "c": "0.65", "s": 12, "lw": 0.8}),
        (
            "all seeds, breaks a constraint",
            pl.col("dropped").is_null() & ~pl.col("feasible"),
            {"marker": "v", "facecolors": "none", "edgecolors": VERMILLION, "s": 16, "lw": 0.9},
        ),
        (
            "all seeds",
            pl.col("dropped").is_null() & pl.col("feasible"),
            {"marker": "o", "c": _BLUE, "s": 14, "lw": 0},
        ),
        (
            "Pareto front",
            pl.col("on_front"),
            {"marker": "o", "facecolors": "none", "edgecolors": "black", "s": 40, "lw": 1.1},
        ),
    )
    with style():
        figure = Figure(figsize=(PAGE_IN, 1.9 * rows + 0.5), layout="constrained")
        axes = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
        for label, which, marks in kinds:
            mine = table.filter(which)
            if not mine.is_empty():
                axes[0].scatter(mine["mission_time_s"], mine["false_positives"], label=label, **marks)
            for axis, field in zip(axes[1:], fields, strict=False):
                axis.scatter(
                    _places(table, field, mine[f"param.{field}"].to_numpy()), mine["cost_s"], **marks
                )
        axes[0].set(xlabel="Mission time (s)", ylabel="False positives")
        most = max(1.0, float(np.nanmax(table["false_positives"].to_numpy())))
        axes[0].set_ylim(-0.06 * most, 1.06 * most)
        _show_the_good(axes[0].set_xlim, table, "mission_time_s")
        for k, (axis, field) in enumerate(zip(axes[1:], fields, strict=False), start=1):
            axis.set_xlabel(math_text(symbols[field]))
            _show_the_good(axis.set_ylim, table, "cost_s")
            _infinity_tick(axis, table, field)
            if k % _COLUMNS == 0 or k == 1:
                axis.set_ylabel("Cost (s)")
        for spare in axes[len(fields) + 1 :]:
            spare.set_axis_off()
        for axis in axes[: len(fields) + 1]:
            axis.grid(lw=0.3, color="0.88")
            axis.set_axisbelow(True)
        figure.legend(loc="outside lower center", ncols=4, frameon=False)
        for suffix in (".png", ".svg"):
            save_figure(figure, path.with_suffix(suffix))


def draw_matters(cells: Sequence[Cell], name: str, path: Path) -> None:
    """Mission time over n_c, a line for every d_c, with 95 % intervals; PNG and SVG."""
    n_cs = sorted({cell.n_c for cell in cells})
    distances = sorted({cell.d_c_m for cell in cells if cell.d_c_m is not None})
    with style():
        figure = Figure(figsize=(PAGE_IN / 2, 3.0), layout="constrained")
        axis = figure.subplots()
        for k, (d_c_m, (colour, marker)) in enumerate(zip(distances, _LINES, strict=False)):
            line = [c for c in cells if c.d_c_m in (d_c_m, None)]
            x = np.array([n_cs.index(c.n_c) for c in line]) + 0.08 * (k - (len(distances) - 1) / 2)
            mean = np.array([c.mission_time_s.mean for c in line])
            low, high = (np.array([getattr(c.mission_time_s, b) for c in line]) for b in ("low", "high"))
            axis.errorbar(
                x,
                mean,
                np.nan_to_num([mean - low, high - mean]),
                color=colour,
                marker=marker,
                ms=4,
                lw=1.0,
                elinewidth=0.8,
                capsize=1.5,
                label=r"$d_c=\infty$" if np.isinf(d_c_m) else f"$d_c={d_c_m:g}$ m",
            )
        axis.set_xticks(range(len(n_cs)), [number(n) for n in n_cs])
        axis.set(xlabel="$n_c$", ylabel="Mission time (s)")
        axis.set_title(name, loc="left")
        axis.grid(lw=0.3, color="0.88")
        figure.legend(loc="outside lower center", ncols=2, frameon=False)
        for suffix in (".png", ".svg"):
            save_figure(figure, path.with_suffix(suffix))


def _places(table: pl.DataFrame, field: str, values: F64) -> F64:
    """Where values stand on the axis: infinity to the right of all others."""
    return np.where(np.isinf(values), _infinity_place(table, field), values)


def _infinity_place(table: pl.DataFrame, field: str) -> float:
    finite = table[f"param.{field}"].filter(table[f"param.{field}"].is_finite())
    if finite.is_empty():
        return 1.0
    low, high = float(finite.min()), float(finite.max())  # type: ignore[arg-type]
    return high + max(0.15 * (high - low), 1.0)


def _infinity_tick(axis: Axes, table: pl.DataFrame, field: str) -> None:
    values = table[f"param.{field}"]
    if values.is_infinite().any():
        place = _infinity_place(table, field)
        finite = np.unique(values.filter(values.is_finite()).to_numpy())
        ticks = [t for t in axis.get_xticks() if len(finite) > 3 and finite[0] <= t < 0.95 * place]
        ticks = ticks or finite.tolist()
        axis.set_xticks([*ticks, place], [number(tick) for tick in (*ticks, np.inf)])


def _show_the_good(limits: object, table: pl.DataFrame, column: str) -> None:
    """Limits that show the best nine tenths: a few hopeless trials would squeeze the rest."""
    values = table[column].to_numpy()
    low, high = float(values.min()), float(np.quantile(values, 0.9))
    pad = 0.06 * (high - low) or 1.0
    limits(low - pad, high + pad)  # type: ignore[operator]
