"""Buildings and roads from GeoJSON with OpenStreetMap's names."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import shapely.ops
from numpy.typing import ArrayLike
from shapely.geometry import shape

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.files.geojson import read_geojson
from skysweep.files.reading import stamp_of
from skysweep.geometry.areas import turned_boxes
from skysweep.geometry.frames import LocalFrame
from skysweep.scenarios.model import MAX_BUILDINGS
from skysweep.worlds.rasters import Bounds

MAX_BYTES = 100_000_000
_STOREY_M = 3.0
_FOOT_M = 0.3048
_LOWEST_M = 2.0
_BOXY = 0.85  # share of its rectangle that a footprint fills: one that fills less is cut
_MOST_CUTS = 4  # one after another
_SMALLEST_M2 = 4.0  # of a part that a cut makes
_NOTHING_M2 = 0.01
_SIMPLER_M = 0.3
_CORNERS = 60  # of a footprint that is worth cutting
_NUMBER = r"(\d+(?:[.,]\d+)?)"
_LENGTH = re.compile(rf"{_NUMBER}\s*([a-z]+|'|\"|'')?(?:\s*{_NUMBER}\s*(?:\"|''|in))?", re.IGNORECASE)
_UNITS_M = {
    **dict.fromkeys(("", "m", "meter", "meters", "metre", "metres"), 1.0), "cm": 0.01, "km": 1000.0,
    **dict.fromkeys(("ft", "feet", "foot", "'"), _FOOT_M), **dict.fromkeys(("in", '"', "''"), _FOOT_M / 12),
}  # fmt: skip
_ANOTHER_PLACE_KM = 5.0  # away; nearer, the area may be a part without any
_ROADS_M = {
    "motorway": 20.0, "trunk": 12.0, "primary": 9.0, "secondary": 7.5, "tertiary": 6.5,
    "unclassified": 5.5, "residential": 5.5, "living_street": 5.0, "service": 4.0, "pedestrian": 4.0,
    "track": 3.0, "cycleway": 2.5, "bridleway": 2.0, "footway": 1.5, "path": 1.2, "steps": 1.5,
}  # fmt: skip
_OTHER_ROAD_M = 5.0
_PAVED = {"asphalt", "paved", "concrete", "concrete:plates", "paving_stones", "sett", "cobblestone", "metal"}
_GROWN = {"grass", "grass_paver"}
_UNPAVED_ROADS = {"track", "bridleway", "path"}  # where they do not say
_POINT, _LINE, _POLYGON = range(3)  # dimensions

Notes = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Box:
    """A building, or a part of one, in ENU metres."""

    position_enu_m: tuple[float, float]  # of the centre
    size_m: tuple[float, float]  # length, width
    yaw_rad: float
    eaves_m: float  # above the ground
    is_flat: bool  # its roof; else a gable that rises by half the width at most

    @property
    def top_m(self) -> float:
        """Of the ridge at most, above the ground."""
        return self.eaves_m + (0.0 if self.is_flat else self.size_m[1] / 2)

    def outline(self) -> shapely.Polygon:
        """Its walls, seen from above."""
        return turned_boxes(self.position_enu_m, self.size_m, self.yaw_rad)[0]


@dataclass(frozen=True, slots=True)
class Road:
    """A road's ground in ENU metres."""

    outline: shapely.Geometry
    surface: str


def buildings(path: Path, frame: LocalFrame, bounds_enu_m: Bounds) -> tuple[tuple[Box, ...], Notes]:
    """The buildings of a file that touch the ground within bounds, as boxes that hold them, and notes.

    Raises UserError where the file is no GeoJSON, holds no footprint there, or too many.
    """
    return _buildings(path, stamp_of(path), frame, bounds_enu_m)


def roads(path: Path, frame: LocalFrame, bounds_enu_m: Bounds) -> tuple[tuple[Road, ...], Notes]:
    """The roads of a file within bounds, narrow ones first, and notes.

    Raises UserError where it is no GeoJSON, or holds no road there.
    """
    return _roads(path, stamp_of(path), frame, bounds_enu_m)


@lru_cache(maxsize=4)
def _buildings(
    path: Path, _stamp: tuple[int, int] | None, frame: LocalFrame, bounds_enu_m: Bounds
) -> tuple[tuple[Box, ...], Notes]:
    boxes: list[Box] = []
    found, notes = _tagged(path, "buildings", "building", _POLYGON, frame, bounds_enu_m)
    low = sum(not any(_metres(tags.get(tag)) for tag in ("height", "building:levels")) for _, tags in found)
    if low:
        which = f"{low} of {len(found)} buildings in the area"
        notes += (f"buildings_file: {which} tell no height and no storeys: taken for one storey each",)
    for outline, tags in found:
        for part in shapely.get_parts(outline):
            if part.geom_type == "Polygon":
                boxes += _boxes(part, tags)
        if len(boxes) > MAX_BUILDINGS:
            raise UserError(
                f"buildings_file: {path}: makes more than {MAX_BUILDINGS} boxes; leave the small ones out"
            )
    return tuple(boxes), notes


@lru_cache(maxsize=4)
def _roads(
    path: Path, _stamp: tuple[int, int] | None, frame: LocalFrame, bounds_enu_m: Bounds
) -> tuple[tuple[Road, ...], Notes]:
    wide: list[tuple[float, Road]] = []
    found, notes = _tagged(path, "roads", "highway", _LINE, frame, bounds_enu_m)
    for line, tags in found:
        if tags.get("tunnel", "no") != "no":
            continue
        kind = str(tags["highway"]).removesuffix("_link")
        width_m = _metres(tags.get("width")) or _ROADS_M.get(kind, _OTHER_ROAD_M)
        outline = shapely.buffer(line, width_m / 2, cap_style="flat").intersection(shapely.box(*bounds_enu_m))
        wide.append((width_m, Road(outline, _surface(kind, tags))))
    return tuple(road for _, road in sorted(wide, key=lambda each: each[0])), notes


def _tagged(
    path: Path, what: str, tag: str, dimensions: int, frame: LocalFrame, bounds_enu_m: Bounds
) -> tuple[list[tuple[shapely.Geometry, dict[str, Any]]], Notes]:
    """The features within bounds that have a tag and the right shape, and a note on others with that tag.

    Raises UserError where none is usable, or all are so far away that the file is one of another place.
    """
    field, word = f"{what}_file", {_LINE: "line", _POLYGON: "polygon"}[dimensions]
    instead = f"give {what} of this area, or leave the file out"
    features = list(_features(path, field, frame))
    tagged = [each for each in features if each[1].get(tag, "no") != "no"]
    tagged = [each for each in tagged if not each[0].is_empty]
    usable = [each for each in tagged if shapely.get_dimensions(each[0]) == dimensions]
    if not usable:
        raise UserError(f"{field}: {path}: holds no {word} with OpenStreetMap's tag '{tag}'; {instead}")
    ground = shapely.box(*bounds_enu_m)
    here = [each for each in usable if shapely.intersects(ground, each[0])]
    if not here:
        away_km = min(shapely.distance(ground, each[0]) for each in usable) / 1e3
        where = f"its {what} are {away_km:.1f} km away"
        if away_km > _ANOTHER_PLACE_KM:
            raise UserError(f"{field}: {path}: {where}; {instead}")
        return [], (f"{field}: {where}: there are none in the area",)
    other_shapes = {_LINE: (_POLYGON,), _POLYGON: (_POINT, _LINE)}[
        dimensions
    ]  # points on roads are crossings
    others = [
        each for each, _ in tagged if shapely.get_dimensions(each) in other_shapes and ground.intersects(each)
    ]
    if not others:
        return here, ()
    many = f"{len(others)} of {len(others) + len(here)} {what}"
    return here, (f"{field}: {many} in the area left out: not a {word}",)


def _surface(kind: str, tags: dict[str, Any]) -> str:
    """Asphalt, grass or bare ground, which is looked at as sand."""
    told = str(tags.get("surface", "")).lower()
    if told in _GROWN:
        return "grass"
    is_paved = told in _PAVED if told else kind not in _UNPAVED_ROADS
    return "asphalt" if is_paved else "sand"


def _features(path: Path, field: str, frame: LocalFrame) -> Iterator[tuple[shapely.Geometry, dict[str, Any]]]:
    """Shapes in ENU metres, and their tags."""
    try:
        data = read_geojson(path, MAX_BYTES)
    except UserError as error:
        raise UserError(f"{field}: {error}") from None
    features = data.get("features") if isinstance(data, dict) else None
    if not isinstance(features, list):
        raise UserError(f"{field}: {path}: is no collection of features; export it again as GeoJSON")

    def enu_m(lon_lat_deg: F64) -> F64:
        heights = np.full(len(lon_lat_deg), frame.altitude_m)
        return frame.enu_from_geodetic(np.column_stack([lon_lat_deg[:, ::-1], heights]))[:, :2]

    for number, feature in enumerate(features, 1):
        try:
            if feature["geometry"] is None:
                continue
            lon_lat, told = shape(feature["geometry"]), dict(feature.get("properties") or {})
        except (AttributeError, KeyError, TypeError, ValueError, IndexError, shapely.errors.ShapelyError):
            raise UserError(
                f"{field}: {path}: feature {number} has no shape; export it again as GeoJSON"
            ) from None
        corners = shapely.get_coordinates(lon_lat)
        if not np.isfinite(corners).all() or (np.abs(corners) > [180.0, 90.0]).any():
            raise UserError(
                f"{field}: {path}: feature {number} is not in longitude and latitude in degrees; export it "
                "in EPSG:4326"
            )
        tags = {tag: value for tag, value in told.items() if value not in (None, "")}  # empty table columns
        yield shapely.make_valid(shapely.transform(lon_lat, enu_m)), tags


def _metres(told: Any) -> float | None:
    """A length as OpenStreetMap has it, metres or feet and inches; the greatest of several (3;4), or None."""
    lengths_m = []
    for part in re.split("[;-]", str(told)):
        length = _LENGTH.fullmatch(part.strip(" ~<>"))
        unit_m = _UNITS_M.get((length[2] or "").lower()) if length else None
        if length and unit_m:
            inches = float((length[3] or "0").replace(",", "."))
            lengths_m.append(float(length[1].replace(",", ".")) * unit_m + inches * _FOOT_M / 12)
    return max(lengths_m, default=0.0) or None


def _boxes(outline: shapely.Polygon, tags: dict[str, Any]) -> Iterator[Box]:
    storeys = _metres(tags.get("building:levels")) or 1.0
    roof = str(tags.get("roof:shape", "")).lower()
    for sides in _rectangles(shapely.Polygon(outline.exterior), _MOST_CUTS):
        centre, length, width, yaw = sides
        is_flat = roof == "flat" or (not roof and width > 12.0)
        top = _metres(tags.get("height"))
        eaves = storeys * _STOREY_M if top is None else top - (0.0 if is_flat else 0.5 * width)
        yield Box(centre, (length, width), yaw, max(eaves, _LOWEST_M), is_flat)


def _rectangles(
    outline: shapely.Polygon, cuts: int
) -> Iterator[tuple[tuple[float, float], float, float, float]]:
    """Centre, length, width and yaw of rectangles that together hold a footprint; an L becomes two."""
    rectangle = shapely.minimum_rotated_rectangle(outline)
    a, b, c = shapely.get_coordinates(rectangle)[:3] if rectangle.geom_type == "Polygon" else np.zeros((3, 2))
    sides = [b - a, c - b]
    along, across = sorted(sides, key=lambda side: -float(np.hypot(*side)))
    length, width = float(np.hypot(*along)), float(np.hypot(*across))
    if length * width < (_SMALLEST_M2 if cuts < _MOST_CUTS else _NOTHING_M2):
        return
    if cuts and outline.area < _BOXY * length * width:
        parts = _cut(outline.simplify(_SIMPLER_M), along / length, across / width)
        if parts:
            for part in parts:
                yield from _rectangles(part, cuts - 1)
            return
    middle = (a + c) / 2
    yield (float(middle[0]), float(middle[1])), length, width, math.atan2(along[1], along[0])


def _cut(outline: shapely.Polygon, *directions: ArrayLike) -> list[shapely.Polygon]:
    """The footprint cut through one of its corners so that the rectangles of its parts are smallest."""
    corners = shapely.get_coordinates(outline)[:-1]
    if not outline.is_valid or len(corners) > _CORNERS:
        return []
    best, found = 0.95 * shapely.minimum_rotated_rectangle(outline).area, []
    far = 2.0 * math.hypot(*np.ptp(corners, axis=0))
    for corner in corners:
        for direction in directions:
            reach = far * np.asarray(direction)
            line = shapely.linestrings([corner - reach, corner + reach])
            parts = list(shapely.get_parts(shapely.ops.split(outline, line)))
            area = sum(shapely.minimum_rotated_rectangle(part).area for part in parts)
            if len(parts) > 1 and area < best:
                best, found = area, parts
    return found
