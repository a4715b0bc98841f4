"""Patterns fitted to where an ideal searcher searches: on even maps and small spots they are hard to beat."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from skysweep.arrays import F64
from skysweep.planning.prior.allocation import ideal_coverage
from skysweep.planning.prior.coverage import coverage_of, length_of
from skysweep.planning.prior.lattice import joined
from skysweep.planning.prior.patterns import expanding_square, legs_over

_LINES = 5  # beside each other, that a sweep is taken for
_MOST_CELLS = 250_000  # of a map that patterns are tried on
_SHRUNK = (1.0, 0.85, 0.7, 0.5)  # sides, in those of the box about what the ideal searcher searches
_SPARSE = 0.4  # of that box: where less is searched, no pattern fits
_LEGS = (-1, 0, 1, 2)  # tried beside what the budget does for
_CLOSEST = 0.25  # sweeps, between legs; what is left is flown back along them
_MOST_REPEATS = 1000
_WITHIN = 1.0 - 1e-12  # of a budget, for what is lost in rounding


def best_pattern(
    poa: F64, cell_size_m: float, start_xy_m: F64, each_m: float, n: int, sweep_width_m: float
) -> list[list[F64]]:
    """The pattern, shared out among n vehicles, that finds most on a map (R, C) whose corner is 0, 0.

    None where no pattern fits; for one vehicle and each of more a path (K, 2) that begins at the start.
    """
    wide_m = max(cell_size_m, sweep_width_m / _LINES)
    cells, cell_m, corner = poa, cell_size_m, np.zeros(2)
    if wide_m > cell_size_m:
        cells, corner = joined(poa, cell_size_m, wide_m)
        cell_m = wide_m
    if cells.size > _MOST_CELLS:
        return []
    ideal = ideal_coverage(cells, n * each_m * sweep_width_m / cell_m**2)
    inside = np.argwhere(ideal > 0.0)[:, ::-1]
    least, most = inside.min(axis=0), inside.max(axis=0) + 1
    if len(inside) < _SPARSE * np.prod(most - least):
        return []
    box = corner + cell_m * np.array([least, most])
    datum = corner + cell_m * (
        np.average(inside, axis=0, weights=(cells * -np.expm1(-ideal))[ideal > 0]) + 0.5
    )
    best: tuple[float, list[F64]] = 0.0, []
    for pattern in _patterns(box, datum, start_xy_m, each_m, n, sweep_width_m):
        paths = _shared(pattern, start_xy_m, each_m, n)
        found = cells * -np.expm1(-coverage_of(paths, cells.shape, cell_m, corner, sweep_width_m))
        if found.sum() > best[0]:
            best = float(found.sum()), paths
    return [best[1]] if best[1] else []


def _patterns(
    box: F64, datum: F64, start_xy_m: F64, each_m: float, n: int, sweep_width_m: float
) -> Iterator[F64]:
    """Parallel tracks over a box (2, 2) both ways, and expanding squares about a datum."""
    way_m = float(np.linalg.norm(np.clip(start_xy_m, *box) - start_xy_m))
    length_m = n * max(each_m - way_m, 0.0)
    least_m, middle = _CLOSEST * sweep_width_m, box.mean(axis=0)
    for shrunk, turned in itertools.product(_SHRUNK, (False, True)):
        across_m, along_m = (shrunk * (box[1] - box[0]))[:: -1 if turned else 1].tolist()
        fit = int((length_m - across_m) / along_m) if length_m > across_m else 1
        most = max(math.ceil(across_m / least_m), 1)
        for count in sorted({min(max(fit + more, 1), most) for more in _LEGS}):
            legs = legs_over(along_m, across_m, count)[:, :: -1 if turned else 1]
            corners = middle + legs[0] * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
            nearest = corners[np.argmin(np.linalg.norm(corners - start_xy_m, axis=1))]
            yield middle + legs * np.where(
                legs[0] != 0.0, (nearest - middle) / np.where(legs[0], legs[0], 1), 1
            )
    for shrunk in _SHRUNK:
        radius_m = shrunk * float((box[1] - box[0]).max()) / 2.0
        if length_m > 0.0:
            spacing_m = min(max(4.0 * radius_m**2 / length_m, least_m), radius_m)
            yield expanding_square(datum, radius_m, spacing_m, 0.0)


def _shared(pattern: F64, start_xy_m: F64, each_m: float, n: int) -> list[F64]:
    """Consecutive parts of a pattern (K, 2), each with the way there; at its end it is flown back."""
    once_m = length_of(pattern)
    repeats = min(max(math.ceil(n * each_m / once_m), 1), _MOST_REPEATS) if once_m > 0.0 else 1
    whole = np.concatenate([pattern, *([pattern[-2::-1], pattern[1:]] * (repeats // 2 + 1))[: repeats - 1]])
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(whole, axis=0), axis=1)))
    paths, done_m = [], 0.0
    for _ in range(n):
        begin = _places(whole, along, done_m)
        way_m = float(np.linalg.norm(begin - start_xy_m))
        until_m = min(done_m + max(each_m * _WITHIN - way_m, 0.0), along[-1])
        inner = whole[(along > done_m) & (along < until_m)]
        reached = start_xy_m + min(1.0, each_m * _WITHIN / max(way_m, 1e-9)) * (begin - start_xy_m)
        last = [_places(whole, along, until_m)] if until_m > done_m else []
        paths.append(np.array([start_xy_m, reached, *inner, *last]))
        done_m = until_m
    return paths


def _places(path_xy_m: F64, along: F64, at_m: float) -> F64:
    return np.array([np.interp(at_m, along, path_xy_m[:, axis]) for axis in (0, 1)])
