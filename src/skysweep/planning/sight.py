"""From how high a place on hilly ground is seen by a camera that looks straight down.

From farther up a place stays in the picture, and what lies between stops hiding it: whatever sees a place
sees it from anywhere above, too. So a least height says all about a place and a station above the ground.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F64, I64
from skysweep.geometry.areas import heading_axes
from skysweep.geometry.camera import Lens
from skysweep.worlds.world import TerrainSurface, bilinear_at

CELLS_ACROSS = 16  # a swath
_MAX_CELLS = 2_000_000
_TOUCHES_M = 0.02  # of ground beside a line of sight that does not hide


class View(NamedTuple):
    """A picture straight down: half its extent along and across the heading, over the height."""

    along: float
    across: float
    east: float  # of the heading's unit vector
    north: float

    @classmethod
    def of(cls, lens: Lens, heading_deg: float) -> View:
        """The view of a camera whose picture's height lies along a compass heading."""
        width, height = lens.footprint_m(1.0)
        east, north = heading_axes(heading_deg)[0].tolist()
        return cls(height / 2.0, width / 2.0, east, north)


class GroundCells(NamedTuple):
    """Middles of square cells (N, 3) on the ground of an area, ENU, by row from south to north."""

    centres_enu_m: F64
    row_starts: I64  # (R + 1,) into the cells
    south_m: float  # of the middles of the first row
    size_m: float

    def only(self, kept: NDArray[np.bool_]) -> GroundCells:
        """Those that are marked (N,)."""
        starts = np.concatenate([[0], np.cumsum(kept)])[self.row_starts]
        return self._replace(centres_enu_m=self.centres_enu_m[kept], row_starts=starts)


def ground_cells(area: shapely.Polygon, terrain: TerrainSurface, swath_m: float) -> GroundCells:
    """The cells whose middles lie in the area: ``CELLS_ACROSS`` a swath, or as many as can be handled."""
    west, south, east, north = area.bounds
    wanted_m = min(swath_m, math.sqrt(area.area)) / CELLS_ACROSS
    size_m = max(wanted_m, math.sqrt((east - west) * (north - south) / _MAX_CELLS))
    columns, rows = (max(1, math.ceil(extent_m / size_m)) for extent_m in (east - west, north - south))
    x, y = np.meshgrid(west + (np.arange(columns) + 0.5) * size_m, south + (np.arange(rows) + 0.5) * size_m)
    shapely.prepare(area)
    inside = shapely.contains_xy(area, x, y)
    xy = np.column_stack([x[inside], y[inside]])
    starts = np.concatenate([[0], np.cumsum(inside.sum(axis=1))])
    return GroundCells(np.column_stack([xy, terrain.height_m(xy)]), starts, south + 0.5 * size_m, size_m)


def nearest_transects(cells: GroundCells, legs_xy_enu_m: F64, reach_m: float) -> I64:
    """The nearest of the legs (T, 2, 2) to each cell (N,); -1 if all are farther than ``reach_m``."""
    nearest = np.full(len(cells.centres_enu_m), -1)
    _nearest(nearest, *cells, legs_xy_enu_m, reach_m)
    return nearest


def least_heights(terrain: TerrainSurface, view: View, places_enu_m: F64, stations_xy_enu_m: F64) -> F64:
    """Heights ENU (N,) above stations (N, 2) from which places (N, 3) on the ground are seen."""
    return _least_heights(terrain.heights_m, terrain.bounds_enu_m, view, places_enu_m, stations_xy_enu_m)


@njit(cache=True)
def foot_point(leg: F64, x: float, y: float) -> tuple[float, float, float]:
    """The nearest place of a leg (2, 2), and its share of the way."""
    dx, dy = leg[1, 0] - leg[0, 0], leg[1, 1] - leg[0, 1]
    share = ((x - leg[0, 0]) * dx + (y - leg[0, 1]) * dy) / max(dx * dx + dy * dy, 1e-12)
    share = min(max(share, 0.0), 1.0)
    return leg[0, 0] + share * dx, leg[0, 1] + share * dy, share


@njit(cache=True)
def strip_of_row(leg: F64, y: float, reach: float) -> tuple[float, float]:
    """West and east of what may be within reach of a leg (2, 2) in a row."""
    x0, y0, x1, y1 = leg[0, 0], leg[0, 1], leg[1, 0], leg[1, 1]
    if y0 > y1:
        x0, y0, x1, y1 = x1, y1, x0, y0
    if y1 - y0 < 1e-9:
        return min(x0, x1) - reach, max(x0, x1) + reach
    slope, length = (x1 - x0) / (y1 - y0), math.hypot(x1 - x0, y1 - y0)
    wide = reach * length / (y1 - y0)
    low, high = min(x0, x1) - reach, max(x0, x1) + reach
    middle = x0 + (y - y0) * slope
    return max(low, middle - wide), min(high, middle + wide)


@njit(cache=True)
def _nearest(
    nearest: I64, centres: F64, starts: I64, south: float, size: float, legs: F64, reach: float
) -> None:
    distance = np.full(len(centres), reach * reach)
    for k in range(len(legs)):
        leg = legs[k]
        low, high = min(leg[0, 1], leg[1, 1]) - reach, max(leg[0, 1], leg[1, 1]) + reach
        first = max(math.ceil((low - south) / size), 0)
        last = min(math.floor((high - south) / size), len(starts) - 2)
        for row in range(first, last + 1):
            begin, end = starts[row], starts[row + 1]
            west, east = strip_of_row(leg, south + row * size, reach)
            i = begin + np.searchsorted(centres[begin:end, 0], west)
            while i < end and centres[i, 0] <= east:
                x, y = centres[i, 0], centres[i, 1]
                at_x, at_y, _ = foot_point(leg, x, y)
                away = (x - at_x) ** 2 + (y - at_y) ** 2
                if away <= distance[i]:
                    distance[i], nearest[i] = away, k
                i += 1


@njit(cache=True)
def least_height(
    heights: F64,
    bounds: tuple[float, float, float, float],
    view: View,
    place: F64,
    x: float,
    y: float,
    enough: float,
) -> float:
    """Height above (x, y) from which a place (3,) is in the picture and not behind other ground.

    Beyond ``enough`` it is any height above that.
    """
    dx, dy = x - place[0], y - place[1]
    along, across = abs(dx * view.east + dy * view.north), abs(dy * view.east - dx * view.north)
    in_picture = place[2] + max(along / view.along, across / view.across)
    return height_over_ground(heights, bounds, place, x, y, in_picture, enough)


@njit(cache=True)
def height_over_ground(
    heights: F64,
    bounds: tuple[float, float, float, float],
    place: F64,
    x: float,
    y: float,
    least: float,
    enough: float,
) -> float:
    """Height above (x, y), at least ``least``, from which no ground hides a place (3,) on or above it.

    Beyond ``enough`` it is any height above that. Ground between four posts is bilinear, a parabola along the
    line of sight, so the crossings of the posts' grid and one place between two of them tell all.
    """
    dx, dy = x - place[0], y - place[1]
    west, south, east, north = bounds
    rows, columns = heights.shape
    next_x, every_x = _crossings(place[0] - west, dx, (east - west) / (columns - 1))
    next_y, every_y = _crossings(place[1] - south, dy, (north - south) / (rows - 1))
    begin, ground = 0.0, bilinear_at(heights, bounds, place[0], place[1])
    while begin < 1.0 and least <= enough:
        end = min(next_x, next_y, 1.0)
        middle = 0.5 * (begin + end)
        halfway = bilinear_at(heights, bounds, place[0] + middle * dx, place[1] + middle * dy)
        far = bilinear_at(heights, bounds, place[0] + end * dx, place[1] + end * dy)
        least = max(least, _over(place[2], far, end))
        steepest = _steepest(place[2], begin, end, ground, halfway, far)
        if begin < steepest < end:
            top = bilinear_at(heights, bounds, place[0] + steepest * dx, place[1] + steepest * dy)
            least = max(least, _over(place[2], top, steepest))
        next_x += every_x if next_x <= end else 0.0
        next_y += every_y if next_y <= end else 0.0
        begin, ground = end, far
    return float(least)


@njit(cache=True)
def _crossings(start: float, way: float, spacing: float) -> tuple[float, float]:
    """Shares of a way at which it first crosses a multiple of ``spacing``, and from one to the next."""
    if way == 0.0:
        return math.inf, math.inf
    line = math.floor(start / spacing) + 1 if way > 0.0 else math.ceil(start / spacing) - 1
    return (line * spacing - start) / way, spacing / abs(way)


@njit(cache=True)
def _over(place: float, ground: float, share: float) -> float:
    """Height at the end of a line of sight from ``place`` over ``ground`` at a share of it, above 0."""
    return place + (ground - _TOUCHES_M - place) / share


@njit(cache=True)
def _steepest(place: float, begin: float, end: float, ground: float, halfway: float, far: float) -> float:
    """Share at which the line of sight over a parabola rises steepest; -1 if that is at one of its ends."""
    span = end - begin
    bend = 2.0 * (ground - 2.0 * halfway + far) / span**2
    slope = (4.0 * halfway - 3.0 * ground - far) / span
    at_place = ground - slope * begin + bend * begin**2 - _TOUCHES_M - place
    return math.sqrt(at_place / bend) if at_place < 0.0 and bend < 0.0 else -1.0


@njit(cache=True)
def _least_heights(
    heights: F64,
    bounds: tuple[float, float, float, float],
    view: View,
    places: F64,
    stations: F64,
) -> F64:
    least = np.empty(len(places))
    for k in range(len(places)):
        least[k] = least_height(heights, bounds, view, places[k], stations[k, 0], stations[k, 1], math.inf)
    return least
