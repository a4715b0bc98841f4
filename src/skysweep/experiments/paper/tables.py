"""Missions over many seeds beside the paper's Tables 1-3, and Algorithm 1 beside scan-only and belief."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from skysweep.results.reporting.html import Grid
from skysweep.results.reporting.statistics import MeanCI, mean_ci95
from skysweep.results.reporting.symbols import number
from skysweep.results.reporting.tables import markdown
from skysweep.results.summary import Limit, Summary, finite_or_inf, value_of

Choice = Limit  # of a row: n_c of Algorithm 1, or the name of another strategy

BASELINE = "scan-only"  # the same transects without a descent, as a reference for Algorithm 1
OTHERS = (BASELINE, "belief")  # flown beside Algorithm 1; the paper has neither


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One row of the paper's tables, a single flight."""

    scenario: str
    n_c: float
    mission_time_s: float
    false_positives: int


PAPER = (
    PaperRow("clusters", 1, 379.66, 2),
    PaperRow("clusters", 5, 348.78, 0),
    PaperRow("clusters", math.inf, 384.23, 1),
    PaperRow("abundance", 1, 799.00, 2),
    PaperRow("abundance", 5, 869.61, 0),
    PaperRow("abundance", math.inf, 834.87, 1),
    PaperRow("sparse", 1, 379.71, 2),
    PaperRow("sparse", math.inf, 316.61, 0),
)
CAPTIONS = {
    "clusters": "Table 1: 2 clusters of targets",
    "abundance": "Table 2: an abundance of targets",
    "sparse": "Table 3: sparsely distributed targets",
}


@dataclass(frozen=True, slots=True)
class CompareRow:
    """One strategy in one scenario over N seeds beside the paper's single flight (None: not in the paper)."""

    scenario: str
    n_c: Choice
    paper_time_s: float | None
    mission_time_mean_s: float
    mission_time_ci95_s: tuple[float, float]
    paper_false_positives: int | None
    false_scans_mean: float
    false_positives_mean: float
    recall_mean: float | None
    n_seeds: int
    n_unfinished: int  # of these, whose time to the turn home is in the mean, though the search takes longer

    @property
    def difference(self) -> float | None:
        """The relative difference of our mean from the paper's time."""
        return None if self.paper_time_s is None else self.mission_time_mean_s / self.paper_time_s - 1.0


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """Mission time of the paper's best choice minus that of another one, over the seeds that both flew."""

    scenario: str
    best: Limit
    other: Limit
    n_pairs: int
    mean_s: float
    ci95_s: tuple[float, float]

    @property
    def holds(self) -> bool:
        """Whether the whole interval says that the paper's best choice is faster."""
        return self.ci95_s[1] < 0.0


@dataclass(frozen=True, slots=True)
class CheckEffect:
    """The paper's best choice or belief, minus scan-only, over the seeds that both flew."""

    scenario: str
    choice: Choice
    n_pairs: int
    mission_time_s: MeanCI
    recall: MeanCI
    false_positives: MeanCI

    @property
    def brings(self) -> str:
        """The metrics in which it differs from scan-only, where the whole interval says so."""
        shown = [
            f"{more if ci95[0] > 0 else less} {what}"
            for what, more, less, (_, ci95) in (
                ("recall", "more", "less", self.recall),
                ("false pos.", "more", "fewer", self.false_positives),
            )
            if ci95[0] > 0 or ci95[1] < 0
        ]
        return " and ".join(shown) or ("nothing clear" if self.n_pairs > 1 else "one seed")


def compare_rows(summaries: Iterable[Summary]) -> list[CompareRow]:
    """One row for each scenario and choice: the paper's rows in its order, then the others."""
    groups: dict[tuple[str, Choice], list[Summary]] = {}
    for summary in summaries:
        groups.setdefault((summary["scenario"], choice_of(summary)), []).append(summary)
    paper: dict[tuple[str, Choice], PaperRow] = {(row.scenario, finite_or_inf(row.n_c)): row for row in PAPER}
    order = [key for key in paper if key in groups] + [key for key in groups if key not in paper]
    rows = []
    for key in order:
        group, printed = groups[key], paper.get(key)
        mean, ci95 = mean_ci95([s["mission_time_s"] for s in group])
        recalls = [s["recall"] for s in group if s["recall"] is not None]
        rows.append(
            CompareRow(
                scenario=key[0],
                n_c=key[1],
                paper_time_s=printed.mission_time_s if printed else None,
                mission_time_mean_s=mean,
                mission_time_ci95_s=ci95,
                paper_false_positives=printed.false_positives if printed else None,
                false_scans_mean=float(np.mean([s["false_scans"] for s in group])),
                false_positives_mean=float(np.mean([s["false_positives"] for s in group])),
                recall_mean=float(np.mean(recalls)) if recalls else None,
                n_seeds=len(group),
                n_unfinished=sum(not s["completed"] for s in group),
            )
        )
    return rows


def paired_differences(summaries: Iterable[Summary]) -> list[PairedDifference]:
    """The paper's best choice of each scenario against its others, in the same worlds and wind."""
    times = by_seed(summaries, "mission_time_s")
    differences = []
    for scenario in CAPTIONS:
        best, *others = _paper_order(scenario)
        for other in others:
            pairs = paired(times.get((scenario, best), {}), times.get((scenario, other), {}))
            if pairs:
                differences.append(PairedDifference(scenario, best, other, len(pairs), *mean_ci95(pairs)))
    return differences


def check_effects(summaries: Sequence[Summary]) -> list[CheckEffect]:
    """The paper's best choice of each scenario and belief against scan-only, in the same worlds and wind."""
    metrics = [by_seed(summaries, key) for key in ("mission_time_s", "recall", "false_positives")]
    effects = []
    for scenario in CAPTIONS:
        only = [m.get((scenario, BASELINE), {}) for m in metrics]
        for tried in (_paper_order(scenario)[0], *(name for name in OTHERS if name != BASELINE)):
            pairs = [paired(m.get((scenario, tried), {}), o) for m, o in zip(metrics, only, strict=True)]
            if pairs[0]:
                effects.append(CheckEffect(scenario, tried, len(pairs[0]), *map(mean_ci95, pairs)))
    return effects


def by_seed(summaries: Iterable[Summary], key: str) -> dict[tuple[str, Choice], dict[int, float]]:
    """Scenario and choice -> seed -> a number of the summary. Missions without that number are left out.

    So are, of mission times, those of searches that were not finished.
    """
    values: dict[tuple[str, Choice], dict[int, float]] = {}
    for s in summaries:
        is_cut = key == "mission_time_s" and not s["completed"]
        if (value := value_of(s, key)) is not None and not is_cut:
            values.setdefault((s["scenario"], choice_of(s)), {})[s["seed"]] = value
    return values


def paired(a: Mapping[int, float], b: Mapping[int, float]) -> list[float]:
    """Differences a - b at the seeds that both have."""
    return [a[seed] - b[seed] for seed in sorted(a.keys() & b.keys())]


def choice_of(summary: Summary) -> Choice:
    """n_c of a mission of Algorithm 1, or its other strategy."""
    return summary["strategy"] if summary["strategy"] in OTHERS else summary["n_c"]


def _paper_order(scenario: str) -> list[Limit]:
    """The paper's n_c of a scenario, the fastest first."""
    printed = {finite_or_inf(row.n_c): row.mission_time_s for row in PAPER if row.scenario == scenario}
    best = min(printed, key=lambda n_c: printed[n_c])
    return [best, *(n_c for n_c in printed if n_c != best)]


def compare_json(rows: Iterable[CompareRow]) -> list[dict[str, Any]]:
    """The rows of Algorithm 1 for ``compare.json``. Bounds that a single seed leaves open are None."""
    return [asdict(row) | _time_ci95(row) for row in rows if row.n_c not in OTHERS]


def baselines_json(rows: Iterable[CompareRow]) -> list[dict[str, Any]]:
    """The rows of scan-only and belief for ``baselines.json``."""
    kept = ("mission_time_mean_s", "recall_mean", "false_positives_mean", "n_seeds", "n_unfinished")
    return [
        {"scenario": row.scenario, "strategy": row.n_c}
        | {key: getattr(row, key) for key in kept}
        | _time_ci95(row)
        for row in rows
        if row.n_c in OTHERS
    ]


def _time_ci95(row: CompareRow) -> dict[str, list[float | None]]:
    return {"mission_time_ci95_s": [b if math.isfinite(b) else None for b in row.mission_time_ci95_s]}


_HEADER = (
    *("n_c", "Mission\ntime (s)", "95 % CI", "Paper\n(s)", "Diffe-\nrence"),
    *("False\nscans", "False\npos.", "Paper\nf. p.", "Recall", "Seeds"),
)
_PAIRED_HEADER = ("Scenario", "Paper's best", "Against", "Difference (s)", "95 % CI", "Pairs", "Faster?")
_CHECK_HEADER = ("Scenario", "Strategy", "Time (s)", "Recall", "False positives", "Brings")


def scenario_grids(rows: Iterable[CompareRow]) -> list[Grid]:
    """A table for each scenario. The fastest n_c stands out."""
    groups: dict[str, list[CompareRow]] = {}
    for row in rows:
        groups.setdefault(CAPTIONS.get(row.scenario, row.scenario), []).append(row)
    grids = []
    for caption, group in groups.items():
        ours = [k for k, row in enumerate(group) if row.n_c not in OTHERS and not row.n_unfinished]
        fastest = sorted(ours, key=lambda k: group[k].mission_time_mean_s)[:1]
        grids.append(Grid(_HEADER, [_cells(row) for row in group], caption, best=fastest))
    return grids


def paired_grid(summaries: Iterable[Summary]) -> Grid:
    """The paper's best choices against the others."""
    rows = [_paired_cells(difference) for difference in paired_differences(summaries)]
    return Grid(_PAIRED_HEADER, rows, "Paired over seeds: best choice minus the other")


def check_grid(summaries: Sequence[Summary]) -> Grid:
    """The paper's best choices and belief against scan-only."""
    caption = "What closer looks cost and bring: minus scan-only, paired over seeds"
    return Grid(_CHECK_HEADER, [_check_cells(effect) for effect in check_effects(summaries)], caption)


def _cells(row: CompareRow) -> tuple[str, ...]:
    return (
        _label(row.n_c),
        f"{row.mission_time_mean_s:.1f}",
        interval(row.mission_time_ci95_s),
        "-" if row.paper_time_s is None else f"{row.paper_time_s:.2f}",
        "-" if row.difference is None else f"{row.difference:+.1%}",
        f"{row.false_scans_mean:.2f}",
        f"{row.false_positives_mean:.2f}",
        "-" if row.paper_false_positives is None else str(row.paper_false_positives),
        "-" if row.recall_mean is None else f"{row.recall_mean:.3f}",
        f"{row.n_seeds} ({row.n_unfinished} cut)" if row.n_unfinished else str(row.n_seeds),
    )


def _paired_cells(difference: PairedDifference) -> tuple[str, ...]:
    low, high = difference.ci95_s
    return (
        difference.scenario,
        choice(difference.best),
        choice(difference.other),
        f"{difference.mean_s:+.1f}",
        interval((low, high)),
        str(difference.n_pairs),
        "yes" if difference.holds else "no: slower" if low > 0 else "not shown",
    )


def _check_cells(effect: CheckEffect) -> tuple[str, ...]:
    return (
        effect.scenario,
        choice(effect.choice),
        _difference(effect.mission_time_s, 1),
        _difference(effect.recall, 3),
        _difference(effect.false_positives, 2),
        effect.brings,
    )


def comparison_tables(rows: Sequence[CompareRow], summaries: Sequence[Summary]) -> list[Table]:
    """All tables for a terminal."""
    made = []
    for grid in _all_grids(rows, summaries):
        table = Table(title=grid.caption, title_justify="left", box=SIMPLE_HEAD, padding=0, pad_edge=False)
        for column in grid.header:
            table.add_column(column, justify="right", no_wrap=column != _CHECK_HEADER[-1])
        for row in grid.rows:
            table.add_row(*row)
        made.append(table)
    return made


def markdown_tables(rows: Sequence[CompareRow], summaries: Sequence[Summary]) -> str:
    """All tables in Markdown."""
    return "\n".join(map(markdown, _all_grids(rows, summaries)))


def _all_grids(rows: Sequence[CompareRow], summaries: Sequence[Summary]) -> list[Grid]:
    return [g for g in (*scenario_grids(rows), paired_grid(summaries), check_grid(summaries)) if g.rows]


def choice(n_c: Choice) -> str:
    """The strategy of a row, for a reader."""
    return str(n_c) if n_c in OTHERS else f"n_c = {_label(n_c)}"


def _label(n_c: Choice) -> str:
    return str(n_c) if n_c in OTHERS else number(float(n_c))


def interval(bounds: tuple[float, float]) -> str:
    """A 95 % interval in seconds, for a reader."""
    return f"{bounds[0]:.1f} to {bounds[1]:.1f}" if math.isfinite(bounds[0]) else "one seed"


def _difference(found: MeanCI, digits: int) -> str:
    mean, (low, high) = found
    if math.isnan(mean):
        return "-"
    interval = f"{low:.{digits}f} to {high:.{digits}f}" if math.isfinite(low) else "one seed"
    return f"{mean:+.{digits}f}\n({interval})"
