"""The analysis of a sweep: intervals, paired differences, the Pareto front, effects of parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations

import numpy as np

from skysweep.experiments.sweep.missions import (
    COMPARED,
    FALSE_POSITIVES,
    METRICS,
    MISSION_TIME,
    RECALL,
    Configuration,
    Flown,
    Metric,
    Value,
    in_order,
)
from skysweep.results.reporting.statistics import (
    SIGNIFICANCE,
    Estimate,
    PairedTest,
    estimate,
    front_shares,
    holm,
    paired_tests,
    pairs_needed,
    pairs_to_tell,
    pareto_front,
)
from skysweep.results.reporting.wording import counted
from skysweep.types import F64

MIN_RECALL = 0.95
MOST_LOST = 0.05  # greatest share of failed and unfinished missions of the best configuration
MOST_CURVES = 6
FEW_SEEDS = 20  # with fewer, bootstrap intervals are clearly too narrow (see docs/statistics.md)
_ROUNDING = 1e-9  # a mean may miss a round number by its last bits
_OBJECTIVES = (MISSION_TIME, RECALL, FALSE_POSITIVES)


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One configuration in one scenario, with its statistics."""

    flown: Flown
    estimates: dict[str, Estimate]  # by metric, over all missions without an error
    on_front: bool  # of mean mission time, recall and false positives
    front_share: float  # of the resamplings of the seeds that leave it there; NaN where unknown

    @property
    def label(self) -> str:
        return self.flown.label

    def mean(self, metric: Metric) -> float:
        return self.estimates[metric.key].mean if metric.key in self.estimates else math.nan


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two configurations of one scenario, a - b over common seeds."""

    scenario: str
    metric: Metric
    a: int
    b: int
    test: PairedTest
    p_holm: float  # NaN without common seeds
    family: int  # tests that p_holm is corrected for

    @property
    def distinguishable(self) -> bool:
        """Whether the corrected p is below 5 % and the interval excludes zero."""
        return self.p_holm < SIGNIFICANCE and (self.test.low > 0 or self.test.high < 0)

    @property
    def too_few(self) -> bool:
        """Whether no outcome of so few pairs can be distinguished from chance."""
        return self.test.n_pairs < pairs_needed(self.family)

    @property
    def undecided(self) -> bool:
        """Whether more pairs might decide: there are too few for any outcome, or for the correction."""
        return not self.distinguishable and (self.too_few or self.test.low > 0 or self.test.high < 0)


@dataclass(frozen=True, slots=True, eq=False)
class Analysis:
    """One scenario of a sweep.

    ``tiers`` are the members whose missions finished, by ``best_rule``: those with the recall and false
    positives of the best, those with more false positives, and those with less recall, each with the fastest
    first. Where none has the required recall, ``reached`` is false and one tier has all by their recall.
    """

    scenario: str
    members: tuple[Member, ...]
    comparisons: dict[tuple[str, int, int], Comparison]  # metric, a < b
    tiers: tuple[tuple[int, ...], ...]
    reached: bool

    @property
    def ranking(self) -> tuple[int, ...]:
        return tuple(chain.from_iterable(self.tiers))

    def compare(self, metric: Metric, a: int, b: int) -> Comparison:
        if a < b:
            return self.comparisons[metric.key, a, b]
        found = self.comparisons[metric.key, b, a]
        test, signed = found.test, ("mean", "rank_biserial", "cohens_dz")
        turned = {name: 0.0 - getattr(test, name) for name in signed}
        turned |= {"low": 0.0 - test.high, "high": 0.0 - test.low}
        return replace(found, a=a, b=b, test=replace(test, **turned))

    @property
    def metrics(self) -> list[Metric]:
        """The metrics of at least one configuration."""
        return [m for m in METRICS if any(math.isfinite(member.mean(m)) for member in self.members)]


@dataclass(frozen=True, slots=True)
class Curve:
    """Metrics over the values of one parameter."""

    label: str
    values: tuple[Value, ...]
    estimates: dict[str, tuple[Estimate, ...]]  # by metric, one per value
    averaged_over: int  # configurations at each value


def analyse(groups: Mapping[str, Sequence[Flown]], min_recall: float = MIN_RECALL) -> list[Analysis]:
    """The analysis of each scenario.

    In Holm's correction, all pairs of configurations of all scenarios are one family for each metric.
    """
    pairs = []
    for metric in COMPARED:
        family = [c for scenario, flown in groups.items() for c in _compare_all(scenario, metric, flown)]
        p = np.array([c.test.p if c.test.n_pairs else math.nan for c in family])
        size = int(np.isfinite(p).sum())
        pairs += [replace(c, p_holm=float(q), family=size) for c, q in zip(family, holm(p), strict=True)]
    analyses = []
    for scenario, flown in groups.items():
        members = _members(flown)
        own = {(c.metric.key, c.a, c.b): c for c in pairs if c.scenario == scenario}
        analyses.append(Analysis(scenario, members, own, *_tiers(members, own, min_recall)))
    return analyses


def best_rule(min_recall: float = MIN_RECALL) -> str:
    """The rule that chooses the best."""
    return (
        f"The best: of the configurations with a mean recall of at least {min_recall:g} and at most "
        f"{MOST_LOST:.0%} of their missions failed or unfinished, those whose recall is not distinguishable "
        "from the highest; of these, those whose false positives are not distinguishable from the fewest; of "
        "these, the fastest."
    )


def _members(flown: Sequence[Flown]) -> tuple[Member, ...]:
    estimates = [{key: estimate(values) for key, values in f.values.items()} for f in flown]
    has_targets = any(e[RECALL.key].n for e in estimates)
    objectives = [m for m in _OBJECTIVES if m is not RECALL or has_targets]
    means = np.array([[_cost(m, e[m.key].mean) for m in objectives] for e in estimates])
    ends = [_lost_share(f) <= MOST_LOST for f in flown]
    front = pareto_front(np.where(np.array(ends)[:, None], means, math.nan))
    shares = np.full(len(flown), math.nan)
    known = [k for k, f in enumerate(flown) if f.n and ends[k]]
    common = _common_seeds([flown[k] for k in known])
    if known and common:
        costs = np.array([[_cost(m, _at(flown[k], m, common)) for m in objectives] for k in known])
        costs = np.moveaxis(costs, 2, 0)
        if np.isfinite(costs).all():
            shares[known] = front_shares(costs)
    return tuple(
        Member(f, e, bool(on), float(share))
        for f, e, on, share in zip(flown, estimates, front, shares, strict=True)
    )


def _cost(metric: Metric, value: F64 | float) -> F64 | float:
    return -value if metric.more_is_better else value


def _at(flown: Flown, metric: Metric, seeds: Sequence[int]) -> F64:
    """Values of a metric at given seeds, all of which were flown."""
    return flown.values[metric.key][np.searchsorted(flown.seeds, seeds)]


def _tiers(
    members: Sequence[Member], comparisons: Mapping[tuple[str, int, int], Comparison], min_recall: float
) -> tuple[tuple[tuple[int, ...], ...], bool]:

    flying = [k for k, member in enumerate(members) if member.flown.n]
    whole = [k for k in flying if _lost_share(members[k].flown) <= MOST_LOST]
    common = _common_seeds([members[k].flown for k in whole])
    comparable = set(whole) if common else set()

    def cost(metric: Metric, k: int) -> float:
        if k not in comparable or metric.key not in members[k].flown.values:
            return float(_cost(metric, members[k].mean(metric)))
        return float(_cost(metric, _at(members[k].flown, metric, common).mean()))

    def is_worse(metric: Metric, k: int, best: int) -> bool:
        found = comparisons[metric.key, min(k, best), max(k, best)]
        by = _cost(metric, found.test.mean if k < best else -found.test.mean)
        return found.distinguishable and bool(by > 0.0)

    def not_worse(metric: Metric, among: list[int]) -> list[int]:
        best = min(among, key=lambda k: cost(metric, k))
        return [k for k in among if k == best or not is_worse(metric, k, best)]

    flying.sort(key=lambda k: cost(MISSION_TIME, k))
    whole.sort(key=lambda k: cost(MISSION_TIME, k))
    good = [k for k in whole if not members[k].mean(RECALL) < min_recall - _ROUNDING]
    if not good:
        return (tuple(sorted(flying, key=lambda k: -members[k].mean(RECALL))),), False
    thorough = not_worse(RECALL, good)
    finalists = not_worse(FALSE_POSITIVES, thorough)
    noisy = [k for k in thorough if k not in finalists]
    hasty = [k for k in whole if k not in thorough]
    return (tuple(finalists), tuple(noisy), tuple(hasty)), True


def _common_seeds(flown: Sequence[Flown]) -> list[int]:
    """Seeds that all of them were flown with, in order: means over others differ by luck."""
    return sorted(set.intersection(*(set(f.seeds.tolist()) for f in flown))) if flown else []


def _lost_share(flown: Flown) -> float:
    return (flown.n_failed + flown.n_unfinished) / (flown.n_failed + flown.n)


def _compare_all(scenario: str, metric: Metric, flown: Sequence[Flown]) -> list[Comparison]:
    """All pairs of one scenario, tested together where they have the same seeds. p is not corrected yet."""
    if not any(metric.key in f.values for f in flown):
        return []
    seeds = np.unique(np.concatenate([f.seeds for f in flown]))
    values = np.full((len(seeds), len(flown)), math.nan)
    for k, f in enumerate(flown):
        values[np.searchsorted(seeds, f.seeds), k] = f.values[metric.key]
    alike: dict[bytes, list[tuple[int, int]]] = {}
    present = np.isfinite(values)
    for a, b in combinations(range(len(flown)), 2):
        alike.setdefault((present[:, a] & present[:, b]).tobytes(), []).append((a, b))
    comparisons = []
    for mask, pairs in sorted(alike.items(), key=lambda item: sum(item[0])):  # equal n draws equal samples
        rows = values[np.frombuffer(mask, dtype=bool)]
        first, second = (rows[:, list(side)] for side in zip(*pairs, strict=True))
        for (a, b), test in zip(pairs, paired_tests(first - second), strict=True):
            comparisons.append(Comparison(scenario, metric, a, b, test, math.nan, 0))
    return comparisons


def sensitivity(flown: Sequence[Flown], field: str) -> list[Curve]:
    """Metrics over one swept field; empty unless two of its values were flown.

    All else is equal along a curve. Instead of more than ``MOST_CURVES`` there is one per strategy: the mean,
    seed by seed, over those settings of the other fields that were flown at every value, so that all values
    are averaged over the same settings.
    """
    cells: dict[Configuration, dict[Value, Flown]] = {}
    for f in flown:
        value = dict(f.configuration.parameters).get(field)
        if value is not None and f.n:
            cells.setdefault(f.configuration.without(field), {})[value] = f
    cells = {others: row for others, row in cells.items() if len(row) > 1}
    if len(cells) <= MOST_CURVES:
        fields = dict.fromkeys(name for others in cells for name, _ in others.parameters)
        varied = [f for f in fields if len({dict(others.parameters).get(f) for others in cells}) > 1]
        several = len({others.strategy for others in cells}) > 1
        return [_curve(others.only(varied).label(several), [row]) for others, row in cells.items()]
    values = {value for row in cells.values() for value in row}
    whole: dict[str, list[dict[Value, Flown]]] = {}
    for others, row in cells.items():
        if set(row) == values:
            whole.setdefault(others.strategy, []).append(row)
    return [_curve(strategy, rows) for strategy, rows in list(whole.items())[:MOST_CURVES]]


def _curve(label: str, rows: Sequence[dict[Value, Flown]]) -> Curve:
    values = in_order([value for row in rows for value in row])
    estimates: dict[str, list[Estimate]] = {metric.key: [] for metric in COMPARED}
    common = _common_seeds([f for row in rows for f in row.values()])
    for value in values:
        cells = [row[value] for row in rows]
        seeds = common or _common_seeds(cells)
        for metric in COMPARED:
            if all(metric.key in f.values for f in cells):
                means = np.mean([_at(f, metric, seeds) for f in cells], axis=0)
                estimates[metric.key].append(estimate(means))
    found = {key: tuple(es) for key, es in estimates.items() if len(es) == len(values)}
    return Curve(label, tuple(values), found, len(rows))


def verdict(analysis: Analysis, min_recall: float = MIN_RECALL) -> str:
    """The best configuration, by how much, and how certain that is, in sentences to quote."""
    name = f"{analysis.scenario}:"
    if not analysis.ranking:
        return f"{name} all missions failed."
    best = analysis.members[analysis.ranking[0]]
    if not analysis.reached:
        return (
            f"{name} no configuration reaches a mean recall of {min_recall:g} with at least "
            f"{1 - MOST_LOST:.0%} of its missions finished; the highest recall is that of {best.label}: "
            f"{_figures(best)}."
        )
    if len(analysis.members) == 1:
        return f"{name} one configuration was flown ({best.label}): {_figures(best)}."
    left_out = _left_out(analysis)
    if len(analysis.tiers[0]) == 1:
        which = "configuration that finishes its missions" if left_out else "configuration"
        runner_up = f"no other {which} has recall and false positives that are as good"
    else:
        runner_up = _against_runner_up(analysis)
    sentences = [f"{name} {best.label} is the best: {_figures(best)}; {runner_up}."]
    sentences += [
        f"{rival.label} is faster but {worse}: {_figures(rival)}."
        for tier, metric, worse in zip(
            analysis.tiers[1:],
            (FALSE_POSITIVES, RECALL),
            ("has more false positives", "finds less"),
            strict=True,
        )
        for rival in _worse_than(best, [analysis.members[k] for k in tier], metric)[:1]
        if rival.mean(MISSION_TIME) < best.mean(MISSION_TIME)
    ]
    return " ".join([*sentences, *left_out, *_not_weighed(analysis)])


def _worse_than(best: Member, rivals: Sequence[Member], metric: Metric) -> list[Member]:
    """Those whose mean is worse, too: a tier is told from the best mean, which may be another's."""
    return [m for m in rivals if _cost(metric, m.mean(metric)) > _cost(metric, best.mean(metric))]


def _left_out(analysis: Analysis) -> list[str]:
    """Who cannot be called the best because too few of its missions were finished."""
    members = [m for m in analysis.members if _lost_share(m.flown) > MOST_LOST]
    if not members:
        return []
    member = max(members, key=lambda m: m.mean(RECALL) if m.flown.n else -1.0)
    flown = member.flown
    figures = f": {_figures(member)}" if flown.n else ""
    others = f" So {'is 1 other' if len(members) == 2 else f'are {len(members) - 1} others'}."
    return [
        f"{member.label} is left out, as {flown.n_failed + flown.n_unfinished} of its "
        f"{flown.n_failed + flown.n} missions failed or were not finished{figures}."
        f"{others if len(members) > 1 else ''}"
    ]


def _figures(member: Member) -> str:
    metrics = [m for m in (RECALL, FALSE_POSITIVES, MISSION_TIME) if math.isfinite(member.mean(m))]
    shown = ", ".join(f"{m.name.lower()} {_with_interval(member, m)}" for m in metrics)
    return f"{shown} over {counted(member.flown.n, 'seed')}"


def _not_weighed(analysis: Analysis) -> list[str]:
    """A warning where the seeds are too few to compare recall and false positives."""
    best, *others = analysis.ranking
    found = [analysis.compare(m, k, best) for k in others for m in (RECALL, FALSE_POSITIVES)]
    missing = [c for c in found if c.too_few and c.test.n_zero < c.test.n_pairs]
    if not missing:
        return []
    return [
        "These are too few seeds to weigh recall and false positives: at least "
        f"{pairs_needed(missing[0].family)} common seeds are needed."
    ]


def _against_runner_up(analysis: Analysis) -> str:
    best, second = analysis.tiers[0][:2]
    label = analysis.members[second].label
    found = analysis.compare(MISSION_TIME, second, best)
    test = found.test
    alike = f"not distinguishable from the runner-up {label}"
    if not test.n_pairs:
        return f"the runner-up {label} was flown on other seeds, so that the two cannot be compared"
    if test.n_pairs == 1:
        return f"{alike} ({test.mean:+.1f} s on the one common seed)"
    if test.n_zero == test.n_pairs:
        return f"{alike}: equal with each of {test.n_pairs} common seeds"
    gap = f"{test.mean:.1f} s (95 % CI {test.low:.1f} to {test.high:.1f}, {test.n_pairs} common seeds)"
    if found.distinguishable and test.mean < 0.0:
        return f"the runner-up {label} is {-test.mean:.1f} s faster on {test.n_pairs} common seeds of both"
    if found.distinguishable:
        return f"it is {gap} faster than the runner-up {label}, corrected p {p_text(found.p_holm)}"
    others, counted = analysis.tiers[0][1:], ""
    if len(others) > 1:
        n = sum(not analysis.compare(MISSION_TIME, other, best).distinguishable for other in others)
        counted = (
            f"; not distinguishable in time from {n} of the {len(others)} others with recall and false "
            "positives that are as good"
        )
    if found.undecided:
        correcting = f" after correcting for {found.family} comparisons" if found.family > 1 else ""
        return (
            f"the runner-up {label} is {gap} slower, but these are too few seeds to tell{correcting}: at "
            f"least {pairs_to_tell(test, found.family)} common seeds are needed{counted}"
        )
    return f"{alike}: {gap} slower, corrected p {p_text(found.p_holm)}{counted}"


def _with_interval(member: Member, metric: Metric) -> str:
    e, digits = member.estimates[metric.key], metric.decimals
    if e.n < 2:
        spread = "1 seed: no interval"
    elif e.low == e.high:
        spread = "with every seed"
    else:
        spread = f"95 % CI {e.low:.{digits}f} to {e.high:.{digits}f}"
    return f"{e.mean:.{digits}f} {metric.unit}".rstrip() + f" ({spread})"


def p_text(p: float) -> str:
    """A p-value with its relation, for a reader."""
    return "< 0.001" if p < 0.001 else f"= {p:.3f}" if p < 0.1 else f"= {p:.2f}"
