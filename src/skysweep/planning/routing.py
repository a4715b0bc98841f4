"""In which order to visit places that can each be entered in several ways.

Small instances are solved exactly (Held and Karp, "A dynamic programming approach to sequencing problems",
1962), larger ones by nearest neighbour and 2-opt (Croes, 1958).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F64

EXACT_MAX = 7  # places
MAX_TRIES = 50_000_000  # of an improvement
_LEAST_GAIN_M = 1e-6


def visit_order(
    entries: F64, exits: F64, lengths: F64, reverse: NDArray[np.int_], start: F64 | None
) -> list[tuple[int, int]]:
    """The shortest open tour through all places, as (place, way) in order.

    ``entries`` and ``exits`` (M, K, 2) say where way k into place m begins and ends, ``lengths`` (M, K) how
    long it is inside, ``reverse`` (M, K) which way is the same one backwards. ``start`` (2,) is where the
    tour begins; None leaves it free.
    """
    m, k = lengths.shape
    first = lengths.ravel().copy()
    if start is not None:
        first += np.linalg.norm(entries.reshape(-1, 2) - start, axis=1)
    ends = np.column_stack([entries.reshape(-1, 2), exits.reshape(-1, 2), lengths.ravel()])
    if m <= EXACT_MAX:
        nodes = _exact(ends, first, m, k).tolist()
    else:
        backwards = (np.arange(m)[:, None] * k + reverse).ravel()
        nodes = _two_opt(_nearest(ends, first, m, k), ends, first, backwards, MAX_TRIES).tolist()
    return [divmod(node, k) for node in nodes]


def shortest_tour(start: tuple[float, float], places: F64) -> list[int]:
    """Indices of ``places`` (N, 2) in the order of a short open tour from ``start``."""
    return [int(place) for place in tour_from(start, places)]


@njit(cache=True)
def tour_from(start: tuple[float, float], places: F64) -> NDArray[np.int64]:
    """:func:`shortest_tour`, for compiled code."""
    n = len(places)
    nodes = np.arange(n)
    if n < 2:
        return nodes
    ends, first = np.zeros((n, 5)), np.empty(n)
    for i in range(n):
        ends[i, 0] = ends[i, 2] = places[i, 0]
        ends[i, 1] = ends[i, 3] = places[i, 1]
        dx, dy = places[i, 0] - start[0], places[i, 1] - start[1]
        first[i] = math.sqrt(dx * dx + dy * dy)
    if n <= EXACT_MAX:
        return _exact(ends, first, n, 1)
    return _two_opt(_nearest(ends, first, n, 1), ends, first, nodes, MAX_TRIES)


@njit(cache=True)
def _hop(ends: F64, node: int, to: int) -> float:
    """From where a node is left to where another one is, by its entry. Rows: entry, exit, length inside."""
    dx, dy = ends[node, 2] - ends[to, 0], ends[node, 3] - ends[to, 1]
    return float(math.sqrt(dx * dx + dy * dy) + ends[to, 4])


@njit(cache=True)
def _exact(ends: F64, first: F64, m: int, k: int) -> NDArray[np.int64]:
    """Dynamic programme over (set of places visited, last node)."""
    n = m * k
    hop = np.empty((n, n))
    for node in range(n):
        for to in range(n):
            hop[node, to] = _hop(ends, node, to)
    best = np.full((1 << m, n), np.inf)
    before = np.full((1 << m, n), -1)
    for node in range(n):
        best[1 << node // k, node] = first[node]
    for visited in range(1, 1 << m):
        for node in range(n):
            new = visited | (1 << node // k)
            if new == visited:
                continue
            for last in range(n):
                cost = best[visited, last] + hop[last, node]
                if cost < best[new, node]:
                    best[new, node], before[new, node] = cost, last
    tour = np.empty(m, dtype=np.int64)
    visited, last = (1 << m) - 1, int(np.argmin(best[-1]))
    for position in range(m - 1, -1, -1):
        tour[position] = last
        visited, last = visited & ~(1 << last // k), before[visited, last]
    return tour


@njit(cache=True)
def _nearest(ends: F64, first: F64, m: int, k: int) -> NDArray[np.int64]:
    """A tour that always goes to the nearest place that is left."""
    free = np.ones(m, dtype=np.bool_)
    tour = np.empty(m, dtype=np.int64)
    for n in range(m):
        least = np.inf
        for node in range(m * k):
            if free[node // k]:
                cost = _hop(ends, tour[n - 1], node) if n else first[node]
                if cost < least:
                    least, tour[n] = cost, node
        free[tour[n] // k] = False
    return tour


@njit(cache=True)
def _measure(
    tour: NDArray[np.int64], ends: F64, backwards: NDArray[np.int64], forth: F64, back: F64, begin: int
) -> None:
    """Lengths of the hops up to each node of the tour, and of those the other way, from ``begin`` on."""
    for n in range(max(begin, 1), len(tour)):
        forth[n] = forth[n - 1] + _hop(ends, tour[n - 1], tour[n])
        back[n] = back[n - 1] + _hop(ends, backwards[tour[n]], backwards[tour[n - 1]])


@njit(cache=True)
def _two_opt(
    tour: NDArray[np.int64], ends: F64, first: F64, backwards: NDArray[np.int64], tries: int
) -> NDArray[np.int64]:
    """Reverses parts of the tour for as long as they shorten it, and ``tries`` last.

    What the lengths inside a reversed part change: hops are symmetric, ways count at the node entered.
    """
    m = len(tour)
    forth, back = np.zeros(m), np.zeros(m)
    _measure(tour, ends, backwards, forth, back, 0)
    improved = True
    while improved and tries > 0:
        improved = False
        for i in range(m):
            for j in range(i, m):
                new_first, new_last = backwards[tour[j]], backwards[tour[i]]
                if i:
                    gain = _hop(ends, tour[i - 1], tour[i]) - _hop(ends, tour[i - 1], new_first)
                else:
                    gain = first[tour[i]] - first[new_first]
                if j + 1 < m:
                    gain += _hop(ends, tour[j], tour[j + 1]) - _hop(ends, new_last, tour[j + 1])
                gain += (forth[j] - forth[i]) - (back[j] - back[i])
                if gain > _LEAST_GAIN_M:
                    tour[i : j + 1] = backwards[tour[i : j + 1][::-1]]
                    _measure(tour, ends, backwards, forth, back, i)
                    improved = True
            tries -= m - i
    return tour
