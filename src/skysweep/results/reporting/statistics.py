"""Statistics of repeated missions, on arrays: bootstrap intervals, paired tests, Holm, Pareto.

Only ``SEED`` and the number of missions seed a resampling. A report made twice is the same, and all that flew
the same seeds are resampled alike. docs/statistics.md explains the methods for users.

Sources: Efron, Better bootstrap confidence intervals, JASA 82 (1987) 171-185 (BCa); Wilcoxon, Individual
comparisons by ranking methods, Biometrics Bulletin 1 (1945) 80-83; Kerby, The simple difference formula,
Comprehensive Psychology 3 (2014) (matched-pairs rank-biserial correlation); Cohen, Statistical power
analysis, 2nd ed. (1988), p. 48 (d_z); Holm, A simple sequentially rejective multiple test procedure, Scand.
J. Statist. 6 (1979) 65-70.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri, stdtrit

from skysweep.types import F64

MeanCI = tuple[float, tuple[float, float]]  # mean and its 95 % confidence interval

SEED = 1979
RESAMPLES = 5000
LEVEL = 0.95
SIGNIFICANCE = 0.05
EXACT_UP_TO = 50  # pairs; beyond it Wilcoxon's p is by the normal approximation
_BLOCK = 256  # columns resampled at a time, which limits the memory to 10 MB


@dataclass(frozen=True, slots=True)
class Estimate:
    """The mean of a sample. Its bounds are NaN with fewer than 2 values."""

    n: int
    mean: float
    low: float
    high: float
    median: float
    std: float  # of the sample (n - 1); NaN for one value


@dataclass(frozen=True, slots=True)
class PairedTest:
    """Differences a - b over common seeds.

    ``p`` is Wilcoxon's, two-sided, without zero differences (1 where all are zero). ``rank_biserial`` is +1
    where a is larger in all pairs, -1 where b is. ``cohens_dz`` is the mean over the standard deviation of
    the differences, NaN where they do not vary.
    """

    n_pairs: int
    n_zero: int
    mean: float
    low: float
    high: float
    p: float
    rank_biserial: float
    cohens_dz: float


@lru_cache(maxsize=2)
def resample_counts(n: int, resamples: int = RESAMPLES) -> NDArray[np.float32]:
    """Counts of each of ``n`` missions in each bootstrap sample: (resamples, n). Rows sum to n."""
    rng = np.random.default_rng([SEED, n])
    counts = np.empty((resamples, n), dtype=np.float32)
    for rows in _row_blocks(resamples, n):
        size = len(counts[rows])
        drawn = rng.integers(0, n, (size, n)) + n * np.arange(size)[:, None]
        counts[rows] = np.bincount(drawn.ravel(), minlength=n * size).reshape(size, n)
    counts.setflags(write=False)
    return counts


def resampled_means(values: F64, resamples: int = RESAMPLES) -> F64:
    """Bootstrap means (resamples, K) of columns (n, K)."""
    counts = resample_counts(len(values), resamples)
    rows = _row_blocks(resamples, len(values))
    return np.concatenate([counts[block].astype(float) @ values for block in rows]) / len(values)


def _row_blocks(rows: int, columns: int) -> list[slice]:
    """Slices of rows with at most two million cells each, which limits the memory."""
    size = max(1, 2_000_000 // columns)
    return [slice(start, start + size) for start in range(0, rows, size)]


def bca_intervals(values: F64, resamples: int = RESAMPLES) -> tuple[F64, F64]:
    """Bounds of the 95 % BCa bootstrap intervals of the means of columns (n, K): (K,) and (K,).

    The acceleration of a mean needs no jackknife: with d the deviations from the mean, it is
    sum(d^3) / (6 sum(d^2)^1.5). Columns that do not vary give an interval without width; n < 2 gives NaN.
    """
    values = np.asarray(values, dtype=float)
    n, columns = values.shape
    if n < 2:
        return np.full(columns, np.nan), np.full(columns, np.nan)
    mean = values.mean(axis=0)
    deviations = values - mean
    deviations[np.abs(deviations) < 1e-12 * np.abs(values).max(axis=0, initial=0.0)] = 0.0
    scale = np.abs(deviations).max(axis=0)
    deviations /= np.where(scale > 0, scale, 1.0)
    bounds = np.empty((2, columns))
    for start in range(0, columns, _BLOCK):
        block = slice(start, start + _BLOCK)
        bounds[:, block] = _bca_block(deviations[:, block], resamples)
    low, high = mean + scale * bounds
    return np.where(np.abs(low) < 1e-12 * scale, 0.0, low), np.where(np.abs(high) < 1e-12 * scale, 0.0, high)


def _bca_block(deviations: F64, resamples: int) -> F64:
    """Bounds (2, K) of the mean of deviations (n, K), each within -1..1 and zero on average."""
    squares = (deviations**2).sum(axis=0)
    varies = squares > 0
    acceleration = np.zeros_like(squares)
    acceleration[varies] = (deviations[:, varies] ** 3).sum(axis=0) / (6 * squares[varies] ** 1.5)
    means = np.sort(resampled_means(deviations, resamples), axis=0)
    tolerance = 1e-9
    below = (means < -tolerance).mean(axis=0)
    level = (np.abs(means) <= tolerance).mean(axis=0)
    half = 0.5 / resamples
    bias = ndtri(np.clip(below + level / 2, half, 1 - half))
    bounds = np.empty((2, deviations.shape[1]))
    for row, tail in enumerate(((1 - LEVEL) / 2, (1 + LEVEL) / 2)):
        z = bias + ndtri(tail)
        bounds[row] = _column_quantiles(means, ndtr(bias + z / (1 - acceleration * z)))
    return bounds


def _column_quantiles(ordered: F64, shares: F64) -> F64:
    """One quantile for each column of ordered values (B, K), linear between neighbours."""
    place = shares * (len(ordered) - 1)
    lower = np.floor(place).astype(int)
    upper = np.minimum(lower + 1, len(ordered) - 1)
    columns = np.arange(ordered.shape[1])
    low, high = ordered[lower, columns], ordered[upper, columns]
    return np.asarray(low + (place - lower) * (high - low))


def estimate(values: F64) -> Estimate:
    """Mean with its 95 % BCa interval, median and standard deviation of values (n,), without NaN."""
    x = np.asarray(values, dtype=float)
    x = x[np.isfinite(x)]
    if not len(x):
        return Estimate(0, *[math.nan] * 5)
    low, high = bca_intervals(x[:, None])
    std = float(x.std(ddof=1)) if len(x) > 1 else math.nan
    return Estimate(len(x), float(x.mean()), float(low[0]), float(high[0]), float(np.median(x)), std)


def ratio_of_means(above: F64, below: F64) -> Estimate:
    """mean(above) / mean(below) of pairs (n,), with its 95 % percentile bootstrap interval over the pairs.

    Median and standard deviation are NaN, for a pair has no ratio where its second value is 0.
    """
    means = resampled_means(np.column_stack([above, below]))
    low, high = np.quantile(means[:, 0] / means[:, 1], ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    low, high = (float(low), float(high)) if len(above) > 1 else (math.nan, math.nan)
    return Estimate(len(above), float(np.mean(above) / np.mean(below)), low, high, math.nan, math.nan)


def pointwise_band(curves: F64) -> tuple[F64, F64]:
    """Pointwise 95 % percentile bootstrap band of the mean of curves (n, T): (T,) and (T,); NaN for n < 2."""
    n, length = curves.shape
    if n < 2:
        return np.full(length, np.nan), np.full(length, np.nan)
    means = np.sort(resampled_means(curves), axis=0)
    low, high = (_column_quantiles(means, np.full(length, q)) for q in ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return low, high


def paired_tests(differences: F64) -> list[PairedTest]:
    """One test for each column of differences (n, K) without gaps."""
    differences = np.asarray(differences, dtype=float)
    n = len(differences)
    low, high = bca_intervals(differences)
    tests = []
    for k, column in enumerate(differences.T):
        p, correlation = signed_rank_test(column)
        mean = float(column.mean()) if n else math.nan
        std = float(column.std(ddof=1)) if n > 1 else 0.0
        tests.append(
            PairedTest(
                n_pairs=n,
                n_zero=int((_without_noise(column) == 0).sum()),
                mean=mean,
                low=float(low[k]),
                high=float(high[k]),
                p=p,
                rank_biserial=correlation,
                cohens_dz=mean / std if std > 1e-9 * abs(mean) else math.nan,
            )
        )
    return tests


def signed_rank_test(differences: F64) -> tuple[float, float]:
    """Wilcoxon's two-sided p and the matched-pairs rank-biserial correlation of differences (n,).

    Zeros are left out, and ties share their mean rank; both are told from ten digits. Up to ``EXACT_UP_TO``
    pairs p is exact, also with ties: the share of all 2^n equally likely signs whose rank sum is at least
    this far from the middle. Beyond, it is the normal approximation with the variance corrected for ties.
    Without any difference p is 1 and the correlation 0.
    """
    from scipy.stats import rankdata  # imported late: it takes half a second

    rounded = _without_noise(differences)
    kept = rounded[rounded != 0]
    n = len(kept)
    if not n:
        return 1.0, 0.0
    ranks = rankdata(np.abs(kept))
    positive, total = float(ranks[kept > 0].sum()), n * (n + 1) / 2
    correlation = 2 * positive / total - 1
    if n > EXACT_UP_TO:
        z = (positive - total / 2) / math.sqrt((ranks**2).sum() / 4)
        return float(2 * ndtr(-abs(z))), correlation
    doubled = np.rint(2 * ranks).astype(int)
    smaller = round(2 * min(positive, total - positive))
    if smaller == round(total):
        return 1.0, correlation
    return min(1.0, 2 * float(_rank_sum_chances(doubled)[: smaller + 1].sum())), correlation


def _without_noise(differences: F64) -> F64:
    """In units of the largest one's tenth digit, rounded: as floats, 142.3 - 142.2 is not 141.9 - 141.8."""
    largest = float(np.abs(differences).max(initial=0.0))
    if not largest:
        return differences
    return np.asarray(np.rint(differences / 10.0 ** (math.floor(math.log10(largest)) - 9)))


def _rank_sum_chances(ranks: NDArray[np.int64]) -> F64:
    """Probability of each sum of ranks, the index, where each rank counts with probability 1/2."""
    chances = np.zeros(int(ranks.sum()) + 1)
    chances[0] = 1.0
    reached = 0
    for rank in ranks:
        with_it = chances[: reached + 1].copy()
        chances[rank : reached + rank + 1] += with_it
        reached += rank
        chances[: reached + 1] /= 2
    return chances


def pairs_needed(family: int) -> int:
    """The fewest pairs n whose smallest possible p, 2^(1 - n), is below 5 % after Holm's correction."""
    return math.ceil(1 + math.log2(max(family, 1) / SIGNIFICANCE))


def pairs_to_tell(test: PairedTest, family: int) -> int:
    """About how many pairs would distinguish a difference like this one from chance in a family of tests.

    That is at least ``pairs_needed``. It uses the normal approximation of the signed-rank test, whose z grows
    with the square root of the number of pairs, and Bonferroni's correction.
    """
    least = pairs_needed(family)
    z_found = -float(ndtri(test.p / 2))
    if test.n_pairs < least or z_found <= 0:
        return max(least, test.n_pairs + 1)
    z_wanted = -float(ndtri(SIGNIFICANCE / (2 * family)))
    return max(test.n_pairs + 1, math.ceil(test.n_pairs * (z_wanted / z_found) ** 2))


def holm(p: F64) -> F64:
    """Holm's step-down correction of p (m,) for the family of all m. NaN stay NaN and do not count."""
    p = np.asarray(p, dtype=float)
    corrected = np.full(p.shape, np.nan)
    tested = np.flatnonzero(np.isfinite(p))
    order = tested[np.argsort(p[tested], kind="stable")]
    steps = p[order] * (len(order) - np.arange(len(order)))
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return corrected


def pareto_front(costs: F64) -> NDArray[np.bool_]:
    """(K,) the rows of costs (K, M), all to minimise, that no other row dominates.

    A row dominates another when it is nowhere larger and somewhere smaller. Rows with NaN are not on the
    front and dominate none.
    """
    costs = _rounded_means(np.asarray(costs, dtype=float))
    known = np.flatnonzero(np.isfinite(costs).all(axis=1))
    front = np.zeros(len(costs), dtype=bool)
    front[known] = ~_dominated(costs[known][None])[0]
    return front


def front_shares(costs: F64) -> F64:
    """(K,) shares of the resamplings of n seeds with each row on the front. Costs are (n, K, M)."""
    n, members, objectives = costs.shape
    if n < 2:
        return np.full(members, np.nan)
    means = _rounded_means(resampled_means(costs.reshape(n, -1)).reshape(-1, members, objectives))
    dominated = [_dominated(means[block]) for block in _row_blocks(len(means), members**2)]
    return np.asarray(1.0 - np.concatenate(dominated).mean(axis=0))


def _rounded_means(means: F64) -> F64:
    """Equal ones stay equal whatever the order of a sum."""
    return np.round(means, 9)


def _dominated(costs: F64) -> NDArray[np.bool_]:
    """(B, K) the members that another one dominates, for costs (B, K, M) of each sample."""
    shape = (len(costs), costs.shape[1], costs.shape[1])
    no_worse, better = np.ones(shape, dtype=bool), np.zeros(shape, dtype=bool)
    for objective in range(costs.shape[2]):
        a, b = costs[:, :, None, objective], costs[:, None, :, objective]
        no_worse &= a <= b
        better |= a < b
    return np.asarray((no_worse & better).any(axis=1))


def t_quantile(n: int) -> float:
    """Two-sided 95 % quantile of Student's t for a mean of n values."""
    return float(stdtrit(n - 1, 0.975))


def mean_ci95(values: Sequence[float]) -> MeanCI:
    """Mean and its 95 % confidence interval by Student's t, infinite with fewer than 2 values."""
    x = np.asarray(values, dtype=float)
    mean = float(x.mean()) if len(x) else math.nan
    if len(x) < 2:
        return mean, (-math.inf, math.inf)
    half = t_quantile(len(x)) * float(x.std(ddof=1)) / math.sqrt(len(x))
    return mean, (mean - half, mean + half)
