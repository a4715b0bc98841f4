"""A picture of a sortie: the map, the paths over it, and what they may find against their length."""

from __future__ import annotations

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from skysweep.planning.prior.planned_sortie import PlannedSortie

_COLOURS = ("#0b5fa5", "#c0392b", "#1e8449", "#7d3c98", "#b9770e")
_INK = "#1f2933"


def draw_sortie(path_png: Path, name: str, sortie: PlannedSortie) -> None:
    """Write a PNG (150 dpi), north up, lengths in metres."""
    figure = Figure(figsize=(8.0, 10.5), dpi=150, layout="constrained")
    over, below = figure.subplots(2, 1, height_ratios=(3, 1))
    cells, expected = sortie.before, sortie.expected
    west, south, east, north = cells.bounds_m
    image = over.imshow(
        cells.poa / cells.poa.max(), origin="lower", extent=(west, east, south, north), cmap="Greys", vmin=0
    )
    figure.colorbar(image, ax=over, label="Probability density, of the highest", shrink=0.8)
    for k, path in enumerate(sortie.paths_xy_m):
        label = f"Vehicle {k + 1}" if len(sortie.paths_xy_m) <= len(_COLOURS) else None
        over.plot(path[:, 0], path[:, 1], color=_COLOURS[k % len(_COLOURS)], linewidth=0.8, label=label)
        over.plot(*path[-1], "s", color=_COLOURS[k % len(_COLOURS)], markersize=4)
    over.plot(
        *sortie.paths_xy_m[0][0], "*", color="#f2a900", markeredgecolor=_INK, markersize=13, label="Start"
    )
    over.set_aspect("equal")
    over.set_xlabel("East of origin (m)")
    over.set_ylabel("North of origin (m)")
    over.set_title(
        f"{name}: {expected.pos[-1]:.1%} expected within {expected.length_m[-1] / 1e3:.1f} km, "
        f"no path above {expected.bound_from_start[-1]:.1%}",
        loc="left",
        fontsize=10,
        color=_INK,
    )
    over.legend(fontsize=8, loc="upper right")
    below.plot(expected.length_m / 1e3, expected.bound, "--", color=_INK, label="Ideal allocation")
    below.plot(
        expected.length_m / 1e3,
        expected.bound_from_start,
        ":",
        color=_INK,
        label="Ideal, after the way there",
    )
    below.plot(expected.length_m / 1e3, expected.pos, color=_COLOURS[0], label="These paths")
    below.set_xlabel("Length flown, all vehicles (km)")
    below.set_ylabel("Probability of success")
    below.set_ylim(0.0, 1.0)
    below.legend(fontsize=8)
    FigureCanvasAgg(figure).print_png(path_png)  # type: ignore[no-untyped-call]
