"""Paths that grow on a lattice where searching pays for the way.

Between two neighbouring nodes of a path a move goes straight aside for some nodes and back beside itself; at
its end it goes straight on. A move is worth what it finds less what its length costs; the best of all is made
until none pays. What a move finds only falls as more is searched, so that a heap of old values need only look
at its first again (Minoux, "Accelerated greedy algorithms for maximizing submodular set functions", 1978).
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from skysweep.arrays import F64, I64
from skysweep.planning.prior.coverage import length_of
from skysweep.planning.prior.lattice import Lattice

MOST_JUMPS = 2000  # visits that are added by anything but moves
_UNPAID_NODES = 3.0  # that a move may cross in one go
_MOVE_NODES = 0.5  # what the turns of a move cost, as nodes


@dataclass
class Paths:
    """Paths on a lattice, one linked list of visits; each path begins with its start, beside the nodes."""

    lattice: Lattice
    starts_xy_m: F64  # (N, 2)
    nodes: I64  # (room, 2) row and column
    following: I64  # (room,) the next visit; -1 at an end
    owner: I64  # (room,) which path
    count: int
    left_m: F64  # (N,) of each path's budget
    coverage: F64  # (R, C) of the lattice's cells

    @classmethod
    def through(cls, lattice: Lattice, starts_xy_m: F64, budget_m: float, routes: Sequence[I64]) -> Paths:
        """Paths from starts (N, 2) through nodes (K, 2) each, with a budget each."""
        n = len(starts_xy_m)
        visits = n + sum(map(len, routes)) + int(n * budget_m / lattice.pitch_m) + MOST_JUMPS
        paths = cls(
            lattice,
            starts_xy_m,
            np.full((visits, 2), -(2**40)),
            np.full(visits, -1),
            np.arange(visits),
            n,
            np.full(n, budget_m),
            np.zeros(lattice.poa.shape),
        )
        for path, route in enumerate(routes):
            first, end = paths.count, paths.count + len(route)
            paths.nodes[first:end], paths.owner[first:end] = route, path
            paths.following[[path, *range(first, end)][: len(route)]] = np.arange(first, end)
            paths.count = end
            way = paths.xy_m(paths.visits(path))
            paths.left_m[path] -= length_of(way)
            lattice.add_coverage(paths.coverage, way)
        return paths

    def grow(self, worth_per_m: float) -> None:
        """Make moves while one finds more than its length is worth."""
        field = self.lattice
        self.count = _grow(
            self.nodes,
            self.following,
            self.owner,
            self.count,
            self.left_m,
            worth_per_m * field.pitch_m,
            field.pitch_m,
            field.poa,
            self.coverage,
            field.step,
        )

    @property
    def pos(self) -> float:
        """What the paths find, as the lattice counts it."""
        return float(np.sum(self.lattice.poa * -np.expm1(-self.coverage)))

    def visits(self, path: int) -> I64:
        """The visits of one path in order, its start first."""
        return _in_order(self.following, path)

    def xy_m(self, visits: I64) -> F64:
        """Where visits are, (K, 2)."""
        places = self.lattice.xy_m(self.nodes[visits])
        at_start = visits < len(self.starts_xy_m)
        places[at_start] = self.starts_xy_m[visits[at_start]]
        return places


@njit(cache=True)
def _in_order(following: I64, first: int) -> I64:
    order = np.empty(len(following), dtype=np.int64)
    n, i = 0, first
    while i >= 0:
        order[n] = i
        n += 1
        i = following[i]
    return order[:n]


@njit(cache=True)
def _along(
    a: I64, b: I64, dr: int, dc: int, most: int, cost: float, poa: F64, coverage: F64, step: float
) -> tuple[float, int]:
    """Worth and depth of the best move to one side: from node a, and back to b where that is another one."""
    pair = a[0] != b[0] or a[1] != b[1]
    share = -math.expm1(-step)
    cost_of_nodes = 2.0 * cost if pair else cost
    best, depth, net = 0.0, 0, -_MOVE_NODES * cost
    for k in range(1, most + 1):
        r, c = a[0] + k * dr, a[1] + k * dc
        if r < 0 or c < 0 or r >= poa.shape[0] or c >= poa.shape[1]:
            break
        net += poa[r, c] * math.exp(-coverage[r, c]) * share - cost_of_nodes
        if pair:
            r, c = b[0] + k * dr, b[1] + k * dc
            net += poa[r, c] * math.exp(-coverage[r, c]) * share
        if net > best:
            best, depth = net, k
        elif net < best - _UNPAID_NODES * cost_of_nodes:
            break
    return best, depth


@njit(cache=True)
def _best_move(
    i: int,
    nodes: I64,
    following: I64,
    most: int,
    cost: float,
    poa: F64,
    coverage: F64,
    step: float,
) -> tuple[float, int, int, int]:
    """Worth, depth and direction (rows, columns) of the best move after visit i; depth 0 for none."""
    best, depth, best_dr, best_dc = 0.0, 0, 0, 0
    a, j = nodes[i], following[i]
    if j < 0:
        if a[0] >= 0:
            for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                net, k = _along(a, a, dr, dc, most, cost, poa, coverage, step)
                if net > best:
                    best, depth, best_dr, best_dc = net, k, dr, dc
        return best, depth, best_dr, best_dc
    b = nodes[j]
    if abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1:
        for side in (1, -1):
            dr, dc = side * (b[1] - a[1]), side * (b[0] - a[0])
            net, k = _along(a, b, dr, dc, most // 2, cost, poa, coverage, step)
            if net > best:
                best, depth, best_dr, best_dc = net, k, dr, dc
    return best, depth, best_dr, best_dc


@njit(cache=True)
def _grow(
    nodes: I64,
    following: I64,
    owner: I64,
    count: int,
    left_m: F64,
    cost: float,
    pitch_m: float,
    poa: F64,
    coverage: F64,
    step: float,
) -> int:
    heap = [(0.0, -1)]
    first, until = 0, count
    while True:
        for i in range(first, until):
            most = int(left_m[owner[i]] / pitch_m)
            net, k, dr, dc = _best_move(i, nodes, following, most, cost, poa, coverage, step)
            if k:
                heapq.heappush(heap, (-net, i))
        k = 0
        while True:
            i = heapq.heappop(heap)[1]
            if i < 0:
                return count
            most = int(left_m[owner[i]] / pitch_m)
            net, k, dr, dc = _best_move(i, nodes, following, most, cost, poa, coverage, step)
            if k and -net <= heap[0][0]:
                break
            if k:
                heapq.heappush(heap, (-net, i))
        j, new = following[i], count
        for m in range(1, k + 1):
            nodes[count, 0], nodes[count, 1] = nodes[i, 0] + m * dr, nodes[i, 1] + m * dc
            count += 1
        if j >= 0:
            for m in range(k, 0, -1):
                nodes[count, 0], nodes[count, 1] = nodes[j, 0] + m * dr, nodes[j, 1] + m * dc
                count += 1
        following[i] = new
        for m in range(new, count):
            following[m], owner[m] = m + 1, owner[i]
            coverage[nodes[m, 0], nodes[m, 1]] += step
        following[count - 1] = j
        left_m[owner[i]] -= (count - new) * pitch_m
        heapq.heappush(heap, (-np.inf, i))  # what it can do now is looked at when it comes up
        first, until = new, count
