"""When does looking twice pay? The cheapest strategy by look-alikes a hectare and the price of a false alarm.

The cost of a mission is its time, plus the price of every false positive, plus that of every target missed.
The belief strategy is told the price, and confirms without a closer look where a mistake costs less than that
would; the others cannot use it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from skysweep.experiments.benchmark.run import Flown
from skysweep.experiments.benchmark.suite import (
    OURS,
    SCAN_ONLY,
    TUNED,
    BreakEven,
    Suite,
    look_alike_scenarios,
)
from skysweep.experiments.matrix import Matrix
from skysweep.results.reporting.statistics import Estimate, estimate, resampled_means
from skysweep.results.summary import Summary
from skysweep.scenarios.files import change_scenario
from skysweep.types import F64

BELIEF = "belief"
COMPARED = tuple(c for c in OURS if c.is_bound or c.name in (SCAN_ONLY, TUNED, BELIEF))
_CLOSER_LOOK_S = 20.0
_SURE = 0.6, 0.99  # least and most, as a probability


@dataclass(frozen=True, slots=True)
class Cell:
    """One number of look-alikes at one price of a false alarm."""

    per_ha: float
    price_s: float
    costs_s: Mapping[str, Estimate]
    saved_s: Estimate  # by the cheapest, against the next one, seed by seed

    @property
    def cheapest(self) -> str:
        """The one with the least mean cost."""
        return min(self.costs_s, key=lambda name: self.costs_s[name].mean)

    @property
    def is_certain(self) -> bool:
        """Whether the interval of what it saves excludes zero."""
        return self.saved_s.low > 0.0


@dataclass(frozen=True, slots=True)
class BreakEvens:
    """The answer: cells by look-alikes, then by price; and the price from which each beats scan-only."""

    per_ha: tuple[float, ...]
    prices_s: tuple[float, ...]
    cells: tuple[Cell, ...]
    from_s: Mapping[str, tuple[Estimate, ...]]  # by contender, for each number of look-alikes; inf: at none


def break_even_matrices(suite: Suite, added: Sequence[str], seeds: range) -> dict[str, Matrix]:
    """The missions by contender; those of belief by the price that it is told."""
    spec = suite.break_even
    told = {
        price: {
            "alarm_cost_s": price,
            "missed_cost_s": spec.missed_cost_s,
            "confirm_probability": round(float(np.clip(1.0 - _CLOSER_LOOK_S / price, *_SURE)), 3),
        }
        for price in spec.prices_s
    }
    changes: dict[str, dict[str, Any]] = {
        SCAN_ONLY: {"search.strategy": "scan-only"},
        TUNED: {"search.strategy": "scan-check", **suite.tuned[spec.tuned]},
        **{name: {"search.strategy": name} for name in added},
        **{
            belief_at(price): {"search.strategy": "belief", "search.parameters": parameters}
            for price, parameters in told.items()
        },
    }
    bases = list(look_alike_scenarios(suite))
    return {
        name: Matrix.of(
            ((label_of(count), change_scenario(base, change)) for count, base in bases),
            seeds,
            suite.sensor,
            (),
        )
        for name, change in changes.items()
    }


def label_of(count: int) -> str:
    """Of the missions with so many look-alikes."""
    return f"look-alikes-{count}"


def belief_at(price_s: float) -> str:
    """The name of belief that is told this price."""
    return f"{BELIEF} at {price_s:g} s"


def break_evens(suite: Suite, flown: Flown, added: Sequence[str]) -> BreakEvens:
    """The costs of all contenders in all cells, and where they break even with scan-only."""
    spec = suite.break_even
    names = [SCAN_ONLY, TUNED, *added, BELIEF]
    per_ha, cells = [], []
    gains: dict[str, list[F64]] = {name: [] for name in names[1:]}
    for count in spec.counts:
        missions = flown[label_of(count)]
        per_ha.append(round(count / (missions[SCAN_ONLY][0]["area_m2"] / 1e4), 2))
        costs = [
            {name: _costs_s(missions[belief_at(p) if name == BELIEF else name], p, spec) for name in names}
            for p in spec.prices_s
        ]
        cells += [_cell(per_ha[-1], p, cost) for p, cost in zip(spec.prices_s, costs, strict=True)]
        for name in gains:
            gains[name].append(np.column_stack([cost[SCAN_ONLY] - cost[name] for cost in costs]))
    from_s = {name: tuple(price_from(spec.prices_s, g) for g in found) for name, found in gains.items()}
    return BreakEvens(tuple(per_ha), tuple(spec.prices_s), tuple(cells), from_s)


def _costs_s(missions: Sequence[Summary], price_s: float, spec: BreakEven) -> F64:
    return np.array(
        [
            m["mission_time_s"]
            + price_s * (m["false_positives"] or 0)
            + spec.missed_cost_s * ((m["n_targets"] or 0) - m["n_confirmed"])
            for m in missions
        ]
    )


def _cell(per_ha: float, price_s: float, costs_s: Mapping[str, F64]) -> Cell:
    best, second = sorted(costs_s, key=lambda name: float(costs_s[name].mean()))[:2]
    estimates = {name: estimate(values) for name, values in costs_s.items()}
    return Cell(per_ha, price_s, estimates, estimate(costs_s[second] - costs_s[best]))


def price_from(prices_s: Sequence[float], gains_s: F64) -> Estimate:
    """The price from which a contender saves cost, by its gains (n, prices) over scan-only.

    Between two prices it is interpolated by the logarithm. The interval is of the 95 % percentile bootstrap.
    Infinity: at none of the prices; the lowest price: at all of them.
    """
    logs = np.log(prices_s)
    low, high = np.quantile(
        [_crossing(logs, g) for g in resampled_means(gains_s)], (0.025, 0.975), method="inverted_cdf"
    )
    mean, low, high = np.exp([_crossing(logs, gains_s.mean(axis=0)), low, high]).round(6).tolist()
    return Estimate(len(gains_s), mean, low, high, math.nan, math.nan)


def _crossing(logs: F64, gains_s: F64) -> float:
    """Where the gains turn positive, and stay so; inf where they end below zero."""
    losing = np.flatnonzero(gains_s <= 0.0)
    if not len(losing):
        return float(logs[0])
    k = int(losing[-1])
    if k == len(logs) - 1:
        return math.inf
    share = gains_s[k] / (gains_s[k] - gains_s[k + 1])
    return float(logs[k] + share * (logs[k + 1] - logs[k]))
