"""Report a mission or a sweep."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skysweep.cli import completion
from skysweep.cli.answers import JsonOption, answer
from skysweep.cli.common import counting, friendly, local_folder, warn
from skysweep.cli.missions import answer_mission
from skysweep.errors import UserError


@friendly
def report(
    folder: Annotated[
        str,
        typer.Argument(
            metavar="DIR",
            help="Run folder of a mission; folder or URL of a sweep or of a comparison with the paper.",
            autocompletion=completion.runs,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the results. Default: DIR for a mission, DIR/report for a sweep."),
    ] = None,
    min_recall: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Mean recall that the best configuration of a sweep must reach."),
    ] = 0.95,
    from_sound_lines: Annotated[
        bool,
        typer.Option(
            "--from-sound-lines", help="Report the sound part of a damaged run folder; needs --out."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write the results of a mission from its journal, or report the statistics of a sweep.

    A mission may have been interrupted or still be flying: summary, found positions, map and report then show
    the results so far, and resume and fly can still continue it. Only the run folder is needed, not the
    vehicle or the computer that flew it.

    A sweep's report has intervals, tests, tables and figures; a sweep that still runs is reported so far.
    The best of a scenario: of the configurations that reach --min-recall, those whose recall is not
    distinguishable from the highest; of these, those whose false positives are not distinguishable from the
    fewest; of these, the fastest.

    Examples:

        skysweep report runs/clusters-scan-check-seed0

        skysweep report /media/card/my-run --out my-run-results

        skysweep report my-sweep

        skysweep report my-sweep --min-recall 0.9 --out my-report

        skysweep report s3://bucket/my-sweep --out my-report
    """
    from skysweep.results.run_folder import JOURNAL_FILE

    target, here = out, local_folder(folder)
    if here is not None and (here / JOURNAL_FILE).is_file():
        _report_mission(as_json, here, out or here, from_sound_lines)
        return
    if from_sound_lines:
        raise UserError(f"--from-sound-lines: {folder} is not the folder of one mission; leave it out")

    from skysweep.experiments.benchmark import BENCHMARK_PAGE, BREAK_EVEN_PAGE
    from skysweep.experiments.sweep.missions import load_missions
    from skysweep.experiments.sweep.report import REPORT_FILE, write_sweep_report
    from skysweep.experiments.sweep.spec import matrix_of, parse_spec

    for page in (BENCHMARK_PAGE, BREAK_EVEN_PAGE):
        if here is not None and (here / page).is_file():
            raise UserError(f"{folder}: is of a benchmark, which writes its own report; open {here / page}")
    if target is None:
        if here is None:
            raise UserError(f"{folder}: is not on this computer; write the report's folder as --out")
        target = here / "report"
    missions = load_missions(folder, lambda spec: matrix_of(parse_spec(spec, f"{folder}/spec.yaml")).table())
    with counting("report") as count:
        sentences = write_sweep_report(missions, target, min_recall, on_step=count)
    record = {"report": str(target / REPORT_FILE), "sentences": sentences}
    answer(as_json, record, *sentences, f"report: {target / REPORT_FILE}")


def _report_mission(as_json: bool, folder: Path, out: Path, from_sound_lines: bool) -> None:
    from skysweep.results.run_folder import JOURNAL_FILE, is_older, load_run
    from skysweep.results.writing import write_results

    run = load_run(folder, from_sound_lines)
    if run.left_out and out.resolve() == folder.resolve():
        raise UserError(
            f"{folder}: is damaged ({', '.join(run.left_out)}); write the sound part elsewhere with --out"
        )
    if out.resolve() != folder.resolve() and (out / JOURNAL_FILE).exists():
        raise UserError(f"--out {out}: is the folder of a mission; write one of the report's own")
    for what in run.left_out:
        warn(f"{folder}: is damaged; left out: {what}")
    if not run.has_its_plan:
        warn(
            f"{run.scenario.search.plan}: is missing, or not the plan that was flown; the time of a scan "
            "alone is left out"
        )
    if is_older(run.records):
        warn(f"{folder}: an older skysweep wrote it; some damage may go undetected")
    if not run.ended:
        warn(f"{folder}: the mission was interrupted or is still flying; these are the results so far")
    with counting("report") as count:
        summary = write_results(run, out, (run.summary or {}).get("wall_time_s"), on_step=count)
    answer_mission(as_json, out, summary)
