"""A picture of a map of probabilities."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure

from skysweep.arrays import F64
from skysweep.planning.picture import draw_scale
from skysweep.planning.prior.maps import ProbabilityMap

_INK = "#1f2933"
_CONTOURS = {0.5: "solid", 0.75: "dashed", 0.95: "dotted"}


def draw_map(
    path_png: Path,
    title: str,
    cells: ProbabilityMap,
    last_known_xy_m: F64 | None = None,
    tracks_xy_m: Sequence[F64] = (),
) -> None:
    """Write a PNG (150 dpi), north up: density, where the likeliest half of it lies, a grid and a scale.

    Tracks (K, 2) that were flown are drawn over it. All in ENU metres of the map's frame.
    """
    figure = Figure(figsize=(8.0, 7.6), dpi=150, layout="constrained")
    axes = figure.add_subplot()
    west, south, east, north = cells.bounds_m
    extent = (west, east, south, north)
    image = axes.imshow(
        1e6 * cells.poa / cells.cell_size_m**2,
        origin="lower",
        extent=extent,
        cmap="YlOrRd",
        norm=PowerNorm(0.5, vmin=0.0),
    )
    figure.colorbar(image, ax=axes, label="Probability per km²", shrink=0.8)
    for share, style in _CONTOURS.items():
        axes.plot([], [], color=_INK, linewidth=0.9, linestyle=style, label=f"{share:.0%} inside")
        if min(cells.poa.shape) > 1:
            axes.contour(
                cells.poa,
                levels=[_density_of_share(cells.poa, share)],
                extent=extent,
                colors=_INK,
                linewidths=0.9,
                linestyles=style,
            )
    for k, track in enumerate(tracks_xy_m):
        label = "Searched" if k == 0 else None
        axes.plot(track[:, 0], track[:, 1], color="#0b5fa5", linewidth=0.7, label=label)
    if last_known_xy_m is not None:
        axes.plot(
            *last_known_xy_m,
            "*",
            color="#2d9cdb",
            markeredgecolor=_INK,
            markersize=14,
            label="Last known position",
        )
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)
    axes.set_aspect("equal")
    axes.grid(color=_INK, alpha=0.25, linewidth=0.5)
    draw_scale(axes)
    frame = cells.frame
    axes.set_xlabel(f"East of {frame.latitude_deg:.5f}, {frame.longitude_deg:.5f} (latitude, longitude), m")
    axes.set_ylabel("North of it, m")
    axes.set_title(title, loc="left", fontsize=10, color=_INK)
    axes.legend(fontsize=8, loc="upper left")
    FigureCanvasAgg(figure).print_png(path_png)  # type: ignore[no-untyped-call]


def _density_of_share(poa: F64, share: float) -> float:
    """What the cells have at least that hold this share together, the likeliest first."""
    falling = -np.sort(-poa, axis=None)
    return float(falling[min(int(np.searchsorted(np.cumsum(falling), share)), len(falling) - 1)])
