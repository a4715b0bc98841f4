"""The paper's findings beside our measurements, and whether these confirm them.

A claim holds when all of its 95 % intervals lie on its side. It fails when one lies on the other side.
Anything else, such as a tie or a single seed, shows nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from skysweep.experiments.paper.tables import (
    CAPTIONS,
    OTHERS,
    by_seed,
    choice,
    compare_rows,
    paired,
    paired_differences,
)
from skysweep.results.reporting.html import Grid
from skysweep.results.reporting.statistics import MeanCI, mean_ci95
from skysweep.results.summary import Summary

TIME_TOLERANCE = 0.15
RECALL_GOAL = 0.95

# the claim, our measurement, and intervals that are above 0 if the claim holds
Claim = tuple[str, str, Sequence[tuple[float, float]]]


def claims(summaries: Sequence[Summary]) -> Grid:
    """The paper's findings, each with our measurement."""
    tests = (_faster, _times_near_the_papers, _most_false_scans, _recall)
    found = [claim for test in tests for claim in test(summaries)]
    rows = [(what, measured, _verdict(margins)) for what, measured, margins in found]
    return Grid(("Claim", "Measured (95 % interval)", "Holds"), rows, words=True)


def _verdict(margins: Sequence[tuple[float, float]]) -> str:
    if any(high < 0 for _, high in margins):
        return "no"
    return "yes" if all(low > 0 for low, _ in margins) else "not shown"


def _faster(summaries: Sequence[Summary]) -> Iterator[Claim]:
    for d in paired_differences(summaries):
        low, high = d.ci95_s
        what = f"{d.scenario}: {choice(d.best)} is faster than {choice(d.other)}"
        yield what, _text((d.mean_s, d.ci95_s), "+.1f", " s"), [(-high, -low)]


def _times_near_the_papers(summaries: Sequence[Summary]) -> Iterator[Claim]:
    gaps: dict[str, MeanCI] = {}
    for row in compare_rows(summaries):
        if row.paper_time_s is not None and row.difference is not None and not row.n_unfinished:
            low, high = (bound / row.paper_time_s - 1.0 for bound in row.mission_time_ci95_s)
            gaps[f"{row.scenario}, {choice(row.n_c)}"] = row.difference, (low, high)
    if gaps:
        where = max(gaps, key=lambda key: abs(gaps[key][0]))
        yield (
            f"Every mean mission time is within {TIME_TOLERANCE:.0%} of the paper's",
            f"the furthest: {where}: {_text(gaps[where], '+.1%')}",
            [
                (TIME_TOLERANCE - max(-low, high), TIME_TOLERANCE - max(low, -high, 0.0))
                for _, (low, high) in gaps.values()
            ],
        )


def _most_false_scans(summaries: Sequence[Summary]) -> Iterator[Claim]:
    counts = by_seed(summaries, "false_scans")
    for scenario in CAPTIONS:
        one = counts.get((scenario, 1), {})
        others = {c: mine for (name, c), mine in counts.items() if name == scenario and c not in (1, *OTHERS)}
        more = {c: mean_ci95(pairs) for c, mine in others.items() if (pairs := paired(one, mine))}
        if more:
            shown = [f"minus that of {choice(c)}: {_text(found, '+.2f')}" for c, found in more.items()]
            mean = sum(one.values()) / len(one)
            what = f"{scenario}: n_c = 1 has the most false scans"
            yield what, "; ".join([f"mean {mean:.2f}", *shown]), [interval for _, interval in more.values()]


def _recall(summaries: Sequence[Summary]) -> Iterator[Claim]:
    recalls = by_seed(summaries, "recall")
    means = {key: mean_ci95(list(v.values())) for key, v in recalls.items() if key[1] not in OTHERS}
    if means:
        least = min(means, key=lambda key: means[key][0])
        mean, (low, high) = means[least]
        told = _text((mean, (low, min(high, 1.0))), ".3f")  # no share is greater
        yield (
            f"Recall is at least {RECALL_GOAL}",
            f"the least: {told} ({least[0]}, {choice(least[1])})",
            [(low - RECALL_GOAL, high - RECALL_GOAL) for _, (low, high) in means.values()],
        )


def _text(found: MeanCI, form: str, unit: str = "") -> str:
    mean, (low, high) = found
    interval = f"{low:{form}} to {high:{form}}" if math.isfinite(low) else "one seed: no interval"
    return f"{mean:{form}}{unit} ({interval})"
