"""Solids by square cells of the ground: those around a place are found without a look at the others."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from skysweep.arrays import F64, I64

_CELL_M = 16.0


class Grid(NamedTuple):
    """Solids by square cells of the ground: plain arrays for compiled code."""

    frame: F64  # west and south in metres, columns, rows, and the largest reach of a solid
    starts: I64  # where each cell's part of the order begins, by row from the south-west on
    order: I64  # (S,)

    @classmethod
    def of(cls, places: F64, reach_m: F64) -> Grid:
        """The grid of solids at places (S, 2), each of which reaches as far as that (S,)."""
        if not len(places):
            return cls(np.array([0.0, 0.0, 0.0, 0.0, 0.0]), np.zeros(1, np.int64), np.zeros(0, np.int64))
        corner = places.min(axis=0)
        column, row = ((places - corner) / _CELL_M).astype(np.int64).T
        columns, rows = int(column.max()) + 1, int(row.max()) + 1
        cell = row * columns + column
        starts = np.searchsorted(np.sort(cell), np.arange(columns * rows + 1))
        frame = np.array([*corner, columns, rows, reach_m.max()])
        return cls(frame, starts.astype(np.int64), np.argsort(cell, kind="stable"))


@njit(cache=True)
def around(
    found: I64,
    frame: F64,
    starts: I64,
    order: I64,
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    margin_m: float,
) -> int:
    """Write the solids of a grid that may reach the rectangle between two corners, widened; their number."""
    west, south, columns, rows, reach_m = frame
    margin_m += reach_m
    first_column = int(max(math.floor((min(x0, x1) - margin_m - west) / _CELL_M), 0.0))
    first_row = int(max(math.floor((min(y0, y1) - margin_m - south) / _CELL_M), 0.0))
    end_column = int(min(math.floor((max(x0, x1) + margin_m - west) / _CELL_M) + 1.0, columns))
    end_row = int(min(math.floor((max(y0, y1) + margin_m - south) / _CELL_M) + 1.0, rows))
    n = 0
    if first_column < end_column:
        for row in range(first_row, end_row):
            first_cell = row * int(columns)
            for k in range(starts[first_cell + first_column], starts[first_cell + end_column]):
                found[n] = order[k]
                n += 1
    return n
