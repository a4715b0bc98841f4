"""Where a path may turn: the middles of cells that are about as wide as a sweep."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.planning.prior.allocation import ideal_coverage
from skysweep.planning.prior.coverage import add_lengths

MAX_NODES = 40_000  # on all paths together
WIDEST = 4.0  # cells, in sweeps: a wider one is cut, so that passes over it lie beside each other
ENOUGH_CELLS = 16.0  # that what is found lies in; fewer are cut
MOST_CELLS = 1_000_000  # after which none is cut


@dataclass(frozen=True)
class Lattice:
    """Cells, whose middles are the nodes of paths."""

    poa: F64  # (R, C) of its cells
    pitch_m: float  # side of a cell
    origin_xy_m: F64  # (2,) corner of cell 0, 0
    step: float  # coverage that one visit adds to a cell
    axes: F64 = field(default_factory=lambda: np.eye(2))  # directions of columns and of rows, (2, 2)

    def xy_m(self, nodes: NDArray[np.int64]) -> F64:
        """Places (N, 2) of nodes (N, 2) given as row and column."""
        return np.asarray(self.origin_xy_m + (nodes[:, ::-1] + 0.5) * self.pitch_m @ self.axes)

    def add_coverage(self, coverage: F64, path_xy_m: F64, times: float = 1.0) -> None:
        """Add what a path (K, 2) covers of the cells to their coverage (R, C), so many times."""
        lengths = np.zeros(coverage.shape)
        add_lengths(lengths, (path_xy_m - self.origin_xy_m) @ self.axes.T / self.pitch_m, 0.0)
        coverage += times * self.step * lengths


def lattice_over(
    poa: F64, cell_size_m: float, origin_xy_m: F64, sweep_width_m: float, length_m: float, cuts: int = 1
) -> Lattice:
    """The lattice for sweeps of a width over a map (R, C), coarse enough for paths ``length_m`` long.

    Each side of its cells may be cut into several.
    """
    finest_m = max(sweep_width_m, length_m / MAX_NODES)
    pitch_m = max(finest_m, cell_size_m / math.ceil(cell_size_m / (WIDEST * finest_m))) / cuts
    step = sweep_width_m / pitch_m
    if pitch_m == cell_size_m:
        return Lattice(poa, pitch_m, origin_xy_m, step)
    cells, corner = joined(poa, cell_size_m, pitch_m)
    return Lattice(cells, pitch_m, origin_xy_m + corner, step)


def cuts_for(lattice: Lattice, length_m: float) -> int:
    """Into how many parts sides are cut for what is found to lie in enough cells to search between them."""
    found = lattice.poa * -np.expm1(-ideal_coverage(lattice.poa, length_m / lattice.pitch_m * lattice.step))
    cells = found.sum() ** 2 / np.sum(found**2)  # so many equal ones would hold it
    cuts = max(1, math.ceil(math.sqrt(ENOUGH_CELLS / cells) - 1e-9))
    return cuts if cuts**2 * lattice.poa.size <= MOST_CELLS else 1


def joined(poa: F64, cell_size_m: float, other_m: float) -> tuple[F64, F64]:
    """A map (R, C) on cells of another size, centred over it, and their corner (2,) from the map's."""
    rows, south = _shares(poa.shape[0], cell_size_m, other_m)
    columns, west = _shares(poa.shape[1], cell_size_m, other_m)
    return rows @ poa @ columns.T, np.array([west, south])


def diagonal(lattice: Lattice) -> Lattice:
    """The lattice whose paths cross another's cells diagonally: 0.71 of the coverage, on 1.41 times as many.

    Each of its cells is a pair, one above the other, with the node in the middle of their common side; a
    diagonal leg through it is as long in one as in the other. The pairs tile as bricks do.
    """
    rows, columns = lattice.poa.shape
    row, column = np.mgrid[0:rows, 0:columns]
    side = row + (row + column) % 2  # row above the pair's common side
    i, j = (side - column) // 2 + columns // 2, (side + column) // 2
    poa = np.zeros((i.max() + 1, j.max() + 1))
    np.add.at(poa, (i, j), lattice.poa)
    axes = np.array([[1.0, 1.0], [-1.0, 1.0]]) / math.sqrt(2.0)
    pitch_m = math.sqrt(2.0) * lattice.pitch_m
    node = np.array([0.5, 0.0]) + columns // 2 * np.array([1.0, -1.0])  # row 0, column 0
    origin = lattice.origin_xy_m + lattice.pitch_m * node - 0.5 * pitch_m * axes.sum(axis=0)
    return Lattice(poa, pitch_m, origin, lattice.step / math.sqrt(2.0), axes)


def _shares(count: int, size_m: float, other_m: float) -> tuple[F64, float]:
    """Shares (M, count) of cells in others, centred over them, and where these begin."""
    others = math.ceil(count * size_m / other_m - 1e-9)
    begin_m = (count * size_m - others * other_m) / 2.0
    low, high = begin_m + other_m * np.arange(others)[:, None], size_m * np.arange(count)
    overlap_m = np.minimum(low + other_m, high + size_m) - np.maximum(low, high)
    return np.maximum(overlap_m, 0.0) / size_m, begin_m
