"""Maps of where a target may be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.prior.checks import MAX_CELLS, checked_poa, positive
from skysweep.planning.prior.coverage import coverage_of

FARTHEST_M = 200_000.0  # from the origin of a local frame, where it is flat enough


@dataclass(frozen=True)
class ProbabilityMap:
    """Probability of area in square cells over ENU metres; row 0 is the southernmost."""

    poa: F64  # (R, C), sum 1
    cell_size_m: float
    origin_xy_m: F64  # (2,) south-western corner
    frame: LocalFrame

    @property
    def centres_xy_m(self) -> F64:
        """Middle of each cell, (R, C, 2)."""
        rows, columns = self.poa.shape
        x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
        return np.asarray(self.origin_xy_m + self.cell_size_m * np.stack([x, y], axis=-1))

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """West, south, east, north."""
        west, south = (float(v) for v in self.origin_xy_m)
        rows, columns = self.poa.shape
        return west, south, west + columns * self.cell_size_m, south + rows * self.cell_size_m

    def times(self, factors: ArrayLike) -> ProbabilityMap:
        """The map with each cell (R, C) that many times as probable, scaled to a sum of 1 again.

        Factors are likelihoods (Bayes), or a mask. Raises UserError where they leave nothing.
        """
        return self.with_poa(checked_poa(self.poa * np.asarray(factors, dtype=float), "factors"))

    def with_poa(self, poa: F64) -> ProbabilityMap:
        """The same cells with other probabilities (R, C)."""
        return ProbabilityMap(poa, self.cell_size_m, self.origin_xy_m, self.frame)

    def after_search(self, paths_xy_m: Sequence[F64], sweep_width_m: float) -> ProbabilityMap:
        """What is known when a search along paths (K, 2) has found nothing (Bayes)."""
        return self.after_coverage(self.coverage_by(paths_xy_m, sweep_width_m))

    def after_coverage(self, coverage: F64) -> ProbabilityMap:
        """The same where cells (R, C) were covered so well. Raises UserError where that leaves nothing."""
        left = self.poa * np.exp(-coverage)
        if not left.any():
            raise UserError("searched: the whole map is searched so well that nothing is left of it")
        return self.with_poa(checked_poa(left))

    def coverage_by(self, paths_xy_m: Sequence[F64], sweep_width_m: float) -> F64:
        """How thoroughly paths (K, 2) search the cells (R, C), as ``coverage_of`` counts it."""
        return coverage_of(paths_xy_m, self.poa.shape, self.cell_size_m, self.origin_xy_m, sweep_width_m)

    def pos_of(self, coverage: F64) -> float:
        """Probability that a search finds the target that covers the cells (R, C) so well."""
        return float(np.sum(self.poa * -np.expm1(-coverage)))

    def share_within(self, area: shapely.Geometry) -> float:
        """Probability that the target is in an area, by the middles of the cells."""
        return float(self.poa[self._inside(area)].sum())

    def within(self, area: shapely.Geometry) -> ProbabilityMap:
        """The map where the target is in an area. Raises UserError where they do not overlap."""
        inside = self._inside(area)
        if not self.poa[inside].any():
            raise UserError(
                "prior: does not overlap the area; give the map of this area, or check its coordinates"
            )
        return self.times(inside)

    def _inside(self, area: shapely.Geometry) -> NDArray[np.bool_]:
        x, y = np.moveaxis(self.centres_xy_m, -1, 0)
        return np.asarray(shapely.contains_xy(area, x, y))


def grid_over(area: shapely.Polygon, cell_size_m: float, frame: LocalFrame) -> ProbabilityMap:
    """Every place of an area (ENU metres) equally probable, in cells that span its bounds.

    Raises UserError where there are too many cells, or the area reaches too far from the frame's origin.
    """
    west, south, east, north = area.bounds
    if max(map(abs, area.bounds)) > FARTHEST_M:
        raise UserError(
            f"area: reaches {max(map(abs, area.bounds)) / 1e3:.0f} km from the map's origin; make a map that "
            f"reaches at most {FARTHEST_M / 1e3:.0f} km"
        )
    cell_m = positive(cell_size_m, "cell_size_m")
    rows, columns = (max(1, round((b - a) / cell_m + 0.499)) for a, b in ((south, north), (west, east)))
    if rows * columns > MAX_CELLS:
        raise UserError(f"cell_size_m: {cell_m:g} m make {rows * columns:,} cells; write a larger one")
    cells = ProbabilityMap(
        np.full((rows, columns), 1.0 / (rows * columns)), cell_size_m, np.array([west, south]), frame
    )
    return cells.within(area)


def mixed(maps: Sequence[ProbabilityMap], weights: ArrayLike) -> ProbabilityMap:
    """Scenarios that exclude each other, with the probability of each: the weighted sum of maps.

    Raises UserError where weights are no probabilities, or the maps do not have the same cells.
    """
    shares = np.asarray(weights, dtype=float)
    if shares.shape != (len(maps),) or not np.isfinite(shares).all() or not maps:
        raise UserError(f"weights: write one number for each of the {len(maps)} maps")
    if shares.min() < 0.0 or shares.sum() == 0.0:
        raise UserError("weights: write numbers from 0 on, one of them above 0")
    first = maps[0]
    for other in maps[1:]:
        same_cells = other.poa.shape == first.poa.shape and np.allclose(other.bounds_m, first.bounds_m)
        if not same_cells or other.frame != first.frame:
            raise UserError("maps: have different cells; bring them onto one grid before they are mixed")
    return first.with_poa(checked_poa(np.tensordot(shares, [m.poa for m in maps], axes=1), "maps"))
