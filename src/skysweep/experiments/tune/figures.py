"""Figures of a tuning: the trials of the search, and when n_c and d_c matter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skysweep.experiments.tune.validate import Cell, distances_m, limits
from skysweep.results.reporting.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PAGE_IN,
    PURPLE,
    VERMILLION,
    save_figures,
    style,
)
from skysweep.results.reporting.symbols import field_title, number
from skysweep.results.reporting.tables import math_text
from skysweep.types import F64

_COLUMNS = 4
_LINES = ((BLUE, "o"), (VERMILLION, "s"), (GREEN, "^"), (PURPLE, "D"), (ORANGE, "v"), (GREY, "P"))


def draw_search(table: pl.DataFrame, fields: Sequence[str], path: Path) -> None:
    """Time against false positives with the Pareto front, then cost over each parameter, as PNG and SVG."""
    rows = -(-(len(fields) + 1) // _COLUMNS)
    dropped, feasible = pl.col("dropped").is_not_null(), pl.col("feasible")
    hollow = {"facecolors": "none"}
    kinds: tuple[tuple[str, pl.Expr, dict[str, Any]], ...] = (
        ("dropped early", dropped, {"marker": "x", "c": "0.65", "s": 12, "lw": 0.8}),
        (
            "all seeds, breaks a constraint",
            ~dropped & ~feasible,
            hollow | {"marker": "v", "edgecolors": VERMILLION, "s": 16, "lw": 0.9},
        ),
        ("all seeds", ~dropped & feasible, {"marker": "o", "c": BLUE, "s": 14, "lw": 0}),
        (
            "Pareto front",
            pl.col("on_front"),
            hollow | {"marker": "o", "edgecolors": "black", "s": 40, "lw": 1.1},
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
                values = mine[f"param.{field}"].to_numpy()
                axis.scatter(_places(table, field, values), mine["cost_s"], **marks)
        axes[0].set(xlabel="Mission time (s)", ylabel="False positives")
        most = max(1.0, float(np.nanmax(table["false_positives"].to_numpy())))
        axes[0].set_ylim(-0.06 * most, 1.06 * most)
        _show_the_good(axes[0].set_xlim, table, "mission_time_s")
        for k, (axis, field) in enumerate(zip(axes[1:], fields, strict=False), start=1):
            axis.set_xlabel(math_text(field_title(field)))
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
        save_figures(figure, path, ".png", ".svg")


def draw_matters(cells: Sequence[Cell], name: str, path: Path) -> None:
    """Mission time over n_c with 95 % intervals, a line for each d_c, as PNG and SVG."""
    n_cs, distances = limits(cells), distances_m(cells)
    with style():
        figure = Figure(figsize=(PAGE_IN / 2, 3.0), layout="constrained")
        axis = figure.subplots()
        for k, (d_c_m, (colour, marker)) in enumerate(zip(distances, _LINES, strict=False)):
            line = [c for c in cells if c.d_c_m in (d_c_m, None)]
            x = np.array([n_cs.index(c.n_c) for c in line]) + 0.08 * (k - (len(distances) - 1) / 2)
            mean = np.array([c.mission_time_s.mean for c in line])
            low, high = (np.array([getattr(c.mission_time_s, b) for c in line]) for b in ("low", "high"))
            bars = np.nan_to_num([mean - low, high - mean])
            label = r"$d_c=\infty$" if np.isinf(d_c_m) else f"$d_c={d_c_m:g}$ m"
            look: dict[str, Any] = {"color": colour, "marker": marker, "ms": 4, "lw": 1.0}
            axis.errorbar(x, mean, bars, label=label, elinewidth=0.8, capsize=1.5, **look)
        axis.set_xticks(range(len(n_cs)), [number(n) for n in n_cs])
        axis.set(xlabel="$n_c$", ylabel="Mission time (s)")
        axis.set_title(name, loc="left")
        axis.grid(lw=0.3, color="0.88")
        figure.legend(loc="outside lower center", ncols=2, frameon=False)
        save_figures(figure, path, ".png", ".svg")


def _places(table: pl.DataFrame, field: str, values: F64) -> F64:
    """Places of values on the axis, with infinity to the right of all others."""
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


def _show_the_good(set_limits: Callable[[float, float], Any], table: pl.DataFrame, column: str) -> None:
    """Show the best nine tenths, since a few hopeless trials would squeeze the rest."""
    values = table[column].to_numpy()
    low, high = float(values.min()), float(np.quantile(values, 0.9))
    pad = 0.06 * (high - low) or 1.0
    set_limits(low - pad, high + pad)
