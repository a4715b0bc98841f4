"""What covers the ground and what grows on it, from a map of classes and from roads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from skysweep.arrays import F64, I64, U8
from skysweep.files.reading import stamp_of
from skysweep.geometry.frames import LocalFrame
from skysweep.scenarios.model import LandClass, Surface
from skysweep.worlds.map_features import roads
from skysweep.worlds.rasters import Bounds, geotiff

FIELD = "terrain.land_cover"
SURFACES: tuple[str, ...] = get_args(Surface)
MAX_CELLS = 4_000_000
_ROAD_CELL_M = 1.5
_NO_CLASS = 255
_SHIFT = 4  # binary digits of a corner's fraction


def _class(code: int, surface: Surface, trees: float = 0.0, **growth: object) -> LandClass:
    return LandClass.model_validate({"code": code, "surface": surface, "trees_per_hectare": trees, **growth})


_BUSHES = {"height_m": (1.0, 3.0), "crown_radius_m": (0.5, 1.4), "conifer_fraction": 0.0}
WORLDCOVER = (  # ESA WorldCover 2021, product user manual, table 1; the trees: open woodland
    _class(10, "forest floor", 250.0, height_m=(6.0, 20.0), crown_radius_m=(1.2, 2.6)),
    _class(20, "grass", 80.0, **_BUSHES),
    _class(30, "grass"),
    _class(40, "grass"),
    _class(50, "asphalt", 10.0),
    _class(60, "sand"),
    _class(70, "snow"),
    _class(80, "water"),
    _class(90, "grass"),
    _class(95, "forest floor", 400.0, height_m=(3.0, 10.0), conifer_fraction=0.0),
    _class(100, "rock"),
)


@dataclass(frozen=True)
class LandCover:
    """Cells over the ground, rows south to north, columns west to east."""

    surfaces: U8  # (R, C), indices into names
    classes: U8  # (R, C), indices of the classes; 255 where nothing grows
    bounds_enu_m: Bounds
    names: tuple[str, ...]  # of the surfaces
    covered: float  # share of the ground that the map tells of
    notes: tuple[str, ...]


def land_cover(
    path: Path | None,
    roads_file: Path | None,
    classes: Sequence[LandClass],
    surface: str,
    frame: LocalFrame,
    bounds_enu_m: Bounds,
) -> LandCover:
    """The cover of the ground within bounds: a map's classes, else ``surface``, and roads over both.

    Raises UserError where the map is none, lies elsewhere or has classes that are not known.
    """
    stamps = [None if file is None else stamp_of(file) for file in (path, roads_file)]
    return _land_cover(path, roads_file, tuple(stamps), tuple(classes), surface, frame, bounds_enu_m)


@lru_cache(maxsize=4)
def _land_cover(
    path: Path | None,
    roads_file: Path | None,
    _stamps: tuple[tuple[int, int] | None, ...],
    classes: tuple[LandClass, ...],
    surface: str,
    frame: LocalFrame,
    bounds_enu_m: Bounds,
) -> LandCover:
    west, south, east, north = bounds_enu_m
    source = None if path is None else geotiff(path, FIELD, frame)
    paved, about_roads = ((), ()) if roads_file is None else roads(roads_file, frame, bounds_enu_m)
    finest_m = math.sqrt((east - west) * (north - south) / MAX_CELLS)
    cell_m = max(finest_m, _ROAD_CELL_M if source is None else source.pixel_m)
    if paved:
        cell_m = max(finest_m, min(cell_m, _ROAD_CELL_M))
    columns, rows = math.ceil((east - west) / cell_m), math.ceil((north - south) / cell_m)
    surfaces = np.full((rows, columns), SURFACES.index(surface), np.uint8)
    grown = np.full((rows, columns), _NO_CLASS, np.uint8)
    covered, notes = 1.0, list(about_roads)
    if source is not None:
        if not np.issubdtype(np.dtype(source.dtype), np.integer) or source.bands > 1:
            raise source.error("is no map of classes; give one band of whole numbers")
        source.overlap(bounds_enu_m)  # or refused
        x = west + (np.arange(columns) + 0.5) * (east - west) / columns
        y = south + (np.arange(rows) + 0.5) * (north - south) / rows
        places = source.pixels_over(x, y)
        part = source.window(np.moveaxis(places, 0, -1), 2)
        if part is None:
            raise source.error("overlaps the area by less than a cell; give land cover of this area")
        pixels = source.read(part, max(1.0, cell_m / source.pixel_m))
        i, j = np.floor(pixels.places_of(places) + 0.5).astype(int)
        told = (i >= 0) & (i < len(pixels.values)) & (j >= 0) & (j < pixels.values.shape[1])
        told[told] = pixels.is_valid[i[told], j[told]]
        covered = float(told.mean())
        if covered < 0.999:
            notes.append(f"{FIELD}: tells of {covered:.0%} of the ground; the rest is {surface}")
        codes = pixels.values[i[told], j[told]]
        known = [c.code for c in classes]
        strange = sorted(set(np.unique(codes).tolist()) - set(known))
        if strange:
            raise source.error(
                f"has the class{'es' if len(strange) > 1 else ''} {', '.join(map(str, strange[:8]))}, which "
                "terrain.land_cover_classes does not tell; add what it is"
            )
        order = np.argsort(known)
        which = order[np.searchsorted(np.array(known)[order], codes)]
        surfaces[told] = np.array([SURFACES.index(c.surface) for c in classes], np.uint8)[which]
        grown[told] = which
    for road in paved:
        _pave(surfaces, SURFACES.index(road.surface), road.outline, bounds_enu_m)
        _pave(grown, _NO_CLASS, road.outline, bounds_enu_m)
    return LandCover(surfaces, grown, bounds_enu_m, SURFACES, covered, tuple(notes))


def _pave(cells: U8, value: int, outline: shapely.Geometry, bounds_enu_m: Bounds) -> None:
    west, south, east, north = bounds_enu_m
    per_m = np.array([cells.shape[1] / (east - west), cells.shape[0] / (north - south)])
    for polygon in shapely.get_parts(outline):
        if polygon.geom_type == "Polygon":
            rings = [
                np.round(((shapely.get_coordinates(ring) - [west, south]) * per_m - 0.5) * 2**_SHIFT).astype(
                    np.int32
                )
                for ring in (polygon.exterior, *polygon.interiors)
            ]
            cv2.fillPoly(cells, rings, value, shift=_SHIFT)


@dataclass(frozen=True)
class Growth:
    """Trees by place and looks, all (N,) but the places."""

    xy_enu_m: F64  # (N, 2)
    height_m: F64
    crown_radius_m: F64
    is_conifer: NDArray[np.bool_]
    variant: I64


def wanted_trees(cover: LandCover, classes: Sequence[LandClass]) -> F64:
    """Trees (N,) that the cells of each class have."""
    west, south, east, north = cover.bounds_enu_m
    cell_ha = (east - west) * (north - south) / cover.classes.size / 1e4
    held = np.bincount(cover.classes.ravel(), minlength=_NO_CLASS)[: len(classes)]
    return np.asarray(held * [c.trees_per_hectare for c in classes] * cell_ha)


def growth(cover: LandCover, classes: Sequence[LandClass], most: int, seed: int) -> Growth:
    """Trees drawn in the cells of each class, as many as it has, thinned evenly to ``most``."""
    west, south, east, north = cover.bounds_enu_m
    rows, columns = cover.classes.shape
    across, along = (east - west) / columns, (north - south) / rows
    wanted = wanted_trees(cover, classes)
    thinned = wanted * min(1.0, most / max(wanted.sum(), 1.0))
    stands = []
    for k, c in enumerate(classes):
        rng = np.random.default_rng([seed, k, 37])
        count = int(thinned[k])
        i, j = np.nonzero(cover.classes == k)
        chosen = rng.integers(len(i), size=count) if len(i) else np.zeros(0, int)
        u, v = rng.random((2, count))
        stands.append(
            (
                west + (j[chosen] + u) * across,
                south + (i[chosen] + v) * along,
                rng.uniform(*c.height_m, count),
                rng.uniform(*c.crown_radius_m, count),
                rng.random(count) < c.conifer_fraction,
                rng.integers(1000, size=count),
            )
        )
    x, y, height, radius, conifer, variant = (np.concatenate(each) for each in zip(*stands, strict=True))
    return Growth(np.column_stack([x, y]), height, radius, conifer, variant)
