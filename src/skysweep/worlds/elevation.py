"""The ground's height from a digital elevation model."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pyproj
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.files.reading import stamp_of
from skysweep.geometry.frames import LocalFrame
from skysweep.types import XY
from skysweep.worlds.rasters import Bounds, GeoTiff, Part, between_nodes, geotiff

FIELD = "terrain.dem"
_WRITE_UNIT = "write terrain.dem_unit (--dem-unit)"
MAX_POSTS = 4_000_000
_COARSE_M = 100.0  # between heights; SRTM has one every 90 m
_MAX_HOLE_M = 50.0  # from its middle to where the height is known
HEIGHTS_M = -500.0, 9000.0  # on earth; what lies beyond stands for a hole
_SHORE_M = 10.0  # ground beside water at height 0 is lower somewhere
_CLIFF_M = 300.0  # no shore is higher all along
_SHORE_SHARE = 0.05  # of the ground around a water that is that low
_STRIP_PX = 4_000_000  # read at once
_FOOT_M = 0.3048
_NAMED_M = {"metres": 1.0, "feet": _FOOT_M}
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
    states_unit: bool  # else metres are assumed
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
    if any(axis.name.startswith("Ellipsoidal") for axis in dem.crs.axis_info):
        raise dem.error(
            "has heights above the ellipsoid, up to 100 m off those above sea level; convert them, as  "
            "gdalwarp -t_srs EPSG:4326+3855  does"
        )
    dem.overlap(bounds_enu_m)
    metres = _told_unit_m(dem) if unit is None else _NAMED_M[unit]
    west, south, east, north = bounds_enu_m
    fine_m = dem.pixel_m
    step_m = max(fine_m, math.sqrt((east - west) * (north - south) / MAX_POSTS))
    x = np.linspace(west, east, max(2, math.ceil((east - west) / step_m) + 1))
    y = np.linspace(south, north, max(2, math.ceil((north - south) / step_m) + 1))
    places = dem.pixels_over(x, y)
    heights = _sampled(dem, places, max(1, round(step_m / fine_m)), metres or 1.0)
    notes = list(_about_zeros(dem, heights, step_m))
    if fine_m > _COARSE_M:
        notes.append(
            f"{FIELD}: has a height every {fine_m:,.0f} m, and hills between them are not known; give a "
            "finer one, or keep a larger safety.clearance_m"
        )
    if step_m > 1.01 * fine_m:
        notes.append(
            f"{FIELD}: is read every {step_m:.1f} m, as means, not every {fine_m:.1f} m: the ground is too "
            "large, and summits are lower than in the file; keep a larger safety.clearance_m"
        )
    missing = np.isnan(heights)
    if missing.any():
        heights, made_up = _whole(dem, heights, places, x, y, shapely.from_wkb(area_wkb), home)
        notes += made_up

    def plane_m(xy: F64) -> F64:
        """How far the ENU plane lies above a level surface, which curves away below it."""
        flat = np.column_stack([xy, np.zeros(len(xy))])
        return frame.geodetic_from_enu(flat)[:, 2:] - frame.altitude_m

    heights -= between_nodes(plane_m, x, y)[0]
    i, j = np.interp(home[1], y, np.arange(len(y))), np.interp(home[0], x, np.arange(len(x)))
    at_home = float(ndimage.map_coordinates(heights, [[i], [j]], order=1)[0])
    home_amsl_m = at_home + float(plane_m(np.array([home]))[0, 0])
    filled, states_unit = float(missing.mean()), metres is not None
    return Elevation(heights - at_home, home_amsl_m, filled, states_unit, dem, tuple(notes))


def _told_unit_m(dem: GeoTiff) -> float | None:
    """Metres of one unit of the heights by the file, None where it says nothing.

    Raises UserError where they may as well be feet, or are in a unit that is not known.
    """
    try:
        return metres_told(dem.unit, dem.crs)
    except UserError as error:
        raise dem.error(f"{error}, or {_WRITE_UNIT}") from None


def metres_told(unit: str, crs: pyproj.CRS) -> float | None:
    """Metres of one unit of a file's heights, by the unit of its band, else its CRS; None: neither says.

    Raises UserError where they may as well be feet, or are in a unit that is not known.
    """
    if unit:
        if unit.lower() not in _UNITS_M:
            raise UserError(f"has heights in '{unit[:20]}'; save it in metres")
        return _UNITS_M[unit.lower()]
    up = [axis for axis in crs.axis_info if axis.direction == "up"]
    if up:
        return float(up[0].unit_conversion_factor)
    across = crs.axis_info[0].unit_name.lower()
    if "foot" in across or "feet" in across:
        raise UserError("lies in feet and does not say whether its heights do; save it with their unit")
    return None


def _about_zeros(dem: GeoTiff, heights: F64, step_m: float) -> Iterator[str]:
    """A sentence where heights of exactly 0 may stand for missing ones: amid ground that is nowhere as low.

    Raises UserError where they certainly do.
    """
    zero = heights == 0.0
    if not zero.any():
        return
    waters, count = ndimage.label(zero, np.ones((3, 3)))
    away, nearest = ndimage.distance_transform_edt(~zero, return_indices=True)
    shore = (away > 1.5) & (away < 3.5) & ~np.isnan(heights)  # not interpolated with the zeros themselves
    of, shore_m = waters[tuple(nearest[:, shore])], np.abs(heights[shore])
    length = np.bincount(of, minlength=count + 1)
    low = np.bincount(of[shore_m < max(_SHORE_M, 2.0 * step_m)], minlength=count + 1)
    is_odd = (length > 0) & (low < _SHORE_SHARE * length)
    odd = is_odd[waters]
    if not odd.any():
        return
    lowest_m = float(np.quantile(shore_m[is_odd[of]], _SHORE_SHARE))
    what = f"{_percent(odd.mean())} of the ground is exactly 0 amid heights of {lowest_m:.0f} m and more"
    cure = f"mark missing heights with  rio edit-info --nodata 0 {dem.path.name}"
    if lowest_m > _CLIFF_M:
        raise dem.error(f"{what}; {cure}")
    yield f"{FIELD}: {what}; unless that is water, {cure}"


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
    heights = pixels.values.astype(np.float32 if every > 1 else float)
    heights *= scale * metres
    heights += offset * metres
    with np.errstate(invalid="ignore"):
        known = pixels.is_valid & (heights > HEIGHTS_M[0]) & (heights < HEIGHTS_M[1])
    if every == 1:
        return np.where(known, heights, np.nan)
    rows, columns = (-(-n // every) for n in heights.shape)
    room = ((0, rows * every - heights.shape[0]), (0, columns * every - heights.shape[1]))
    share, sums = (
        cv2.resize(np.pad(each, room), (columns, rows), interpolation=cv2.INTER_AREA)
        for each in (known.astype(np.float32), np.where(known, heights, np.float32(0.0)))
    )
    return np.where(share > 0.0, sums / np.maximum(share, np.float32(1e-9)), np.nan).astype(float)


def _whole(
    dem: GeoTiff, heights: F64, places: F64, x: F64, y: F64, area: shapely.Polygon, home: XY
) -> tuple[F64, list[str]]:
    """Heights without holes, and what was made up. Raises UserError where that would be too much."""
    missing = np.isnan(heights)
    spacing = (float(y[1] - y[0]), float(x[1] - x[0]))
    if missing.all():
        raise dem.error("has no heights here, only holes; give one of this area")
    away_m = ndimage.distance_transform_edt(missing, sampling=spacing)
    i, j = np.nonzero(missing)
    beyond_m = dem.outside_m(np.moveaxis(places, 0, -1)[i, j])
    for where, wanted, cure in (
        ("the area", area, "search a smaller area"),
        ("home", shapely.Point(home), "move home"),
    ):
        needed = shapely.intersects_xy(wanted.buffer(max(spacing)), x[j], y[i])
        short_m = float(beyond_m[needed].max(initial=0.0))
        if short_m > 0.0:
            cells = (needed & (beyond_m > 0.0)).sum() * spacing[0] * spacing[1]
            lacks = f" and lacks {_percent(min(cells / wanted.area, 1.0))} of it" if wanted.area else ""
            raise dem.error(f"ends {short_m:.0f} m short of {where}{lacks}; give a larger one, or {cure}")
        largest_m = float(away_m[i, j][needed].max(initial=0.0))
        if largest_m > _MAX_HOLE_M + dem.pixel_m:
            raise dem.error(
                f"has a hole at {where}, {2 * largest_m:.0f} m wide, too large to be filled; "
                f"give one without it, or {cure}"
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
