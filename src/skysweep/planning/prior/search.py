"""Paths that find most of what a map says may be there, within a length.

Path planning with a budget on an area of probabilities is the orienteering problem with a submodular reward,
which is NP-hard. Here one price of a metre, that of the last metre of an ideal allocation, decides
everywhere alike: moves, ways to other parts and shortcuts are made when what they find is worth their length.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.planning.prior.allocation import ideal_coverage, least_worth
from skysweep.planning.prior.checks import checked_poa, place, positive, uavs, way_to_map
from skysweep.planning.prior.coverage import coverage_of
from skysweep.planning.prior.excursions import go_where_it_pays
from skysweep.planning.prior.fitted import best_pattern
from skysweep.planning.prior.growth import Paths
from skysweep.planning.prior.lattice import Lattice, cuts_for, diagonal, lattice_over
from skysweep.planning.prior.sharing import shared_out
from skysweep.planning.prior.shortcuts import take_shortcuts

ENOUGH_COVERAGE = 12.0  # of every cell: there is nothing left to find
_PRICES = (1.0, 1.4)  # of a metre to begin with, in those of the ideal allocation's last one
_MANY_VISITS = 8000  # with which one of them does
_FEW_VISITS = 2500  # with which going over cells half as well, and patterns, are tried too
_REVISIONS = 3
_DEARER = 1.25  # the price in a revision
_CHEAPER = 0.85  # the price from round to round, while there is budget left
_ROUNDS = 40
_MOST_CELLS_WIDE = 1000  # a sweep
_ROUNDING = 1e-9  # of a path's length, by large coordinates
_TIES = 1e-7  # by which the seed tells equal cells apart
_NOWHERE = np.zeros((0, 2), dtype=np.int64)


def plan_search(
    poa: ArrayLike,
    cell_size_m: float,
    origin_xy_m: ArrayLike,
    start_xy_m: ArrayLike,
    budget_m: float,
    sweep_width_m: float,
    n_uavs: int,
    seed: int = 0,
    on_step: Callable[[int, int], None] = lambda done, of: None,
) -> list[F64]:
    """Paths from a start that find most, by exponential detection, of a target on a map.

    Args:
        poa: (R, C) probability of area in each square cell, of any sum; row 0 is the southernmost.
        cell_size_m: side of a cell.
        origin_xy_m: (2,) south-western corner of cell 0, 0.
        start_xy_m: (2,) where all paths begin, on the map or beside it.
        budget_m: length of all paths together; each may be ``budget_m / n_uavs`` long.
        sweep_width_m: of the sensor; a length L inside a cell covers it L * sweep width / cell area times.
        n_uavs: how many paths.
        seed: which of equally good paths.
        on_step: gets how many steps are done, and of how many.

    Returns:
        One path (K, 2) in metres for each vehicle, K at least 2.

    Raises:
        UserError: a field that no search can be planned with, or a budget that does not reach the map or is
            shorter for each vehicle than a cell or a sweep is wide.
    """
    p = checked_poa(poa)
    cell_m = positive(cell_size_m, "cell_size_m")
    origin, start = place(origin_xy_m, "origin_xy_m"), place(start_xy_m, "start_xy_m")
    width_m, n = positive(sweep_width_m, "sweep_width_m"), uavs(n_uavs)
    each_m = positive(budget_m, "budget_m") / n
    if not isinstance(seed, Integral) or seed < 0:
        raise UserError(f"seed: is {seed!r:.60}; write a whole number from 0 on")
    if width_m > _MOST_CELLS_WIDE * cell_m:
        raise UserError(
            f"sweep_width_m: is {width_m / cell_m:.0f} cells wide; write cells of at least "
            f"{width_m / _MOST_CELLS_WIDE:g} m"
        )
    way_m = way_to_map(p, cell_m, origin, start)
    if each_m <= way_m:
        raise UserError(
            f"budget_m: {each_m:g} m for each vehicle do not reach the map, which begins {way_m:.0f} m from "
            f"the start; write more than {math.ceil(n * way_m)}, or start nearer"
        )
    least_m = max(cell_m, width_m)
    if each_m < least_m:
        raise UserError(
            f"budget_m: {each_m:g} m for each vehicle are less than a cell or a sweep is wide; write metres, "
            f"at least {n * least_m:g}"
        )
    p *= 1.0 + _TIES * np.random.default_rng(seed).random(p.shape)
    p, corner = _without_border(p)
    origin = origin + cell_m * corner
    enough_m = ENOUGH_COVERAGE * np.prod(cell_m * np.array(p.shape) + width_m) / width_m + way_m
    each_m = min(each_m * (1.0 - _ROUNDING), float(enough_m))
    lattice = lattice_over(p, cell_m, np.zeros(2), width_m, n * each_m)
    visits = n * each_m / lattice.pitch_m
    prices = _PRICES if visits < _MANY_VISITS else _PRICES[:1]
    lattices, cuts = [lattice], cuts_for(lattice, n * each_m)
    if cuts > 1:
        lattices.append(lattice_over(p, cell_m, np.zeros(2), width_m, n * each_m, cuts))
    if visits < _FEW_VISITS and cell_m / math.sqrt(2.0) <= width_m <= cell_m:  # it still sees the middles
        lattices.append(diagonal(lattice))
    steps = len(lattices) * len(prices) * min(n, 2) * (1 + _REVISIONS)
    done = itertools.count(1)
    plans = [
        _flown(_planned(nodes, start - origin, each_m, n, price, lambda: on_step(next(done), steps)), each_m)
        for nodes in lattices
        for price in prices
    ]
    if visits < _FEW_VISITS:
        plans += best_pattern(p, cell_m, start - origin, each_m, n, width_m)
    found = [
        np.sum(p * -np.expm1(-coverage_of(plan, p.shape, cell_m, np.zeros(2), width_m))) for plan in plans
    ]
    paths = [origin + path for path in plans[int(np.argmax(found))]]
    for path in paths:
        path[0] = start
    return paths


def _without_border(poa: F64) -> tuple[F64, F64]:
    """A map without the rows and columns around it that hold nothing, and its column and row 0 there."""
    rows, columns = np.flatnonzero(poa.any(axis=1)), np.flatnonzero(poa.any(axis=0))
    return poa[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], np.array([columns[0], rows[0]])


def _flown(paths: Paths, each_m: float) -> list[F64]:
    """Where each path leads (K, 2); one that has no budget for any node leads towards the best."""
    places = [_corners(paths.xy_m(paths.visits(k))) for k in range(len(paths.starts_xy_m))]
    return [xy_m if len(xy_m) > 1 else _straight(paths.lattice, xy_m[0], each_m) for xy_m in places]


def _planned(
    lattice: Lattice, start_xy_m: F64, each_m: float, n: int, price: float, step: Callable[[], None]
) -> Paths:
    if n == 1:
        length_m = each_m
        paths = Paths.through(lattice, start_xy_m[None], each_m, [_NOWHERE])
    else:
        length_m = max(n * each_m - (n - 1) * _mean_way(lattice, start_xy_m, n * each_m), each_m)
        paths = shared_out(_planned(lattice, start_xy_m, length_m, 1, price, step), n, each_m)
    worth_per_m = least_worth(lattice.poa, lattice.step, length_m / lattice.pitch_m) / lattice.pitch_m
    best, worth_per_m = paths, _grow(paths, price * worth_per_m)
    step()
    for _ in range(_REVISIONS):
        paths = take_shortcuts(paths, each_m, worth_per_m * _DEARER)
        worth_per_m = _grow(paths, worth_per_m * _DEARER)
        best = max(best, paths, key=lambda p: p.pos)
        step()
    return best


def _grow(paths: Paths, worth_per_m: float) -> float:
    """Spend the budget where a metre is worth most; the last price."""
    for _ in range(_ROUNDS):
        go_where_it_pays(paths, worth_per_m)
        paths.grow(worth_per_m)
        if paths.left_m.max() < paths.lattice.pitch_m:
            break
        worth_per_m *= _CHEAPER
    return worth_per_m


def _mean_way(lattice: Lattice, start_xy_m: F64, length_m: float) -> float:
    """From the start to where an ideal searcher searches."""
    ideal = ideal_coverage(lattice.poa, length_m / lattice.pitch_m * lattice.step)
    centres = lattice.xy_m(np.argwhere(ideal > 0.0))
    return float(np.average(np.linalg.norm(centres - start_xy_m, axis=1), weights=ideal[ideal > 0.0]))


def _straight(lattice: Lattice, start_xy_m: F64, length_m: float) -> F64:
    """Straight towards the best cell, where the budget does for no more."""
    cells = np.argwhere(lattice.poa > 0.0)
    centres = lattice.xy_m(cells)
    ways = np.linalg.norm(centres - start_xy_m, axis=1)
    worth = np.where(ways <= length_m, lattice.poa[tuple(cells.T)], -ways)
    k = int(np.argmax(worth))
    share = min(1.0, length_m / ways[k]) if ways[k] > 0.0 else 1.0
    return np.array([start_xy_m, start_xy_m + share * (centres[k] - start_xy_m)])


def _corners(xy_m: F64) -> F64:
    """A path (K, 2) without the places where it goes straight on."""
    legs = np.diff(xy_m, axis=0)
    legs = legs[np.linalg.norm(legs, axis=1) > 0.0]
    turn = legs[:-1, 0] * legs[1:, 1] - legs[:-1, 1] * legs[1:, 0]
    ahead = np.sum(legs[:-1] * legs[1:], axis=1) > 0.0
    scale = np.linalg.norm(legs[:-1], axis=1) * np.linalg.norm(legs[1:], axis=1)
    straight = ahead & (np.abs(turn) <= 1e-9 * scale)
    moved = np.concatenate([[True], np.linalg.norm(np.diff(xy_m, axis=0), axis=1) > 0.0])
    return np.asarray(xy_m[moved][np.concatenate([[True], ~straight, np.full(min(len(legs), 1), True)])])
