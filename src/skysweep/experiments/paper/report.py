"""The report of a comparison with the paper."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from skysweep.experiments.paper.claims import claims
from skysweep.experiments.paper.tables import (
    BASELINE,
    CAPTIONS,
    OTHERS,
    Choice,
    CompareRow,
    baselines_json,
    check_grid,
    choice,
    choice_of,
    compare_json,
    compare_rows,
    interval,
    markdown_tables,
    paired_grid,
    scenario_grids,
)
from skysweep.files.writing import whole_files
from skysweep.results.figures import n_c_label, panels, pos_curves
from skysweep.results.reporting.html import Grid, Picture, Section, picture, write_page
from skysweep.results.reporting.wording import counted, definitions, parameters
from skysweep.results.run_folder import JOURNAL_FILE, Run, load_run, summary_of_complete
from skysweep.results.summary import Summary, finite_or_inf
from skysweep.scenarios.model import Scenario


def write_compare_report(
    folder: str | Path, summaries: Sequence[Summary], run_folders: Iterable[Path]
) -> list[CompareRow]:
    """Write ``compare.json``, ``baselines.json``, ``compare.md``, figures and ``report.html``.

    Trajectories are drawn from those of the run folders that are there, the lowest seed of each row. Missions
    with pictures are those in ``folder/pictures/SCENARIO``. Returns the rows of the tables. Raises UserError
    where ``folder`` cannot be written to.
    """
    with whole_files(Path(folder)) as unfinished:
        return _write(unfinished, summaries, Path(folder), run_folders)


def _write(
    folder: Path, summaries: Sequence[Summary], flown: Path, run_folders: Iterable[Path]
) -> list[CompareRow]:
    rows = compare_rows(summaries)
    for name, records in (("compare", compare_json(rows)), ("baselines", baselines_json(rows))):
        text = json.dumps(records, indent=1) + "\n"
        (folder / f"{name}.json").write_text(text, encoding="utf-8")
    (folder / "compare.md").write_text(markdown_tables(rows, summaries), encoding="utf-8")
    runs = drawn_runs(run_folders, rows)
    sections = [
        Section("Are the paper's findings confirmed?", grids=[claims(summaries)]),
        Section(
            "Tables 1-3",
            paragraphs=[
                "Green marks our fastest n_c. The paper flew each row once. Ours is the mean over the seeds "
                "with its 95 % confidence interval (Student's t). The paper does not define its false "
                "positives. Here, false scans are checked candidates that were no new target, and false "
                "positives are the confirmed ones among them."
            ],
            grids=scenario_grids(rows),
        ),
        Section(
            "Paired over seeds",
            paragraphs=[
                "Mission time of the paper's best choice minus that of the other choice in the same world "
                "with the same wind: below zero means that the paper's choice is faster."
            ],
            grids=[replace(paired_grid(summaries), caption="")],
        ),
    ]
    if shown := _missions_with_pictures(flown / "pictures", rows):
        sections.insert(0, shown)
    check = check_grid(summaries)
    if check.rows:
        sections.append(
            Section(
                "What closer looks cost and bring",
                paragraphs=[
                    f"{BASELINE} flies the same transects and never descends. It confirms targets that it "
                    "is sure of from the scan altitude. The table shows the mean of the paper's best choice "
                    "and of belief, minus that of scan-only in the same world with the same wind, with its "
                    "95 % confidence interval. Above zero in time is slower, above zero in recall finds more."
                ],
                grids=[replace(check, caption="")],
            )
        )
    if runs:
        drawn, *_ = panels(runs, folder / "trajectories")
        seeds = sorted({run.seed for run in runs})
        which = f"seed {seeds[0]}" if len(seeds) == 1 else "the lowest seed of each row"
        caption = f"Trajectories coloured by altitude, {which}, with scanned, confirmed and false targets."
        sections.append(Section("Trajectories", pictures=[picture(drawn, caption)]))
    sections.append(Section("Success over time", pictures=_pos_pictures(folder, rows, summaries)))
    if runs:
        sections.append(_assumptions(runs))
    sections.append(Section("What the words mean", grids=[definitions()], folded=True))
    seeds_flown = len({s["seed"] for s in summaries})
    sensors = ", ".join(sorted({str(s["sensor"]) for s in summaries if s.get("sensor")})) or "unknown"
    lead = (
        f"{len(summaries)} missions: the rows of the paper's tables{_others(rows)}, each flown with "
        f"{counted(seeds_flown, 'seed')}, sensor: {sensors}."
    )
    unfinished = sum(not s["completed"] for s in summaries)
    if unfinished:
        lead += (
            f" {unfinished} of them ended before the search was finished, so their mission times and the "
            "means that include them are too short: the rows say how many were cut, and no claim of a time "
            "rests on them."
        )
    write_page(folder / "report.html", "Search strategies: ours beside the paper's", lead, sections)
    return rows


def _pos_pictures(folder: Path, rows: Sequence[CompareRow], summaries: Sequence[Summary]) -> list[Picture]:
    shown = []
    for scenario in dict.fromkeys(row.scenario for row in rows):
        curves = {
            str(n_c) if n_c in OTHERS else n_c_label(float(n_c)): [
                np.array(s["pos_curve"])
                for s in summaries
                if (s["scenario"], choice_of(s)) == (scenario, n_c) and s.get("pos_curve")
            ]
            for n_c in dict.fromkeys(row.n_c for row in rows)
        }
        if any(curves.values()):
            path = pos_curves(curves, folder / f"pos-{scenario}.svg")
            caption = f"{scenario}: mean share of targets confirmed, with its 95 % interval"
            shown.append(picture(path, caption))
    return shown


def drawn_runs(folders: Iterable[Path], rows: Sequence[CompareRow]) -> list[Run]:
    """The run with the lowest seed for each row of the tables that has a run folder, in their order.

    Raises UserError where a run folder is damaged.
    """
    found: dict[tuple[str, Choice], Run] = {}
    for folder in folders:
        if not (folder / JOURNAL_FILE).exists():
            continue
        run = load_run(folder)
        n_c = run.strategy if run.strategy in OTHERS else finite_or_inf(run.scenario.search.n_c)
        known = found.setdefault((run.scenario.name, n_c), run)
        if run.seed < known.seed:
            found[run.scenario.name, n_c] = run
    keys = [(row.scenario, row.n_c) for row in rows]
    return [found[key] for key in keys if key in found]


def _others(rows: Sequence[CompareRow]) -> str:
    flown = {row.n_c for row in rows}
    return "".join(f", {name}" for name in OTHERS if name in flown)


def _missions_with_pictures(folder: Path, rows: Sequence[CompareRow]) -> Section | None:
    """The complete missions in ``folder``, each beside the mean of its row; None if there are none."""
    means = {(row.scenario, row.n_c): row for row in rows}
    lines, maps = [], []
    for name in CAPTIONS:
        found = summary_of_complete(folder / name)
        if found is None:
            continue
        s = cast(Summary, found)
        row = means.get((name, choice_of(s)))
        mean = "-" if row is None else f"{row.mission_time_mean_s:.0f} ({interval(row.mission_time_ci95_s)})"
        right = f"{s['n_confirmed']} of {s['n_targets']}"
        time_s = f"{s['mission_time_s']:.0f}"
        lines.append((name, choice(choice_of(s)), time_s, mean, right, str(s["false_positives"])))
        maps.append(
            picture(folder / name / "map.png", f"{name}: its own report is {folder.name}/{name}/report.html")
        )
    if not lines:
        return None
    header = ("Scenario", "Strategy", "Time (s)", "Mean of all seeds (95 % CI)", "Found", "False pos.")
    return Section(
        "Missions with pictures",
        paragraphs=[
            "One mission each with rendered pictures and the detector. Each has a report of its own."
        ],
        grids=[Grid(header, lines)],
        pictures=maps,
    )


def _assumptions(runs: Sequence[Run]) -> Section:
    common = {_comparable(run.scenario) for run in runs}
    same = "the same in all rows" if len(common) == 1 else "NOT the same in all rows: compare with care"
    layouts = []
    for name in dict.fromkeys(run.scenario.name for run in runs):
        world = next(run.world for run in runs if run.scenario.name == name)
        targets = np.array([t.position_enu_m[:2] for t in world.targets])
        nearest = [np.sort(np.hypot(*(targets - t).T))[1] for t in targets] if len(targets) > 1 else [np.nan]
        distractors = sum(not thing.is_target for thing in world.objects)
        layouts.append((name, str(len(targets)), f"{np.median(nearest):.1f}", str(distractors)))
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
    for chosen in ("strategy", "n_c", "d_c_m"):  # of the row
        data["search"].pop(chosen)
    return json.dumps(data, sort_keys=True, default=str)
