"""Many missions: scenarios x strategies x parameters x seeds."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from skysweep.cli.common import WorkersOption, bar, duration, friendly, local_folder, say, warn
from skysweep.cli.terminal import has_keyboard
from skysweep.errors import UserError

if TYPE_CHECKING:
    from skysweep.experiments.sweep.run import Outlook

ASK_ABOVE_S = 3600.0


@friendly
def sweep(
    spec: Annotated[Path, typer.Argument(help="YAML file of the sweep; see docs/sweeps.md.")],
    out: Annotated[
        str | None, typer.Option(help="Folder or fsspec URL of the results. Default: sweeps/NAME.")
    ] = None,
    engine: Annotated[
        Literal["local", "ray"], typer.Option(help="Processes on this machine, or a Ray cluster.")
    ] = "local",
    address: Annotated[
        str | None,
        typer.Option(help="Ray's: auto, host:port or ray://host:port. Default: a Ray started here."),
    ] = None,
    workers: WorkersOption = None,
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Do not ask before a sweep of more than an hour.")
    ] = False,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Fly failed missions again.")] = False,
) -> None:
    """Fly every scenario with every strategy, parameter and seed; write one table, missions.parquet.

    The same command continues an interrupted sweep. `skysweep report DIR` makes statistics of the table.

    Examples:

        skysweep sweep my-sweep.yaml

        skysweep sweep my-sweep.yaml --out s3://bucket/my-sweep --engine ray --address auto --yes

        skysweep sweep my-sweep.yaml --retry-failed
    """
    from skysweep.experiments.engines import make_engine
    from skysweep.experiments.sweep.run import Sweep
    from skysweep.experiments.sweep.spec import load_spec

    wanted = load_spec(spec)
    if out is not None and out.startswith("memory:"):
        raise UserError(f"--out {out}: is lost when this command ends; write a folder or another URL")
    folder = out or f"sweeps/{wanted.name}"
    runner = make_engine(engine, address, workers)
    say(f"{spec}: checking the missions to fly")
    flight = Sweep(wanted, folder, retry_failed)
    done = flight.missions - flight.left
    say(
        f"{flight.configurations:,} configurations x {flight.missions // flight.configurations:,} seeds = "
        f"{flight.missions:,} missions" + (f", {done:,} of them flown already" if done else "")
    )
    failed = 0
    with bar() as progress:
        task = progress.add_task("missions", total=flight.missions, completed=done)

        def on_done(error: str | None) -> None:
            nonlocal failed
            failed += error is not None
            progress.update(task, advance=1, description=f"missions ({failed} failed)" if failed else None)

        def confirm(outlook: Outlook) -> None:
            say(
                f"about {duration(outlook.seconds)} for {outlook.missions:,} missions on "
                f"{outlook.workers} workers ({outlook.mission_s:.2g} s each)"
            )
            if outlook.seconds <= ASK_ABOVE_S or yes:
                return
            if not has_keyboard():
                raise UserError(
                    f"the sweep would take about {duration(outlook.seconds)}; add --yes to start it"
                )
            progress.stop()
            if not typer.confirm("Start?", err=True):
                raise UserError("not started; nothing was written")
            progress.start()

        try:
            flight.fly(runner, confirm, on_done)
        except KeyboardInterrupt:
            progress.stop()
            say("stopped; flown missions are kept, and the same command continues")
            raise typer.Exit(130) from None
    wrong = flight.errors()
    for error, count in Counter(wrong).most_common(3):
        warn(f"{count:,} of {flight.missions:,} missions failed: {error}")
    say(f"table: {flight.address}")
    if len(wrong) == flight.missions:
        raise typer.Exit(1)
    elsewhere = "" if local_folder(folder) else f" --out {wanted.name}-report"
    say(f"statistics: skysweep report {folder}{elsewhere}")
