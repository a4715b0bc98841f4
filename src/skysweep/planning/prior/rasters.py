"""Maps of probabilities in any projection, brought onto square cells in local metres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyproj
import shapely
from numba import njit
from scipy import ndimage

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.geometry.datums import may_be_wgs84
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.prior.checks import MAX_CELLS, checked_poa
from skysweep.planning.prior.maps import FARTHEST_M, ProbabilityMap, grid_over

_PIECE = 0.75  # cells of the map made, in which a raster's are at most put down
_MOST_PIECES = 1_000_000  # at once
_CUT = 0.05  # of a cell, that a map may lose along its edge
_COARSER = 1.05  # from try to try
_WGS84 = pyproj.Geod(ellps="WGS84")
_BORDER = 50  # points along an edge
_MOST_TIMES_CELLS = 100  # as many as a file has; only very long ones make more
_SMALLEST_CELL_M = 1e-3  # below, differences of coordinates are lost in rounding


@dataclass(frozen=True)
class Raster:
    """A map as a file has it: cell i, j spans x from ``x0 + j dx`` and y from ``y0 + i dy``, of a CRS."""

    poa: F64  # (R, C)
    x0: float
    y0: float
    dx: float
    dy: float
    crs: pyproj.CRS

    @classmethod
    def of(cls, cells: ProbabilityMap) -> Raster:
        """A map, its metres taken for azimuthal equidistant ones: within 1 cm at 10 km from the origin."""
        frame, (west, south, _, _) = cells.frame, cells.bounds_m
        here = f"+proj=aeqd +ellps=WGS84 +lat_0={frame.latitude_deg!r} +lon_0={frame.longitude_deg!r}"
        return cls(cells.poa, west, south, cells.cell_size_m, cells.cell_size_m, pyproj.CRS.from_proj4(here))

    def onto_ground(self, frame: LocalFrame | None = None) -> ProbabilityMap:
        """Square cells of about the same size, east and north of the frame's origin, or of the middle.

        Raises UserError where the CRS leads to no place on earth, or the map is too fine for its extent.
        """
        from_crs = self._to_wgs84()
        rows, columns = self.poa.shape
        share = np.linspace(0.0, 1.0, _BORDER)
        x = self.x0 + self.dx * columns * np.concatenate(
            [share, share, 0.0 * share, 1.0 + 0.0 * share, [0.5]]
        )
        y = self.y0 + self.dy * rows * np.concatenate([0.0 * share, 1.0 + 0.0 * share, share, share, [0.5]])
        self._refuse_no_degrees()
        longitude, latitude = from_crs.transform(x, y)
        if not (np.isfinite(longitude).all() and np.isfinite(latitude).all()):
            raise UserError("its coordinates lie outside its CRS; write those of its CRS, or the right CRS")
        if frame is None:
            frame = LocalFrame(float(latitude[-1]), float((longitude[-1] + 180.0) % 360.0 - 180.0))
        else:
            _, _, away_m = _WGS84.inv(frame.longitude_deg, frame.latitude_deg, longitude[-1], latitude[-1])
            if away_m > FARTHEST_M:
                raise UserError(
                    f"does not overlap the area, which is {away_m / 1e3:.0f} km away; give the map of this "
                    "area, or check its coordinates"
                )
        border = frame.enu_from_geodetic(np.column_stack([latitude, longitude, np.zeros(len(x))]))[:, :2]
        west, south = border.min(axis=0)
        east, north = border.max(axis=0)
        outline = shapely.Polygon(np.concatenate([border[:_BORDER], border[_BORDER : 2 * _BORDER][::-1]]))
        cell_m = math.sqrt(outline.area / self.poa.size)
        if cell_m < _SMALLEST_CELL_M:
            raise UserError(
                f"its cells are {cell_m:.2g} m wide, which no map resolves; check its coordinates"
            )
        n_rows, n_columns = (
            max(1, math.ceil(extent_m / cell_m - _CUT)) for extent_m in (north - south, east - west)
        )
        if n_rows * n_columns > min(_MOST_TIMES_CELLS * self.poa.size, 2 * MAX_CELLS):
            raise UserError("its cells are much longer than wide; write cells that are about square")
        empty = ProbabilityMap(np.zeros((n_rows, n_columns)), cell_m, np.array([west, south]), frame)
        return self.onto(empty)

    def onto(self, cells: ProbabilityMap) -> ProbabilityMap:
        """The same map on other cells. Raises UserError where none of it lies there, or the CRS is local."""
        self._refuse_no_degrees()
        return cells.with_poa(checked_poa(self._put_down(cells, self._to_wgs84())))

    def interpolated(self, cells: ProbabilityMap) -> F64:
        """Values (R, C) in the middles of a map's cells, linear between those of a raster; NaN beyond it.

        Raises UserError where the CRS is local.
        """
        from_crs, turn = self._to_wgs84(), self._turn
        self._refuse_no_degrees()
        xy = cells.centres_xy_m.reshape(-1, 2)
        geodetic = cells.frame.geodetic_from_enu(np.column_stack([xy, np.zeros(len(xy))]))
        x, y = from_crs.transform(geodetic[:, 1], geodetic[:, 0], direction="INVERSE")
        west = min(self.x0, self.x0 + self.dx * self.poa.shape[1])
        x = west + (np.asarray(x) - west) % turn if turn is not None else np.asarray(x)
        i, j = (np.asarray(y) - self.y0) / self.dy - 0.5, (x - self.x0) / self.dx - 0.5
        values = ndimage.map_coordinates(self.poa, [i, j], order=1, cval=np.nan)
        return np.asarray(values.reshape(cells.poa.shape))

    def _to_wgs84(self) -> pyproj.Transformer:
        try:
            return pyproj.Transformer.from_crs(
                self.crs, "EPSG:4326", always_xy=True, allow_ballpark=may_be_wgs84(self.crs)
            )
        except pyproj.exceptions.ProjError:
            raise UserError(
                "is in a CRS that is local or tells no datum, and leads to no place on earth; save it in "
                "EPSG:4326"
            ) from None

    @property
    def _turn(self) -> float | None:
        """Once round the earth in x; None where the CRS is not of longitudes."""
        if not self.crs.is_geographic:
            return None
        return 2.0 * math.pi / float(self.crs.axis_info[0].unit_conversion_factor)

    def _refuse_no_degrees(self) -> None:
        turn = self._turn
        if turn is None:
            return
        rows, columns = self.poa.shape
        x, y = self.x0 + self.dx * np.array([0, columns]), self.y0 + self.dy * np.array([0, rows])
        if not (np.abs(x).max() <= turn * 1.001 and np.abs(y).max() <= turn / 4.0 * 1.001):
            raise UserError(
                f"is in {self.crs.name}, but its coordinates, from {x[0]:g}, {y[0]:g} to {x[1]:g}, {y[1]:g}, "
                "are no longitudes and latitudes; write the CRS that they are in"
            )

    def _put_down(self, cells: ProbabilityMap, from_crs: pyproj.Transformer) -> F64:
        """What each of a map's cells (R, C) gets of the raster's, which are put down in pieces.

        A piece is as a rectangle along the map's axes of the piece's area: nothing of a cell is lost or
        counted twice.
        """
        rows, columns = self.poa.shape
        n = self._pieces(cells, from_crs)
        sums = np.zeros(cells.poa.shape)
        x = self.x0 + self.dx * np.linspace(0.0, columns, columns * n[1] + 1)
        at_once = max(1, _MOST_PIECES // (n[0] * len(x)))
        for first in range(0, rows, at_once):
            until = min(first + at_once, rows)
            y = self.y0 + self.dy * np.linspace(first, until, (until - first) * n[0] + 1)
            corners = self._on_map(*np.meshgrid(x, y), cells, from_crs)
            down, right = np.diff(corners, axis=0)[:, :-1], np.diff(corners, axis=1)[:-1]
            sizes = np.hypot(down, right)
            middles = corners[:-1, :-1] + (down + right) / 2.0
            poa = np.repeat(np.repeat(self.poa[first:until], n[0], axis=0), n[1], axis=1) / (n[0] * n[1])
            _share_out(sums, middles.reshape(-1, 2), sizes.reshape(-1, 2), poa.ravel())
        return sums

    def _pieces(self, cells: ProbabilityMap, from_crs: pyproj.Transformer) -> tuple[int, int]:
        """Into how many pieces a cell is cut, down and across, each smaller than the map's cells."""
        rows, columns = self.poa.shape
        x = self.x0 + self.dx * np.array([[0.0, 1.0, 0.0], [columns - 1, columns, columns - 1]])
        y = self.y0 + self.dy * np.array([[0.0, 0.0, 1.0], [rows - 1, rows - 1, rows]])
        place = self._on_map(x, y, cells, from_crs)
        right, down = (np.linalg.norm(place[:, k] - place[:, 0], axis=-1).max() for k in (1, 2))
        return max(1, math.ceil(down / _PIECE)), max(1, math.ceil(right / _PIECE))

    @staticmethod
    def _on_map(x: F64, y: F64, cells: ProbabilityMap, from_crs: pyproj.Transformer) -> F64:
        """Places (..., 2) on a map, column and row, of places in the CRS."""
        longitude, latitude = from_crs.transform(x.ravel(), y.ravel())
        geodetic = np.column_stack([latitude, longitude, np.zeros(x.size)])
        xy = cells.frame.enu_from_geodetic(geodetic)[:, :2]
        return np.asarray(((xy - cells.origin_xy_m) / cells.cell_size_m).reshape(*x.shape, 2))


@njit(cache=True)
def _share_out(sums: F64, middles: F64, sizes: F64, values: F64) -> None:
    """Add values (N,) to the cells (R, C) that rectangles (N, 2) overlap, by the area of each overlap."""
    rows, columns = sums.shape
    for k in range(len(values)):
        if values[k] == 0.0 or not math.isfinite(middles[k, 0] + middles[k, 1]):
            continue
        wide, high = max(sizes[k, 0], 1e-9), max(sizes[k, 1], 1e-9)
        west, south = middles[k, 0] - wide / 2.0, middles[k, 1] - high / 2.0
        for row in range(max(math.floor(south), 0), min(math.floor(south + high) + 1, rows)):
            part = values[k] * (min(south + high, row + 1.0) - max(south, float(row))) / high
            for column in range(max(math.floor(west), 0), min(math.floor(west + wide) + 1, columns)):
                overlap = min(west + wide, column + 1.0) - max(west, float(column))
                sums[row, column] += part * overlap / wide


def on_one_grid(maps: Sequence[ProbabilityMap]) -> list[ProbabilityMap]:
    """The maps on the finest one's cells, over the bounds of all, in the first one's frame.

    Where that makes too many cells, they are as fine as they may be. Raises UserError where the maps are too
    far from each other.
    """
    frame = maps[0].frame
    brought = [m if m.frame == frame else Raster.of(m).onto_ground(frame) for m in maps]
    bounds = np.array([m.bounds_m for m in brought])
    least, most = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
    cell_m = min(m.cell_size_m for m in maps)
    while np.prod(np.ceil((most - least) / cell_m)) > MAX_CELLS:
        cell_m *= _COARSER
    cells = grid_over(shapely.box(*least, *most), cell_m, frame)
    return [Raster.of(m).onto(cells) for m in maps]
