"""Small GeoTIFFs and the scenarios over them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyproj
import pytest

from skysweep.scenarios.model import Scenario

rasterio = pytest.importorskip("rasterio")
pytest.importorskip("rasterio.warp")

LATITUDE_DEG, LONGITUDE_DEG = 61.0, 25.0  # of home
AREA = [[0, 0], [600, 0], [600, 400], [0, 400]]


def write(path, values, crs="EPSG:3067", transform=None, **profile):
    """A GeoTIFF of values (rows, columns) or (bands, rows, columns)."""
    values = np.asarray(values)
    bands = values if values.ndim == 3 else values[None]
    profile = {"dtype": bands.dtype, "crs": crs, "transform": transform} | profile
    unit = profile.pop("unit", None)
    with rasterio.open(
        path, "w", driver="GTiff", width=bands.shape[2], height=bands.shape[1], count=len(bands), **profile
    ) as file:
        file.write(bands)
        if unit:
            file.units = [unit] * len(bands)
    return Path(path)


def placed(pixel, size, crs="EPSG:3067", turned_deg=0.0, upside_down=False, middle_enu_m=(300.0, 200.0),
           home=(LATITUDE_DEG, LONGITUDE_DEG)):  # fmt: skip
    """The transform of ``size`` (rows, columns) pixels, in units of the CRS, around a place by home."""
    rows, columns = size
    to_crs = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    per_degree = 111_320.0
    latitude = home[0] + middle_enu_m[1] / per_degree
    longitude = home[1] + middle_enu_m[0] / per_degree / math.cos(math.radians(home[0]))
    x, y = to_crs.transform(longitude, latitude)
    down = pixel if upside_down else -pixel
    cos, sin = math.cos(math.radians(turned_deg)), math.sin(math.radians(turned_deg))
    a, b, d, e = cos * pixel, -sin * down, sin * pixel, cos * down
    return rasterio.Affine(a, b, x - a * columns / 2 - b * rows / 2, d, e, y - d * columns / 2 - e * rows / 2)


def slope(size, column_m=0.3, row_m=-0.2, level_m=100.0):
    """Heights that rise with columns and rows."""
    row, column = np.mgrid[: size[0], : size[1]] + 0.5
    return (level_m + column_m * column + row_m * row).astype(np.float32)


def over(home=(LATITUDE_DEG, LONGITUDE_DEG), area=AREA, altitude_amsl_m=100.0, others=None, **terrain):
    """A scenario with files as its ground."""
    told = {field: str(value) if isinstance(value, Path) else value for field, value in terrain.items()}
    return Scenario.model_validate(
        {
            "name": "here",
            "area": {"polygon_enu_m": area},
            "home": {"latitude_deg": home[0], "longitude_deg": home[1], "altitude_amsl_m": altitude_amsl_m},
            "terrain": told,
            **(others or {}),
        }
    )
