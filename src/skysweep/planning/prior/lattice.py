"""Where a path may turn: nodes at most a sweep width apart, and what a visit to one adds to its cell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skysweep.planning.prior.coverage import add_lengths

F64 = NDArray[np.float64]

MAX_SPLIT = 5  # rows of nodes in a cell
MAX_NODES = 40_000  # on all paths together


@dataclass(frozen=True)
class Lattice:
    """Cells and the nodes in them. Where a sweep is wider than a given cell, cells are as wide as a sweep."""

    poa: F64  # (R, C) of its cells
    cell_m: float
    origin_xy_m: F64  # (2,) corner of cell 0, 0
    split: int  # nodes along a cell's side
    step: float  # coverage that one visit adds to its cell

    @property
    def pitch_m(self) -> float:
        """Between neighbouring nodes."""
        return self.cell_m / self.split

    def xy_m(self, nodes: NDArray[np.int64]) -> F64:
        """Places (N, 2) of nodes (N, 2) given as row and column."""
        return np.asarray(self.origin_xy_m + (nodes[:, ::-1] + 0.5) * self.pitch_m)

    def add_coverage(self, coverage: F64, path_xy_m: F64, times: float = 1.0) -> None:
        """Add what a path (K, 2) covers of the cells to their coverage (R, C), so many times."""
        lengths = np.zeros(coverage.shape)
        add_lengths(lengths, (path_xy_m - self.origin_xy_m) / self.cell_m, 0.0)
        coverage += times * self.step * self.split * lengths


def lattice_over(
    poa: F64, cell_size_m: float, origin_xy_m: F64, sweep_width_m: float, length_m: float
) -> Lattice:
    """The lattice for sweeps of a width over a map (R, C), coarse enough for paths ``length_m`` long."""
    pitch = max(sweep_width_m, length_m / MAX_NODES)
    if pitch > cell_size_m:
        rows, south = _shares(poa.shape[0], cell_size_m, pitch)
        columns, west = _shares(poa.shape[1], cell_size_m, pitch)
        step = sweep_width_m / pitch
        return Lattice(rows @ poa @ columns.T, pitch, origin_xy_m + np.array([west, south]), 1, step)
    split = min(round(cell_size_m / pitch), MAX_SPLIT)
    return Lattice(poa, cell_size_m, origin_xy_m, split, sweep_width_m / (cell_size_m * split))


def _shares(count: int, size_m: float, wide_m: float) -> tuple[F64, float]:
    """Shares (M, count) of narrow cells in wide ones centred over them, and where these begin."""
    wide = math.ceil(count * size_m / wide_m - 1e-9)
    begin_m = (count * size_m - wide * wide_m) / 2.0
    low, high = begin_m + wide_m * np.arange(wide)[:, None], size_m * np.arange(count)
    overlap_m = np.minimum(low + wide_m, high + size_m) - np.maximum(low, high)
    return np.maximum(overlap_m, 0.0) / size_m, begin_m
