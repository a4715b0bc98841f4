"""GeoTIFFs of any CRS and size over local metres: only what is looked at is read, as finely as needed.

A raster's pixel coordinates are columns and rows from its first corner, in pixels; the middle of the first pixel
is (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import shapely
from scipy import ndimage

from skysweep.arrays import F64, U8
from skysweep.errors import MissingExtraError, UserError
from skysweep.geometry.frames import LocalFrame

Bounds = tuple[float, float, float, float]  # west, south, east, north

_NODE_M = 50.0  # between places that are projected; linear in between, which errs by less than 1 mm
_BORDER = 64  # points along each edge of a raster's outline


@dataclass(frozen=True)
class GeoTiff:
    """A GeoTIFF and how its pixels lie in a local frame. ``field`` of the scenario names it in errors."""

    path: Path
    field: str
    frame: LocalFrame
    size_px: tuple[int, int]  # width, height
    affine: tuple[float, float, float, float, float, float]  # x = a col + b row + c, y = d col + e row + f
    crs_wkt: str
    bands: int
    dtype: str
    nodata: float | None
    unit: str | None  # of the first band, as the file says

    @classmethod
    def opened(cls, path: Path, field: str, frame: LocalFrame) -> GeoTiff:
        """What the file says of itself.

        Raises UserError where it is no GeoTIFF or does not say where it lies, MissingExtraError without rasterio.
        """
        with _open(path, field) as file:
            if file.crs is None or file.transform.is_identity:
                raise UserError(
                    f"{field}: {path}: does not say where it lies; save it as a GeoTIFF with its CRS and position"
                )
            t = file.transform
            return cls(
                path,
                field,
                frame,
                (file.width, file.height),
                (t.a, t.b, t.c, t.d, t.e, t.f),
                file.crs.to_wkt(),
                file.count,
                file.dtypes[0],
                file.nodata,
                file.units[0],
            )

    @cached_property
    def crs(self) -> pyproj.CRS:
        """The coordinate reference system."""
        return pyproj.CRS.from_wkt(self.crs_wkt)

    def refuse(self, problem: str) -> UserError:
        """The error that names the field and the file."""
        return UserError(f"{self.field}: {self.path}: {problem}")

    def pixels_at(self, xy_enu_m: F64) -> F64:
        """Columns and rows (N, 2) of places (N, 2). Raises UserError where the CRS does not reach there."""
        geodetic = self.frame.geodetic_from_enu(np.column_stack([xy_enu_m, np.zeros(len(xy_enu_m))]))
        to_crs = pyproj.Transformer.from_crs("EPSG:4326", self.crs, always_xy=True)
        x, y = to_crs.transform(geodetic[:, 1], geodetic[:, 0])
        a, b, c, d, e, f = self.affine
        x, y, whole = np.asarray(x) - c, np.asarray(y) - f, a * e - b * d
        pixels = np.column_stack([(e * x - b * y) / whole, (a * y - d * x) / whole])
        if not np.isfinite(pixels).all():
            raise self.refuse("its CRS does not reach the area; give a raster of this area")
        return pixels

    @cached_property
    def outline_enu_m(self) -> shapely.Polygon:
        """Where it lies."""
        raise NotImplementedError


@dataclass(frozen=True)
class GroundPicture:
    """The ground's picture: an orthophoto, of which each look reads a window, coarsely where it is small.

    It holds no open file, so that threads and processes may share it.
    """

    source: GeoTiff
    bounds_enu_m: Bounds  # of the part on the scenario's ground
    pixel_m: float

    def read(
        self, west: float, south: float, east: float, north: float, width_px: int, height_px: int
    ) -> U8:
        """The ground between these ENU metres (H, W, 4) RGBA, north up; alpha is 0 where there is no picture."""
        raise NotImplementedError


def _open(path: Path, field: str) -> Any:
    try:
        import rasterio
    except ImportError:
        raise MissingExtraError(f"{field}: a GeoTIFF", "geo") from None
    if not path.is_file():
        raise UserError(f"{field}: {path}: there is no such file; check the path")
    try:
        return rasterio.open(path, driver="GTiff")
    except rasterio.errors.RasterioError:
        raise UserError(f"{field}: {path}: is no readable GeoTIFF; save it again as one") from None
