"""Strategies on a versioned suite of missions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skysweep.cli import completion
from skysweep.cli.answers import JsonOption, answer
from skysweep.cli.common import WorkersOption, bar, friendly
from skysweep.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from skysweep.experiments.benchmark.run import Flown
    from skysweep.experiments.benchmark.suite import Suite
    from skysweep.experiments.matrix import Matrix


@friendly
def benchmark(
    strategy: Annotated[
        list[str] | None,
        typer.Option(
            help="A strategy beside ours: its name, or MODULE:NAME; may be repeated.",
            autocompletion=completion.strategies,
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fly few seeds: a first look in minutes.")] = False,
    reference: Annotated[
        str | None,
        typer.Option(help="Row that the others are compared with, seed by seed. Default: algorithm-1-tuned."),
    ] = None,
    break_even: Annotated[
        bool,
        typer.Option(
            "--break-even",
            help="Fly the missions with more and more look-alikes instead: when do checks pay?",
        ),
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the results. Default: benchmarks/sar-1, or -break-even.")
    ] = None,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fly the suite sar-1 with our strategies and yours; write tables, one JSON file and a page.

    Scenarios and seeds are fixed by the version of the suite, so that results can be compared. The oracle
    among the rows is no strategy: it knows where the targets are, and its time is a bound.

    The same command continues an interrupted benchmark; a larger one flies only what is missing.

    Examples:

        skysweep benchmark --quick

        skysweep benchmark --strategy my_module:MyStrategy

        skysweep benchmark --break-even
    """
    from skysweep.experiments.benchmark import BENCHMARK_PAGE, BREAK_EVEN_PAGE, break_even_report, report
    from skysweep.experiments.benchmark import break_even as pays
    from skysweep.experiments.benchmark import suite as suites

    suite = suites.load_suite()
    chosen = suites.contenders(strategy or (), pays.COMPARED if break_even else suites.OURS)
    if break_even and reference is not None:
        raise UserError("--reference: the break-even compares all with scan-only; leave it out")
    reference = reference or suites.TUNED
    strategies = [contender.name for contender in chosen if not contender.is_bound]
    if reference not in strategies:
        raise UserError(f"--reference {reference}: is not compared; write one of {', '.join(strategies)}")
    folder = out or Path("benchmarks", suite.version + ("-break-even" if break_even else ""))
    if break_even:
        seeds = suite.break_even.seeds.chosen(quick)
        flown = _fly(suite, pays.break_even_matrices(suite, strategy or (), seeds), folder, workers)
        found_even = pays.break_evens(suite, flown, strategy or ())
        record = break_even_report.write_break_even(folder, suite, found_even, seeds)
        grids = [break_even_report.prices_grid(found_even), break_even_report.cheapest_grid(found_even)]
        page = folder / BREAK_EVEN_PAGE
    else:
        seeds = suite.seeds.chosen(quick)
        flown = _fly(suite, suites.suite_matrices(suite, chosen, seeds), folder, workers)
        found = report.standings_of(suite, flown, chosen, reference)
        record = report.write_benchmark(folder, suite, found, seeds, reference)
        grids = report.overview(found, with_intervals=False)
        page = folder / BENCHMARK_PAGE
    answer(as_json, record, *grids, f"report: {page}")


def _fly(suite: Suite, matrices: Mapping[str, Matrix], folder: Path, workers: int | None) -> Flown:
    from skysweep.experiments.benchmark.run import fly_matrices

    with bar() as progress:
        task = progress.add_task("missions", total=sum(map(len, matrices.values())))
        return fly_matrices(matrices, suite.target_px, folder, workers, lambda: progress.advance(task))
