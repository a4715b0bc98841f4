"""The cost of missions, and when a candidate is clearly beaten: pure functions of outcomes.

All candidates fly the same seeds in the same order (common random numbers). They are compared seed by seed,
so differences between the seeds drop out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from skysweep.errors import UserError
from skysweep.results.reporting.statistics import pareto_front
from skysweep.types import F64

FIRST_BLOCK = 4  # seeds before the first judgement
DROP_CONFIDENCE = 0.99  # one-sided, of "clearly", so that bad luck rarely drops a good candidate
RECALL_SLACK = 0.01  # recall this close to the best counts as equal, where recall comes first
_KEYS = (
    *("mission_time_s", "recall", "false_positives", "false_scans"),
    *("n_targets", "n_confirmed", "completed", "energy_wh"),
)
Outcome = dict[str, float]  # of one mission, the quantities of ``_KEYS``


def outcome_of(summary: Mapping[str, Any]) -> Outcome:
    """The part of a mission's summary that tuning needs. Raises UserError where there were no targets."""
    if summary["recall"] is None:
        raise UserError(
            f"{summary['scenario']}: there are no targets, so no search can be tuned; "
            "write targets or generators"
        )
    return {key: float(summary[key]) for key in _KEYS}


@dataclass(frozen=True)
class Outcomes:
    """The missions of one candidate: ``values`` (seeds, scenarios, quantities in the order of ``_KEYS``)."""

    values: F64

    @staticmethod
    def of(outcomes: Iterable[Outcome], scenarios: int) -> Outcomes:
        """From outcomes ordered by seed, then by scenario."""
        rows = [[outcome[key] for key in _KEYS] for outcome in outcomes]
        return Outcomes(np.array(rows, dtype=float).reshape(-1, scenarios, len(_KEYS)))

    @property
    def seeds(self) -> int:
        return len(self.values)

    def first(self, seeds: int) -> Outcomes:
        return Outcomes(self.values[:seeds])

    def per_seed(self, key: str) -> F64:
        """(seeds,) means of a quantity over the scenarios."""
        return np.asarray(self.values[:, :, _KEYS.index(key)].mean(axis=1))

    def mean(self, key: str) -> float:
        return float(self.per_seed(key).mean())

    @property
    def recalls(self) -> F64:
        """(scenarios,) mean recalls."""
        return np.asarray(self.values[:, :, _KEYS.index("recall")].mean(axis=0))

    @property
    def unfinished(self) -> float:
        """Share of missions that ended before the search was finished, so that their times are too short."""
        return 1.0 - self.mean("completed")

    def recall_bounds_above(self) -> F64:
        """(scenarios,) upper bounds of the true recall: Clopper-Pearson over all targets."""
        totals = dict(zip(_KEYS, self.values.sum(axis=0).T, strict=True))
        targets, found = totals["n_targets"], totals["n_confirmed"]
        bound = stats.beta.ppf(DROP_CONFIDENCE, found + 1, np.maximum(targets - found, 1e-9))
        return np.where(found < targets, bound, 1.0)


@dataclass(frozen=True, slots=True)
class RaceRules:
    """Costs and constraints. ``min_recall`` None makes recall an objective instead of a constraint."""

    min_recall: float | None = 0.95
    false_positive_cost_s: float = 60.0

    def cost_s(self, flown: Outcomes) -> F64:
        """(seeds,) mission time plus ``false_positive_cost_s`` for each false positive."""
        false_positives = flown.per_seed("false_positives")
        return flown.per_seed("mission_time_s") + self.false_positive_cost_s * false_positives

    def objectives(self, flown: Outcomes) -> tuple[float, ...]:
        """To minimise: mission time in s, false positives, and 1 - recall where it is an objective."""
        values = (flown.mean("mission_time_s"), flown.mean("false_positives"))
        return values if self.min_recall is not None else (*values, 1.0 - flown.mean("recall"))

    def violations(self, flown: Outcomes) -> tuple[float, ...]:
        """Positive where a constraint is broken: the recall of each scenario, and unfinished missions."""
        if self.min_recall is None:
            return (flown.unfinished,)
        return (*(self.min_recall - flown.recalls).tolist(), flown.unfinished)

    def feasible(self, flown: Outcomes) -> bool:
        return all(violation <= 1e-12 for violation in self.violations(flown))


def blocks(seeds: int) -> list[int]:
    """The numbers of seeds after which a candidate is judged: 4, 8, 16 ... and all."""
    ends = []
    end = FIRST_BLOCK
    while end < seeds:
        ends.append(end)
        end *= 2
    return [*ends, seeds]


def why_dropped(flown: Outcomes, incumbents: Sequence[Outcomes], rules: RaceRules) -> str | None:
    """Why a candidate is clearly not the best; None where it deserves more seeds."""
    if flown.unfinished > 0:
        return "missions ended before the search was finished"
    if rules.min_recall is not None and (flown.recall_bounds_above() < rules.min_recall).any():
        return f"recall {flown.recalls.min():.2f} is clearly below {rules.min_recall:g}"
    for incumbent in incumbents:
        if rules.min_recall is None and flown.mean("recall") > incumbent.first(flown.seeds).mean("recall"):
            continue
        worse_s = clearly_worse_by_s(rules.cost_s(flown), rules.cost_s(incumbent))
        if worse_s > 0:
            return f"clearly worse than the best so far, by at least {worse_s:.0f} s"
    return None


def clearly_worse_by_s(cost_s: F64, best_s: F64) -> float:
    """Lower bound of the mean difference over common seeds (Student's t, one-sided)."""
    n = min(len(cost_s), len(best_s))
    if n < 2:
        return -math.inf
    difference = cost_s[:n] - best_s[:n]
    spread = float(difference.std(ddof=1)) / math.sqrt(n)
    return float(difference.mean() - stats.t.ppf(DROP_CONFIDENCE, n - 1) * spread)


def incumbents(finished: Sequence[Outcomes], rules: RaceRules) -> list[Outcomes]:
    """The candidates that a new one has to beat, among those that flew all seeds.

    That is the cheapest that keeps the constraints. With recall as an objective, it is the Pareto front of
    cost and recall.
    """
    feasible = [flown for flown in finished if rules.feasible(flown)]
    if not feasible:
        return []
    if rules.min_recall is not None:
        return [min(feasible, key=lambda flown: float(rules.cost_s(flown).mean()))]
    scores = np.array([(rules.cost_s(flown).mean(), -flown.mean("recall")) for flown in feasible])
    return [flown for flown, best in zip(feasible, pareto_front(scores), strict=True) if best]


def recall_floor(candidates: Sequence[Outcomes]) -> float:
    """The least recall that is as good as the best of those that finished every search."""
    finished = [flown for flown in candidates if flown.unfinished == 0.0] or candidates
    return max(float(flown.recalls.min()) for flown in finished) - RECALL_SLACK


def least_recall(candidates: Sequence[Outcomes], rules: RaceRules) -> float:
    """With which recall a candidate keeps the constraint, or where none does, is as good as the best."""
    floor = recall_floor(candidates)
    if rules.min_recall is None:
        return floor
    return rules.min_recall if any(map(rules.feasible, candidates)) else min(floor, rules.min_recall)


def best_first(candidates: Sequence[Outcomes], rules: RaceRules) -> list[int]:
    """Indices of candidates from the best to the worst.

    The cheapest that keep the constraints come first. Where recall is no constraint, or no candidate keeps
    it, the constraint is a recall within ``RECALL_SLACK`` of the best.
    """
    if not candidates:
        return []
    floor = least_recall(candidates, rules)

    def rank(index: int) -> tuple[float, ...]:
        flown = candidates[index]
        short = max(0.0, floor - float(flown.recalls.min()) - 1e-12)
        return (flown.unfinished, short, float(rules.cost_s(flown).mean()), index)

    return sorted(range(len(candidates)), key=rank)
