"""In which order to visit places that can each be entered in several ways.

Small instances are solved exactly (Held and Karp, "A dynamic programming approach to sequencing problems",
1962), larger ones by nearest neighbour and 2-opt (Croes, 1958).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

EXACT_MAX = 7  # places


def visit_order(
    entries: F64, exits: F64, lengths: F64, reverse: NDArray[np.int_], start: F64 | None
) -> list[tuple[int, int]]:
    """The shortest open tour through all places, as (place, way) in order.

    ``entries`` and ``exits`` (M, K, 2) say where way k into place m begins and ends, ``lengths`` (M, K) how
    long it is inside, ``reverse`` (M, K) which way is the same one backwards. ``start`` (2,) is where the
    tour begins; None leaves it free.
    """
    m, k = lengths.shape
    hop = np.linalg.norm(exits.reshape(-1, 1, 2) - entries.reshape(1, -1, 2), axis=2)
    hop += lengths.reshape(1, -1)
    first = lengths.ravel().copy()
    if start is not None:
        first += np.linalg.norm(entries.reshape(-1, 2) - start, axis=1)
    nodes = _exact(hop, first, m, k) if m <= EXACT_MAX else _two_opt(hop, first, m, k, reverse)
    return [divmod(node, k) for node in nodes]


def _exact(hop: F64, first: F64, m: int, k: int) -> list[int]:
    """Dynamic programme over (set of places visited, last node)."""
    place = np.arange(m * k) // k
    best = np.full((1 << m, m * k), np.inf)
    before = np.full((1 << m, m * k), -1)
    best[1 << place, np.arange(m * k)] = first
    for visited in range(1, 1 << m):
        cost = best[visited][:, None] + hop
        previous = np.argmin(cost, axis=0)
        cost = cost[previous, np.arange(m * k)]
        for node in np.flatnonzero((visited >> place) & 1 == 0):
            new = visited | (1 << place[node])
            if cost[node] < best[new, node]:
                best[new, node], before[new, node] = cost[node], previous[node]
    visited, last = (1 << m) - 1, int(np.argmin(best[-1]))
    nodes: list[int] = []
    while last >= 0:
        nodes.append(last)
        visited, last = visited & ~(1 << int(place[last])), int(before[visited, last])
    return nodes[::-1]


def _two_opt(hop: F64, first: F64, m: int, k: int, reverse: NDArray[np.int_]) -> list[int]:
    """Nearest neighbour, then reversals of parts of the tour for as long as they shorten it."""
    backwards = (np.arange(m)[:, None] * k + reverse).ravel()
    free = np.ones(m * k, dtype=bool)
    tour: list[int] = []
    cost = first
    while free.any():
        node = int(np.argmin(np.where(free, cost, np.inf)))
        tour.append(node)
        free[node // k * k : node // k * k + k] = False
        cost = hop[node]

    def into(before: int, node: int) -> float:
        return float(hop[tour[before], node] if before >= 0 else first[node])

    improved = True
    while improved:
        improved = False
        for i in range(m):
            for j in range(i, m):
                new_first, new_last = int(backwards[tour[j]]), int(backwards[tour[i]])
                gain = into(i - 1, tour[i]) - into(i - 1, new_first)
                if j + 1 < m:
                    gain += float(hop[tour[j], tour[j + 1]] - hop[new_last, tour[j + 1]])
                if i < j:
                    gain += _inside_gain(hop, tour, backwards, i, j)
                if gain > 1e-6:
                    tour[i : j + 1] = [int(backwards[n]) for n in reversed(tour[i : j + 1])]
                    improved = True
    return tour


def _inside_gain(hop: F64, tour: list[int], backwards: NDArray[np.int_], i: int, j: int) -> float:
    """What the lengths inside a reversed part change: hops are symmetric, ways count at the node entered."""
    part = np.array(tour[i : j + 1])
    back = backwards[part[::-1]]
    return float(hop[part[:-1], part[1:]].sum() - hop[back[:-1], back[1:]].sum())
