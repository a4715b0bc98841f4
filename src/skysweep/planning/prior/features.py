"""Trails, streams, water and forest from a GeoJSON file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import shapely

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.files.geojson import read_geojson
from skysweep.geometry.frames import LocalFrame

_MOST_BYTES = 10_000_000
_MOST_CORNERS = 1_000_000


def read_features(path: Path, frame: LocalFrame) -> shapely.Geometry:
    """All shapes in a file together, ENU metres of the frame.

    Raises UserError naming the file where it is no GeoJSON in WGS 84, or holds no shape.
    """
    if path.suffix.lower() not in (".geojson", ".json"):
        raise UserError(f"{path}: is no GeoJSON; save the shapes as .geojson in WGS 84")
    data = read_geojson(path, _MOST_BYTES)
    try:
        shapes = shapely.from_geojson(json.dumps(data))
    except (shapely.errors.GEOSException, ValueError):
        raise UserError(f"{path}: is no GeoJSON of shapes; save it again") from None
    lon_lat = shapely.get_coordinates(shapes)
    if not len(lon_lat):
        raise UserError(f"{path}: holds no shape; save trails, streams or areas into it")
    if len(lon_lat) > _MOST_CORNERS:
        raise UserError(f"{path}: has {len(lon_lat):,} corners; cut it to the map, or simplify it")
    if not np.isfinite(lon_lat).all() or (np.abs(lon_lat) > [180.0, 90.0]).any():
        raise UserError(
            f"{path}: a corner is no longitude and latitude in degrees; save it in WGS 84 (EPSG:4326)"
        )

    def enu_m(lon_lat_deg: F64) -> F64:
        heights = np.full(len(lon_lat_deg), frame.altitude_m)
        return frame.enu_from_geodetic(np.column_stack([lon_lat_deg[:, ::-1], heights]))[:, :2]

    return shapely.union_all(shapely.make_valid(shapely.transform(shapes, enu_m)))
