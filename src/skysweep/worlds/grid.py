"""Things on the ground by square cells, so that those around a place are found without a look at the others."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from skysweep.arrays import F64, I64

_CELL_M = 16.0


class Grid(NamedTuple):
    """For compiled code: the things of cell k are ``things[starts[k] : starts[k + 1]]``."""

    west_m: float
    south_m: float
    columns: int
    rows: int
    reach_m: float  # the largest of a thing
    starts: I64
    things: I64

    @classmethod
    def of(cls, places: F64, reach_m: F64) -> Grid:
        """The grid of places (S, 2), of which each reaches as far as that (S,)."""
        if not len(places):
            return cls(0.0, 0.0, 1, 1, 0.0, np.zeros(2, dtype=np.int64), np.zeros(0, dtype=np.int64))
        west, south = places.min(axis=0)
        column, row = ((places - (west, south)) / _CELL_M).astype(np.int64).T
        columns, rows = int(column.max()) + 1, int(row.max()) + 1
        cell = row * columns + column
        starts = np.searchsorted(np.sort(cell), np.arange(columns * rows + 1)).astype(np.int64)
        order = np.argsort(cell, kind="stable").astype(np.int64)
        return cls(float(west), float(south), columns, rows, float(reach_m.max()), starts, order)


@njit(cache=True)
def around(grid: Grid, x0: float, y0: float, x1: float, y1: float, margin_m: float) -> I64:
    """All things that reach the rectangle between two corners, widened by a margin, and some beside it."""
    margin_m += grid.reach_m
    first_column = min(max(math.floor((min(x0, x1) - margin_m - grid.west_m) / _CELL_M), 0), grid.columns)
    end_column = min(max(math.floor((max(x0, x1) + margin_m - grid.west_m) / _CELL_M) + 1, 0), grid.columns)
    first_row = min(max(math.floor((min(y0, y1) - margin_m - grid.south_m) / _CELL_M), 0), grid.rows)
    end_row = min(max(math.floor((max(y0, y1) + margin_m - grid.south_m) / _CELL_M) + 1, 0), grid.rows)
    found = np.empty(len(grid.things), dtype=np.int64)
    n = 0
    for row in range(int(first_row), int(end_row)):
        first = grid.starts[row * grid.columns + int(first_column)]
        end = grid.starts[row * grid.columns + int(end_column)]
        found[n : n + end - first] = grid.things[first:end]
        n += end - first
    return found[:n]
