"""Polygons on flat ground: directions, strips and what lies inside them. Pure functions."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from numba import njit
from numpy.typing import ArrayLike, NDArray

from skysweep.arrays import F64

_MANY_CORNERS = 500  # above it, a cut by GEOS, which rounds better, takes too long


def heading_axes(heading_deg: float) -> F64:
    """Rows (2, 2): the unit vector along a compass heading and the one to its left, in ENU."""
    s, c = np.sin(np.radians(heading_deg)), np.cos(np.radians(heading_deg))
    return np.array([[s, c], [-c, s]])


def headings_of(legs_xy: ArrayLike) -> F64:
    """Compass headings in degrees [0, 360) of legs (N, 2, 2), each from its first point to its second."""
    legs = np.asarray(legs_xy, dtype=float).reshape(-1, 2, 2)
    east, north = (legs[:, 1] - legs[:, 0]).T
    return np.asarray(np.degrees(np.arctan2(east, north)) % 360.0)


def edge_headings(area: shapely.Polygon) -> F64:
    """Compass headings in degrees [0, 180) of all edges, outer ring and holes, the longest edge first."""
    legs = _edges(area)
    lengths = np.linalg.norm(legs[:, 1] - legs[:, 0], axis=1)
    return headings_of(legs)[np.argsort(-lengths, kind="stable")] % 180.0


def turned_boxes(centres_xy: ArrayLike, sizes_m: ArrayLike, yaws_rad: ArrayLike) -> NDArray[np.object_]:
    """Rectangles (N,) around centres (N, 2), of length and width (N, 2), their length at yaws (N,) in ENU."""
    centres, halves = np.reshape(centres_xy, (-1, 1, 2)), np.reshape(sizes_m, (-1, 1, 2)) / 2.0
    corners = halves * [(1, -1), (1, 1), (-1, 1), (-1, -1)]
    cos, sin = np.cos(yaws_rad).reshape(-1, 1), np.sin(yaws_rad).reshape(-1, 1)
    x, y = corners[..., 0], corners[..., 1]
    return np.asarray(shapely.polygons(centres + np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)))


def _edges(area: shapely.Polygon) -> F64:
    """All edges (N, 2, 2), outer ring and holes."""
    rings = [shapely.get_coordinates(ring) for ring in (area.exterior, *area.interiors)]
    return np.concatenate([np.stack([r[:-1], r[1:]], axis=1) for r in rings])


def swept_rectangles(legs_xy: ArrayLike, heading_deg: float, width_m: float, height_m: float) -> NDArray[Any]:
    """Polygons (N,) that a rectangle sweeps when it moves along legs (N, 2, 2) without turning.

    ``height_m`` is its extent along ``heading_deg``, ``width_m`` its extent across.
    """
    legs = np.asarray(legs_xy, dtype=float).reshape(-1, 2, 2)
    along, left = heading_axes(heading_deg)
    signs = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)])
    corners = signs[:, :1] * along * height_m / 2 + signs[:, 1:] * left * width_m / 2
    corners_of_legs = (legs[:, :, None] + corners).reshape(-1, 8, 2)
    return np.asarray(shapely.convex_hull(shapely.multipoints(corners_of_legs)))


def intervals_in_bands(area: shapely.Polygon, bands: ArrayLike, min_gap: float) -> list[F64]:
    """The intervals of x that the area spans in each of ``bands`` (B, 2) from low to high y.

    Each band has one array (K, 2) of disjoint ascending intervals that hold all of the area within the band.
    Intervals no more than ``min_gap`` apart are joined.
    """
    bands = np.asarray(bands, dtype=float)
    if shapely.get_num_coordinates(area) > _MANY_CORNERS:
        edges = _edges(area).reshape(-1, 4)
        return [_joined(_extents(edges, low, high), min_gap) for low, high in bands]
    west, _, east, _ = area.bounds
    low, high = bands.T
    shapely.prepare(area)
    cuts = shapely.intersection(area, shapely.box(west - 1.0, low, east + 1.0, high))
    parts, index = shapely.get_parts(cuts, return_index=True)
    solid = shapely.area(parts) > 0.0
    parts, index = parts[solid], index[solid]
    spans = shapely.bounds(parts)[:, [0, 2]]
    return [_joined(spans[index == i], min_gap) for i in range(len(low))]


@njit(cache=True)
def _extents(edges: F64, low: float, high: float) -> F64:
    """Ranges (K, 2) of x: of edges (N, 4) between two heights, and between edges at the lower height."""
    ranges, k = np.empty((2 * len(edges), 2)), 0
    crossings, c = np.empty(len(edges)), 0
    for x, y, to_x, to_y in edges:
        if max(y, to_y) <= low or min(y, to_y) >= high:
            continue
        slope = (to_x - x) / (to_y - y) if to_y != y else 0.0
        begin = x if low <= y <= high else x + (min(max(y, low), high) - y) * slope
        end = to_x if low <= to_y <= high else x + (min(max(to_y, low), high) - y) * slope
        ranges[k] = min(begin, end), max(begin, end)
        k += 1
        if (y <= low) != (to_y <= low):
            crossings[c] = begin if y <= low else end
            c += 1
    crossings[:c].sort()
    for i in range(0, c - 1, 2):
        ranges[k] = crossings[i], crossings[i + 1]
        k += 1
    return ranges[:k]


def _joined(intervals: F64, min_gap: float) -> F64:
    if not len(intervals):
        return intervals
    lows, highs = intervals[np.argsort(intervals[:, 0], kind="stable")].T
    highs = np.maximum.accumulate(highs)
    apart = lows[1:] - highs[:-1] > min_gap
    return np.column_stack([lows[np.insert(apart, 0, True)], highs[np.append(apart, True)]])
