"""A picture of a plan: the area, the path over it, the ground it shows, and the figures of the flight."""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from skysweep.planning.coverage import CoveragePlan, footprints
from skysweep.planning.flight_plan import FlightEstimate
from skysweep.planning.flown_path import FlownPath, flown_path, hidden_from, mast_enu_m
from skysweep.planning.surroundings import surroundings
from skysweep.scenarios.model import Scenario
from skysweep.worlds.world import TerrainSurface, build_terrain

_INK, _PATH, _SWATH, _FENCE = "#1f2933", "#0b5fa5", "#7fb3dd", "#c0392b"
_CONTOUR, _GROUND, _NO_RADIO = "#c9bfa8", "#d8cfba", "#e07b00"
_ARROWS_MAX = 40
_CONTOURS = 12
_WIDTH_IN, _PROFILE_IN = 8.0, 2.0


def draw_plan(path_png: str | Path, scenario: Scenario, plan: CoveragePlan, estimate: FlightEstimate) -> Path:
    """Write a PNG (200 dpi) of ``plan`` over the scenario's area, north up."""
    path = Path(path_png)
    path.write_bytes(plan_png(scenario, plan, estimate))
    return path


def plan_png(scenario: Scenario, plan: CoveragePlan, estimate: FlightEstimate) -> bytes:
    """The same picture as bytes."""
    altitude = scenario.search.scan_altitude_agl_m
    terrain = build_terrain(scenario)
    figure = Figure(dpi=200, layout="constrained")
    if terrain.is_flat:
        axes, profile_in = figure.add_subplot(), 0.0
    else:
        axes, below = figure.subplots(2, height_ratios=[3.2, 1.0])
        profile_in = _PROFILE_IN
        _draw_contours(axes, terrain)
        _draw_profile(below, flown_path(plan, scenario, altitude, terrain), scenario, terrain)
    _draw_ground(axes, scenario, plan)
    _draw_path(axes, scenario, plan, altitude)
    axes.margins(0.06)
    axes.set_aspect("equal")
    tall = np.ptp(axes.get_ylim()) / np.ptp(axes.get_xlim())
    figure.set_size_inches(_WIDTH_IN, float(np.clip(_WIDTH_IN * 0.9 * tall, 2.5, 10.0)) + 1.6 + profile_in)
    axes.set_xlabel("East of origin (m)")
    axes.set_ylabel("North of origin (m)")
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    draw_scale(axes)
    axes.set_title(f"{scenario.name}\n", loc="left", fontsize=12, fontweight="bold", color=_INK, pad=18)
    axes.set_title(_figures(plan, estimate, altitude), loc="right", fontsize=8, color=_INK)
    figure.legend(loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    content = BytesIO()
    FigureCanvasAgg(figure).print_png(content)  # type: ignore[no-untyped-call]
    return content.getvalue()


def _draw_ground(axes: Axes, scenario: Scenario, plan: CoveragePlan) -> None:
    area = scenario.area_enu_m
    axes.add_patch(
        PathPatch(_outline(area), facecolor="#eef1e6", edgecolor=_INK, linewidth=1.4, label="Search area")
    )
    for i, hole in enumerate(area.interiors):
        axes.add_patch(
            PathPatch(
                _outline(shapely.Polygon(hole)),
                facecolor="none",
                edgecolor="#9aa5b1",
                hatch="////",
                linewidth=0.8,
                label="No search needed" if i == 0 else None,
            )
        )
    drawn = scenario.geofence_enu_m
    fence = surroundings(scenario, plan.waypoints_xy_enu_m) if drawn is None else shapely.Polygon(drawn)
    if fence is not None:
        axes.plot(*fence.exterior.xy, "--", color=_FENCE, linewidth=1.2, label="Geofence")
    axes.autoscale_view()


def _draw_path(axes: Axes, scenario: Scenario, plan: CoveragePlan, altitude_agl_m: float) -> None:
    for i, part in enumerate(shapely.get_parts(footprints(plan, scenario.camera.lens, altitude_agl_m))):
        label = "Seen by the camera" if i == 0 else None
        axes.add_patch(PathPatch(_outline(part), facecolor=_SWATH, alpha=0.35, edgecolor="none", label=label))
    xy = plan.waypoints_xy_enu_m
    axes.plot(xy[:, 0], xy[:, 1], color=_PATH, linewidth=1.3, solid_joinstyle="round", label="Path")
    legs = np.array(plan.transects)[:: -(-len(plan.transects) // _ARROWS_MAX)]
    middle, step = legs.mean(axis=1), (legs[:, 1] - legs[:, 0]) * 1e-3
    for (x, y), (dx, dy) in zip(middle, step, strict=True):
        axes.annotate(
            "",
            xy=(x + dx, y + dy),
            xytext=(x - dx, y - dy),
            arrowprops={"arrowstyle": "-|>", "color": _PATH, "linewidth": 0.0, "mutation_scale": 12},
        )
    home = scenario.home.position_enu_m
    axes.plot(*zip(home, xy[0], strict=True), ":", color=_PATH, linewidth=1.0)
    axes.plot(*xy[0], "o", color="white", markeredgecolor=_PATH, markersize=5, label="Start")
    axes.plot(*xy[-1], "s", color=_PATH, markersize=5, label="End")
    axes.plot(*home, "*", color="#f2a900", markeredgecolor=_INK, markersize=13, label="Home")


def _draw_contours(axes: Axes, terrain: TerrainSurface) -> None:
    west, south, east, north = terrain.bounds_enu_m
    rows, columns = terrain.heights_m.shape
    axes.contour(
        np.linspace(west, east, columns),
        np.linspace(south, north, rows),
        terrain.heights_m,
        levels=_CONTOURS,
        colors=_CONTOUR,
        linewidths=0.5,
        linestyles="solid",
        zorder=1.5,
    )


def _draw_profile(axes: Axes, path: FlownPath, scenario: Scenario, terrain: TerrainSurface) -> None:
    """The ground below the whole path, the height flown, and where the radio does not reach it."""
    along_km = path.along_m / 1e3
    lowest_m = float(path.ground_m.min())
    axes.fill_between(along_km, lowest_m, path.ground_m, color=_GROUND, linewidth=0.0)
    axes.plot(along_km, path.height_m, color=_PATH, linewidth=0.8)
    hidden = hidden_from(mast_enu_m(scenario, terrain), path, terrain)
    if hidden.any():
        flown = np.where(hidden, path.height_m, np.nan)
        axes.plot(along_km, flown, color=_NO_RADIO, linewidth=1.4, label="No line of sight to the radio")
    axes.margins(x=0.0)
    axes.set_xlabel("Along the path (km)")
    axes.set_ylabel("Height (m)")
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def draw_scale(axes: Axes) -> None:
    """A scale bar of a round length, and an arrow to the north, in the lower right corner."""
    west, east = axes.get_xlim()
    target = (east - west) / 6
    power = 10.0 ** math.floor(math.log10(target))
    length = max(k * power for k in (1, 2, 5) if k * power <= target)
    share = length / (east - west)
    left, bottom = 0.97 - share, 0.035
    axes.plot(
        [left, 0.97],
        [bottom, bottom],
        transform=axes.transAxes,
        color=_INK,
        linewidth=2.5,
        solid_capstyle="butt",
        zorder=5,
    )
    axes.text(
        left + share / 2, bottom + 0.012, f"{length:g} m", transform=axes.transAxes, ha="center", fontsize=8
    )
    axes.annotate(
        "N",
        xy=(0.975, 0.99),
        xytext=(0.975, 0.915),
        xycoords="axes fraction",
        ha="center",
        va="center",
        fontsize=10,
        fontweight="bold",
        arrowprops={"arrowstyle": "-|>", "color": _INK, "linewidth": 1.4},
    )


def _figures(plan: CoveragePlan, estimate: FlightEstimate, altitude_agl_m: float) -> str:
    minutes, seconds = divmod(round(estimate.time_s), 60)
    batteries = f"{estimate.batteries} batter{'y' if estimate.batteries == 1 else 'ies'}"
    area = estimate.area_m2
    size = f"{area / 1e4:.1f} ha" if area < 1e6 else f"{area / 1e6:.2f} km²"
    return (
        f"{size} from {altitude_agl_m:g} m AGL, {estimate.n_transects} transects {plan.spacing_m:.1f} m "
        f"apart, swath {plan.swath_m:.1f} m, path {estimate.path_length_m / 1e3:.2f} km\n"
        f"{minutes} min {seconds:02d} s, {estimate.energy_wh:.0f} Wh, {batteries}, GSD {estimate.gsd_cm:.1f} "
        f"cm, {estimate.pixels_on_target:.0f} px on the smallest target"
    )


def _outline(polygon: shapely.Polygon) -> Outline:
    """A matplotlib path with the holes left out."""
    oriented = shapely.geometry.polygon.orient(polygon)
    rings = [oriented.exterior, *oriented.interiors]
    return Outline.make_compound_path(*(Outline(shapely.get_coordinates(r), closed=True) for r in rings))
