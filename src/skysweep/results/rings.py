"""Polygons in ENU metres as rings of longitude and latitude, for GeoJSON and KML."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence

import numpy as np
import shapely
import shapely.affinity

from skysweep.arrays import F64
from skysweep.geometry.frames import LocalFrame

_DECIMALS_DEG = 8  # 1 mm
_WEST, _EAST = shapely.box(0.0, -90.0, 180.0, 90.0), shapely.box(180.0, -90.0, 360.0, 90.0)

Ring = list[list[float]]  # closed; each corner longitude and latitude in degrees


def polygons_lon_lat(polygon: shapely.Polygon, frame: LocalFrame) -> list[list[Ring]]:
    """For each polygon its outer ring counterclockwise, then its holes clockwise.

    It is one, or several where the antimeridian cuts it (RFC 7946, 3.1.9).
    """
    parts = shapely.get_parts(on_earth(polygon, frame))
    return [_rings(part) for part in parts if isinstance(part, shapely.Polygon)]


def on_earth(shape_enu_m: shapely.Geometry, frame: LocalFrame) -> shapely.Geometry:
    """A shape in longitudes and latitudes, degrees; in parts where the antimeridian cuts it."""

    def lon_lat(xy_enu_m: F64) -> F64:
        places = frame.geodetic_from_enu(np.column_stack([xy_enu_m, np.zeros(len(xy_enu_m))]))
        return np.asarray(places[:, 1::-1])

    whole = shapely.transform(shape_enu_m, lon_lat)
    west, _, east, _ = whole.bounds
    if east - west <= 180.0:
        return whole
    unwrapped = shapely.transform(whole, lambda lon, lat: (lon % 360.0, lat), interleaved=False)
    sides = (_WEST, 0.0), (_EAST, -360.0)
    return shapely.union_all(
        [shapely.affinity.translate(unwrapped.intersection(side), turned_deg) for side, turned_deg in sides]
    )


def add_polygons(geometry: ET.Element, polygons: Iterable[Sequence[Ring]]) -> None:
    """Append polygons to an element of KML."""
    for rings in polygons:
        part = ET.SubElement(geometry, "Polygon")
        for i, ring in enumerate(rings):
            boundary = ET.SubElement(part, "innerBoundaryIs" if i else "outerBoundaryIs")
            corners = " ".join(f"{lon:.8f},{lat:.8f}" for lon, lat in ring)
            ET.SubElement(ET.SubElement(boundary, "LinearRing"), "coordinates").text = corners


def _rings(polygon: shapely.Polygon) -> list[Ring]:
    oriented = shapely.geometry.polygon.orient(polygon)
    rings = (shapely.get_coordinates(ring) for ring in (oriented.exterior, *oriented.interiors))
    return [ring.round(_DECIMALS_DEG).tolist() for ring in rings]
