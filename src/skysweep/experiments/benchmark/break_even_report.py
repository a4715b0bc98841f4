"""The figure, the table and the JSON file of the break-even."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from skysweep.experiments.benchmark import BREAK_EVEN_PAGE
from skysweep.experiments.benchmark.break_even import BELIEF, BreakEvens, Cell
from skysweep.experiments.benchmark.suite import SCAN_ONLY, Suite
from skysweep.files.writing import whole_files
from skysweep.results.reporting.html import Grid, Section, picture, write_page
from skysweep.results.reporting.statistics import Estimate
from skysweep.results.reporting.style import PAGE_IN, SERIES_COLOURS, save_figures, style
from skysweep.results.reporting.tables import markdown
from skysweep.results.reporting.wording import counted
from skysweep.results.summary import plain

STEM = "break-even"
_PALE = 0.55  # of a cell's colour
_CAPTION = (
    "Colour: the strategy with the least mean cost. Number: seconds that it saves against the next one; ~ "
    "where the 95 % interval includes zero. Lines: the price from which a strategy is cheaper than scan-only."
)


def write_break_even(folder: Path, suite: Suite, found: BreakEvens, seeds: range) -> dict[str, Any]:
    """Write ``break-even.json``, ``.md``, ``.svg``, ``.pdf`` and ``.html``; returns what the first one holds.

    Raises UserError where ``folder`` cannot be written to.
    """
    record = as_json(suite, found, seeds)
    grids = [prices_grid(found), cheapest_grid(found)]
    missed_s = suite.break_even.missed_cost_s
    lead = (
        f"Suite {suite.version}, {counted(len(seeds), 'seed')} from {seeds.start} a cell, "
        f"{suite.sensor} sensor. Cost: mission time, the price of every false positive, and "
        f"{missed_s:g} s for every target missed."
    )
    with whole_files(folder) as unfinished:
        text = json.dumps(record, indent=1) + "\n"
        (unfinished / f"{STEM}.json").write_text(text, encoding="utf-8")
        tables = [markdown(grid, left=1) for grid in grids]
        (unfinished / f"{STEM}.md").write_text("\n".join([lead + "\n", *tables]), encoding="utf-8")
        drawn = picture(draw(found, unfinished / STEM), _CAPTION, wide=True)
        sections = [Section("The cheapest strategy", pictures=[drawn]), Section("Tables", grids=grids)]
        write_page(unfinished / BREAK_EVEN_PAGE, "When does looking twice pay?", lead, sections)
    return record


def as_json(suite: Suite, found: BreakEvens, seeds: range) -> dict[str, Any]:
    """The break-even as plain data; infinity is the text ``inf``."""
    record = {
        "suite": suite.version,
        "seeds": {"first": seeds.start, "count": len(seeds)},
        "missed_cost_s": suite.break_even.missed_cost_s,
        "look_alikes_per_ha": found.per_ha,
        "cheaper_than_scan_only_from_s": {
            name: [_interval(e) for e in estimates] for name, estimates in found.from_s.items()
        },
        "cells": [
            {
                "look_alikes_per_ha": cell.per_ha,
                "price_s": cell.price_s,
                "cheapest": cell.cheapest,
                "saved_s": _interval(cell.saved_s),
                "costs_s": {name: _interval(e) for name, e in cell.costs_s.items()},
            }
            for cell in found.cells
        ],
    }
    plain_record: dict[str, Any] = plain(record)
    return plain_record


def _interval(e: Estimate) -> dict[str, float]:
    return {"mean": round(e.mean, 3), "low": round(e.low, 3), "high": round(e.high, 3)}


def prices_grid(found: BreakEvens) -> Grid:
    """From which price of a false alarm each contender is cheaper than scan-only."""
    rows = [
        [f"{per_ha:g}", *(_price(estimates[k], found.prices_s) for estimates in found.from_s.values())]
        for k, per_ha in enumerate(found.per_ha)
    ]
    return Grid(
        ["Look-alikes a hectare", *found.from_s],
        rows,
        f"Cheaper than {SCAN_ONLY} from this price of a false alarm (s)",
    )


def _price(e: Estimate, prices_s: Sequence[float]) -> str:
    least, most = prices_s[0], prices_s[-1]

    def text(price_s: float) -> str:
        if price_s <= least:
            return f"{least:g} or less"
        return f"{price_s:.0f}" if math.isfinite(price_s) else f"above {most:g}"

    mean, low, high = map(text, (e.mean, e.low, e.high))
    return mean if low == high else f"{mean} ({low} to {high})"


def cheapest_grid(found: BreakEvens) -> Grid:
    """The cheapest strategy of every cell, and what it saves."""
    rows = []
    for k, per_ha in enumerate(found.per_ha):
        row = found.cells[k * len(found.prices_s) : (k + 1) * len(found.prices_s)]
        rows.append([f"{per_ha:g}", *(f"{cell.cheapest}, {_saved(cell)}" for cell in row)])
    return Grid(
        ["Look-alikes a hectare", *(f"{price:g} s" for price in found.prices_s)],
        rows,
        "The cheapest by the price of a false alarm, and seconds that it saves against the next one",
    )


def _saved(cell: Cell) -> str:
    return f"{'' if cell.is_certain else '~'}{cell.saved_s.mean:.0f}"


def draw(found: BreakEvens, stem: Path) -> Path:
    """The map of the cheapest strategies; the SVG, with a PDF beside it."""
    shape = len(found.per_ha), len(found.prices_s)
    names = [SCAN_ONLY, *(name for name in found.from_s if name != BELIEF), BELIEF]
    colours = {name: SERIES_COLOURS[k % len(SERIES_COLOURS)] for k, name in enumerate(names)}
    which = np.array([names.index(cell.cheapest) for cell in found.cells]).reshape(shape).T
    with style():
        figure = Figure(figsize=(PAGE_IN, 3.4), layout="constrained")
        axis = figure.subplots()
        axis.pcolormesh(
            which,
            cmap=ListedColormap([colours[name] for name in names]),
            vmin=-0.5,
            vmax=len(names) - 0.5,
            alpha=_PALE,
            edgecolors="white",
        )
        for k, cell in enumerate(found.cells):
            column, row = divmod(k, shape[1])
            number = axis.text(column + 0.5, row + 0.82, _saved(cell), ha="center", va="center", zorder=3)
            number.set_bbox({"color": "white", "alpha": 0.6, "lw": 0, "pad": 0.8})  # over a line, too
        places = np.arange(shape[1]) + 0.5
        for name, estimates in found.from_s.items():
            prices_s = np.array([e.mean for e in estimates])
            inside = np.isfinite(prices_s) & (prices_s > found.prices_s[0])
            at = np.interp(
                np.log(prices_s, where=inside, out=np.zeros(shape[0])), np.log(found.prices_s), places
            )
            line = np.where(inside, at, np.nan)
            axis.plot(np.arange(shape[0]) + 0.5, line, "o-", color=colours[name], lw=1.6, ms=4, mec="white")
        axis.set_xticks(np.arange(shape[0]) + 0.5, [f"{x:g}" for x in found.per_ha])
        axis.set_yticks(places, [f"{p:g}" for p in found.prices_s])
        axis.set(xlabel="Look-alikes a hectare", ylabel="Price of a false alarm (s)")
        patches = [Patch(color=colours[name], alpha=_PALE, label=name) for name in names]
        figure.legend(handles=patches, loc="outside lower center", ncols=len(names), frameon=False)
        _, path = save_figures(figure, stem, ".pdf", ".svg")
    return path
