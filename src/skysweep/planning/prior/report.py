"""What paths may be expected to find, beside what no path can beat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.planning.prior.allocation import ideal_pos, ideal_pos_definite
from skysweep.planning.prior.checks import way_to_map
from skysweep.planning.prior.coverage import coverage_of, length_of
from skysweep.planning.prior.maps import ProbabilityMap

_POINTS = 20  # of the curve


@dataclass(frozen=True)
class ExpectedPos:
    """Probability of success against length flown, all vehicles together. Shares of the map."""

    length_m: F64  # (N,) from 0 on
    pos: F64  # (N,) exponential detection
    bound: F64  # (N,) of an ideal allocation of as much effort
    bound_from_start: F64  # (N,) the same of what is left after the straight way to the map
    definite_pos: float  # at the end, where a cell within half the sweep width is found for sure
    definite_bound: float


def expected_pos(cells: ProbabilityMap, paths_xy_m: Sequence[F64], sweep_width_m: float) -> ExpectedPos:
    """What paths (K, 2) each may be expected to find, flown together, each by the same share."""
    lengths = np.array([length_of(path) for path in paths_xy_m])
    shares = np.linspace(0.0, 1.0, _POINTS + 1)
    way_m = sum(way_to_map(cells.poa, cells.cell_size_m, cells.origin_xy_m, path[0]) for path in paths_xy_m)
    effort_per_m = sweep_width_m / cells.cell_size_m**2
    flown = shares * lengths.sum()
    coverages = [
        coverage_of(
            [beginning(path, share * length) for path, length in zip(paths_xy_m, lengths, strict=True)],
            cells.poa.shape,
            cells.cell_size_m,
            cells.origin_xy_m,
            sweep_width_m,
        )
        for share in shares
    ]
    bounds = [
        [ideal_pos(cells.poa, max(m, 0.0) * effort_per_m) for m in flown - less] for less in (0.0, way_m)
    ]
    return ExpectedPos(
        length_m=flown,
        pos=np.array([np.sum(cells.poa * -np.expm1(-coverage)) for coverage in coverages]),
        bound=np.array(bounds[0]),
        bound_from_start=np.array(bounds[1]),
        definite_pos=float(cells.poa[_within(cells, paths_xy_m, sweep_width_m / 2.0)].sum()),
        definite_bound=ideal_pos_definite(cells.poa, float(flown[-1]) * effort_per_m),
    )


def beginning(path_xy_m: F64, length_m: float) -> F64:
    """The first metres of a path (K, 2)."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path_xy_m, axis=0), axis=1)))
    kept = path_xy_m[: np.searchsorted(along, length_m, side="right")]
    end = [np.interp(length_m, along, path_xy_m[:, axis]) for axis in (0, 1)]
    return np.concatenate([kept, [end]])


def _within(cells: ProbabilityMap, paths_xy_m: Sequence[F64], distance_m: float) -> NDArray[np.bool_]:
    """Which cells' middles a path passes that near."""
    near = np.zeros(cells.poa.shape, dtype=np.bool_)
    for path in paths_xy_m:
        _mark(near, (path - cells.origin_xy_m) / cells.cell_size_m, distance_m / cells.cell_size_m + 1e-9)
    return near


@njit(cache=True)
def _mark(near: NDArray[np.bool_], path: F64, distance: float) -> None:
    """Mark the cells whose middles are that near to a path (K, 2); all in cells."""
    rows, columns = near.shape
    for i in range(len(path) - 1):
        a, b = path[i], path[i + 1]
        dx, dy = b[0] - a[0], b[1] - a[1]
        square = dx * dx + dy * dy
        first_row = max(int(min(a[1], b[1]) - distance) - 1, 0)
        first_column = max(int(min(a[0], b[0]) - distance) - 1, 0)
        for row in range(first_row, min(int(max(a[1], b[1]) + distance) + 1, rows)):
            for column in range(first_column, min(int(max(a[0], b[0]) + distance) + 1, columns)):
                x, y = column + 0.5 - a[0], row + 0.5 - a[1]
                share = min(max((x * dx + y * dy) / square, 0.0), 1.0) if square > 0.0 else 0.0
                if (x - share * dx) ** 2 + (y - share * dy) ** 2 <= distance * distance:
                    near[row, column] = True
