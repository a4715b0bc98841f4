"""The report of a comparison with the paper."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skysweep.results.figures import n_c_label, panels, pos_curves
from skysweep.results.html import Grid, Picture, Section, picture, write_page
from skysweep.results.metrics import Summary
from skysweep.results.run_folder import JOURNAL_FILE, Run, load_run
from skysweep.results.tables import (
    HEADER,
    PAIRED_HEADER,
    PAPER,
    CompareRow,
    PairedDifference,
    cells,
    compare_json,
    compare_rows,
    grouped,
    infinity_sign,
    markdown_tables,
    one_line,
    paired_cells,
    paired_differences,
)
from skysweep.results.wording import definitions, parameters
from skysweep.scenarios.model import Scenario

TIME_TOLERANCE = 0.15
RECALL_GOAL = 0.95


def write_compare_report(folder: str | Path, summaries: Sequence[Summary]) -> list[CompareRow]:
    """Write ``compare.json``, ``compare.md``, figures and ``report.html`` of a comparison with the paper.

    Trajectories are drawn from the run folders below ``folder/runs``, the lowest seed of each row.

    Returns:
        The rows of the tables.
    """
    folder = Path(folder)
    rows, differences = compare_rows(summaries), paired_differences(summaries)
    (folder / "compare.json").write_text(json.dumps(compare_json(rows), indent=1) + "\n", encoding="utf-8")
    (folder / "compare.md").write_text(markdown_tables(rows, differences), encoding="utf-8")
    runs = _drawn_runs(folder / "runs", rows)
    sections = [
        Section("Does it show what the paper shows?", grids=[_claims(rows, differences)]),
        Section(
            "Tables 1-3",
            paragraphs=[
                "Green: the fastest of ours. The paper flew each row once; ours is the mean over the seeds "
                "with its 95 % confidence interval (Student's t). The paper counts false positives without "
                "saying which kind; false scans are candidates flown to for nothing, false positives are "
                "those that were even confirmed."
            ],
            grids=[_table(caption, group) for caption, group in grouped(rows).items()],
        ),
        Section(
            "Paired over seeds",
            paragraphs=[
                "Mission time of the paper's best choice minus that of the other choice in the same world "
                "with the same wind: below zero means that the paper's choice is faster."
            ],
            grids=[Grid(PAIRED_HEADER, [paired_cells(d) for d in differences])],
        ),
    ]
    if runs:
        drawn = panels(runs, folder / "trajectories")
        seeds = sorted({run.seed for run in runs})
        which = f"seed {seeds[0]}" if len(seeds) == 1 else "the lowest seed of each row"
        caption = f"Trajectories coloured by altitude, {which}, with scanned, confirmed and false targets."
        sections.append(Section("Trajectories", pictures=[picture(drawn[0], caption)]))
    sections.append(Section("Success over time", pictures=_pos_pictures(folder, rows, summaries)))
    if runs:
        sections.append(_assumptions(runs))
    sections.append(Section("What the words mean", grids=[definitions()], folded=True))
    seeds_flown = len({s["seed"] for s in summaries})
    sensors = ", ".join(sorted({str(s["sensor"]) for s in summaries if s.get("sensor")})) or "unknown"
    lead = (
        f"{len(summaries)} missions: the rows of the paper's tables, each flown with {seeds_flown} "
        f"{'seed' if seeds_flown == 1 else 'seeds'}, sensor: {sensors}."
    )
    unfinished = sum(not s["completed"] for s in summaries)
    if unfinished:
        lead += (
            f" {unfinished} of them ended before the search was finished (battery): their mission times, and "
            "the means with them, are too short."
        )
    write_page(folder / "report.html", "Search strategies: ours beside the paper's", lead, [], sections)
    return rows


def _claims(rows: Sequence[CompareRow], differences: Sequence[PairedDifference]) -> Grid:
    """The paper's findings, each with what we measured."""
    claims = []
    for d in differences:
        low, high = d.ci95_s
        interval = f"{low:+.1f} to {high:+.1f} s" if np.isfinite(low) else "one seed: no interval"
        claims.append(
            (
                f"{d.scenario}: n_c = {infinity_sign(d.best)} is faster than n_c = {infinity_sign(d.other)}",
                f"{d.mean_s:+.1f} s ({interval})",
                "yes" if d.holds else "no" if low > 0 else "not shown",
            )
        )
    printed = [(r, r.difference) for r in rows if r.difference is not None]
    if printed:
        worst, gap = max(printed, key=lambda p: abs(p[1]))
        claims.append(
            (
                f"Every mean mission time is within {TIME_TOLERANCE:.0%} of the paper's",
                f"the furthest: {worst.scenario}, n_c = {infinity_sign(worst.n_c)}: {gap:+.1%}",
                "yes" if abs(gap) <= TIME_TOLERANCE else "no",
            )
        )
    for scenario in dict.fromkeys(p.scenario for p in PAPER):
        group = [r for r in rows if r.scenario == scenario]
        if len(group) > 1 and any(r.n_c == 1 for r in group):
            most = max(group, key=lambda r: r.false_scans_mean)
            shown = ", ".join(f"n_c = {infinity_sign(r.n_c)}: {r.false_scans_mean:.2f}" for r in group)
            claims.append((f"{scenario}: n_c = 1 has the most false scans", shown, _yes(most.n_c == 1)))
    recalls = [(r.recall_mean, r) for r in rows if r.recall_mean is not None]
    if recalls:
        recall, least = min(recalls, key=lambda pair: pair[0])
        where = f"{least.scenario}, n_c = {infinity_sign(least.n_c)}"
        claims.append(
            (
                f"Recall is at least {RECALL_GOAL}",
                f"the least: {recall:.3f} ({where})",
                _yes(recall >= RECALL_GOAL),
            )
        )
    return Grid(("Claim", "Measured", "Holds"), claims, words=True)


def _table(caption: str, group: Sequence[CompareRow]) -> Grid:
    fastest = min(range(len(group)), key=lambda k: group[k].mission_time_mean_s)
    return Grid([one_line(name) for name in HEADER], [cells(row) for row in group], caption, best=[fastest])


def _pos_pictures(folder: Path, rows: Sequence[CompareRow], summaries: Sequence[Summary]) -> list[Picture]:
    shown = []
    for scenario in dict.fromkeys(row.scenario for row in rows):
        curves = {
            n_c_label(float(row.n_c)): [
                np.array(s["pos_curve"])
                for s in summaries
                if (s["scenario"], s["n_c"]) == (scenario, row.n_c) and s.get("pos_curve")
            ]
            for row in rows
            if row.scenario == scenario
        }
        if all(curves.values()):
            path = pos_curves(curves, folder / f"pos-{scenario}.svg")
            caption = f"{scenario}: mean share of targets confirmed, with its 95 % interval"
            shown.append(picture(path, caption))
    return shown


def _drawn_runs(folder: Path, rows: Sequence[CompareRow]) -> list[Run]:
    """One run a row of the tables, the lowest seed that has a folder, in the order of the rows."""
    found: dict[tuple[str, float], Run] = {}
    for journal in sorted(folder.glob(f"*/{JOURNAL_FILE}")):
        run = load_run(journal.parent)
        key = (run.scenario.name, run.scenario.search.n_c)
        if key not in found or run.seed < found[key].seed:
            found[key] = run
    keys = [(row.scenario, float(row.n_c)) for row in rows]
    return [found[key] for key in keys if key in found]


def _assumptions(runs: Sequence[Run]) -> Section:
    """What the paper does not print and we had to choose."""
    common = {_comparable(run.scenario) for run in runs}
    same = "the same in all rows" if len(common) == 1 else "NOT the same in all rows: compare with care"
    layouts = []
    for name in dict.fromkeys(run.scenario.name for run in runs):
        world = next(run.world for run in runs if run.scenario.name == name)
        targets = np.array([t.position_enu_m[:2] for t in world.targets])
        nearest = [np.sort(np.hypot(*(targets - t).T))[1] for t in targets] if len(targets) > 1 else [np.nan]
        layouts.append(
            (
                name,
                str(len(targets)),
                f"{np.median(nearest):.1f}",
                str(sum(not thing.is_target for thing in world.objects)),
            )
        )
    return Section(
        "Assumptions",
        paragraphs=[
            "The paper prints no target layouts, no altitudes, no sizes, no lens and no area, and flew each "
            f"row once. All of these are our choice; apart from targets and distractors they are {same}."
        ],
        grids=[
            parameters(runs[0].scenario),
            Grid(("Scenario", "Targets", "Median gap to the next (m)", "Distractors"), layouts),
        ],
    )


def _comparable(scenario: Scenario) -> str:
    layout = {"name", "description", "targets", "distractors", "generators"}
    data = scenario.model_dump(exclude=layout)
    data["search"].pop("n_c")
    return json.dumps(data, sort_keys=True, default=str)


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"
