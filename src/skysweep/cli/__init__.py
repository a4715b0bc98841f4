"""The command line: one thin command per job."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from skysweep import __version__
from skysweep.cli import (
    bench,
    benchmark,
    calibrate,
    detection,
    doctor,
    export,
    fly,
    gym,
    missions,
    planning,
    prior,
    report,
    ros,
    scenarios,
    serve_vehicle,
    sweep,
    tune,
    video,
    view,
    world,
)
from skysweep.cli.common import tell


class _Commands(TyperGroup):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse an empty word: as a path it would be the folder from which the command was given."""
        for k, word in enumerate(() if ctx.resilient_parsing else args):
            if not word or (word.startswith("--") and word.find("=") == len(word) - 1):
                after = f" after {args[k - 1]!r}" if k and not word else word and f": {word!r}"
                ctx.fail(f"a word of the command is empty{after}; a shell variable in it may not be set")
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Plan, simulate, compare and fly UAV search-and-rescue missions.",
)


def _show_version(wanted: bool) -> None:
    if wanted:
        tell(f"skysweep {__version__}")
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show it and end.")
    ] = False,
) -> None:
    """Plan, simulate, compare and fly UAV search-and-rescue missions."""


app.command()(missions.run)
app.command()(missions.resume)
app.command()(fly.fly)
app.command()(view.view)
app.command()(planning.plan)
app.add_typer(prior.app, name="prior")
app.add_typer(scenarios.app, name="scenarios")

compare = typer.Typer(no_args_is_help=True, help="Compare strategies.")
compare.command("paper")(missions.compare_paper_command)
app.add_typer(compare, name="compare")
app.command()(sweep.sweep)
app.command()(report.report)
app.command()(export.export)
app.command()(video.video)
app.command()(tune.tune)
app.command()(benchmark.benchmark)
app.command()(serve_vehicle.serve_vehicle)
app.add_typer(ros.app, name="ros")

app.command()(detection.dataset)
app.command()(detection.train)
detect = typer.Typer(no_args_is_help=True, help="Try and evaluate detectors.")
detect.command("inspect")(detection.detect_inspect)
detect.command("evaluate")(detection.detect_evaluate)
detect.command("run")(detection.detect_run)
app.add_typer(detect, name="detect")
app.add_typer(calibrate.app, name="calibrate")
app.command()(bench.bench)
app.command()(doctor.doctor)
app.command()(gym.gym)
app.add_typer(world.app, name="world")
