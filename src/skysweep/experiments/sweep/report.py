"""The report of a sweep: sentences to quote, tables, figures, and one page with all of them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import polars as pl

from skysweep.experiments.sweep.analysis import (
    FEW_SEEDS,
    MIN_RECALL,
    MOST_LOST,
    Analysis,
    Comparison,
    Member,
    analyse,
    best_rule,
    p_text,
    sensitivity,
    verdict,
)
from skysweep.experiments.sweep.figures import draw_pareto, draw_pos, draw_sensitivity, write_csv
from skysweep.experiments.sweep.missions import (
    COMPARED,
    FALSE_POSITIVES,
    MISSION_TIME,
    RECALL,
    Flown,
    Metric,
    Missions,
    by_scenario,
)
from skysweep.files.writing import whole_files
from skysweep.results.reporting.html import Grid, Picture, Section, picture, write_page
from skysweep.results.reporting.statistics import pairs_needed, pairs_to_tell
from skysweep.results.reporting.symbols import field_name
from skysweep.results.reporting.tables import write_tables
from skysweep.results.reporting.wording import counted, definitions, glossary

MOST_ROWS_BEFORE_FIGURES = 12
_NOT_FINISHED = "The sweep is not finished: this report has its missions so far."
REPORT_FILE, TABLES, FIGURES = "report.html", "tables", "figures"


def write_sweep_report(
    missions: Missions,
    out: Path,
    min_recall: float = MIN_RECALL,
    on_step: Callable[[int, int], None] = lambda _done, _of: None,
) -> list[str]:
    """Write ``report.html``, ``tables/`` and ``figures/`` into ``out``, in place of an earlier report.

    The best configuration must have a mean recall of ``min_recall``. ``on_step`` is called with parts done
    and total. Returns sentences: that the sweep is not finished, where that is so, and for each scenario the
    best configuration and how certain that is. Raises UserError where ``out`` cannot be written to.
    """
    groups = by_scenario(missions)
    steps = 1 + 2 * len(groups)
    on_step(0, steps)
    with whole_files(out) as unfinished:
        tables, figures = unfinished / TABLES, unfinished / FIGURES
        tables.mkdir()
        figures.mkdir()
        analyses = analyse(groups, min_recall)
        sentences = [verdict(analysis, min_recall) for analysis in analyses]
        _write_tables(analyses, missions, tables)
        on_step(1, steps)
        sections = [
            Section("In a sentence", paragraphs=[*sentences, best_rule(min_recall)]),
            *([Section("Caveats", paragraphs=cautions)] if (cautions := _cautions(analyses)) else []),
        ]
        names = _file_names([a.scenario for a in analyses])
        for k, analysis in enumerate(analyses):
            drawn = _pictures(analysis, names[k], figures)
            on_step(2 + 2 * k, steps)
            drawn += _parameter_pictures(groups[analysis.scenario], missions, names[k], figures)
            grids = [_statistics(analysis), *_differences(analysis, [MISSION_TIME])]
            if len(analysis.members) <= MOST_ROWS_BEFORE_FIGURES:
                sections.append(Section(analysis.scenario, grids=grids, pictures=drawn))
            else:
                sections.append(Section(analysis.scenario, grids=[_front(analysis)], pictures=drawn))
                sections.append(Section(f"{analysis.scenario}: every configuration", grids=grids))
            on_step(3 + 2 * k, steps)
        sections += _appendix(missions, analyses)
        title = f"Sweep {missions.source.rstrip('/').rpartition('/')[2]}: what the missions show"
        write_page(unfinished / REPORT_FILE, title, _lead(missions), sections)
    return sentences if missions.finished else [_NOT_FINISHED, *sentences]


def _lead(missions: Missions) -> str:
    table = missions.table
    parameters = [f"param.{field}" for field in missions.parameters]
    counts = [
        (len(table), "mission"),
        (table["scenario"].n_unique(), "scenario"),
        (table.select("strategy", *parameters).n_unique(), "configuration"),
        (table["seed"].n_unique(), "seed"),
    ]
    text = ", ".join(counted(n, word) for n, word in counts)
    sensors = sorted(set(table["sensor"].drop_nulls())) if "sensor" in table.columns else []
    lead = text + (f"; sensor: {', '.join(sensors)}." if sensors else ".")
    if not missions.finished:
        lead += f" {_NOT_FINISHED}"
    return lead


def _cautions(analyses: Sequence[Analysis]) -> list[str]:
    members = [member for analysis in analyses for member in analysis.members]
    failed = sum(m.flown.n_failed for m in members)
    unfinished = sum(m.flown.n_unfinished for m in members)
    smallest = min(m.flown.n for m in members)
    cautions = []
    if failed:
        cautions.append(f"{failed} missions failed with an error and are in no mean; they are listed below.")
    if unfinished:
        cautions.append(
            f"{unfinished} missions ended before the search was finished (an empty battery, for example), so "
            "their mission times and the means that include them are too short. A configuration with more "
            f"than {MOST_LOST:.0%} of its missions failed or unfinished is never called the best."
        )
    if smallest < 2:
        cautions.append("Some configurations have 1 mission or none: no interval, and nothing can be tested.")
    elif smallest < FEW_SEEDS:
        cautions.append(
            f"Some configurations have only {smallest} missions. With fewer than {FEW_SEEDS}, bootstrap "
            "intervals are too narrow: about 88 % of them hold the truth with 10 missions, 82 % with 5."
        )
    family = max((c.family for a in analyses for c in a.comparisons.values()), default=0)
    if family and any(c.too_few for a in analyses for c in a.comparisons.values()):
        cautions.append(
            f"With {family} pairs of configurations compared at once, at least {pairs_needed(family)} common "
            "seeds are needed to distinguish any difference from chance."
        )
    return cautions


def _statistics(analysis: Analysis) -> Grid:
    """One row per configuration: means with their intervals. The best one stands out."""
    metrics = [metric for metric in COMPARED if metric in analysis.metrics]
    lost = any(m.flown.n_failed or m.flown.n_unfinished for m in analysis.members)
    header = ["Configuration", "Seeds", *(metric.title for metric in metrics), "On front"]
    rows = [
        [m.label, str(m.flown.n), *(_cell(m, metric) for metric in metrics), _front_cell(m)]
        for m in analysis.members
    ]
    if lost:
        header.append("Failed / unfinished")
        for row, member in zip(rows, analysis.members, strict=True):
            row.append(f"{member.flown.n_failed} / {member.flown.n_unfinished}")
    best = analysis.ranking[:1] if analysis.reached and len(analysis.members) > 1 else ()
    return Grid(header, rows, f"{analysis.scenario}: means with 95 % intervals", best=best)


def _cell(member: Member, metric: Metric) -> str:
    e = member.estimates.get(metric.key)
    if e is None or not e.n:
        return "-"
    digits = metric.decimals
    if e.n < 2:
        return f"{e.mean:.{digits}f}"
    spread = "all alike" if e.low == e.high else f"{e.low:.{digits}f} to {e.high:.{digits}f}"
    return f"{e.mean:.{digits}f}\n({spread})"


def _front_cell(member: Member) -> str:
    share = "" if math.isnan(member.front_share) else f"\n({member.front_share:.0%})"
    return f"{'yes' if member.on_front else 'no'}{share}" if member.flown.n else "-"


def _differences(analysis: Analysis, metrics: Sequence[Metric]) -> list[Grid]:
    """The other configurations minus the best, over common seeds: a table per metric."""
    if not analysis.ranking or len(analysis.members) < 2:
        return []
    best = analysis.ranking[0]
    header = (
        *("Configuration", "Difference (95 % CI)", "Common seeds", "Equal"),
        *("p", "Corrected p", "r", "d_z", "Distinguishable"),
    )
    grids = []
    for metric in (m for m in metrics if m in analysis.metrics):
        found = [analysis.compare(metric, k, best) for k in range(len(analysis.members)) if k != best]
        rows = [(analysis.members[c.a].label, *_test_cells(c)) for c in found]
        than = f"minus that of {analysis.members[best].label}, seed by seed"
        grids.append(Grid(header, rows, f"{analysis.scenario}: {metric.title} {than}"))
    return grids


def _test_cells(comparison: Comparison) -> tuple[str, ...]:
    test, digits = comparison.test, comparison.metric.decimals
    if not test.n_pairs:
        return ("-", "0", "-", "-", "-", "-", "-", "no common seeds")
    if test.n_pairs == 1:
        interval = "1 seed"
    elif test.low == test.high:
        interval = "all alike"
    else:
        interval = f"{_signed(test.low, digits)} to {_signed(test.high, digits)}"
    return (
        f"{_signed(test.mean, digits)}\n({interval})",
        str(test.n_pairs),
        str(test.n_zero),
        p_text(test.p).removeprefix("= "),
        p_text(comparison.p_holm).removeprefix("= "),
        _signed(test.rank_biserial, 2),
        "-" if math.isnan(test.cohens_dz) else _signed(test.cohens_dz, 2),
        _told(comparison),
    )


def _told(comparison: Comparison) -> str:
    """Whether two configurations are distinguishable, or how many seeds might decide it."""
    if comparison.undecided:
        return f"too few seeds\n(at least {pairs_to_tell(comparison.test, comparison.family)})"
    return "yes" if comparison.distinguishable else "no"


def _signed(value: float, digits: int) -> str:
    return f"{rounded:+.{digits}f}" if (rounded := round(value, digits)) else f"{0:.{digits}f}"


def _write_tables(analyses: Sequence[Analysis], missions: Missions, folder: Path) -> None:
    write_tables(folder / "statistics", [_statistics(a) for a in analyses])
    differences = [grid for a in analyses for grid in _differences(a, COMPARED)]
    if differences:
        write_tables(folder / "differences", differences)
    statistics, pairs = [], []
    for analysis in analyses:
        for member in analysis.members:
            lost = {"failed": member.flown.n_failed, "unfinished": member.flown.n_unfinished}
            statistics += [
                {**_names(analysis, member), "metric": m.key, **lost, **asdict(member.estimates[m.key])}
                for m in analysis.metrics
                if m.key in member.estimates
            ]
        best = analysis.ranking[0] if analysis.ranking else None
        pairs += [
            {
                "scenario": analysis.scenario,
                "metric": c.metric.key,
                "a": analysis.members[c.a].label,
                "b": analysis.members[c.b].label,
                "best": "a" if c.a == best else "b" if c.b == best else None,
                **asdict(c.test),
                "p_holm": c.p_holm,
                "family": c.family,
                "distinguishable": c.distinguishable,
                "too_few_pairs": c.too_few,
            }
            for c in analysis.comparisons.values()
        ]
    write_csv(statistics, folder / "statistics.csv")
    if pairs:
        write_csv(pairs, folder / "all_pairs.csv")
    pareto = [
        _names(analysis, member)
        | {metric.key: member.mean(metric) for metric in COMPARED}
        | {"on_front": member.on_front, "front_share": member.front_share}
        for analysis in analyses
        for member in analysis.members
    ]
    write_csv(pareto, folder / "pareto.csv")
    write_tables(folder / "pareto", [_front(analysis) for analysis in analyses])
    if len(missions.failed):
        write_csv(_failures(missions).to_dicts(), folder / "failed.csv")


def _names(analysis: Analysis, member: Member) -> dict[str, object]:
    configuration = member.flown.configuration
    return {
        "scenario": analysis.scenario,
        "configuration": member.label,
        "strategy": configuration.strategy,
        **{f"param.{field}": value for field, value in configuration.parameters},
    }


def _front(analysis: Analysis) -> Grid:
    metrics = [metric for metric in COMPARED if metric in analysis.metrics]
    rows = []
    for member in sorted((m for m in analysis.members if m.on_front), key=lambda m: m.mean(MISSION_TIME)):
        share = "-" if math.isnan(member.front_share) else f"{member.front_share:.0%}"
        rows.append((member.label, *(_cell(member, metric) for metric in metrics), share))
    return Grid(
        ("Configuration", *(metric.title for metric in metrics), "Stays there"),
        rows,
        f"{analysis.scenario}: Pareto front of mission time, recall and false positives",
    )


def _pictures(analysis: Analysis, name: str, folder: Path) -> list[Picture]:
    drawn = []
    if len(analysis.members) > 1 and {RECALL, FALSE_POSITIVES}.intersection(analysis.metrics):
        caption = (
            f"{analysis.scenario}: mission time against recall and false positives. A configuration is on "
            "the front when no other is at least as good in all three and better in one, and nearly all of "
            "its missions were finished. Bars: 95 % intervals."
        )
        drawn.append(picture(draw_pareto(analysis, folder / f"pareto-{name}"), caption, wide=True))
    curves = draw_pos(analysis, folder / f"pos-{name}")
    if curves is not None:
        caption = (
            f"{analysis.scenario}: mean share of targets confirmed by a time, with the pointwise 95 % "
            "bootstrap band over the seeds."
        )
        drawn.append(picture(curves, caption, wide=True))
    return drawn


def _parameter_pictures(flown: Sequence[Flown], missions: Missions, name: str, folder: Path) -> list[Picture]:
    drawn = []
    for field in missions.parameters:
        curves = sensitivity(flown, field)
        if curves:
            path = draw_sensitivity(curves, field, folder / f"{_slug(field)}-{name}")
            averaged = max(curve.averaged_over for curve in curves)
            over = f", averaged over {averaged} settings of the other parameters" if averaged > 1 else ""
            caption = f"Effect of {field_name(field)} ({field}): means with 95 % intervals{over}."
            drawn.append(picture(path, caption, wide=True))
    return drawn


def _appendix(missions: Missions, analyses: Sequence[Analysis]) -> list[Section]:
    others = [g for a in analyses for g in _differences(a, [m for m in COMPARED if m is not MISSION_TIME])]
    sections = []
    if others:
        title = "Differences in recall, false scans, false positives, energy"
        sections.append(Section(title, grids=others, folded=True))
    if len(missions.failed):
        failures = _failures(missions).head(20)
        rows = [[str(cell) for cell in row] for row in failures.iter_rows()]
        grid = Grid(("Scenario", "Strategy", "Missions", "First seed", "Error"), rows, words=True)
        sections.append(Section("Failed missions", grids=[grid]))
    sections.append(Section("How this was computed", grids=[_methods()], folded=True))
    sections.append(Section("What the words mean", grids=[definitions()], folded=True))
    if missions.spec:
        sections.append(Section("Specification", verbatim=missions.spec, folded=True))
    return sections


def _failures(missions: Missions) -> pl.DataFrame:
    """Kinds of failure, the most frequent first."""
    return (
        missions.failed.group_by("scenario", "strategy", "error")
        .agg(pl.len().alias("missions"), pl.col("seed").min().alias("first_seed"))
        .select("scenario", "strategy", "missions", "first_seed", "error")
        .sort(["missions", "scenario", "strategy", "error"], descending=[True, False, False, False])
    )


def _methods() -> Grid:
    return glossary(
        {
            "Interval": "95 % BCa bootstrap interval of the mean, from 5000 fixed samples of the seeds.",
            "Difference": "Mean over common seeds, with the same world, wind and noise. Its interval is a "
            "bootstrap, too.",
            "p, corrected p": "Wilcoxon's signed-rank test, two-sided, without equal pairs, exact up to 50 "
            "pairs; corrected by Holm for all pairs of configurations of all scenarios, in each metric.",
            "All alike": "All seeds gave the same value. An event not seen in n missions can still have a "
            "probability of up to 3 in n.",
            "r": "Matched-pairs rank-biserial correlation: +1 where the other is larger with every seed.",
            "d_z": "Cohen's: mean of the differences over their standard deviation.",
            "Distinguishable": "The corrected p is below 0.05 and the interval excludes zero. Too few seeds: "
            "the interval excludes zero but the corrected p is 0.05 or more, or no outcome could be "
            "distinguished. In brackets: about how many common seeds would show a difference like this one.",
            "Pareto front": "No other configuration is better in one of the means of mission time, recall "
            "and false positives and at least as good in the others. In brackets: the share of resamplings "
            "of the seeds that leave it there. Configurations with more than "
            f"{MOST_LOST:.0%} of their missions failed or unfinished are left out: their times are too "
            "short.",
        }
    )


def _file_names(scenarios: Sequence[str]) -> list[str]:
    names: list[str] = []
    for scenario in scenarios:
        name = _slug(scenario)
        names.append(name if name not in names else f"{name}-{len(names)}")
    return names


def _slug(text: str) -> str:
    return re.sub(r"[^\w=-]+", "-", text).strip("-") or "scenario"
