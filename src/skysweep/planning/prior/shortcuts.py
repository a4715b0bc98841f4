"""Parts of paths that find less than their length is worth are flown past."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.planning.prior.growth import Paths

_LONGEST = 300  # visits left out in one go


def take_shortcuts(paths: Paths, budget_m: float, worth_per_m: float) -> Paths:
    """Paths within the budget each, without the visits that are not worth their way."""
    field, routes = paths.lattice, []
    finds = field.poa * np.exp(-paths.coverage) * math.expm1(field.step)
    for path in range(len(paths.starts_xy_m)):
        visits = paths.visits(path)
        cells = paths.nodes[visits[1:]]
        found = np.append(0.0, finds[cells[:, 0], cells[:, 1]])
        kept = visits[_kept(paths.xy_m(visits), found, worth_per_m)]
        routes.append(paths.nodes[kept[1:]])
    return Paths.through(field, paths.starts_xy_m, budget_m, routes)


@njit(cache=True)
def _kept(places: F64, found: F64, worth_per_m: float) -> NDArray[np.bool_]:
    """Which visits stay: the best way through them, when what is left out saves its way's worth."""
    n = len(places)
    best = np.zeros(n)
    before = np.full(n, -1)
    for j in range(1, n):
        best[j] = -np.inf
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
