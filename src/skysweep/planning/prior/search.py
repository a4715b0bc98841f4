"""Paths that find most of what a map says may be there, within a length."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skysweep.planning.prior.allocation import least_worth
from skysweep.planning.prior.excursions import go_where_it_pays
from skysweep.planning.prior.growth import Paths
from skysweep.planning.prior.lattice import Lattice, lattice_over
from skysweep.planning.prior.shortcuts import take_shortcuts

F64 = NDArray[np.float64]

_ROUNDS = 40
_CHEAPER = 0.85


def plan_search(poa, cell_size_m, origin_xy_m, start_xy_m, budget_m, sweep_width_m, n_uavs, seed=0, factors=(1.0,1.25,1.6), again=3, up=1.5):
    lattice = lattice_over(poa / poa.sum(), cell_size_m, np.asarray(origin_xy_m, float), sweep_width_m, budget_m)
    starts = np.tile(np.asarray(start_xy_m, float), (n_uavs, 1))
    best = None
    for f in factors:
        paths, worth = _grown(lattice, starts, budget_m / n_uavs, f)
        for k in range(again + 1):
            pos = float(np.sum(lattice.poa * -np.expm1(-paths.coverage)))
            if best is None or pos > best[0]:
                best = pos, paths, f, k
            if k == again: break
            paths = take_shortcuts(paths, worth * up)
            worth = _grow(paths, worth * up)
    _, paths, *plan_search.which = best
    return [_corners(paths.xy_m(paths.visits(k))) for k in range(n_uavs)]


def _grown(lattice: Lattice, starts_xy_m: F64, budget_m: float, factor: float):
    visits = len(starts_xy_m) * budget_m / lattice.pitch_m
    paths = Paths.at_starts(lattice, starts_xy_m, budget_m, int(visits)+ 2000)
    worth_per_m = factor * least_worth(lattice.poa, lattice.step, visits) / lattice.pitch_m
    return paths, _grow(paths, worth_per_m)

def _grow(paths, worth_per_m):
    for _ in range(_ROUNDS):
        before=paths.left_m.sum()
        went = go_where_it_pays(paths, worth_per_m)
        paths.grow(worth_per_m)
        if paths.left_m.max() < paths.lattice.pitch_m:
            break
        worth_per_m *= _CHEAPER
    return worth_per_m


def _corners(xy_m: F64) -> F64:
    """A path (K, 2) without the places where it goes straight on."""
    legs = np.diff(xy_m, axis=0)
    turn = legs[:-1, 0] * legs[1:, 1] - legs[:-1, 1] * legs[1:, 0]
    ahead = np.sum(legs[:-1] * legs[1:], axis=1) > 0.0
    scale = np.linalg.norm(legs[:-1], axis=1) * np.linalg.norm(legs[1:], axis=1)
    straight = ahead & (np.abs(turn) <= 1e-9 * scale)
    return xy_m[np.concatenate([[True], ~straight, [True]])]
