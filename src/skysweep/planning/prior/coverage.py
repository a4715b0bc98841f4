"""How thoroughly paths search each cell of a map."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from skysweep.arrays import F64


def coverage_of(
    paths_xy_m: Sequence[F64],
    shape: tuple[int, int],
    cell_size_m: float,
    origin_xy_m: F64,
    sweep_width_m: float,
) -> F64:
    """Coverage (R, C) of each cell: sweep width times the length of paths inside, over the cell's area.

    A sweep that is wider than a cell is as many lines beside each other as it takes cells.
    """
    lines = max(1, math.ceil(sweep_width_m / cell_size_m - 1e-9))
    length_m = np.zeros(shape)
    for path in paths_xy_m:
        for line in range(lines):
            aside_m = sweep_width_m * ((line + 0.5) / lines - 0.5)
            add_lengths(length_m, (path - origin_xy_m) / cell_size_m, aside_m / cell_size_m)
    return length_m * (sweep_width_m / (lines * cell_size_m))


@njit(cache=True)
def add_lengths(lengths: F64, path: F64, aside: float) -> None:
    """Add the length that a path (K, 2), moved aside to its left, has in each cell; all in cells."""
    rows, columns = lengths.shape
    for i in range(len(path) - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        length = math.hypot(dx, dy)
        if length == 0.0:
            continue
        x, y = path[i, 0] - aside * dy / length, path[i, 1] + aside * dx / length
        done = 0.0
        while done < 1.0:
            until = 1.0
            if dx != 0.0:
                column = math.floor(x + done * dx + 1e-9 * (1.0 if dx > 0.0 else -1.0))
                until = min(until, (column + (1.0 if dx > 0.0 else 0.0) - x) / dx)
            if dy != 0.0:
                row = math.floor(y + done * dy + 1e-9 * (1.0 if dy > 0.0 else -1.0))
                until = min(until, (row + (1.0 if dy > 0.0 else 0.0) - y) / dy)
            until = min(max(until, done + 1e-9), 1.0)
            middle = (done + until) / 2.0
            column, row = math.floor(x + middle * dx), math.floor(y + middle * dy)
            if 0 <= row < rows and 0 <= column < columns:
                lengths[row, column] += (until - done) * length
            done = until


def length_of(path_xy_m: F64) -> float:
    """Metres along a path (K, 2)."""
    return float(np.linalg.norm(np.diff(path_xy_m, axis=0), axis=1).sum())


def beginning(path_xy_m: F64, length_m: float) -> F64:
    """The first metres of a path (K, 2)."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path_xy_m, axis=0), axis=1)))
    kept = path_xy_m[: np.searchsorted(along, length_m, side="right")]
    end = [np.interp(length_m, along, path_xy_m[:, axis]) for axis in (0, 1)]
    return np.concatenate([kept, [end]])
