"""Compare missions over many seeds with the paper's Tables 1-3."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from scipy import stats

from skysweep.results.metrics import Summary, finite_or_inf
from skysweep.results.table_files import markdown

Limit = float | str  # n_c; infinity is the string "inf", as in summary.json


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One row of the paper's tables: each was flown once."""

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
    n_c: Limit
    paper_time_s: float | None
    mission_time_mean_s: float
    mission_time_ci95_s: tuple[float, float]
    paper_false_positives: int | None
    false_scans_mean: float
    false_positives_mean: float
    recall_mean: float | None
    n_seeds: int

    @property
    def difference(self) -> float | None:
        """Our mean over the paper's time, minus 1."""
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
        """The whole interval says that the paper's best choice is faster."""
        return self.ci95_s[1] < 0.0


def t_quantile(n: int) -> float:
    """Two-sided 95 % quantile of Student's t for a mean of n values."""
    return float(stats.t.ppf(0.975, n - 1))


def mean_ci95(values: Sequence[float]) -> tuple[float, tuple[float, float]]:
    """Mean and its 95 % confidence interval by Student's t; a single value gives infinitely wide bounds."""
    x = np.asarray(values, dtype=float)
    mean = float(x.mean())
    if len(x) < 2:
        return mean, (-math.inf, math.inf)
    half = t_quantile(len(x)) * float(x.std(ddof=1)) / math.sqrt(len(x))
    return mean, (mean - half, mean + half)


def compare_rows(summaries: Iterable[Summary]) -> list[CompareRow]:
    """One row for each scenario and n_c flown: the paper's rows in its order, then the others."""
    groups: dict[tuple[str, Limit], list[Summary]] = {}
    for summary in summaries:
        groups.setdefault((summary["scenario"], summary["n_c"]), []).append(summary)
    paper = {(row.scenario, finite_or_inf(row.n_c)): row for row in PAPER}
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
            )
        )
    return rows


def paired_differences(summaries: Iterable[Summary]) -> list[PairedDifference]:
    """The paper's best choice of each scenario against its others, seed by seed (same world, same wind)."""
    times: dict[tuple[str, Limit], dict[int, float]] = {}
    for s in summaries:
        times.setdefault((s["scenario"], s["n_c"]), {})[s["seed"]] = s["mission_time_s"]
    differences = []
    for scenario in CAPTIONS:
        printed = {finite_or_inf(row.n_c): row.mission_time_s for row in PAPER if row.scenario == scenario}
        best = min(printed, key=lambda n_c: printed[n_c])
        for other in (n_c for n_c in printed if n_c != best):
            a, b = times.get((scenario, best), {}), times.get((scenario, other), {})
            seeds = sorted(a.keys() & b.keys())
            if seeds:
                mean, ci95 = mean_ci95([a[seed] - b[seed] for seed in seeds])
                differences.append(PairedDifference(scenario, best, other, len(seeds), mean, ci95))
    return differences


def compare_json(rows: Iterable[CompareRow]) -> list[dict[str, Any]]:
    """Rows as ``compare.json`` holds them; bounds that a single seed leaves open are None."""
    return [
        asdict(row)
        | {"mission_time_ci95_s": [b if math.isfinite(b) else None for b in row.mission_time_ci95_s]}
        for row in rows
    ]


HEADER = (
    "n_c",
    "Mission\ntime (s)",
    "95 % CI",
    "Paper\n(s)",
    "Differ-\nence",
    "False\nscans",
    "False\npos.",
    "Paper\n(f. p.)",
    "Recall",
    "Seeds",
)
PAIRED_HEADER = (
    "Scenario",
    "Paper's best",
    "Against",
    "Difference (s)",
    "95 % CI",
    "Pairs",
    "Faster?",
)


def cells(row: CompareRow) -> tuple[str, ...]:
    """A row as text, in the order of ``HEADER``."""
    return (
        infinity_sign(row.n_c),
        f"{row.mission_time_mean_s:.1f}",
        _interval(row.mission_time_ci95_s),
        "-" if row.paper_time_s is None else f"{row.paper_time_s:.2f}",
        "-" if row.difference is None else f"{row.difference:+.1%}",
        f"{row.false_scans_mean:.2f}",
        f"{row.false_positives_mean:.2f}",
        "-" if row.paper_false_positives is None else str(row.paper_false_positives),
        "-" if row.recall_mean is None else f"{row.recall_mean:.3f}",
        str(row.n_seeds),
    )


def paired_cells(difference: PairedDifference) -> tuple[str, ...]:
    """A paired difference as text, in the order of ``PAIRED_HEADER``."""
    low, high = difference.ci95_s
    return (
        difference.scenario,
        f"n_c = {infinity_sign(difference.best)}",
        f"n_c = {infinity_sign(difference.other)}",
        f"{difference.mean_s:+.1f}",
        _interval((low, high)),
        str(difference.n_pairs),
        "yes" if difference.holds else "no: slower" if low > 0 else "not shown",
    )


def grouped(rows: Iterable[CompareRow]) -> dict[str, list[CompareRow]]:
    """Caption -> rows of one scenario."""
    groups: dict[str, list[CompareRow]] = {}
    for row in rows:
        groups.setdefault(CAPTIONS.get(row.scenario, row.scenario), []).append(row)
    return groups


def print_tables(console: Console, rows: Sequence[CompareRow], summaries: Sequence[Summary]) -> None:
    """The tables on a terminal: our mean, its interval, the paper's number and the difference."""
    differences = paired_differences(summaries)
    for caption, group in grouped(rows).items():
        console.print(_table(caption, HEADER, [cells(row) for row in group]))
    if differences:
        texts = [paired_cells(difference) for difference in differences]
        console.print(_table("Paired over seeds: best choice minus the other", PAIRED_HEADER, texts))


def markdown_tables(rows: Sequence[CompareRow], differences: Sequence[PairedDifference] = ()) -> str:
    """The same tables in Markdown."""
    header = [one_line(name) for name in HEADER]
    parts = [markdown(caption, header, map(cells, group)) for caption, group in grouped(rows).items()]
    if differences:
        title = "Paired over seeds: best choice minus the other"
        parts.append(markdown(title, PAIRED_HEADER, map(paired_cells, differences)))
    return "\n".join(parts)


def infinity_sign(n_c: Limit) -> str:
    """``n_c`` for a reader."""
    return "∞" if n_c == "inf" else f"{n_c:g}"


def one_line(name: str) -> str:
    """A column's name without the line break that narrow terminals need."""
    return name.replace("-\n", "").replace("\n", " ")


def _interval(bounds: tuple[float, float]) -> str:
    return f"{bounds[0]:.1f} to {bounds[1]:.1f}" if math.isfinite(bounds[0]) else "one seed"


def _table(caption: str, header: Sequence[str], texts: Iterable[Sequence[str]]) -> Table:
    table = Table(title=caption, title_justify="left", box=SIMPLE_HEAD, padding=(0, 0), pad_edge=False)
    for column in header:
        table.add_column(column, justify="right", no_wrap=True)
    for text in texts:
        table.add_row(*text)
    return table
