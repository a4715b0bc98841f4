"""Coverage: parallel transects from which a nadir camera sees all of an area.

The area is cut into bands, one a transect, across the flight direction. What the area spans in each band is
flown by one transect for each connected part; transects that follow one another without a split or a merge
form a cell, flown back and forth, and the cells are put in the shortest order. This is the boustrophedon
cellular decomposition (Choset, "Coverage of known spaces: the boustrophedon cellular decomposition",
Autonomous Robots 9, 2000) with the bands as its slices. Holes need no search but may be flown over.

The vehicle keeps its nose along the transects, so a picture's width lies across the track, its height along
it. Transects stop short of the area's edge by a quarter of that height: a vehicle that turns a little before
it is there still sees all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.geometry.areas import edge_headings, heading_axes, intervals_in_bands, swept_rectangles
from skysweep.geometry.camera import Lens
from skysweep.planning.following import LegProfile
from skysweep.planning.routing import visit_order

TURN_COST_M = 10.0  # what a stop at a waypoint costs, as a distance: 2 s at 5 m/s (see flight_plan)
END_MARGIN = 0.25  # of the picture's height that still lies beyond the area's edge where a transect ends
MAX_TRANSECTS = 5000
_SWEEP_DEG = 15.0
_EDGES_TRIED = 12
_HEADINGS_PLANNED = 3
_BANDS_SAMPLED = 24
_MAX_ROWS_CORNERS = 10_000_000


@dataclass(frozen=True)
class CoveragePlan:
    """A path from which everything is seen. ENU metres; ``heading_deg`` is a compass heading."""

    waypoints_xy_enu_m: F64  # (N, 2) in flight order
    transects: tuple[F64, ...]  # (2, 2) each: from, to, as flown; parts of the path
    spacing_m: float  # between neighbouring transects
    swath_m: float  # width of ground in the picture
    heading_deg: float
    length_m: float  # of the path, first waypoint to last
    profiles: tuple[LegProfile, ...] = ()  # of the transects; none over flat ground


class Rows(NamedTuple):
    """Bands that share out an area across the flight direction, and where their transects lie.

    In axes turned so that x is along the heading: ``bands_m`` (R, 2) from low to high y, ``centres_m`` (R,).
    """

    bands_m: F64
    centres_m: F64

    def halved(self, crowded: NDArray[np.bool_]) -> Rows:
        """Two bands in place of each of those (R,), flown along their middles."""
        twice = np.repeat(np.arange(len(crowded)), np.where(crowded, 2, 1))
        same = twice[1:] == twice[:-1]
        lower, upper = np.append(same, False), np.append(False, same)
        bands, middles = self.bands_m[twice], self.bands_m.mean(axis=1)[twice]
        bands[lower, 1], bands[upper, 0] = middles[lower], middles[upper]
        return Rows(bands, np.where(crowded[twice], bands.mean(axis=1), self.centres_m[twice]))


def plan_coverage(
    area: shapely.Polygon,
    lens: Lens,
    altitude_agl_m: float,
    sidelap: float,
    heading_deg: float | None = None,
    start_xy: ArrayLike | None = None,
) -> CoveragePlan:
    """Transects over ``area`` (ENU metres, holes allowed) seen from ``altitude_agl_m`` over flat ground.

    Neighbouring swaths share at least ``sidelap`` of their width. ``heading_deg`` fixes the transects'
    compass heading; by default it is the one with the shortest path, counting turns. The path begins at the
    end that is nearer to ``start_xy`` (2,), by shortest way there plus path.

    Raises UserError when the area is no searchable polygon, or needs more than ``MAX_TRANSECTS`` transects.
    """
    start = None if start_xy is None else np.asarray(start_xy, dtype=float)
    return min(
        plans_tried(area, lens, altitude_agl_m, sidelap, heading_deg, start),
        key=lambda plan: cost_m(plan, start),
    )


def plans_tried(
    area: shapely.Polygon,
    lens: Lens,
    altitude_agl_m: float,
    sidelap: float,
    heading_deg: float | None,
    start: F64 | None,
) -> list[CoveragePlan]:
    """The plan along the heading or, without one, along each of the most promising ones.

    The arguments are those of ``plan_coverage``, which raises what this raises.
    """
    if area.geom_type != "Polygon" or area.is_empty or not area.is_valid:
        raise UserError("area: write one simple polygon with its corners in order around it")
    if not 0.0 <= sidelap < 1.0:
        raise UserError(f"sidelap: {sidelap:g} is no share of the swath; write a number from 0 to below 1")
    if not altitude_agl_m > 0.0:
        raise UserError(f"altitude_agl_m: {altitude_agl_m:g} is not above ground; write a number above 0")
    width, height = lens.footprint_m(altitude_agl_m)
    headings = [heading_deg] if heading_deg is not None else _promising_headings(area, width, sidelap)
    return [plan_rows(area, h, rows_of(area, h, width, sidelap), width, height, start) for h in headings]


def footprints(plan: CoveragePlan, lens: Lens, altitude_agl_m: float) -> shapely.Geometry:
    """The ground (ENU metres) that the camera sees along the plan's transects over flat ground."""
    width, height = lens.footprint_m(altitude_agl_m)
    return shapely.union_all(swept_rectangles(np.array(plan.transects), plan.heading_deg, width, height))


def rows_needed(extent_m: float, swath_m: float, sidelap: float) -> int:
    """How many swaths with at least ``sidelap`` between them it takes to cover ``extent_m``."""
    return 1 + max(0, int(np.ceil((extent_m - swath_m) / (swath_m * (1.0 - sidelap)) - 1e-9)))


def cost_m(plan: CoveragePlan, start: F64 | None) -> float:
    """What plans are compared by: the way from ``start`` (2,) and the path, and every turn as a distance."""
    approach = 0.0 if start is None else float(np.linalg.norm(plan.waypoints_xy_enu_m[0] - start))
    return approach + plan.length_m + TURN_COST_M * len(plan.waypoints_xy_enu_m)


def _promising_headings(area: shapely.Polygon, swath: float, sidelap: float) -> list[float]:
    """The headings with the cheapest paths, judged by what the area spans in sample bands."""
    outline = area.simplify(swath / 20)
    edges = edge_headings(outline)[:_EDGES_TRIED]
    candidates = np.unique(np.round(np.concatenate([edges, np.arange(0.0, 180.0, _SWEEP_DEG)]), 6) % 180.0)
    costs = []
    for heading in candidates:
        turned = _turned(outline, heading_axes(heading))
        bands = _rows(turned, swath, sidelap).bands_m
        sample = bands[:: -(-len(bands) // _BANDS_SAMPLED)]
        spans = np.concatenate(intervals_in_bands(turned, sample, min_gap=swath))
        per_transect = np.diff(spans).ravel() + swath + 2 * TURN_COST_M
        costs.append(per_transect.sum() * len(bands) / len(sample))
    return [float(h) for h in candidates[np.argsort(costs, kind="stable")[:_HEADINGS_PLANNED]]]


def _turned(area: shapely.Polygon, axes: F64) -> shapely.Polygon:
    return shapely.transform(area, lambda xy: xy @ axes.T)


def rows_of(area: shapely.Polygon, heading_deg: float, swath_m: float, sidelap: float) -> Rows:
    """Rows of equal width along a heading.

    What the last swath has to spare is shared by all: between the transects and at both edges.
    """
    return _rows(_turned(area, heading_axes(heading_deg)), swath_m, sidelap)


def _rows(turned: shapely.Polygon, swath: float, sidelap: float) -> Rows:
    low, high = turned.bounds[1], turned.bounds[3]
    rows = rows_needed(high - low, swath, sidelap)
    _refuse_many(rows, swath)
    used = (high - low) / ((rows - 1) * (1.0 - sidelap) + 1.0)
    centres = low + used / 2 + used * (1.0 - sidelap) * np.arange(rows)
    edges = np.concatenate([[low], (centres[1:] + centres[:-1]) / 2, [high]])
    return Rows(np.column_stack([edges[:-1], edges[1:]]), centres)


def _refuse_many(transects: int, swath: float) -> None:
    if transects > MAX_TRANSECTS:
        raise UserError(
            f"area: {transects} transects of {swath:.1f} m swath are more than {MAX_TRANSECTS}; "
            "write a higher altitude, or split the area"
        )


def plan_rows(
    area: shapely.Polygon,
    heading_deg: float,
    rows: Rows,
    swath: float,
    picture_height: float,
    start: F64 | None,
) -> CoveragePlan:
    """The plan with these rows along a heading. Raises UserError if it is too large."""
    axes = heading_axes(heading_deg)
    turned = _turned(area, axes)
    bands, centres = rows
    corners = shapely.get_num_coordinates(turned)
    if len(bands) * corners > _MAX_ROWS_CORNERS:
        raise UserError(
            f"area: {corners:,} corners are too many for {len(bands):,} transects of {swath:.1f} m swath; "
            "write a simpler outline, or a higher altitude"
        )
    spans = [_shorten(s, picture_height) for s in intervals_in_bands(turned, bands, min_gap=swath)]
    _refuse_many(sum(map(len, spans)), swath)
    legs = _fly(_cells(spans), spans, centres, None if start is None else axes @ start) @ axes
    waypoints = legs.reshape(-1, 2)
    length = float(np.linalg.norm(np.diff(waypoints, axis=0), axis=1).sum())
    spacing = float(centres[1] - centres[0]) if len(centres) > 1 else swath
    return CoveragePlan(waypoints, tuple(legs), spacing, swath, heading_deg % 360.0, length)


def _shorten(spans: F64, picture_height: float) -> F64:
    """Transects end before the edge, which the picture still shows with END_MARGIN to spare."""
    margin = picture_height * (0.5 - END_MARGIN)
    middle = spans.mean(axis=1)
    half = np.maximum((spans[:, 1] - spans[:, 0]) / 2 - margin, margin / 2)
    return np.column_stack([middle - half, middle + half])


def _cells(spans: list[F64]) -> list[list[tuple[int, int]]]:
    """Chains of (row, index) of transects where each has one neighbour ahead that has it alone behind."""
    cells: list[list[tuple[int, int]]] = []
    open_cells: dict[int, list[tuple[int, int]]] = {}
    for row, here in enumerate(spans):
        continued: dict[int, list[tuple[int, int]]] = {}
        if row:
            behind = spans[row - 1]
            touch = (here[:, None, 0] <= behind[None, :, 1]) & (behind[None, :, 0] <= here[:, None, 1])
            alone = touch & (touch.sum(axis=1, keepdims=True) == 1) & (touch.sum(axis=0, keepdims=True) == 1)
            continued = {int(i): open_cells[int(j)] for i, j in np.argwhere(alone)}
        open_cells = {}
        for i in range(len(here)):
            cell = continued.get(i)
            if cell is None:
                cell = []
                cells.append(cell)
            cell.append((row, i))
            open_cells[i] = cell
    return cells


def _fly(cells: list[list[tuple[int, int]]], spans: list[F64], centres: F64, start: F64 | None) -> F64:
    """Legs (T, 2, 2) of all cells in flight order: each from its first or last row, from left or right."""
    ways: list[list[F64]] = []
    for cell in cells:
        legs = np.array([[(x, centres[row]) for x in spans[row][i]] for row, i in cell])
        ways.append([_zigzag(legs[::step], side) for step in (1, -1) for side in (0, 1)])
    entries = np.array([[way[0, 0] for way in four] for four in ways])
    exits = np.array([[way[-1, 1] for way in four] for four in ways])
    lengths = np.array(
        [[np.linalg.norm(np.diff(w.reshape(-1, 2), axis=0), axis=1).sum() for w in four] for four in ways]
    )
    reverse = np.array([[2, 3, 0, 1] if len(cell) % 2 == 0 else [3, 2, 1, 0] for cell in cells])
    order = visit_order(entries, exits, lengths, reverse, start)
    return np.concatenate([ways[cell][way] for cell, way in order])


def _zigzag(legs: F64, side: int) -> F64:
    """Legs (R, 2, 2) flown alternately: the first from its left end (side 0) or its right end (side 1)."""
    flown = legs.copy()
    flown[1 - side :: 2] = flown[1 - side :: 2, ::-1]
    return flown
