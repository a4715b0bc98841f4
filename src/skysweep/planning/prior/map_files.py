"""Maps of probabilities from files: GeoTIFF, NumPy and CSV; and into the first two.

A NumPy file (``.npz``) holds ``poa`` (R, C), row 0 in the south, and ``bounds_lon_lat_deg`` (west, south,
east, north); or, as written here, ``cell_size_m``, ``origin_xy_m`` and ``frame_lat_lon_deg``, which lose
nothing. A CSV file has the columns ``lon``, ``lat`` and ``poa``, a line for the middle of each cell; cells
that are left out are 0. A GeoTIFF has a CRS; its first band is read and its nodata are 0.
"""

from __future__ import annotations

import csv
import math
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.errors import MissingExtraError, UserError
from skysweep.files.reading import read_limited, read_text_limited
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.prior.checks import MAX_CELLS, checked_poa
from skysweep.planning.prior.maps import ProbabilityMap
from skysweep.planning.prior.rasters import Raster
from skysweep.text import percent
from skysweep.worlds.elevation import HEIGHTS_M, metres_told

MAX_MAP_BYTES = 200_000_000
_COLUMNS = ("lon", "lat", "poa")
_UNEVEN = 0.01  # of a cell, by which a CSV's places may be off the grid
_MOST_ROUNDED = 0.2  # of a cell, by which they may be off besides, where few decimals are written


def read_map(path: str | Path, frame: LocalFrame | None = None) -> ProbabilityMap:
    """The map in a file, in the frame given or one of its own.

    Raises UserError naming the file where it is unreadable, holds no probabilities, or is in a CRS that is
    not known or not its own.
    """
    path = Path(path)
    readers = {".npz": _read_npz, ".csv": _read_csv, ".tif": _read_tiff, ".tiff": _read_tiff}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise UserError(f"{path}: is no map of probabilities; give a {', '.join(readers)} file")
    try:
        read = reader(path)
        if isinstance(read, Raster):
            checked_poa(read.poa)
            return read.onto_ground(frame)
        return read if frame in (None, read.frame) else Raster.of(read).onto_ground(frame)
    except MissingExtraError:
        raise
    except UserError as error:
        raise UserError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None


def write_map(path: Path, cells: ProbabilityMap) -> None:
    """Write a map as a ``.npz`` file that ``read_map`` reads back as it is."""
    np.savez_compressed(
        path,
        poa=cells.poa,
        cell_size_m=cells.cell_size_m,
        origin_xy_m=cells.origin_xy_m,
        frame_lat_lon_deg=np.array([cells.frame.latitude_deg, cells.frame.longitude_deg]),
    )


def _read_npz(path: Path) -> Raster | ProbabilityMap:
    data = read_limited(path, MAX_MAP_BYTES)
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            if sum(member.file_size for member in archive.infolist()) > MAX_MAP_BYTES:
                raise UserError(f"unpacks to more than {MAX_MAP_BYTES / 1e6:g} MB; give a smaller map")
        with np.load(BytesIO(data), allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name]) for name in file.files}
    except UserError:
        raise
    except Exception as error:  # zipfile and NumPy let through whatever a damaged file makes them raise
        if "allow_pickle" in str(error):
            raise UserError("holds Python objects, not numbers; write poa as an array of floats") from None
        raise UserError("is no NumPy file; write one with numpy.savez(file, poa=..., ...)") from None
    if "poa" not in arrays:
        raise UserError("poa: is missing; write the probabilities (rows, columns) as poa")
    poa = checked_poa(arrays["poa"])
    if "bounds_lon_lat_deg" in arrays:
        west, south, east, north = _numbers(arrays, "bounds_lon_lat_deg", 4)
        _check_degrees(np.array([west, east]), np.array([south, north]), "bounds_lon_lat_deg")
        if west > east + 180.0:  # across the antimeridian
            east += 360.0
        if not (west < east and south < north):
            raise UserError("bounds_lon_lat_deg: are not in order; write west, south, east, north")
        rows, columns = poa.shape
        return Raster(poa, west, south, (east - west) / columns, (north - south) / rows, _wgs84())
    if "frame_lat_lon_deg" not in arrays:
        raise UserError("bounds_lon_lat_deg: is missing; write west, south, east, north in degrees")
    latitude, longitude = _numbers(arrays, "frame_lat_lon_deg", 2)
    _check_degrees(np.array([longitude]), np.array([latitude]), "frame_lat_lon_deg")
    (cell_m,) = _numbers(arrays, "cell_size_m", 1)
    if not cell_m > 0.0:
        raise UserError(f"cell_size_m: is {cell_m:g}; write metres above 0")
    origin = np.array(_numbers(arrays, "origin_xy_m", 2))
    return ProbabilityMap(poa, cell_m, origin, LocalFrame(latitude, longitude))


def _numbers(arrays: dict[str, NDArray[Any]], name: str, count: int) -> list[float]:
    try:
        values = np.asarray(arrays[name], dtype=float).ravel()
    except (KeyError, TypeError, ValueError):
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise UserError(f"{name}: write {count} finite number{'s' if count > 1 else ''}")
    return [float(v) for v in values]


def _read_csv(path: Path) -> Raster:
    try:
        text = read_text_limited(path, MAX_MAP_BYTES)
        lines = list(csv.reader(text.splitlines()))
    except csv.Error as error:  # a NUL on Python 3.10, a field without end
        raise UserError(f"is no CSV file ({error}); write one with the header lon,lat,poa") from None
    header = [name.strip().lower() for name in lines[0]] if lines else []
    if any(name not in header for name in _COLUMNS):
        for separator, name in ((";", "semicolons"), ("\t", "tabs")):
            if len(header) == 1 and separator in header[0]:
                raise UserError(
                    f"line 1: has {name} between its columns; write commas, and points in numbers"
                )
        raise UserError(f"line 1: is no header with {', '.join(_COLUMNS)}; write one")
    order = [header.index(name) for name in _COLUMNS]
    values = []
    for number, line in enumerate(lines[1:], 2):
        if line:
            try:
                values.append([float(line[k]) for k in order])
            except (IndexError, ValueError):
                raise UserError(f"line {number}: write a number for each of {', '.join(_COLUMNS)}") from None
    if not values:
        raise UserError("holds no cells; write a line with lon,lat,poa for each")
    table = np.array(values)
    _check_degrees(table[:, 0], table[:, 1], "lon, lat")
    if np.ptp(table[:, 0]) > 180.0:  # across the antimeridian
        table[:, 0] %= 360.0
    rounding = [_rounding([line[order[k]] for line in lines[1:] if line]) for k in (0, 1)]
    x0, dx, columns = _grid_of(table[:, 0], "lon", rounding[0])
    y0, dy, rows = _grid_of(table[:, 1], "lat", rounding[1])
    if rows * columns > MAX_CELLS:
        raise UserError(f"spans {rows * columns:,} cells; write at most {MAX_CELLS:,}, larger ones")
    i, j = np.floor((table[:, 1] - y0) / dy).astype(int), np.floor((table[:, 0] - x0) / dx).astype(int)
    if len(np.unique(i * columns + j)) < len(table):
        raise UserError("tells a cell twice; write one line for each")
    poa = np.zeros((rows, columns))
    poa[i, j] = table[:, 2]
    return Raster(poa, x0, y0, dx, dy, _wgs84())


def _rounding(numbers: list[str]) -> float:
    """By how much decimals may be off: half a unit of the last place that is written."""
    return 0.5 * 10.0 ** -max(len(number.strip().partition(".")[2]) for number in numbers)


def _grid_of(middles: F64, column: str, rounding: float) -> tuple[float, float, int]:
    """Where cells begin along one axis, how wide they are, and how many."""
    places = np.unique(middles)
    gaps = np.diff(places)
    if not len(gaps):
        raise UserError(f"{column}: is the same everywhere; write at least two rows and two columns of cells")
    wide = float(gaps[gaps < 1.5 * gaps.min()].mean())  # one alone may be rounded
    count = round(float(places[-1] - places[0]) / wide) + 1
    if count > MAX_CELLS:
        raise UserError(f"{column}: is on no grid; write the middles of cells of one size")
    wide = float(places[-1] - places[0]) / (count - 1)
    steps = (places - places[0]) / wide
    if np.abs(steps - np.round(steps)).max() > _UNEVEN + min(2.0 * rounding / wide, _MOST_ROUNDED):
        raise UserError(f"{column}: is on no grid; write the middles of cells of one size")
    return float(places[0]) - wide / 2.0, wide, count


def write_geotiff(path: Path, cells: ProbabilityMap) -> None:
    """Write a map for other programs, a probability a cell. Raises MissingExtraError without rasterio."""
    path.write_bytes(geotiff_of(cells, str(path)))


def geotiff_of(cells: ProbabilityMap, where: str) -> bytes:
    """A map's cells (R, C) as a GeoTIFF, of which NaN is the nodata. ``where`` begins the errors.

    Raises MissingExtraError without rasterio.
    """
    rasterio = _rasterio(where)
    raster, (west, _, _, north) = Raster.of(cells), cells.bounds_m
    rows, columns = cells.poa.shape
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff",
            width=columns,
            height=rows,
            count=1,
            dtype="float64",
            nodata=math.nan,
            compress="deflate",
            crs=rasterio.CRS.from_wkt(raster.crs.to_wkt()),
            transform=rasterio.Affine(cells.cell_size_m, 0.0, west, 0.0, -cells.cell_size_m, north),
        ) as file:
            file.write(cells.poa[::-1], 1)
        return bytes(memory.read())


def read_heights(path: Path, cells: ProbabilityMap) -> tuple[F64, bool]:
    """Heights (R, C) of the ground in the middles of a map's cells from a GeoTIFF, metres.

    And whether the file tells their unit; else they are taken for metres. Raises UserError where it is no
    such GeoTIFF or does not reach over the whole map.
    """
    told: list[float | None] = []

    def in_metres(file: Any, crs: pyproj.CRS, band: F64) -> F64:
        told.append(metres_told((file.units[0] or "").strip(), crs))
        heights = (band * file.scales[0] + file.offsets[0]) * (told[0] or 1.0)
        return np.where((heights > HEIGHTS_M[0]) & (heights < HEIGHTS_M[1]), heights, np.nan)

    try:
        heights = _band_of(path, np.nan, in_metres).interpolated(cells)
    except MissingExtraError:
        raise
    except UserError as error:
        raise UserError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    missing = float(np.isnan(heights).mean())
    if missing > 0.0:
        raise UserError(
            f"{path}: has no height for {percent(missing)} of the map; give one that covers all of it"
        )
    return heights, told[0] is not None


def _rasterio(where: Path | str) -> Any:
    try:
        import rasterio
    except ImportError:
        raise MissingExtraError(f"{where}: a GeoTIFF", "geo") from None
    return rasterio


def _read_tiff(path: Path) -> Raster:
    return _band_of(path, 0.0)


def _band_of(
    path: Path, nodata: float, changed: Callable[[Any, pyproj.CRS, F64], F64] = lambda _file, _crs, band: band
) -> Raster:
    rasterio = _rasterio(path)
    data = read_limited(path, MAX_MAP_BYTES)
    try:
        with rasterio.MemoryFile(data) as memory, memory.open(driver="GTiff") as file:
            if file.width * file.height > MAX_CELLS:
                raise UserError(f"has {file.width * file.height:,} cells; write at most {MAX_CELLS:,}")
            if file.crs is None:
                raise UserError("has no CRS; write one into it, such as EPSG:4326")
            crs, transform = pyproj.CRS.from_wkt(file.crs.to_wkt()), file.transform
            band = changed(file, crs, np.ma.filled(file.read(1, masked=True).astype(float), nodata))
    except (rasterio.errors.RasterioError, pyproj.exceptions.CRSError):
        raise UserError("is no GeoTIFF with a known CRS; save it again with one") from None
    if transform.b or transform.d:
        raise UserError("is turned; save it again with north up")
    return Raster(band, transform.c, transform.f, transform.a, transform.e, crs)


def _check_degrees(longitude: F64, latitude: F64, field: str) -> None:
    if not (np.abs(longitude) <= 180.0).all() or not (np.abs(latitude) <= 90.0).all():
        raise UserError(
            f"{field}: are no degrees, so in another CRS than WGS 84; write longitude and latitude in degrees"
        )


def _wgs84() -> pyproj.CRS:
    return pyproj.CRS.from_epsg(4326)
