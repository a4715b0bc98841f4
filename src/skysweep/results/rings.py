"""Polygons in ENU metres as rings of longitude and latitude, for GeoJSON and KML."""

from __future__ import annotations

import numpy as np
import shapely

from skysweep.geometry.frames import LocalFrame

_DECIMALS_DEG = 8  # 1 mm

Ring = list[list[float]]  # closed; each corner longitude and latitude in degrees


def rings_lon_lat(polygon: shapely.Polygon, frame: LocalFrame) -> list[Ring]:
    """The outer ring counterclockwise, then the holes clockwise (RFC 7946)."""
    oriented = shapely.geometry.polygon.orient(polygon)
    rings = []
    for ring in (oriented.exterior, *oriented.interiors):
        xy = shapely.get_coordinates(ring)
        places = frame.geodetic_from_enu(np.column_stack([xy, np.zeros(len(xy))]))
        rings.append([[round(float(v), _DECIMALS_DEG) for v in (lon, lat)] for lat, lon, _ in places])
    return rings
