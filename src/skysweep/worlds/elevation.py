"""The ground's height from a digital elevation model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from skysweep.arrays import F64
from skysweep.files.reading import stamp_of
from skysweep.geometry.frames import LocalFrame
from skysweep.types import XY
from skysweep.worlds.rasters import Bounds, GeoTiff, Part, between_nodes, geotiff

FIELD = "terrain.dem"
MAX_POSTS = 4_000_000
_MAX_HOLE_M = 50.0  # from its middle to where the height is known
_HEIGHTS_M = -500.0, 9000.0  # on earth; what lies beyond stands for a hole
_STRIP_PX = 20_000_000  # read at once
_FOOT_M = 0.3048
_UNITS_M = {
    **dict.fromkeys(["m", "metre", "metres", "meter", "meters"], 1.0),
    **dict.fromkeys(["ft", "foot", "feet", "international foot"], _FOOT_M),
    **dict.fromkeys(["us-ft", "us survey foot", "us survey feet", "ftus"], 1200 / 3937),
}


@dataclass(frozen=True)
class Elevation:
    """Heights above the ENU plane, 0 at home, over a regular grid as ``TerrainSurface`` has them."""

    heights_m: F64  # (rows south to north, columns west to east)
    home_amsl_m: float
    filled: float  # share of the ground without heights in the file
    source: GeoTiff
    notes: tuple[str, ...]  # a sentence for each thing that had to be made up


def elevation(
    path: Path, unit: str | None, frame: LocalFrame, bounds_enu_m: Bounds, area: shapely.Polygon, home: XY
) -> Elevation:
    """The heights of a file over bounds, which hold the area and home.

    ``unit``: "metres", "feet", or None for what the file says.
    Raises UserError where it is no elevation model, or has no heights for the area or home.
    """
    return _elevation(path, stamp_of(path), unit, frame, bounds_enu_m, area.wkb, home)


@lru_cache(maxsize=4)
def _elevation(
    path: Path,
    _stamp: tuple[int, int] | None,
    unit: str | None,
    frame: LocalFrame,
    bounds_enu_m: Bounds,
    area_wkb: bytes,
    home: XY,
) -> Elevation:
    dem = geotiff(path, FIELD, frame)
    if dem.dtype.startswith("complex") or dem.has_palette or (dem.bands >= 3 and dem.dtype == "uint8"):
        raise dem.error("is a picture, not heights; give a digital elevation model")
    dem.overlap(bounds_enu_m)
    metres = _unit_m(dem, unit)
    west, south, east, north = bounds_enu_m
    fine_m = dem.pixel_m
    step_m = max(fine_m, math.sqrt((east - west) * (north - south) / MAX_POSTS))
    x = np.linspace(west, east, max(2, math.ceil((east - west) / step_m) + 1))
    y = np.linspace(south, north, max(2, math.ceil((north - south) / step_m) + 1))
    places = dem.pixels_over(x, y)
    heights = _sampled(dem, places, max(1, round(step_m / fine_m)), metres)
    notes = []
    if step_m > 1.01 * fine_m:
        notes.append(
            f"{FIELD}: is read every {step_m:.1f} m, not every {fine_m:.1f} m: the ground is too large"
        )
    missing = np.isnan(heights)
    if missing.any():
        searched = shapely.from_wkb(area_wkb).union(shapely.Point(home)).buffer(step_m)
        heights, made_up = _whole(dem, heights, places, x, y, searched)
        notes += made_up

    def plane_m(xy: F64) -> F64:
        """How far the ENU plane lies above a level surface, which curves away below it."""
        flat = np.column_stack([xy, np.zeros(len(xy))])
        return frame.geodetic_from_enu(flat)[:, 2:] - frame.altitude_m

    heights -= between_nodes(plane_m, x, y)[0]
    i, j = np.interp(home[1], y, np.arange(len(y))), np.interp(home[0], x, np.arange(len(x)))
    at_home = float(ndimage.map_coordinates(heights, [[i], [j]], order=1)[0])
    home_amsl_m = at_home + float(plane_m(np.array([home]))[0, 0])
    return Elevation(heights - at_home, home_amsl_m, float(missing.mean()), dem, tuple(notes))


def _unit_m(dem: GeoTiff, unit: str | None) -> float:
    """Metres of one unit of the heights. Raises UserError where nobody knows."""
    if unit is not None:
        return 1.0 if unit == "metres" else _FOOT_M
    if dem.unit:
        if dem.unit.lower() not in _UNITS_M:
            raise dem.error(f"has heights in '{dem.unit[:20]}'; save it in metres, or write terrain.dem_unit")
        return _UNITS_M[dem.unit.lower()]
    up = [axis for axis in dem.crs.axis_info if axis.direction == "up"]
    if up:
        return float(up[0].unit_conversion_factor)
    across = dem.crs.axis_info[0].unit_name.lower()
    if "foot" in across or "feet" in across:
        raise dem.error("lies in feet and does not say whether its heights do; write terrain.dem_unit")
    return 1.0


def _sampled(dem: GeoTiff, places: F64, every: int, metres: float) -> F64:
    """Heights (R, C) at columns and rows (2, R, C) of the file, NaN where it has none.

    Linear between the means of ``every`` x ``every`` pixels.
    """
    part = dem.window(np.moveaxis(places, 0, -1), 2 * every)
    if part is None:
        return np.full(places.shape[1:], np.nan)
    strip = max(every, _STRIP_PX // part.wide // every * every)
    tops = range(part.row, part.row + part.tall, strip)
    strips = [Part(part.column, row, part.wide, min(strip, part.row + part.tall - row)) for row in tops]
    means = np.concatenate([_means(dem, each, every, metres) for each in strips])
    i, j = (places[1] - part.row) / every - 0.5, (places[0] - part.column) / every - 0.5
    heights = ndimage.map_coordinates(means, [i, j], order=1, mode="nearest")
    heights[dem.outside_m(np.moveaxis(places, 0, -1)) > 0.0] = np.nan
    return np.asarray(heights)


def _means(dem: GeoTiff, part: Part, every: int, metres: float) -> F64:
    pixels = dem.read(part)
    scale, offset = dem.scale_offset
    heights = (pixels.values.astype(float) * scale + offset) * metres
    with np.errstate(invalid="ignore"):
        known = pixels.is_valid & (heights > _HEIGHTS_M[0]) & (heights < _HEIGHTS_M[1])
    heights[~known] = np.nan
    if every == 1:
        return np.asarray(heights)
    rows, columns = (-(-n // every) for n in heights.shape)
    room = ((0, rows * every - heights.shape[0]), (0, columns * every - heights.shape[1]))
    blocks = np.pad(heights, room, constant_values=np.nan).reshape(rows, every, columns, every)
    count = np.isfinite(blocks).sum(axis=(1, 3))
    return np.where(count > 0, np.nansum(blocks, axis=(1, 3)) / np.maximum(count, 1), np.nan)


def _whole(
    dem: GeoTiff, heights: F64, places: F64, x: F64, y: F64, searched: shapely.Geometry
) -> tuple[F64, list[str]]:
    """Heights without holes, and what was made up. Raises UserError where that would be too much."""
    missing = np.isnan(heights)
    spacing = (float(y[1] - y[0]), float(x[1] - x[0]))
    if missing.all():
        raise dem.error("has no heights here, only holes; give one of this area")
    away_m = ndimage.distance_transform_edt(missing, sampling=spacing)
    i, j = np.nonzero(missing)
    needed = shapely.intersects_xy(searched, x[j], y[i])
    beyond_m = dem.outside_m(np.moveaxis(places, 0, -1)[i, j])
    short_m = float(beyond_m[needed].max(initial=0.0))
    cells = spacing[0] * spacing[1]
    if short_m > 0.0:
        share = (needed & (beyond_m > 0.0)).sum() * cells / searched.area
        raise dem.error(
            f"ends {short_m:.0f} m short of the area or home, and lacks {min(share, 1.0):.0%} of the area; "
            "give a larger one, or search a smaller area"
        )
    largest_m = float(away_m[i, j][needed].max(initial=0.0))
    if largest_m > _MAX_HOLE_M + dem.pixel_m:
        raise dem.error(
            f"has a hole in the area, {2 * largest_m:.0f} m wide, too large to be filled; give one without it"
        )
    notes = []
    held = beyond_m == 0.0
    if held.any():
        notes.append(
            f"{FIELD}: {_percent(held.sum() / missing.size)} of the ground has no height, at most "
            f"{away_m[i, j][held].max():.0f} m from known ones, and is interpolated"
        )
    if not held.all():
        notes.append(
            f"{FIELD}: ends up to {beyond_m.max():.0f} m before the ground around the area does; "
            "the rest is as high as its edge"
        )
    return _filled(heights, missing, _MAX_HOLE_M / min(spacing)), notes


def _filled(heights: F64, missing: NDArray[np.bool_], reach: float) -> F64:
    """Holes interpolated from their edges; what is farther than that gets the nearest height."""
    from rasterio.fill import fillnodata

    level = float(np.nanmean(heights))  # so that 32 bits hold the rest to the millimetre
    known = np.where(missing, 0.0, heights - level).astype(np.float32)
    near = fillnodata(known, mask=~missing, max_search_distance=math.ceil(2 * reach) + 2)
    far = ndimage.distance_transform_edt(missing) > reach
    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    out = np.where(missing, near.astype(float) + level, heights)
    return np.asarray(np.where(far, heights[tuple(nearest)], out))


def _percent(share: float) -> str:
    return f"{share:.1%}" if share >= 0.001 else "less than 0.1%"
