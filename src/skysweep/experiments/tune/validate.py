"""After the search: the best candidates on fresh seeds, how they compare, and when n_c and d_c matter."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np

from skysweep.experiments.flying import fly_job, fly_missing
from skysweep.experiments.matrix import RESULTS_VERSION, Matrix, digest_of
from skysweep.experiments.tune.race import Outcomes, RaceRules, best_first, outcome_of, recall_floor
from skysweep.experiments.tune.run import PAPER_N_C, Problem
from skysweep.experiments.tune.space import D_C, N_C, nearby_distances_m
from skysweep.experiments.tune.study import Trial
from skysweep.results.reporting.statistics import (
    SIGNIFICANCE,
    Estimate,
    PairedTest,
    estimate,
    holm,
    paired_tests,
    resampled_means,
)
from skysweep.results.reporting.symbols import number
from skysweep.scenarios.files import change_scenario
from skysweep.scenarios.model import Scenario
from skysweep.types import F64

FIRST_VALIDATION_SEED = 1_000_000  # the search never uses seeds this high
FINALISTS = 4
_TIME_ALONE = RaceRules(min_recall=None, false_positive_cost_s=0.0)
MATTERS_N_C = (1.0, 2.0, 3.0, 5.0, 8.0, math.inf)


@dataclass(frozen=True)
class Contender:
    """A way to fly the problem's scenarios, with ``changes`` (dotted field -> value) to each."""

    label: str
    changes: dict[str, float]


@dataclass(frozen=True, slots=True)
class Paired:
    """Differences over common seeds, and the share of bootstrap resamples whose mean is below zero."""

    test: PairedTest
    probability_below: float

    @property
    def is_clear(self) -> bool:
        """Zero lies outside the 95 % interval of the mean difference."""
        return self.test.low > 0.0 or self.test.high < 0.0


@dataclass(frozen=True)
class Standing:
    """A candidate on the validation seeds, compared with the recommended one."""

    candidate: Contender
    flown: Outcomes
    mission_time_s: Estimate
    recall: Estimate
    false_positives: Estimate
    cost_s: Estimate
    feasible: bool
    cost_over_best_s: Paired | None  # None for the recommended one


@dataclass(frozen=True)
class Cell:
    """One n_c and d_c, with all else as in the scenario. ``d_c_m`` is None where it makes no difference."""

    n_c: float
    d_c_m: float | None
    flown: Outcomes
    mission_time_s: Estimate
    time_over_best_s: Paired | None  # None: the fastest
    p_corrected: float  # of that difference, Holm's over all cells; 1 for the fastest
    is_whole: bool  # every search was finished, and recall is as good as the best: it may be the fastest

    @property
    def as_good(self) -> bool:
        """Not distinguishable from the fastest."""
        pair = self.time_over_best_s
        return pair is None or (self.p_corrected >= SIGNIFICANCE and not pair.is_clear)

    @property
    def undecided(self) -> bool:
        """Its interval excludes zero, but the seeds are too few for the corrected test."""
        pair = self.time_over_best_s
        return pair is not None and self.p_corrected >= SIGNIFICANCE and pair.is_clear


@dataclass(frozen=True)
class Effect:
    """The cost of the other parameter where ``held`` (n_c or d_c) is ``value``: each choice over the best."""

    held: str
    value: float
    best: Cell
    others: tuple[tuple[Cell, PairedTest, float], ...]  # time over the best; p, corrected over all effects

    @property
    def matters(self) -> bool:
        return min(p for *_, p in self.others) < SIGNIFICANCE


def candidates_of(problem: Problem, trials: Sequence[Trial]) -> list[Contender]:
    """The best trials that flew all seeds, the scenario's own values, and the paper's n_c.

    Of trials that flew the same missions with other values, as with n_c = 1 and any d_c, the first counts.
    """
    many = len(problem.scenarios)
    finished = [t for t in trials if t.dropped is None and t.same_as is None]
    order = best_first([t.flown(many) for t in finished], problem.rules)
    best: dict[str, Trial] = {}
    for k in order:
        best.setdefault(str(finished[k].missions), finished[k])
    finalists = [*best.values()][:FINALISTS]
    candidates = [Contender(f"trial {trial.number}", trial.values) for trial in finalists]
    candidates.append(Contender("own values", {}))
    if any(parameter.field == N_C for parameter in problem.space):
        candidates += [Contender(f"own, n_c = {number(n_c)}", {N_C: n_c}) for n_c in PAPER_N_C]
    named: dict[str, Contender] = {}
    for candidate in candidates:
        changed = [change_scenario(s, candidate.changes) for s in problem.scenarios]
        key = "".join(digest_of(scenario, "statistical", RESULTS_VERSION) for scenario in changed)
        if key in named:
            known = named[key]
            candidate = Contender(f"{known.label} ({candidate.label.removeprefix('own, ')})", known.changes)
        named[key] = candidate
    return list(named.values())


def matters_candidates(scenario: Scenario) -> list[Contender]:
    """n_c and d_c around the scenario's own."""
    cells = [
        (n_c, d_c_m)
        for n_c in sorted({*MATTERS_N_C, scenario.search.n_c})
        for d_c_m in nearby_distances_m(scenario)
        if math.isinf(d_c_m) or not _checks_at_once(n_c, scenario)
    ]
    return [Contender(f"n_c = {number(n)}, d_c = {number(d)}", {N_C: n, D_C: d}) for n, d in cells]


def fly_candidates(
    scenarios: Sequence[Scenario],
    candidates: Sequence[Contender],
    seeds: int,
    folder: Path,
    workers: int | None = None,
    on_mission: Callable[[int, int], None] = lambda _done, _of: None,
) -> list[Outcomes]:
    """Fly each candidate on the same fresh seeds, except for missions that ``folder`` already holds.

    ``on_mission`` is called with missions done and total.
    """
    fields = sorted({field for candidate in candidates for field in candidate.changes})
    fresh = range(FIRST_VALIDATION_SEED, FIRST_VALIDATION_SEED + seeds)
    changed = [[(s.name, change_scenario(s, c.changes)) for s in scenarios] for c in candidates]
    matrices = [Matrix.of(labelled, fresh, "statistical", fields) for labelled in changed]
    wanted, done = len({job.config_hash for matrix in matrices for job in matrix.jobs()}), count(1)
    on_mission(0, wanted)
    flown = fly_missing(matrices, fly_job, folder, workers, lambda *_: on_mission(next(done), wanted))
    return [
        Outcomes.of([outcome_of(flown[job.config_hash]) for job in matrix.jobs()], len(scenarios))
        for matrix in matrices
    ]


def standings(candidates: Sequence[Contender], flown: Sequence[Outcomes], rules: RaceRules) -> list[Standing]:
    """All candidates, from the recommended to the worst."""
    order = best_first(flown, rules)
    best_cost_s = rules.cost_s(flown[order[0]])
    return [
        Standing(
            candidate=candidates[k],
            flown=flown[k],
            mission_time_s=estimate(flown[k].per_seed("mission_time_s")),
            recall=estimate(flown[k].per_seed("recall")),
            false_positives=estimate(flown[k].per_seed("false_positives")),
            cost_s=estimate(rules.cost_s(flown[k])),
            feasible=rules.feasible(flown[k]),
            cost_over_best_s=paired(rules.cost_s(flown[k]) - best_cost_s) if k != order[0] else None,
        )
        for k in order
    ]


def matters_table(
    candidates: Sequence[Contender], flown: Sequence[Outcomes], scenario: Scenario
) -> list[Cell]:
    """Mission time of each n_c and d_c against the fastest, seed by seed.

    The fastest is chosen among those whose recall is within ``RECALL_SLACK`` of the best. The test is
    Wilcoxon's with Holm's correction for comparing all cells with one.
    """
    fastest = best_first(flown, _TIME_ALONE)[0]
    floor = recall_floor(flown)
    best_s = flown[fastest].per_seed("mission_time_s")
    pairs = [paired(mine.per_seed("mission_time_s") - best_s) for mine in flown]
    others = [k for k in range(len(flown)) if k != fastest]
    p = dict(zip(others, holm(np.array([pairs[k].test.p for k in others])), strict=True))
    return [
        Cell(
            n_c=candidate.changes[N_C],
            d_c_m=None if _checks_at_once(candidate.changes[N_C], scenario) else candidate.changes[D_C],
            flown=mine,
            mission_time_s=estimate(mine.per_seed("mission_time_s")),
            time_over_best_s=pairs[k] if k != fastest else None,
            p_corrected=float(p.get(k, 1.0)),
            is_whole=mine.unfinished == 0.0 and float(mine.recalls.min()) >= floor,
        )
        for k, (candidate, mine) in enumerate(zip(candidates, flown, strict=True))
    ]


def limits(cells: Sequence[Cell]) -> list[float]:
    """All n_c, ascending."""
    return sorted({cell.n_c for cell in cells})


def distances_m(cells: Sequence[Cell]) -> list[float]:
    """All d_c that make a difference, ascending."""
    return sorted({cell.d_c_m for cell in cells if cell.d_c_m is not None})


def effects(cells: Sequence[Cell]) -> list[Effect]:
    """The effect of n_c at each d_c, and of d_c at each n_c, on mission time."""
    lines = [("d_c", d, [c for c in cells if c.d_c_m in (d, None)]) for d in distances_m(cells)]
    lines += [("n_c", n, [c for c in cells if c.n_c == n]) for n in limits(cells)]
    splits = []
    for held, value, line in lines:
        best, *others = (line[k] for k in best_first([cell.flown for cell in line], _TIME_ALONE))
        if others:
            splits.append((held, value, best, others))
    differences = [
        other.flown.per_seed("mission_time_s") - best.flown.per_seed("mission_time_s")
        for *_, best, others in splits
        for other in others
    ]
    tests = paired_tests(np.array(differences).T)
    found = zip(tests, holm(np.array([test.p for test in tests])).tolist(), strict=True)
    return [
        Effect(held, value, best, tuple((cell, *next(found)) for cell in others))
        for held, value, best, others in splits
    ]


def paired(difference: F64) -> Paired:
    """Statistics of (seeds,) differences. Resamples whose mean is exactly zero count by half."""
    means = resampled_means(difference[:, None])[:, 0]
    below = float((means < -1e-9).mean() + 0.5 * (np.abs(means) <= 1e-9).mean())
    return Paired(paired_tests(difference[:, None])[0], below)


def _checks_at_once(n_c: float, scenario: Scenario) -> bool:
    """With n_c = 1 Algorithm 1 never waits, so that d_c makes no difference."""
    return n_c == 1 and scenario.search.strategy == "scan-check"
