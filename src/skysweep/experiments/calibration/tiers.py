"""Missions with the statistical sensor against the same missions with pictures.

Both tiers fly the same scenarios, worlds and wind; the means of mission time, recall and false scans are
compared. The tier without pictures is cheap, so it flies further seeds: its mean is then known better than
the one that it is compared with.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student

from skysweep.experiments.ledger import fly_missing
from skysweep.experiments.paper.run import MISSIONS_FILE, PaperJob, fly_paper_job
from skysweep.files.writing import make_folder, whole_files
from skysweep.results.reporting.tables import markdown

SCENARIOS = ("clusters", "abundance", "sparse")
N_C = (1.0, 5.0, math.inf)
METRICS = ("mission_time_s", "recall", "false_scans")
STATISTICAL_TIMES = 4  # as many seeds without pictures as with
TOLERANCE_PERCENT = 5.0
HEADER = ("scenario", "n_c", "mean of", "pictures", "95 % CI", "statistical", "difference", "agrees")


@dataclass(frozen=True, slots=True)
class Cell:
    """One metric of one scenario and n_c in both tiers."""

    scenario: str
    n_c: float
    metric: str
    seeds: int
    rendered_mean: float
    rendered_ci95: tuple[float, float]
    statistical_mean: float

    @property
    def difference_percent(self) -> float:
        """Of the statistical mean from the rendered one; 0 where both are nothing."""
        gap = self.statistical_mean - self.rendered_mean
        if gap == 0:
            return 0.0
        return 100.0 * gap / self.rendered_mean if self.rendered_mean else math.copysign(math.inf, gap)

    @property
    def agrees(self) -> str:
        """The verdict: inside CI, within 5 %, or no."""
        low, high = self.rendered_ci95
        if low <= self.statistical_mean <= high:
            return "inside CI"
        return "within 5 %" if abs(self.difference_percent) <= TOLERANCE_PERCENT else "no"

    @property
    def row(self) -> tuple[str, ...]:
        """As the tables print it, in the order of HEADER."""
        low, high = self.rendered_ci95
        digits = 1 if self.metric == "mission_time_s" else 3
        return (
            self.scenario,
            f"{self.n_c:g}",
            self.metric,
            f"{self.rendered_mean:.{digits}f}",
            f"{low:.{digits}f} to {high:.{digits}f}",
            f"{self.statistical_mean:.{digits}f}",
            f"{self.difference_percent:+.1f} %",
            self.agrees,
        )


def compare_tiers(
    seeds: int,
    out: Path,
    scenarios: Sequence[str] = SCENARIOS,
    n_c: Sequence[float] = N_C,
    workers: int | None = None,
    on_done: Callable[[PaperJob, dict[str, Any]], None] = lambda _job, _summary: None,
) -> list[Cell]:
    """Fly what ``out`` does not hold yet, write ``validate.json`` and ``validate.md``, return the cells.

    Missions are kept in ``missions.jsonl``; those flown with another detector or another sensor model are
    flown again. Raises UserError when the sensor model does not fit a scenario.
    """
    jobs = {
        (scenario, value, sensor): [
            PaperJob(scenario, value, seed, sensor, None) for seed in range(seeds * times)
        ]
        for sensor, times in (("statistical", STATISTICAL_TIMES), ("imaging", 1))
        for scenario in scenarios
        for value in n_c
    }
    key_of = {job: job.key for some in jobs.values() for job in some}
    make_folder(out)
    by_key = {key: job for job, key in sorted(key_of.items(), key=lambda item: item[0].seed)}
    flown = fly_missing(fly_paper_job, by_key, out / MISSIONS_FILE, workers, on_done)
    summaries = {job: flown[key] for job, key in key_of.items()}
    cells = [
        _cell(
            scenario,
            value,
            metric,
            [summaries[job][metric] for job in jobs[scenario, value, "imaging"]],
            [summaries[job][metric] for job in jobs[scenario, value, "statistical"]],
        )
        for scenario in scenarios
        for value in n_c
        for metric in METRICS
    ]
    _write(cells, out)
    return cells


def _cell(
    scenario: str, n_c: float, metric: str, rendered: Sequence[float], statistical: Sequence[float]
) -> Cell:
    n, mean = len(rendered), float(np.mean(rendered))
    half = float(student.ppf(0.975, n - 1) * np.std(rendered, ddof=1) / math.sqrt(n))
    return Cell(scenario, n_c, metric, n, mean, (mean - half, mean + half), float(np.mean(statistical)))


def validation_text(cells: Sequence[Cell]) -> str:
    """One line that sums up and the table, in Markdown."""
    agree = sum(cell.agrees != "no" for cell in cells)
    summary = (
        f"{agree} of {len(cells)} means of the statistical tier lie inside the 95 % confidence interval of "
        f"the rendered tier or within {TOLERANCE_PERCENT:g} % of it."
    )
    caption = (
        f"Missions with pictures ({cells[0].seeds} seeds) and without ({cells[0].seeds * STATISTICAL_TIMES})"
    )
    return f"{summary}\n\n{markdown(caption, HEADER, [cell.row for cell in cells], left=3)}"


def _write(cells: Sequence[Cell], out: Path) -> None:
    rows = [
        {**asdict(cell), "difference_percent": cell.difference_percent, "agrees": cell.agrees}
        for cell in cells
    ]
    for row in rows:
        for field in ("n_c", "difference_percent"):
            if math.isinf(row[field]):
                row[field] = "inf" if row[field] > 0 else "-inf"
    with whole_files(out) as unfinished:
        (unfinished / "validate.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
        (unfinished / "validate.md").write_text(validation_text(cells), encoding="utf-8")
