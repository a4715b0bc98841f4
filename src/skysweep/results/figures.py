"""Figures for reports and papers: map of a run, the paper's panels, POS over time.

Trajectories are in viridis, darkest when low. Each mark has a shape of its own as well as a colour.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path as MplPath

from skysweep.results.metrics import match
from skysweep.results.pod import CoverageMap
from skysweep.results.reporting.statistics import t_quantile
from skysweep.results.reporting.style import (
    COLUMN_IN,
    GREEN,
    GREY,
    ORANGE,
    PAGE_IN,
    PURPLE,
    VERMILLION,
    draw_pos_axis,
    figure_bytes,
    save_figure,
    save_figures,
    step_values,
    style,
)
from skysweep.results.run_folder import Run
from skysweep.results.summary import finite_or_inf
from skysweep.types import F64, U8
from skysweep.worlds.world import World

ALTITUDE_COLOURS = LinearSegmentedColormap.from_list(
    "altitude", colormaps["viridis"](np.linspace(0.0, 0.87, 256))
)


_GROUND_PX = 1200  # the longer side of the ground under a map
_PALE = 0.45  # share of white in it
_SURFACE_COLOURS = {
    "grass": (150, 170, 95),
    "forest floor": (110, 125, 80),
    "rock": (150, 146, 140),
    "sand": (215, 195, 150),
    "snow": (240, 243, 248),
    "asphalt": (120, 120, 122),
    "water": (95, 150, 185),
}

# name -> marker, size, face, edge, edge width, what the legend says
_MARKS: dict[str, tuple[str, float, str, str, float, str]] = {
    "home": ("s", 5.5, "white", "black", 1.2, "home"),
    "target": ("o", 9.0, "none", "black", 1.0, "target (truth)"),
    "distractor": ("^", 5.0, "none", GREY, 1.0, "distractor (truth)"),
    "scanned": ("+", 10.0, ORANGE, ORANGE, 1.1, "scanned from high up"),
    "confirmed": ("o", 5.0, GREEN, "white", 0.6, "confirmed, right"),
    "false scan": ("x", 6.5, VERMILLION, VERMILLION, 1.6, "false scan (nothing new there)"),
    "false positive": ("D", 5.5, PURPLE, "black", 0.8, "false positive (confirmed wrongly)"),
    "wrong rejection": ("X", 7.0, VERMILLION, "black", 0.8, "target rejected"),
    "found": ("o", 5.0, GREEN, "white", 0.6, "confirmed"),
    "rejected": ("x", 6.5, GREY, GREY, 1.6, "rejected"),
    "unchecked": ("s", 6.5, "none", VERMILLION, 1.4, "not checked"),
}


def run_map(run: Run, path: str | Path) -> Path:
    """Top view of one mission with its altitude profile below, as PNG, SVG or PDF (by suffix)."""
    with style():
        return save_figure(_map_of(run), path)


def run_map_png(run: Run) -> bytes:
    """The same as bytes."""
    with style():
        return figure_bytes(_map_of(run), "png")


def coverage_map_png(run: Run, coverage: CoverageMap) -> bytes:
    """Top view of how probably a target would have been reported at each place, with the path."""
    with style():
        return figure_bytes(_coverage_map_of(run, coverage), "png")


def panels(runs: Sequence[Run], path: str | Path) -> list[Path]:
    """The paper's figures in one, with a row per scenario and a column per ``n_c`` or strategy.

    Scenarios are in the order of ``runs``. Columns are by rising ``n_c``, then by other strategies. Of
    several runs of one cell the first is drawn. All panels share one altitude scale. Returns the PNG, SVG and
    PDF, named after ``path`` without its suffix.
    """
    scenarios = list(dict.fromkeys(run.scenario.name for run in runs))
    by_n_c = sorted(runs, key=lambda run: (run.strategy != "scan-check", run.scenario.search.n_c))
    ways = list(dict.fromkeys(_way(run) for run in by_n_c))
    cells = {(run.scenario.name, _way(run)): run for run in reversed(runs)}
    with style():
        rows, columns = len(scenarios), len(ways)
        figure = Figure(figsize=(PAGE_IN, 2.2 * rows * 3 / max(columns, 2) + 0.7), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
        norm = _altitude_norm(runs)
        for i, scenario in enumerate(scenarios):
            for j, way in enumerate(ways):
                axis = axes[i][j]
                run = cells.get((scenario, way))
                if run is None:
                    axis.axis("off")
                    continue
                _top_view(axis, run, norm, _extent(runs), detail=False)
                axis.set_title(f"{scenario}\n{way}: {_mission_time(run)}", loc="left", fontsize=7)
                axis.label_outer(remove_inner_ticks=False)
        scale = ScalarMappable(norm, ALTITUDE_COLOURS)
        figure.colorbar(scale, ax=axes, label="Altitude above ground (m)", aspect=70, pad=0.015)
        figure.legend(handles=_legend(runs), loc="outside lower center", ncols=4, frameon=False)
        return save_figures(figure, Path(path), ".png", ".svg", ".pdf")


def pos_curves(curves: dict[str, list[F64]], path: str | Path) -> Path:
    """Probability of success over time: a line per label, the mean over its missions, with the 95 % band.

    ``curves`` has, for each label and mission, the steps (K, 2) of time in s and share of targets confirmed.
    A label without missions is not drawn; it keeps its colour for figures beside this one. The suffix of
    ``path`` chooses PNG, SVG or PDF.
    """
    end = max((steps[-1][0] for missions in curves.values() for steps in missions), default=1.0)
    time_s = np.linspace(0.0, end, 400)
    bands = []
    for label, missions in curves.items():
        if not missions:
            bands.append((label, *np.empty((3, 0))))
            continue
        pos = np.array([step_values(np.asarray(steps, dtype=float), time_s) for steps in missions])
        mean, half = pos.mean(axis=0), np.full(len(time_s), np.nan)
        if len(pos) > 1:
            half = t_quantile(len(pos)) * pos.std(axis=0, ddof=1) / math.sqrt(len(pos))
        bands.append((label, mean, *np.clip([mean - half, mean + half], 0, 1)))
    with style():
        figure = Figure(figsize=(COLUMN_IN, 2.4), layout="constrained")
        axis = figure.subplots()
        draw_pos_axis(axis, time_s, bands)
        axis.legend(frameon=False)
        return save_figure(figure, path)


def _map_of(run: Run) -> Figure:
    west, east, south, north = extent = _extent([run])
    height = min(max(0.78 * PAGE_IN * (north - south) / (east - west), 3.0), 8.0)
    figure = Figure(figsize=(PAGE_IN, height + 2.6), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=[height, 1.6])
    norm = _altitude_norm([run])
    _top_view(above, run, norm, extent)
    above.set_title(_title(run), loc="left")
    scale = ScalarMappable(norm, ALTITUDE_COLOURS)
    figure.colorbar(scale, ax=above, label="Altitude above ground (m)", pad=0.02, aspect=30)
    _profile(below, run, norm)
    figure.legend(handles=_legend([run]), loc="outside lower center", ncols=4, frameon=False)
    return figure


def _coverage_map_of(run: Run, coverage: CoverageMap) -> Figure:
    west, east, south, north = extent = _extent([run])
    height = min(max(0.78 * PAGE_IN * (north - south) / (east - west), 3.0), 8.0)
    figure = Figure(figsize=(PAGE_IN, height + 0.6), layout="constrained")
    axis = figure.subplots()
    shown = np.where(coverage.inside, coverage.pod(), np.nan)
    left, bottom, right, top = coverage.bounds_enu_m
    look: Any = {"origin": "lower", "extent": (left, right, bottom, top), "cmap": "cividis", "zorder": 1}
    image = axis.imshow(shown, vmin=0.0, vmax=1.0, **look)
    image.set_clip_path(axis.add_patch(_polygon_patch(run.scenario.area_enu_m, fc="none", ec="0.35", lw=0.8)))
    path = run.states.position_enu_m
    for colour, width in (("white", 1.8), ("black", 0.7)):
        axis.plot(path[:, 0], path[:, 1], color=colour, lw=width, zorder=2)
    figure.colorbar(image, ax=axis, label="Probability of detection", pad=0.02, aspect=30)
    axis.set(xlim=extent[:2], ylim=extent[2:], xlabel="East (m)", ylabel="North (m)", aspect="equal")
    _scale_bar(axis, east - west, west, south)
    return figure


def _top_view(
    axis: Axes, run: Run, norm: Normalize, extent: tuple[float, float, float, float], detail: bool = True
) -> None:
    area = run.scenario.area_enu_m
    ground = _ground_of(run.world, extent)
    if ground is not None:
        axis.imshow(ground, extent=extent, zorder=-1)
    inside = "#f3f3f0" if ground is None else "none"
    axis.add_patch(_polygon_patch(area, facecolor=inside, edgecolor="0.35", lw=0.8, zorder=0))
    plan = run.plan_enu_m
    axis.plot(plan[:, 0], plan[:, 1], color="0.72", lw=0.6, ls=(0, (4, 2)), zorder=1)
    xy = run.states.position_enu_m[:, :2]
    look: dict[str, Any] = {"lw": 1.3 if detail else 1.0, "capstyle": "round", "zorder": 2}
    axis.add_collection(_coloured_line(xy, run.altitudes_agl_m, norm, **look))
    scale = 1.0 if detail else 0.72
    for thing in run.world.objects if run.has_truth else ():
        if thing.track is not None:
            _, way = run.world.way(thing, run.last_s)
            axis.plot(way[:, 0], way[:, 1], color="black" if thing.is_target else GREY, lw=0.6, zorder=3)
    for name, points in _points(run).items():
        axis.plot(points[:, 0], points[:, 1], **_mark(name, scale), zorder=4)
    west, east, south, north = extent
    axis.set(xlim=(west, east), ylim=(south, north), xlabel="East (m)", ylabel="North (m)", aspect="equal")
    if detail:
        _scale_bar(axis, east - west, west, south)


def _ground_of(world: World, extent: tuple[float, float, float, float]) -> U8 | None:
    """The ground's picture (H, W, 3), or the colours of its land cover, pale; None if it has neither."""
    cover = world.terrain.cover
    if cover is None and world.ground_picture is None:
        return None
    west, east, south, north = extent
    width_px = round(_GROUND_PX * min(1.0, (east - west) / (north - south)))
    height_px = max(1, round(width_px * (north - south) / (east - west)))
    x, y = np.linspace(west, east, width_px), np.linspace(north, south, height_px)
    shown = np.full((height_px, width_px, 3), 255.0)
    if cover is not None:
        colours = np.array([_SURFACE_COLOURS[name] for name in cover.names], float)
        codes = cover.codes_at(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
        shown = colours[codes].reshape(shown.shape)
    if world.ground_picture is not None:
        rgba = world.ground_picture.read(west, south, east, north, width_px, height_px)
        shown = np.where(rgba[..., 3:] > 0, rgba[..., :3], shown)
    return np.asarray((1.0 - _PALE) * shown + _PALE * 255.0, dtype=np.uint8)


def _profile(axis: Axes, run: Run, norm: Normalize) -> None:
    time_s, altitude_m = run.states.time_s, run.altitudes_agl_m
    axis.add_collection(_coloured_line(np.column_stack([time_s, altitude_m]), altitude_m, norm, lw=1.4))
    marks = _marks_of_candidates(run)
    for story in run.candidates:
        if story.verdict_s is None:
            continue
        height = np.interp(story.verdict_s, time_s, altitude_m) if len(time_s) else 0.0
        axis.plot(story.verdict_s, height, **_mark(marks[story.id], 0.8))
    top = max(float(altitude_m.max(initial=1.0)), 1.0)
    if run.finished_s is not None:
        axis.axvline(run.finished_s, color="0.4", lw=0.7, ls=":")
        axis.annotate(
            "search finished ", (run.finished_s, top * 1.12), ha="right", va="center", fontsize=7, color="0.3"
        )
    axis.set(xlabel="Time since take-off (s)", ylabel="Altitude (m)", ylim=(0, top * 1.22))
    axis.set_xlim(0, max(run.last_s, 1.0))
    axis.grid(lw=0.3, color="0.88")


def _coloured_line(points: F64, altitude_m: F64, norm: Normalize, **look: Any) -> LineCollection:
    """A line through points (N, 2), each piece coloured by the altitude (N,) at its end."""
    pieces = list(np.stack([points[:-1], points[1:]], axis=1))
    line = LineCollection(pieces, cmap=ALTITUDE_COLOURS, norm=norm, **look)
    line.set_array(altitude_m[1:])
    return line


def _mark(name: str, scale: float) -> dict[str, Any]:
    marker, size, face, edge, width, _ = _MARKS[name]
    return {"marker": marker, "ms": size * scale, "mfc": face, "mec": edge, "mew": width, "ls": ""}


def _marks_of_candidates(run: Run) -> dict[int, str]:
    marks = dict.fromkeys((c.id for c in run.unchecked), "unchecked")
    if not run.has_truth:
        judged = {"confirmed": "found", "rejected": "rejected"}
        return marks | {c.id: judged[c.verdict] for c in run.candidates if c.verdict is not None}
    matches = match(run)
    return (
        marks
        | dict.fromkeys(matches.confirmed, "confirmed")
        | dict.fromkeys(matches.false_positives, "false positive")
        | dict.fromkeys(matches.rejected, "false scan")
        | dict.fromkeys(matches.wrong_rejections, "wrong rejection")
    )


def _points(run: Run) -> dict[str, F64]:
    """Points (N, 2) of each kind of mark in this run."""
    points: dict[str, list[Any]] = {name: [] for name in _MARKS}
    points["home"].append(run.scenario.home.position_enu_m)
    for thing in run.world.objects if run.has_truth else ():
        points["target" if thing.is_target else "distractor"].append(thing.position_enu_m[:2])
    for event in run.events("scanned"):
        if event.get("p") is not None:
            points["scanned"].append(event["p"][:2])
    marks = _marks_of_candidates(run)
    for story in run.candidates:
        if story.id in marks:
            points[marks[story.id]].append(story.position_enu_m[:2])
    return {name: np.array(p, dtype=float) for name, p in points.items() if p}


def _legend(runs: Sequence[Run]) -> list[Line2D]:
    present = {name for run in runs for name in _points(run)}
    plan = Line2D([], [], color="0.72", lw=0.8, ls=(0, (4, 2)), label="planned transects")
    return [
        Line2D([], [], **_mark(name, 0.8), label=label)
        for name, (*_, label) in _MARKS.items()
        if name in present
    ] + [plan]


def _altitude_norm(runs: Sequence[Run]) -> Normalize:
    return Normalize(0.0, max([float(run.altitudes_agl_m.max(initial=1.0)) for run in runs], default=1.0))


def _extent(runs: Sequence[Run]) -> tuple[float, float, float, float]:
    """West, east, south and north limits of the maps of these runs."""
    points: list[Any] = []
    for run in runs:
        points += [np.array(run.scenario.area_enu_m.exterior.coords), [run.scenario.home.position_enu_m]]
        points += [run.states.position_enu_m[:, :2], run.plan_enu_m[:, :2]]
    west, south = np.concatenate(points).min(axis=0)
    east, north = np.concatenate(points).max(axis=0)
    margin = 0.03 * max(east - west, north - south)
    return west - margin, east + margin, south - margin, north + margin


def _scale_bar(axis: Axes, width_m: float, west: float, south: float) -> None:
    magnitude = 10 ** math.floor(math.log10(width_m / 4))
    length = max(k * magnitude for k in (1, 2, 5) if k * magnitude <= width_m / 4)
    x, y = west + 0.97 * width_m - length, south + 0.02 * width_m
    axis.plot([x, x + length], [y, y], color="black", lw=2.5, solid_capstyle="butt", zorder=6)
    place: Any = {"ha": "center", "va": "bottom", "fontsize": 7, "zorder": 6}
    axis.text(x + length / 2, y + 0.008 * width_m, f"{length:g} m", **place)


def _polygon_patch(polygon: shapely.Polygon, **style: Any) -> PathPatch:
    rings = [MplPath(np.array(r.coords), closed=True) for r in (polygon.exterior, *polygon.interiors)]
    return PathPatch(MplPath.make_compound_path(*rings), **style)


def _title(run: Run) -> str:
    how = f"{run.strategy}, {_way(run)}" if run.strategy == "scan-check" else run.strategy
    return f"{run.scenario.name}: {how}, seed {run.seed}, {_mission_time(run)}"


def _way(run: Run) -> str:
    """``n_c`` of Algorithm 1, or the name of another strategy."""
    return n_c_label(run.scenario.search.n_c) if run.strategy == "scan-check" else run.strategy


def n_c_label(value: float) -> str:
    """``n_c`` in math text."""
    return r"$n_c=\infty$" if math.isinf(value) else f"$n_c={finite_or_inf(value)}$"


def _mission_time(run: Run) -> str:
    """Mission time, or a lower bound for an unfinished search."""
    return f"{'' if run.finished_s is not None else '> '}{run.search_end_s:.0f} s"
