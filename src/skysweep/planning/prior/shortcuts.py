"""Parts of paths that find less than their length is worth are flown past."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.planning.prior.coverage import add_lengths
from skysweep.planning.prior.growth import Paths

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_LONGEST = 300  # visits left out in one go


def take_shortcuts(paths: Paths, worth_per_m: float) -> Paths:
    """Paths without the visits that are not worth their way."""
    field, n = paths.lattice, len(paths.starts_xy_m)
    budget_m = paths.left_m + [_length_m(paths.xy_m(paths.visits(path))) for path in range(n)]
    finds = field.poa * np.exp(-paths.coverage) * math.expm1(field.step)
    shorter = Paths.at_starts(field, paths.starts_xy_m, 0.0, len(paths.nodes))
    lengths = np.zeros(field.poa.shape)
    for path in range(n):
        visits = paths.visits(path)
        places = paths.xy_m(visits)
        cells = paths.nodes[visits[1:]] // field.split
        found = np.append(0.0, finds[cells[:, 0], cells[:, 1]])
        kept = visits[_kept(places, found, worth_per_m)][1:]
        end = shorter.count + len(kept)
        shorter.nodes[shorter.count : end] = paths.nodes[kept]
        shorter.owner[shorter.count : end] = path
        if len(kept):
            shorter.following[path] = shorter.count
            shorter.following[shorter.count : end - 1] = np.arange(shorter.count + 1, end)
        shorter.count = end
        way = shorter.xy_m(shorter.visits(path))
        shorter.left_m[path] = budget_m[path] - _length_m(way)
        add_lengths(lengths, (way - field.origin_xy_m) / field.cell_m, 0.0)
    shorter.coverage += field.step * field.split * lengths
    return shorter


@njit(cache=True)
def _kept(places: F64, found: F64, worth_per_m: float) -> NDArray[np.bool_]:
    """Which visits stay: the best way through them, when what is left out saves its way's worth."""
    n = len(places)
    best = np.zeros(n)
    before = np.full(n, -1)
    for j in range(1, n):
        best[j] = -np.inf
        missed = 0.0
        for i in range(j - 1, max(j - _LONGEST, 0) - 1, -1):
            way = math.hypot(places[j, 0] - places[i, 0], places[j, 1] - places[i, 1])
            value = best[i] + found[j] - worth_per_m * way
            if value > best[j]:
                best[j], before[j] = value, i
    kept = np.zeros(n, dtype=np.bool_)
    k = int(np.argmax(best))
    while k >= 0:
        kept[k] = True
        k = before[k]
    return kept


def _length_m(xy_m: F64) -> float:
    return float(np.linalg.norm(np.diff(xy_m, axis=0), axis=1).sum())
