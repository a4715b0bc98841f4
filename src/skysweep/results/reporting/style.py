"""The look of all figures, and their files: the same bytes every time.

Colours are safe for the common kinds of colour blindness. Marks are from Okabe and Ito's palette
(https://jfly.uni-koeln.de/color/).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skysweep.types import F64

COLUMN_IN, PAGE_IN = 3.5, 7.2  # widths of a column and a page of an IEEE paper
BLUE, GREEN, ORANGE = "#0072B2", "#009E73", "#E69F00"
VERMILLION, PURPLE, GREY = "#D55E00", "#CC79A7", "#808080"
SERIES_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, "#56B4E9")
SERIES_DASHES = ("-", "--", ":", "-.")
_STYLE: Any = {
    "font.size": 8,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7.5,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "font.family": "DejaVu Sans",
    "pdf.fonttype": 42,
    "svg.hashsalt": "skysweep",
}


@contextmanager
def style() -> Iterator[None]:
    """Our fonts and line widths, legible in print."""
    with rc_context(_STYLE):
        yield


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure as PNG, SVG or PDF (by suffix)."""
    path = Path(path)
    path.write_bytes(figure_bytes(figure, path.suffix.removeprefix(".")))
    return path


def save_figures(figure: Figure, stem: Path, *suffixes: str) -> list[Path]:
    """Write a figure in several formats."""
    return [save_figure(figure, stem.with_suffix(suffix)) for suffix in suffixes]


def figure_bytes(figure: Figure, form: str) -> bytes:
    """The content of a figure's file in the format ``png``, ``svg`` or ``pdf``."""
    stamp = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(form)
    content = BytesIO()  # Matplotlib would swallow the error of a full disk
    figure.savefig(content, format=form, dpi=200, bbox_inches="tight", pad_inches=0.04, metadata=stamp)
    return content.getvalue()


def draw_pos_axis(axis: Axes, time_s: F64, bands: Iterable[tuple[str, F64, F64, F64]]) -> None:
    """POS over times (M,): a line with its band for each label, mean, lower and upper bound.

    One without values is not drawn, and the others look as if it were.
    """
    for k, (label, mean, low, high) in enumerate(bands):
        if not len(mean):
            continue
        colour = SERIES_COLOURS[k % len(SERIES_COLOURS)]
        dash = SERIES_DASHES[k % len(SERIES_DASHES)]
        axis.plot(time_s, mean, dash, color=colour, label=label, lw=1.4, clip_on=False)
        axis.fill_between(time_s, low, high, color=colour, alpha=0.15, lw=0)
    axis.set(xlabel="Time since take-off (s)", ylabel="POS (share of targets confirmed)")
    axis.set(xlim=(0, time_s[-1]), ylim=(0, 1))
    axis.grid(lw=0.3, color="0.85")


def step_values(steps: F64, time_s: F64) -> F64:
    """Values at times (M,) of a curve given by its steps (K, 2). It is zero before the first."""
    index = np.searchsorted(steps[:, 0], time_s, side="right") - 1
    return np.where(index < 0, 0.0, steps[np.maximum(index, 0), 1])
