"""Maps of probabilities in any projection, brought onto square cells in local metres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyproj
import shapely
from scipy import ndimage

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.prior.checks import MAX_CELLS, checked_poa
from skysweep.planning.prior.maps import FARTHEST_M, ProbabilityMap, grid_over

_SAMPLES = 3  # along a cell's side
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
        longitude, latitude = from_crs.transform(x, y)
        if not (np.isfinite(longitude).all() and np.isfinite(latitude).all()):
            raise UserError("its coordinates lie outside its CRS; write those of its CRS, or the right CRS")
        if frame is None:
            frame = LocalFrame(float(latitude[-1]), float(longitude[-1]))
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
        n_rows, n_columns = max(1, round((north - south) / cell_m)), max(1, round((east - west) / cell_m))
        if n_rows * n_columns > min(_MOST_TIMES_CELLS * self.poa.size, 2 * MAX_CELLS):
            raise UserError("its cells are much longer than wide; write cells that are about square")
        empty = ProbabilityMap(np.zeros((n_rows, n_columns)), cell_m, np.array([west, south]), frame)
        return self.onto(empty)

    def onto(self, cells: ProbabilityMap) -> ProbabilityMap:
        """The same map on other cells. Raises UserError where none of it lies there, or the CRS is local."""
        from_crs = self._to_wgs84()
        return cells.with_poa(checked_poa(self._sampled(cells, from_crs)))

    def interpolated(self, cells: ProbabilityMap) -> F64:
        """Values (R, C) in the middles of a map's cells, linear between those of a raster; NaN beyond it.

        Raises UserError where the CRS is local.
        """
        from_crs = self._to_wgs84()
        xy = cells.centres_xy_m.reshape(-1, 2)
        geodetic = cells.frame.geodetic_from_enu(np.column_stack([xy, np.zeros(len(xy))]))
        x, y = from_crs.transform(geodetic[:, 1], geodetic[:, 0], direction="INVERSE")
        i, j = (np.asarray(y) - self.y0) / self.dy - 0.5, (np.asarray(x) - self.x0) / self.dx - 0.5
        values = ndimage.map_coordinates(self.poa, [i, j], order=1, cval=np.nan)
        return np.asarray(values.reshape(cells.poa.shape))

    def _to_wgs84(self) -> pyproj.Transformer:
        try:
            return pyproj.Transformer.from_crs(self.crs, "EPSG:4326", always_xy=True)
        except pyproj.exceptions.ProjError:
            raise UserError(
                "is in a local CRS that leads to no place on earth; save it in EPSG:4326"
            ) from None

    def _sampled(self, cells: ProbabilityMap, from_crs: pyproj.Transformer) -> F64:
        """The density at places in each cell, (R, C)."""
        rows, columns = self.poa.shape
        sums, n = np.zeros(cells.poa.shape), _SAMPLES
        for k in range(n * n):
            aside = cells.cell_size_m * (np.array([k % n, k // n]) + 0.5 - n / 2.0) / n
            xy = (cells.centres_xy_m + aside).reshape(-1, 2)
            geodetic = cells.frame.geodetic_from_enu(np.column_stack([xy, np.zeros(len(xy))]))
            x, y = from_crs.transform(geodetic[:, 1], geodetic[:, 0], direction="INVERSE")
            i, j = np.floor((y - self.y0) / self.dy), np.floor((x - self.x0) / self.dx)
            inside = (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
            found = self.poa[i[inside].astype(int), j[inside].astype(int)]
            sums[inside.reshape(sums.shape)] += found
        return sums


def on_one_grid(maps: Sequence[ProbabilityMap]) -> list[ProbabilityMap]:
    """The maps on the finest one's cells, over the bounds of all, in the first one's frame.

    Raises UserError where they are too far from each other, or too large together for such cells.
    """
    frame = maps[0].frame
    brought = [m if m.frame == frame else Raster.of(m).onto_ground(frame) for m in maps]
    bounds = np.array([m.bounds_m for m in brought])
    cells = grid_over(
        shapely.box(*bounds[:, :2].min(axis=0), *bounds[:, 2:].max(axis=0)),
        min(m.cell_size_m for m in maps),
        frame,
    )
    return [Raster.of(m).onto(cells) for m in maps]
