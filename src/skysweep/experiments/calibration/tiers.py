"""Missions with the statistical sensor against the same missions with pictures.

Both tiers fly the same scenarios, worlds and wind, and their means of mission time, recall and false scans
are compared. Missions without pictures are cheap, so that tier flies more seeds and its means are more
precise.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skysweep.experiments.flying import OnDone, fly_job, fly_missing
from skysweep.experiments.matrix import Matrix
from skysweep.experiments.paper.run import SWEPT, row_scenario
from skysweep.files.writing import whole_files
from skysweep.results.reporting.html import Grid
from skysweep.results.reporting.statistics import mean_ci95
from skysweep.results.reporting.tables import markdown
from skysweep.results.summary import plain, value_of
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import Scenario

SCENARIOS = ("clusters", "abundance", "sparse")
N_C = (1.0, 5.0, math.inf)
STRATEGIES = ("belief",)  # beside Algorithm 1 with each n_c
TIER_METRICS = ("mission_time_s", "recall", "false_scans")
STATISTICAL_TIMES = 4  # as many seeds without pictures as with
TOLERANCE_PERCENT = 5.0
TIER_HEADER = (
    "scenario",
    "strategy",
    "mean of",
    "pictures",
    "95 % CI",
    "statistical",
    "difference",
    "agrees",
)


@dataclass(frozen=True, slots=True)
class TierMeans:
    """One metric of one scenario and strategy in both tiers."""

    scenario: str
    strategy: str  # in words: with n_c, if that is Algorithm 1
    metric: str
    seeds: int
    rendered_mean: float
    rendered_ci95: tuple[float, float]
    statistical_mean: float

    @property
    def difference_percent(self) -> float:
        gap = self.statistical_mean - self.rendered_mean
        if gap == 0:
            return 0.0
        return 100.0 * gap / self.rendered_mean if self.rendered_mean else math.copysign(math.inf, gap)

    @property
    def agrees(self) -> str:
        """``inside CI``, ``within 5 %`` or ``no``."""
        low, high = self.rendered_ci95
        if low <= self.statistical_mean <= high:
            return "inside CI"
        return "within 5 %" if abs(self.difference_percent) <= TOLERANCE_PERCENT else "no"

    @property
    def row(self) -> tuple[str, ...]:
        low, high = self.rendered_ci95
        digits = 1 if self.metric == "mission_time_s" else 3
        return (
            self.scenario,
            self.strategy,
            self.metric,
            f"{self.rendered_mean:.{digits}f}",
            f"{low:.{digits}f} to {high:.{digits}f}",
            f"{self.statistical_mean:.{digits}f}",
            f"{self.difference_percent:+.1f} %",
            self.agrees,
        )


def validated_rows(
    scenarios: Sequence[str] = SCENARIOS,
    n_c: Sequence[float] = N_C,
    strategies: Sequence[str] = STRATEGIES,
) -> list[tuple[str, str, Scenario]]:
    """Label, strategy in words and scenario of each row: Algorithm 1 with each n_c, then other strategies."""
    rows = []
    for name in scenarios:
        rows += [(f"n_c {value:g}", row_scenario(name, value, {})) for value in n_c]
        for strategy in strategies:
            scenario = change_scenario(load_scenario(name), {"search.strategy": strategy})
            rows.append((strategy, (scenario.name, scenario)))
    return [(label, strategy, scenario) for strategy, (label, scenario) in rows]


def compare_tiers(
    seeds: int,
    out: Path,
    rows: Sequence[tuple[str, str, Scenario]],
    workers: int | None = None,
    on_done: OnDone = lambda _job, _summary: None,
) -> list[TierMeans]:
    """Fly what ``out`` lacks of :func:`validated_rows`, write ``validate.json`` and ``.md``; the cells.

    Missions of another detector or sensor model are flown again. Raises UserError when the sensor model does
    not fit a scenario.
    """
    more = range(seeds * STATISTICAL_TIMES)
    rendered, statistical = (
        [Matrix.of([(label, scenario)], numbers, sensor, [SWEPT]) for label, _, scenario in rows]
        for numbers, sensor in ((range(seeds), "imaging"), (more, "statistical"))
    )
    flown = fly_missing([*statistical, *rendered], fly_job, out, workers, on_done)
    cells = []
    for (label, strategy, _), *tiers in zip(rows, rendered, statistical, strict=True):
        for metric in TIER_METRICS:
            with_pictures, without = (
                [value_of(flown[job.config_hash], metric) for job in matrix.jobs()] for matrix in tiers
            )
            mean, ci95 = mean_ci95(with_pictures)
            cells.append(TierMeans(label, strategy, metric, seeds, mean, ci95, float(np.mean(without))))
    with whole_files(out) as unfinished:
        text = json.dumps(plain(tiers_json(cells)), indent=1) + "\n"
        (unfinished / "validate.json").write_text(text, encoding="utf-8")
        (unfinished / "validate.md").write_text(validation_text(cells), encoding="utf-8")
    return cells


def tiers_json(cells: Sequence[TierMeans]) -> list[dict[str, Any]]:
    """The records of ``validate.json``."""
    return [asdict(c) | {"difference_percent": c.difference_percent, "agrees": c.agrees} for c in cells]


def validation_text(cells: Sequence[TierMeans]) -> str:
    """A one-line summary and the table, in Markdown."""
    agree = sum(cell.agrees != "no" for cell in cells)
    summary = (
        f"{agree} of {len(cells)} means of the statistical tier lie inside the 95 % confidence interval of "
        f"the rendered tier or within {TOLERANCE_PERCENT:g} % of it."
    )
    seeds = cells[0].seeds
    caption = f"Missions with pictures ({seeds} seeds) and without ({seeds * STATISTICAL_TIMES})"
    return f"{summary}\n\n{markdown(Grid(TIER_HEADER, [cell.row for cell in cells], caption), left=3)}"
