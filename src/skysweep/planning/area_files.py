"""Search areas drawn elsewhere: GeoJSON (RFC 7946), KML and KMZ (OGC KML 2.2), QGroundControl ``.plan``.

Each file must hold exactly one polygon; holes are kept. Coordinates are WGS 84. Nothing in a file is fetched,
expanded or unpacked beyond a fixed size.
"""

from __future__ import annotations

import math
import re
import unicodedata
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import numpy as np
import shapely
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from skysweep.errors import UserError
from skysweep.files.geojson import read_geojson
from skysweep.files.models import validated
from skysweep.files.reading import read_limited
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.qgc import QgcPlan, read_plan, survey_polygons
from skysweep.scenarios.model import MAX_AREA_KM2, MAX_CORNERS, Home, Scenario

MAX_AREA_FILE_BYTES = 10_000_000
SUFFIXES = (".geojson", ".json", ".kml", ".kmz", ".plan")

LatLon = tuple[float, float]
Ring = list[tuple[float, float]]

_CIRCLE_CORNERS = 32
_ONE_POLYGON = "save a file with one polygon around the search area"


def read_area(path: str | Path, frame: LocalFrame | None = None) -> tuple[shapely.Polygon, LocalFrame]:
    """The polygon in a file as ENU metres, and the frame they are in.

    The frame is ``frame`` or, without one, that of the polygon's centroid at altitude 0. Raises UserError
    naming the file when it is unreadable, damaged, unsafe, or holds anything but one searchable polygon.
    """
    path = Path(path)
    return _on_ground(_only_polygon(path), path, frame)


def read_corners(path: Path) -> tuple[list[LatLon], list[list[LatLon]]]:
    """Latitude and longitude of the corners of the polygon in a file, and of those of its holes.

    Raises UserError as ``read_area`` does.
    """
    lon_lat = _only_polygon(path)
    _on_ground(lon_lat, path, None)
    outer, *holes = (
        [(float(lat), float(lon)) for lon, lat in shapely.get_coordinates(ring)[:-1]]
        for ring in (lon_lat.exterior, *lon_lat.interiors)
    )
    return outer, holes


def scenario_from_area(path: str | Path) -> Scenario:
    """A scenario to plan with: the file's area; home is its southernmost corner or where a plan has it.

    A plan's fence is kept, too.
    """
    fence: dict[str, Any] = {}
    if Path(path).suffix.lower() == ".plan":
        plan = read_plan(path)
        latitude, longitude, altitude = plan.mission.plannedHomePosition
        fence = fence_of(path, plan, LocalFrame(latitude, longitude, altitude))
    else:
        area, frame = read_area(path)
        corners = shapely.get_coordinates(area.exterior)
        south = corners[np.argmin(corners[:, 1])]
        latitude, longitude, altitude = (float(v) for v in frame.geodetic_from_enu([[*south, 0.0]])[0])
    home = Home(latitude_deg=latitude, longitude_deg=longitude, altitude_amsl_m=altitude)
    area, _ = read_area(path, LocalFrame(latitude, longitude, altitude))

    def ring(line: shapely.LinearRing) -> Ring:
        return [(float(x), float(y)) for x, y in shapely.get_coordinates(line)[:-1]]

    return scenario_over(path, home, ring(area.exterior), [ring(hole) for hole in area.interiors], **fence)


def scenario_over(
    path: str | Path, home: Home, corners: Ring, holes: Sequence[Ring] = (), **more: Any
) -> Scenario:
    """A scenario of the area in a file (corners in ENU metres of home's frame), named after the file.

    ``more`` are other fields. Raises UserError where the area cannot be searched from home.
    """
    area = {"polygon_enu_m": corners, "holes_enu_m": list(holes)}
    return validated(Scenario, {"name": plain_name(path), "area": area, "home": home} | more, str(path))


def fence_of(path: str | Path, plan: QgcPlan, frame: LocalFrame) -> dict[str, Any]:
    """A plan's fence as a scenario's fields. A circle becomes a polygon that is nowhere less strict.

    Raises UserError where there are several to stay inside of.
    """
    fence = plan.geoFence
    inside = [enu_of(p.polygon, frame) for p in fence.polygons if p.inclusion]
    outside = [enu_of(p.polygon, frame) for p in fence.polygons if not p.inclusion]
    for drawn in fence.circles:
        ((x, y),) = enu_of([drawn.circle.center], frame)
        angles = np.arange(_CIRCLE_CORNERS) * 2.0 * math.pi / _CIRCLE_CORNERS
        radius_m = drawn.circle.radius / (1.0 if drawn.inclusion else math.cos(math.pi / _CIRCLE_CORNERS))
        ring = [(x + radius_m * math.cos(a), y + radius_m * math.sin(a)) for a in angles.tolist()]
        (inside if drawn.inclusion else outside).append(ring)
    if len(inside) > 1:
        raise UserError(f"{path}: geoFence has {len(inside)} inclusions; draw one around the mission")
    return {"geofence_enu_m": inside[0] if inside else None, "safety": {"no_fly_enu_m": outside}}


def enu_of(lat_lon_deg: list[LatLon], frame: LocalFrame) -> Ring:
    """Places in latitude and longitude as ENU metres of a frame."""
    points = np.array([(latitude, longitude, frame.altitude_m) for latitude, longitude in lat_lon_deg])
    return [(float(x), float(y)) for x, y, _ in frame.enu_from_geodetic(points)] if len(points) else []


def plain_name(path: str | Path) -> str:
    """A scenario's name after a file."""
    stem = unicodedata.normalize("NFKD", Path(path).stem)
    plain = "".join(c for c in stem if not unicodedata.combining(c))
    return re.sub(r"[^A-Za-z0-9 ._-]+", "-", plain).lstrip(" ._-")[:80].rstrip(" ._-") or "area"


def _only_polygon(path: Path) -> shapely.Polygon:
    """Its coordinates are longitude and latitude."""
    try:
        polygons = list(_polygons(path))
    except RecursionError:
        raise UserError(f"{path}: is nested too deeply; {_ONE_POLYGON}") from None
    if len(polygons) != 1:
        found = f"holds {len(polygons)} polygons" if polygons else "holds no polygon"
        raise UserError(f"{path}: {found}; {_ONE_POLYGON}")
    return polygons[0]


def _polygons(path: Path) -> Iterable[shapely.Polygon]:
    suffix = path.suffix.lower()
    if suffix in (".geojson", ".json"):
        return _geojson_polygons(read_geojson(path, MAX_AREA_FILE_BYTES), path)
    if suffix == ".kml":
        return _kml_polygons(read_limited(path, MAX_AREA_FILE_BYTES), path)
    if suffix == ".kmz":
        return _kml_polygons(_unzip(path), path)
    if suffix == ".plan":
        return survey_polygons(read_plan(path))
    raise UserError(f"{path}: is no area file; give one that ends in {', '.join(SUFFIXES)}")


def _on_ground(
    lon_lat: shapely.Polygon, path: Path, frame: LocalFrame | None
) -> tuple[shapely.Polygon, LocalFrame]:
    corners = shapely.get_coordinates(lon_lat)
    if len(corners) > MAX_CORNERS:
        raise UserError(
            f"{path}: the polygon has {len(corners):,} corners; simplify it to {MAX_CORNERS:,} or fewer"
        )
    if not np.isfinite(corners).all() or (np.abs(corners) > [180.0, 90.0]).any():
        raise UserError(
            f"{path}: a corner is no longitude and latitude in degrees; export the area in WGS 84 (EPSG:4326)"
        )
    if lon_lat.is_empty:
        raise UserError(f"{path}: the polygon has no corners; {_ONE_POLYGON}")
    if np.ptp(corners[:, 0]) > 180.0:  # it lies across the 180th meridian
        lon_lat = shapely.transform(lon_lat, lambda each: np.column_stack([each[:, 0] % 360.0, each[:, 1]]))
        corners = shapely.get_coordinates(lon_lat)
    if not lon_lat.is_valid:
        reason = shapely.is_valid_reason(lon_lat)
        raise UserError(f"{path}: the polygon is not simple ({reason}); draw it without crossing lines")
    if frame is None:
        middle = lon_lat.centroid if lon_lat.area > 0 else shapely.Point(corners.mean(axis=0))
        frame = LocalFrame(middle.y, (middle.x + 180.0) % 360.0 - 180.0)
    local = frame

    def enu(lon_lat_deg: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        altitude = np.full(len(lon_lat_deg), local.altitude_m)
        return local.enu_from_geodetic(np.column_stack([lon_lat_deg[:, ::-1], altitude]))[:, :2]

    area = shapely.transform(lon_lat, enu)
    if not 1.0 <= area.area <= MAX_AREA_KM2 * 1e6:
        raise UserError(
            f"{path}: the polygon covers {area.area / 1e6:.3g} km2; "
            f"draw one between 1 m2 and {MAX_AREA_KM2:g} km2"
        )
    return area, frame


def _geojson_polygons(node: Any, path: Path) -> Iterator[shapely.Polygon]:
    kind = node.get("type") if isinstance(node, dict) else None
    if kind == "FeatureCollection":
        children = node.get("features")
    elif kind == "Feature":
        children = [node.get("geometry")] if node.get("geometry") is not None else []
    elif kind == "GeometryCollection":
        children = node.get("geometries")
    elif kind == "Polygon":
        yield _polygon(node.get("coordinates"), path)
        return
    elif kind == "MultiPolygon":
        for rings in _list(node.get("coordinates"), path):
            yield _polygon(rings, path)
        return
    elif kind in ("Point", "MultiPoint", "LineString", "MultiLineString"):
        return
    else:
        raise UserError(f"{path}: type: {str(kind)[:40]!r} is not of GeoJSON; {_ONE_POLYGON}")
    for child in _list(children, path):
        yield from _geojson_polygons(child, path)


def _list(node: Any, path: Path) -> list[Any]:
    if not isinstance(node, list):
        raise UserError(
            f"{path}: a list of shapes or coordinates is missing; export the area again as GeoJSON"
        )
    return node


def _polygon(rings: Any, path: Path) -> shapely.Polygon:
    if isinstance(rings, list) and len(rings) > MAX_CORNERS:
        raise UserError(f"{path}: the polygon has {len(rings) - 1:,} holes; leave them out, or merge them")
    try:
        shell, *holes = [[(float(p[0]), float(p[1])) for p in ring] for ring in rings]
        return shapely.Polygon(shell, holes)
    except (TypeError, ValueError, IndexError, KeyError, OverflowError, shapely.errors.GEOSException):
        raise UserError(
            f"{path}: the polygon's coordinates are not rings of at least 4 [longitude, latitude] pairs; "
            "export the area again"
        ) from None


def _unzip(path: Path) -> bytes:
    """The KML inside a KMZ: ``doc.kml``, or the first ``.kml``, unpacked no further than the size limit."""
    packed, data = BytesIO(read_limited(path, MAX_AREA_FILE_BYTES)), None
    try:
        with zipfile.ZipFile(packed) as archive:
            names = [n for n in archive.namelist() if n.lower().endswith(".kml")]
            if names:
                with archive.open("doc.kml" if "doc.kml" in names else names[0]) as file:
                    data = file.read(MAX_AREA_FILE_BYTES + 1)
    except Exception:  # zipfile lets through whatever its decompressors raise
        raise UserError(f"{path}: is no readable KMZ (zip) file; export the area again as KMZ") from None
    if data is None:
        raise UserError(f"{path}: holds no .kml file; export the area again as KMZ")
    if len(data) > MAX_AREA_FILE_BYTES:
        raise UserError(
            f"{path}: unpacks to more than {MAX_AREA_FILE_BYTES / 1e6:g} MB; "
            "save only the search area's polygon"
        )
    return data


def _kml_polygons(data: bytes, path: Path) -> Iterator[shapely.Polygon]:
    try:
        root = fromstring(data, forbid_dtd=True)
    except DefusedXmlException:
        raise UserError(
            f"{path}: declares a DTD or entities, which a KML needs not and a trap may; export the area again"
        ) from None
    except (ParseError, ValueError, LookupError) as error:
        raise UserError(f"{path}: is not KML ({error}); export the area again") from None
    for polygon in _descendants(root, "Polygon"):
        outer, inner = (
            [
                _kml_corners(r)
                for edge in _descendants(polygon, side)
                for r in _descendants(edge, "LinearRing")
            ]
            for side in ("outerBoundaryIs", "innerBoundaryIs")
        )
        yield _polygon(outer[:1] + inner, path)


def _descendants(element: Element, name: str) -> Iterator[Element]:
    return (e for e in element.iter() if isinstance(e.tag, str) and e.tag.rpartition("}")[2] == name)


def _kml_corners(ring: Element) -> list[list[str]]:
    text = " ".join(e.text or "" for e in _descendants(ring, "coordinates"))
    return [corner.split(",") for corner in text.split()]
