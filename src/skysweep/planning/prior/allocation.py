"""How an ideal searcher shares effort out: the bound that no path beats.

Koopman, "Search and Screening" (1980), and Stone, "Theory of Optimal Search" (1975): with exponential
detection the effort that finds most goes where the probability density is highest, until what is left of it
is equally high wherever anything was searched.
"""

from __future__ import annotations

import math

import numpy as np

from skysweep.arrays import F64


def ideal_coverage(poa: F64, effort: float) -> F64:
    """Coverage (R, C) of each cell that finds most with ``effort``, the coverage of all cells together.

    With coverage z a cell's target is found with probability 1 - exp(-z). ``poa`` (R, C) is not negative and
    not zero everywhere.
    """
    log_poa = np.log(poa, where=poa > 0.0, out=np.full(poa.shape, -np.inf))
    falling = -np.sort(-log_poa[poa > 0.0])
    sums, counts = np.cumsum(falling), np.arange(1, len(falling) + 1)
    searched = int(np.searchsorted(sums - counts * falling, effort, side="right"))
    level = (sums[searched - 1] - effort) / searched
    return np.asarray(np.maximum(log_poa - level, 0.0))


def ideal_pos(poa: F64, effort: float) -> float:
    """What the ideal searcher finds with ``effort``: the share of ``poa`` (R, C) at exponential detection."""
    return float(np.sum(poa * -np.expm1(-ideal_coverage(poa, effort))) / poa.sum())


def ideal_pos_definite(poa: F64, effort: float) -> float:
    """The same where one look along a cell finds for sure: the best cells that the effort covers once."""
    falling = -np.sort(-poa, axis=None)
    whole = min(int(effort), len(falling))
    part = (effort - whole) * falling[whole] if whole < len(falling) else 0.0
    return float((falling[:whole].sum() + part) / poa.sum())


def least_worth(poa: F64, step: float, visits: float) -> float:
    """The probability that the last of ``visits`` finds, each of coverage ``step``, best first."""
    log_first = np.log(poa[poa > 0.0]) + math.log(-math.expm1(-step))
    low, high = float(log_first.max()) - step * (visits + 1.0), float(log_first.max())
    for _ in range(60):
        middle = (low + high) / 2.0
        if np.floor(np.maximum((log_first - middle) / step + 1.0, 0.0)).sum() > visits:
            low = middle
        else:
            high = middle
    return math.exp(high)
