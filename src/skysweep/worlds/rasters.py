"""GeoTIFFs of any CRS and size over local metres: only what is looked at is read, as finely as needed.

Columns and rows count from a raster's first corner: the middle of its first pixel is (0.5, 0.5).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pyproj
import shapely
from numpy.typing import NDArray

from skysweep.arrays import F64, U8
from skysweep.errors import MissingExtraError, UserError
from skysweep.geometry.datums import may_be_wgs84
from skysweep.geometry.frames import LocalFrame

Bounds = tuple[float, float, float, float]  # west, south, east, north

_NODE_M = 50.0  # between places that are projected; linear in between, which errs by less than 1 mm
_MOST_NODES = 400  # along one side
_MAX_BLOCK_BYTES = 500_000_000  # of what has to be read at once
_BORDER = 64  # points along one edge of four
_TORN = 1e4  # steps along the border that are so much longer than most
_SAMPLES, _SAMPLE_PX = 12, 64  # squares of a picture of 16 bits, in each direction, and their sides
_DARK_BRIGHT = (1.0, 99.0)  # percentiles of the samples


class Part(NamedTuple):
    """Some of a raster's pixels."""

    column: int
    row: int
    wide: int
    tall: int


class Pixels(NamedTuple):
    """What was read, and where."""

    values: NDArray[Any]  # (H, W) or (bands, H, W)
    is_valid: NDArray[np.bool_]  # (H, W)
    column: float  # of the first one's middle
    row: float
    across: float  # columns from one to the next
    down: float  # rows

    def places_of(self, columns_rows: F64) -> F64:
        """Row and column (2, ...) in ``values``, in fractions, of the file's columns and rows (2, ...)."""
        columns, rows = columns_rows
        return np.stack([(rows - self.row) / self.down, (columns - self.column) / self.across])


@dataclass(frozen=True)
class GeoTiff:
    """A GeoTIFF, and how its pixels lie in a local frame. ``field`` of the scenario names it in errors.

    It holds no open file, so that threads and processes may share it.
    """

    path: Path
    field: str
    frame: LocalFrame
    size_px: tuple[int, int]  # width, height
    affine: tuple[float, float, float, float, float, float]  # x = a col + b row + c, y = d col + e row + f
    crs: pyproj.CRS
    bands: int
    dtype: str
    unit: str  # of the first band, as the file says
    scale_offset: tuple[float, float]  # of the first band
    has_palette: bool
    bits: int | None  # of a value, where the file states fewer than its type has
    is_coarse_too: bool  # has overviews, or is small

    def error(self, problem: str) -> UserError:
        """A UserError that names field and file."""
        return UserError(f"{self.field}: {self.path}: {problem}")

    def pixels_at(self, xy_enu_m: F64) -> F64:
        """Columns and rows (N, 2) of places (N, 2). Raises UserError where the CRS does not reach there."""
        geodetic = self.frame.geodetic_from_enu(np.column_stack([xy_enu_m, np.zeros(len(xy_enu_m))]))
        x, y = self._from_wgs84.transform(geodetic[:, 1], geodetic[:, 0])
        a, b, c, d, e, f = self.affine
        if self.crs.is_geographic:  # its longitudes may end at 180 or go on; the area's are not torn apart
            middle = a * self.size_px[0] / 2 + b * self.size_px[1] / 2 + c
            origin = middle + (self.frame.longitude_deg - middle + 180.0) % 360.0 - 180.0
            x = origin + (np.asarray(x) - origin + 180.0) % 360.0 - 180.0
        x, y, whole = np.asarray(x) - c, np.asarray(y) - f, a * e - b * d
        pixels = np.column_stack([(e * x - b * y) / whole, (a * y - d * x) / whole])
        if not np.isfinite(pixels).all():
            raise self.error("its CRS does not reach the area; give a raster of this area")
        return pixels

    def pixels_over(self, x_m: F64, y_m: F64) -> F64:
        """Columns and rows (2, R, C) of the places at these eastings (C,) and northings (R,), rising."""
        return between_nodes(self.pixels_at, x_m, y_m)

    @cached_property
    def pixel_m(self) -> float:
        """Width or height of a pixel at the frame's origin, whichever is smaller."""
        here, east, north = self.pixels_at(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
        per_m = np.array([east - here, north - here])  # pixels
        return float(1.0 / np.linalg.norm(per_m, axis=0).max())

    def outside_m(self, pixels: F64) -> F64:
        """How far places (..., 2), given by columns and rows, lie beyond the raster's edge; 0 on it."""
        beyond = np.maximum(np.maximum(-pixels, pixels - np.array(self.size_px)), 0.0)
        return np.asarray(np.hypot(beyond[..., 0], beyond[..., 1]) * self.pixel_m)

    def covered(self, ground_enu_m: shapely.Polygon) -> shapely.Geometry:
        """Which part of some ground it covers.

        Raises UserError where its CRS does not reach there, or tears it.
        """
        raster = shapely.box(0.0, 0.0, *self.size_px)
        ground = shapely.transform(_with_nodes(ground_enu_m), self.pixels_at)
        steps_px = np.linalg.norm(np.diff(shapely.get_coordinates(ground), axis=0), axis=1)
        if steps_px.max() > _TORN * np.median(steps_px):
            raise self.error(
                "its CRS ends within the area, as Mercator's does at the 180th meridian; give a raster in "
                "another CRS, such as WGS 84"
            )
        if shapely.covers(raster, ground):
            return ground_enu_m
        shared = shapely.intersection(raster, ground)
        return shapely.transform(shared, lambda px: self.frame.enu_from_geodetic(self._geodetic(px))[:, :2])

    def overlap(self, bounds_enu_m: Bounds) -> shapely.Geometry:
        """Where it lies within bounds. Raises UserError where it does not."""
        ground = shapely.box(*bounds_enu_m)
        shared = self.covered(ground)
        if shared.area == 0.0:
            away_km = self._away_km(ground)
            at = f"{self.frame.latitude_deg:g}, {self.frame.longitude_deg:g}"
            raise self.error(
                f"does not overlap the area, {away_km:.1f} km away; give a raster of this area, or write "
                f"home's latitude_deg and longitude_deg (now {at})"
            )
        return shared

    def _away_km(self, ground_enu_m: shapely.Polygon) -> float:
        """From some ground to the raster. Raises UserError where its coordinates are none of its CRS."""
        edge = shapely.get_coordinates(_with_nodes(ground_enu_m))
        there = self._geodetic(np.clip(self.pixels_at(edge), 0.0, self.size_px))
        here = self.frame.geodetic_from_enu(np.column_stack([edge, np.zeros(len(edge))]))
        if not np.isfinite(there).all():
            raise self.error("its coordinates lie outside its CRS; save it again with the right CRS")
        geod = pyproj.Geod(ellps="WGS84")
        return float(np.min(geod.inv(here[:, 1], here[:, 0], there[:, 1], there[:, 0])[2])) / 1e3

    def _geodetic(self, pixels: F64) -> F64:
        """Latitude, longitude, altitude (N, 3) of columns and rows (N, 2), at the frame's altitude."""
        (column, row), (a, b, c, d, e, f) = pixels.T, self.affine
        x, y = a * column + b * row + c, d * column + e * row + f
        to_wgs84 = pyproj.enums.TransformDirection.INVERSE
        longitude, latitude = self._from_wgs84.transform(x, y, direction=to_wgs84)
        return np.column_stack([latitude, longitude, np.full(len(pixels), self.frame.altitude_m)])

    def window(self, pixels: F64, pad: int) -> Part | None:
        """The part around places (..., 2), wider by ``pad`` pixels; None where all lie off the raster."""
        column, row = np.maximum(np.floor(pixels.reshape(-1, 2).min(axis=0)).astype(int) - pad, 0).tolist()
        right, low = (np.ceil(pixels.reshape(-1, 2).max(axis=0)).astype(int) + pad).tolist()
        wide, tall = min(right, self.size_px[0]) - column, min(low, self.size_px[1]) - row
        return Part(column, row, wide, tall) if wide > 0 and tall > 0 else None

    def read(self, part: Part, step: float = 1.0, bands: int | None = None, smooth: bool = False) -> Pixels:
        """The pixels of a part, one for every ``step`` of the file's in each direction.

        ``smooth``: their averages, else the nearest one; ``bands``: that many, else the first alone.
        Raises UserError where the file has gone or is damaged.
        """
        import rasterio
        from rasterio.enums import Resampling
        from rasterio.windows import Window

        columns, rows = max(1, math.ceil(part.wide / step)), max(1, math.ceil(part.tall / step))
        resampling = Resampling.average if smooth and step > 1.0 else Resampling.nearest
        index = 1 if bands is None else list(range(1, bands + 1))
        shape = (rows, columns) if bands is None else (bands, rows, columns)
        window = Window(*part)
        with opened(self.path, self.field) as file:
            try:
                values = file.read(index, window=window, out_shape=shape, resampling=resampling)
                if bands is None:  # what another band has does not make this one valid
                    is_valid = file.read_masks(1, window=window, out_shape=(rows, columns)) > 0
                else:
                    is_valid = file.dataset_mask(window=window, out_shape=(rows, columns)) > 0
            except rasterio.errors.RasterioError:
                raise self.error("is damaged; copy it again") from None
        across, down = part.wide / columns, part.tall / rows
        return Pixels(values, is_valid, part.column + across / 2, part.row + down / 2, across, down)

    @cached_property
    def _from_wgs84(self) -> pyproj.Transformer:
        try:
            return pyproj.Transformer.from_crs(
                "EPSG:4326", self.crs.to_2d(), always_xy=True, allow_ballpark=may_be_wgs84(self.crs)
            )
        except pyproj.exceptions.ProjError:
            raise self.error(
                "its CRS is local or tells no datum; save it again in one with a datum, such as UTM"
            ) from None


def geotiff(path: Path, field: str, frame: LocalFrame) -> GeoTiff:
    """What a file says of itself.

    Raises UserError where it is no GeoTIFF or does not say where it lies, MissingExtraError without rasterio.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Dataset has no geotransform")  # that is an error here
        with opened(path, field) as file:
            return _described(path, field, frame, file)


def _described(path: Path, field: str, frame: LocalFrame, file: Any) -> GeoTiff:
    t = file.transform
    if file.crs is None or t.is_identity or t.is_degenerate:
        raise UserError(
            f"{field}: {path}: does not say where it lies; save it as a GeoTIFF with its CRS and position"
        )
    block = max(h * w for h, w in file.block_shapes) * np.dtype(file.dtypes[0]).itemsize
    if block * file.count > _MAX_BLOCK_BYTES:
        raise UserError(f"{field}: {path}: can only be read as a whole; save it again in tiles")
    try:
        crs = pyproj.CRS.from_wkt(file.crs.to_wkt())
    except pyproj.exceptions.CRSError:
        raise UserError(f"{field}: {path}: its CRS is not known; save it again with a known one") from None
    return GeoTiff(
        path,
        field,
        frame,
        (file.width, file.height),
        (t.a, t.b, t.c, t.d, t.e, t.f),
        crs,
        file.count,
        file.dtypes[0],
        (file.units[0] or "").strip(),
        (file.scales[0], file.offsets[0]),
        file.colorinterp[0].name == "palette",
        int(bits) if (bits := file.tags(1, ns="IMAGE_STRUCTURE").get("NBITS")) else None,
        bool(file.overviews(1)) or file.width * file.height <= 25_000_000,
    )


@contextmanager
def opened(path: Path, field: str) -> Iterator[Any]:
    """The file, opened with rasterio. Raises as ``geotiff``."""
    try:
        import rasterio
    except ImportError:
        raise MissingExtraError(f"{field}: a GeoTIFF", "geo") from None
    if not path.is_file():
        raise UserError(f"{field}: {path}: there is no such file; check the path")
    try:
        file = rasterio.open(path, driver="GTiff")
    except rasterio.errors.RasterioError:
        raise UserError(f"{field}: {path}: is no GeoTIFF; save it as one") from None
    with file:
        yield file


def _with_nodes(ground_enu_m: shapely.Polygon) -> shapely.Polygon:
    return shapely.segmentize(ground_enu_m, ground_enu_m.length / (4 * _BORDER))


def between_nodes(of: Callable[[F64], F64], x_m: F64, y_m: F64) -> F64:
    """Values (K, R, C) over a grid of a smooth function of places (N, 2) -> (N, K), linear between nodes."""
    (x_nodes, x_share), (y_nodes, y_share) = _nodes(x_m), _nodes(y_m)
    x, y = np.meshgrid(x_nodes, y_nodes)
    at_nodes = of(np.column_stack([x.ravel(), y.ravel()])).T.reshape(-1, *x.shape)
    return np.asarray(y_share @ at_nodes @ x_share.T)


def _nodes(places_m: F64) -> tuple[F64, F64]:
    """Nodes (M,) over rising places (N,), and the shares (N, M) that they have in them."""
    low, high = float(places_m.min()), float(places_m.max())
    count = min(max(2, math.ceil((high - low) / _NODE_M) + 1), _MOST_NODES)
    nodes = np.linspace(low, max(high, low + 1e-3), count)
    at = (places_m - nodes[0]) / (nodes[1] - nodes[0])
    return nodes, np.maximum(1.0 - np.abs(at[:, None] - np.arange(count)), 0.0)


@dataclass(frozen=True)
class GroundPicture:
    """The ground's picture: an orthophoto, of which each look reads a window, coarsely where it is small.

    It holds no open file, so that threads and processes may share it.
    """

    source: GeoTiff
    bounds_enu_m: Bounds  # of the part on the scenario's ground
    pixel_m: float
    black_white: tuple[float, float]  # the values that are shown so

    def read(self, west: float, south: float, east: float, north: float, width_px: int, height_px: int) -> U8:
        """The ground between these ENU metres (H, W, 4) RGBA, north up; alpha is 0 where nothing is pictured.

        Raises UserError where the file has gone or is damaged.
        """
        across, along = (east - west) / width_px, (north - south) / height_px
        x = np.asarray(west + across * (np.arange(width_px) + 0.5))
        y = np.asarray(south + along * (np.arange(height_px) + 0.5))
        places = self.source.pixels_over(x, y)[:, ::-1]
        out = np.zeros((height_px, width_px, 4), np.uint8)
        step = max(1.0, min(across, along) / self.source.pixel_m)
        part = self.source.window(np.moveaxis(places, 0, -1), math.ceil(step))
        if part is None:
            return out
        pixels = self.source.read(part, step, bands=3 if self.source.bands >= 3 else 1, smooth=True)
        v, u = pixels.places_of(places).astype(np.float32)
        picture = np.ascontiguousarray(np.moveaxis(self._as_bytes(pixels.values), 0, -1))
        drawn = cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        out[..., :3] = drawn.reshape(height_px, width_px, -1)
        alpha = pixels.is_valid.astype(np.uint8) * 255
        out[..., 3] = cv2.remap(alpha, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
        out[out[..., 3] == 0] = 0
        return out

    def _as_bytes(self, values: NDArray[Any]) -> U8:
        if values.dtype == np.uint8:
            return values
        black, white = self.black_white
        shares = (values.astype(np.float32) - np.float32(black)) / np.float32(white - black)
        return np.asarray(np.clip(np.rint(255 * shares), 0, 255).astype(np.uint8))


def ground_picture(path: Path, frame: LocalFrame, bounds_enu_m: Bounds) -> GroundPicture:
    """The orthophoto over the ground within bounds.

    Raises UserError where it is no picture, or does not overlap them.
    """
    source = geotiff(path, "terrain.orthophoto", frame)
    if source.dtype not in ("uint8", "uint16") or source.has_palette:
        kind = "a palette" if source.has_palette else f"{source.dtype} values"
        raise source.error(f"has {kind}, not colours of 8 or 16 bits; save it as RGB of 8 bits")
    west, south, east, north = source.overlap(bounds_enu_m).bounds
    black_white = (0.0, 255.0) if source.dtype == "uint8" else _black_white(source)
    return GroundPicture(source, (west, south, east, north), source.pixel_m, black_white)


def _black_white(source: GeoTiff) -> tuple[float, float]:
    """The values of 16 bits that are shown black and white, the same in all bands, so that colours stay.

    They span the bits that the file states, else all but the darkest and brightest of samples across it.
    Raises UserError where it shows nothing, or one value alone.
    """
    if source.bits:
        return 0.0, float(2**source.bits - 1)
    (width, height), bands = source.size_px, 3 if source.bands >= 3 else 1
    found = [np.zeros(0, np.uint16)]
    for row in sorted(set(np.linspace(0, max(height - _SAMPLE_PX, 0), _SAMPLES).astype(int).tolist())):
        for column in sorted(set(np.linspace(0, max(width - _SAMPLE_PX, 0), _SAMPLES).astype(int).tolist())):
            part = Part(column, row, min(_SAMPLE_PX, width), min(_SAMPLE_PX, height))
            pixels = source.read(part, bands=bands)
            found.append(pixels.values[:, pixels.is_valid].ravel())
    values = np.concatenate(found)
    black, white = np.percentile(values, _DARK_BRIGHT).tolist() if len(values) else (0.0, 0.0)
    if white <= black:
        raise source.error("shows the same value everywhere; save it as RGB of 8 bits")
    return black, white
