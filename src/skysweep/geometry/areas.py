"""Polygons on flat ground: directions, strips and what lies inside them. Pure functions."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

F64 = NDArray[np.float64]


def heading_axes(heading_deg: float) -> F64:
    """Rows (2, 2): the unit vector along a compass heading and the one to its left, in ENU."""
    s, c = np.sin(np.radians(heading_deg)), np.cos(np.radians(heading_deg))
    return np.array([[s, c], [-c, s]])


def headings_of(legs_xy: ArrayLike) -> F64:
    """Compass headings in degrees [0, 360) of legs (N, 2, 2), each from its first point to its second."""
    legs = np.asarray(legs_xy, dtype=float).reshape(-1, 2, 2)
    east, north = (legs[:, 1] - legs[:, 0]).T
    return np.degrees(np.arctan2(east, north)) % 360.0


def edge_headings(area: shapely.Polygon) -> F64:
    """Compass headings in degrees [0, 180) of every edge, outer ring and holes, the longest edge first."""
    rings = [shapely.get_coordinates(ring) for ring in (area.exterior, *area.interiors)]
    legs = np.concatenate([np.stack([r[:-1], r[1:]], axis=1) for r in rings])
    lengths = np.linalg.norm(legs[:, 1] - legs[:, 0], axis=1)
    return headings_of(legs)[np.argsort(-lengths, kind="stable")] % 180.0


def strips(legs_xy: ArrayLike, width_m: float, extension_m: float) -> NDArray[np.object_]:
    """Rectangles (N,) around legs (N, 2, 2): ``width_m`` wide, ``extension_m`` longer at both ends."""
    legs = np.asarray(legs_xy, dtype=float).reshape(-1, 2, 2)
    start, end = legs[:, 0], legs[:, 1]
    along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    left = np.column_stack([-along[:, 1], along[:, 0]]) * width_m / 2
    start, end = start - along * extension_m, end + along * extension_m
    return shapely.polygons(np.stack([start + left, start - left, end - left, end + left], axis=1))


def intervals_in_bands(area: shapely.Polygon, bands: ArrayLike, min_gap: float) -> list[F64]:
    """What the area spans along x in each of ``bands`` (B, 2), from low to high y.

    Returns one array (K, 2) of disjoint ascending intervals for each band; intervals no more than
    ``min_gap`` apart are joined. The area within a band lies inside the band's intervals.
    """
    west, _, east, _ = area.bounds
    low, high = np.asarray(bands, dtype=float).T
    shapely.prepare(area)
    cuts = shapely.intersection(area, shapely.box(west - 1.0, low, east + 1.0, high))
    parts, index = shapely.get_parts(cuts, return_index=True)
    solid = shapely.area(parts) > 0.0
    parts, index = parts[solid], index[solid]
    spans = shapely.bounds(parts)[:, [0, 2]]
    return [_join(spans[index == i], min_gap) for i in range(len(low))]


def _join(intervals: F64, min_gap: float) -> F64:
    joined: list[list[float]] = []
    for low, high in intervals[np.argsort(intervals[:, 0], kind="stable")]:
        if joined and low - joined[-1][1] <= min_gap:
            joined[-1][1] = max(joined[-1][1], high)
        else:
            joined.append([low, high])
    return np.array(joined).reshape(-1, 2)
