#!/usr/bin/env python3
"""Makes the land cover of the shipped scenario coast:  tools/make_coast.py

A made-up bay south of Turku, in UTM zone 34N: the sea, a curved beach along its south, meadow behind it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import rasterio
from numpy.typing import NDArray

FOLDER = Path(__file__).parents[1] / "src" / "skysweep" / "scenarios" / "shipped" / "coast"
CRS = "EPSG:32634"
ORIGIN_LON_LAT = 22.07, 60.14  # of the scenario's local metres
WEST_M, SOUTH_M, WIDE_M, TALL_M = -200.0, -300.0, 2400.0, 2200.0  # from there
CELL_M = 5.0
MEADOW, BARE, WATER = 30, 60, 80  # as in ESA WorldCover


def make(folder: Path) -> None:
    """Writes the land cover, a GeoTIFF, north up along the UTM grid."""
    folder.mkdir(parents=True, exist_ok=True)
    east = WEST_M + CELL_M * (np.arange(round(WIDE_M / CELL_M)) + 0.5)
    north = SOUTH_M + CELL_M * (np.arange(round(TALL_M / CELL_M)) + 0.5)
    cover = _cover(*np.meshgrid(east, north[::-1]))
    x, y = pyproj.Transformer.from_crs("EPSG:4326", CRS, always_xy=True).transform(*ORIGIN_LON_LAT)
    with rasterio.open(
        folder / "land-cover.tif",
        "w",
        driver="GTiff",
        width=cover.shape[1],
        height=cover.shape[0],
        count=1,
        dtype=cover.dtype,
        crs=CRS,
        transform=rasterio.Affine(CELL_M, 0.0, x + WEST_M, 0.0, -CELL_M, y + SOUTH_M + TALL_M),
        nodata=0,
        compress="deflate",
        zlevel=9,
    ) as file:
        file.write(cover, 1)


def _cover(east: NDArray[np.float64], north: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Water, then 60 m of sand south of the shore, then meadow."""
    shore_m = 60.0 + 70.0 * np.cos((east - 1000.0) / 520.0) + 9.0 * np.sin(east / 63.0)
    inland_m = shore_m - north
    return np.where(inland_m < 0.0, WATER, np.where(inland_m < 60.0, BARE, MEADOW)).astype(np.uint8)


if __name__ == "__main__":
    make(FOLDER)
