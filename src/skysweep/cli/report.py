"""Report what a sweep shows."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skysweep.cli.common import bar, console, friendly, local_folder


@friendly
def report(
    folder: Annotated[
        str, typer.Argument(metavar="DIR", help="Folder or URL of a sweep or of a comparison with the paper.")
    ],
    out: Annotated[Path | None, typer.Option(help="Where the report goes. Default: DIR/report.")] = None,
    min_recall: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Mean recall that the best configuration must have.")
    ] = 0.95,
) -> None:
    """Say what the missions of a sweep show, with intervals, tests, tables and figures in one report.html.

    The best of a scenario: of the configurations that reach --min-recall, those whose recall is not
    distinguishable from the highest; of these, those whose false positives are not distinguishable from the
    fewest; of these, the fastest. A sweep that still runs is reported as far as it is.

    Examples:

        skysweep report my-sweep

        skysweep report my-sweep --min-recall 0.9 --out my-report

        skysweep report s3://bucket/my-sweep --out my-report
    """
    from skysweep.errors import UserError
    from skysweep.experiments.sweep_matrix import Matrix
    from skysweep.experiments.sweep_spec import parse_spec
    from skysweep.results.sweep_missions import load_missions
    from skysweep.results.sweep_report import REPORT_FILE, write_sweep_report

    target = out
    if target is None:
        here = local_folder(folder)
        if here is None:
            raise UserError(f"{folder}: is not on this computer; say with --out where the report goes")
        target = here / "report"
    missions = load_missions(folder, lambda spec: Matrix.of(parse_spec(spec, f"{folder}/spec.yaml")).table())
    with bar() as progress:
        task = progress.add_task("report", total=None)
        sentences = write_sweep_report(
            missions,
            target,
            min_recall,
            on_step=lambda done, of: progress.update(task, completed=done, total=of),
        )
    for sentence in sentences:
        console.print(sentence, soft_wrap=True, highlight=False, markup=False)
    console.print(f"report: {target / REPORT_FILE}", soft_wrap=True)
