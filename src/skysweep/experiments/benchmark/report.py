"""The results of the suite: tables, one JSON file, and a page."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from skysweep import __version__
from skysweep.experiments.benchmark import BENCHMARK_PAGE
from skysweep.experiments.benchmark.measures import (
    MEASURES,
    OVERVIEW,
    Measure,
    Standing,
    standings,
)
from skysweep.experiments.benchmark.run import Flown
from skysweep.experiments.benchmark.suite import Contender, Suite, close_look_m
from skysweep.experiments.matrix import RESULTS_VERSION, digest_of
from skysweep.files.writing import whole_files
from skysweep.results.reporting.html import Grid, Section, write_page
from skysweep.results.reporting.statistics import Estimate
from skysweep.results.reporting.tables import markdown
from skysweep.results.reporting.wording import counted, glossary
from skysweep.results.summary import plain

JSON_FILE, TABLES_FILE = "benchmark.json", "benchmark.md"
NONE = "–"  # in a cell that has no value
CUT = "†"  # at a time that is too short
OF_ORACLE = "Of the oracle's time above scan-only"

Standings = Mapping[str, Sequence[Standing]]  # by family


def standings_of(suite: Suite, flown: Flown, contenders: Sequence[Contender], reference: str) -> Standings:
    """Every contender in every family."""
    return {f.label: standings(flown[f.label], contenders, reference) for f in suite.families}


def write_benchmark(
    folder: Path, suite: Suite, found: Standings, seeds: range, reference: str
) -> dict[str, Any]:
    """Write ``benchmark.json``, ``.md`` and ``.html``; returns what the first one holds.

    Raises UserError where ``folder`` cannot be written to.
    """
    record = as_json(suite, found, seeds, reference)
    overviews = overview(found, with_intervals=True)
    families = {label: family_grid(label, members) for label, members in found.items()}
    lead = (
        f"Suite {suite.version}, {counted(len(seeds), 'seed')} from {seeds.start} a family, "
        f"{suite.sensor} sensor. Means with their 95 % intervals over the seeds."
    )
    if any(s.is_cut for members in found.values() for s in members):
        lead += f" {CUT} Some of these missions ended before their search, so that the time is too short."
    with whole_files(folder) as unfinished:
        text = json.dumps(record, indent=1) + "\n"
        (unfinished / JSON_FILE).write_text(text, encoding="utf-8")
        tables = [markdown(grid, left=1) for grid in (*overviews, *families.values())]
        (unfinished / TABLES_FILE).write_text("\n".join([lead + "\n", *tables]), encoding="utf-8")
        sections = [
            Section("All families", grids=overviews),
            *[
                Section(label, grids=[families[label], difference_grid(found[label], reference)])
                for label in found
            ],
            Section("What the words mean", grids=[_words(next(iter(found.values())))], folded=True),
        ]
        write_page(unfinished / BENCHMARK_PAGE, f"Benchmark {suite.version}", lead, sections)
    return record


def as_json(suite: Suite, found: Standings, seeds: range, reference: str) -> dict[str, Any]:
    """The results as plain data. Unknown values are null."""
    families = {}
    for family in suite.families:
        base = family.base()
        families[family.label] = {
            "area_ha": round(base.area_enu_m.area / 1e4, 3),
            "digest": digest_of(base, suite.sensor, RESULTS_VERSION)[:16],
            "close_look_m": close_look_m(base, suite.target_px),
            "contenders": {s.contender.name: _standing_json(s) for s in found[family.label]},
        }
    record = {
        "suite": suite.version,
        "skysweep": __version__,
        "results_version": RESULTS_VERSION,
        "sensor": suite.sensor,
        "seeds": {"first": seeds.start, "count": len(seeds)},
        "reference": reference,
        "families": families,
    }
    plain_record: dict[str, Any] = plain(record)
    return plain_record


def _standing_json(standing: Standing) -> dict[str, Any]:
    return {
        "strategy": standing.contender.strategy,
        "is_bound": standing.contender.is_bound,
        "measures": {key: _estimate_json(e) for key, e in standing.means.items()},
        "less_reference": {key: _estimate_json(e) for key, e in standing.differences.items()},
        "above_scan_only_of_oracle": standing.of_oracle and _estimate_json(standing.of_oracle),
    }


def _estimate_json(e: Estimate) -> dict[str, float]:
    return {"mean": round(e.mean, 6), "low": round(e.low, 6), "high": round(e.high, 6)}


def overview(found: Standings, with_intervals: bool) -> list[Grid]:
    """A table of families by contenders for each of the measures that tell most."""
    grids = [
        _families_grid(found, m.title, partial(_mean, measure=m, with_interval=with_intervals))
        for m in OVERVIEW
    ]
    return [*grids, _families_grid(found, OF_ORACLE, partial(_of_oracle, with_interval=with_intervals))]


def _families_grid(found: Standings, title: str, cell: Callable[[Standing], str]) -> Grid:
    columns = [
        [s.contender.name, *(cell(members[k]) for members in found.values())]
        for k, s in enumerate(next(iter(found.values())))
    ]
    known = [column for column in columns if set(column[1:]) != {NONE}]
    header, *rows = zip(["Family", *found], *known, strict=True)
    return Grid(header, rows, title)


def family_grid(label: str, members: Sequence[Standing]) -> Grid:
    """Every measure of every contender in one family."""
    rows = [[s.contender.name, *(_mean(s, m) for m in MEASURES), _of_oracle(s)] for s in members]
    return Grid(["Strategy", *(m.title for m in MEASURES), OF_ORACLE], rows, label)


def difference_grid(members: Sequence[Standing], reference: str) -> Grid:
    """The differences from the reference, seed by seed."""
    cut = any(s.is_cut for s in members if s.contender.name == reference)
    rows = [
        [
            s.contender.name,
            *(
                _cell(s.differences.get(m.key), m.decimals, signed=True, cut=m.is_time and (cut or s.is_cut))
                for m in MEASURES
            ),
        ]
        for s in members
        if s.contender.name != reference
    ]
    header = ["Strategy", *(m.title for m in MEASURES)]
    return Grid(header, rows, f"Less {reference}, with the same seeds")


def _mean(s: Standing, measure: Measure, with_interval: bool = True) -> str:
    cut = measure.is_time and s.is_cut
    return _cell(s.mean(measure.key), measure.decimals, with_interval, cut=cut)


def _of_oracle(s: Standing, with_interval: bool = True) -> str:
    return _cell(s.of_oracle, 2, with_interval, cut=s.is_cut)


def _cell(
    e: Estimate | None, decimals: int, with_interval: bool = True, signed: bool = False, cut: bool = False
) -> str:
    """A mean with its interval below it, marked where it is ``cut`` short."""
    if e is None or math.isnan(e.mean):
        return NONE
    sign = "+" if signed else ""
    mean, low, high = (f"{x + 0.0:{sign}.{decimals}f}" for x in (e.mean, e.low, e.high))
    mean += f" {CUT}" * cut
    return f"{mean}\n({low} to {high})" if with_interval and not math.isnan(e.low) else mean


def _words(members: Sequence[Standing]) -> Grid:
    return glossary(
        {s.contender.name: f"{s.contender.what[0].upper()}{s.contender.what[1:]}." for s in members}
        | {
            "Above scan-only": "Mission time less that of scan-only with the same seed.",
            "False positives": "Confirmed candidates that are no new target; duplicates count.",
            "Half found": "When half of the targets were confirmed, or the end of the search.",
            OF_ORACLE: "Mean time above scan-only over that of the oracle, which bounds only those that look "
            "closely at every target before they confirm it.",
        }
    )
