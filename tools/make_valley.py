#!/usr/bin/env python3
"""Makes the files of the shipped scenario valley:  tools/make_valley.py

A made-up valley near Turku, in UTM zone 34N: hillsides along a winding bottom, woods, meadows and a farm.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyproj
import rasterio
from numpy.typing import NDArray
from scipy import ndimage

FOLDER = Path(__file__).parents[1] / "src" / "skysweep" / "scenarios" / "shipped" / "valley"
CRS = "EPSG:32634"
ORIGIN_LON_LAT = 22.2966, 60.4490  # of the scenario's local metres
WEST_M, SOUTH_M, WIDE_M, TALL_M = -300.0, -300.0, 2700.0, 1600.0  # from there
POST_M = 10.0
WOOD, SHRUBS, MEADOW, BARE = 10, 20, 30, 60  # as in ESA WorldCover
SEED = 20

Grid = NDArray[np.float64]


def make(folder: Path) -> None:
    """Writes elevation, land cover, buildings and roads."""
    folder.mkdir(parents=True, exist_ok=True)
    x = WEST_M + POST_M * (np.arange(round(WIDE_M / POST_M)) + 0.5)
    y = SOUTH_M + POST_M * (np.arange(round(TALL_M / POST_M)) + 0.5)
    east, north = np.meshgrid(x, y[::-1])
    rng = np.random.default_rng(SEED)
    heights = _heights(east, north, rng)
    _write(folder / "dem.tif", np.round(heights, 1).astype(np.float32), predictor=3)
    _write(folder / "land-cover.tif", _cover(east, north, heights, rng), nodata=0)
    _write_features(folder / "buildings.geojson", _buildings())
    _write_features(folder / "roads.geojson", _roads())


def _bottom_m(east: Grid) -> Grid:
    """How far north the bottom of the valley runs."""
    return 430.0 + 120.0 * np.sin(east / 420.0) + 40.0 * np.sin(east / 170.0)


def _heights(east: Grid, north: Grid, rng: np.random.Generator) -> Grid:
    """AMSL: a bottom that falls to the west, hillsides, and hills of three sizes."""
    beside = (north - _bottom_m(east)) / 400.0
    hillside = 65.0 * (1.0 - np.exp(-(beside**2)))
    hills = 9.0 * _rough(east.shape, 400.0, rng) + 4.0 * _rough(east.shape, 150.0, rng)
    return 18.0 + 0.008 * (east - WEST_M) + hillside + hills + 0.8 * _rough(east.shape, 50.0, rng)


def _cover(east: Grid, north: Grid, heights: Grid, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Meadows along the bottom and in clearings, woods with shrubs at their edges, bare tops."""
    above = heights - ndimage.uniform_filter(heights, 25)
    open_bottom = np.abs(north - _bottom_m(east)) - 90.0
    wooded = open_bottom / 120.0 + 0.9 * _rough(east.shape, 260.0, rng) - 1.1
    cover = np.full(east.shape, MEADOW, np.uint8)
    cover[wooded > -0.12] = SHRUBS
    cover[wooded > 0.0] = WOOD
    cover[above > 7.0] = BARE
    return cover


def _rough(shape: tuple[int, ...], wavelength_m: float, rng: np.random.Generator) -> Grid:
    """Smooth noise with a standard deviation of 1."""
    noise = ndimage.gaussian_filter(rng.standard_normal(shape), wavelength_m / POST_M / 4.0, mode="wrap")
    return np.asarray(noise / noise.std())


def _write(path: Path, values: NDArray[np.generic], **options: object) -> None:
    """A GeoTIFF, north up along the UTM grid."""
    x, y = pyproj.Transformer.from_crs("EPSG:4326", CRS, always_xy=True).transform(*ORIGIN_LON_LAT)
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=values.shape[1],
        height=values.shape[0],
        count=1,
        dtype=values.dtype,
        crs=CRS,
        transform=rasterio.Affine(POST_M, 0.0, x + WEST_M, 0.0, -POST_M, y + SOUTH_M + TALL_M),
        compress="deflate",
        zlevel=9,
        **options,
    ) as file:
        file.write(values, 1)


def _buildings() -> list[dict[str, object]]:
    """A farm: a house, a barn round a corner, a shed."""
    house = [(820, 395), (836, 398), (834, 408), (818, 405), (820, 395)]
    barn = [(850, 380), (886, 384), (885, 396), (864, 393), (862, 412), (847, 410), (850, 380)]
    shed = [(842, 428), (852, 429), (851, 435), (841, 434), (842, 428)]
    return [
        _feature("Polygon", [_lon_lat(house)], {"building": "house", "building:levels": "2"}),
        _feature("Polygon", [_lon_lat(barn)], {"building": "barn", "height": "9"}),
        _feature("Polygon", [_lon_lat(shed)], {"building": "shed", "height": "3 m", "roof:shape": "flat"}),
    ]


def _roads() -> list[dict[str, object]]:
    """The road along the valley, and the farm's track."""
    east = np.arange(-280.0, 2381.0, 40.0)
    road = np.column_stack([east, _bottom_m(east) - 45.0])
    track = [(838, 418), (880, 430), (905, 455), (912, 640), (960, 780)]
    return [
        _feature("LineString", _lon_lat(road), {"highway": "tertiary", "surface": "asphalt"}),
        _feature("LineString", _lon_lat(track), {"highway": "track"}),
    ]


def _lon_lat(corners: object) -> list[list[float]]:
    """Degrees of places in metres east and north of the origin along the UTM grid."""
    to_utm = pyproj.Transformer.from_crs("EPSG:4326", CRS, always_xy=True)
    x, y = (np.asarray(corners, float) + to_utm.transform(*ORIGIN_LON_LAT)).T
    degrees = to_utm.transform(x, y, direction=pyproj.enums.TransformDirection.INVERSE)
    return [[round(float(lon), 7), round(float(lat), 7)] for lon, lat in zip(*degrees, strict=True)]


def _feature(kind: str, coordinates: object, tags: dict[str, str]) -> dict[str, object]:
    return {"type": "Feature", "properties": tags, "geometry": {"type": kind, "coordinates": coordinates}}


def _write_features(path: Path, features: list[dict[str, object]]) -> None:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    make(FOLDER)
