"""Worlds for other simulators."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.table import Table

from skysweep.cli.answers import JsonOption, answer
from skysweep.cli.common import (
    ScenarioArg,
    SeedOption,
    SetOption,
    bar,
    chosen_scenario,
    friendly,
    tell,
    working,
)

app = typer.Typer(no_args_is_help=True, help="Worlds for Gazebo.")


@app.command("export")
@friendly
def world_export(
    scenario: ScenarioArg,
    out: Annotated[Path, typer.Option(help="New or empty folder.")],
    fmt: Annotated[
        Literal["gazebo-classic", "gz"],
        typer.Option("--format", help="Gazebo Classic 11, or Gazebo (gz-sim) Harmonic and newer."),
    ] = "gazebo-classic",
    seed: SeedOption = 0,
    change: SetOption = None,
) -> None:
    """Write the world of a scenario for Gazebo: ground, trees, buildings, targets, look-alikes, light.

    The folder holds everything; the command that opens it is printed.

    Examples:

        skysweep world export clusters --out clusters-world

        skysweep world export maritime --format gz --seed 7 --out sea
    """
    from skysweep.gazebo.export import export_world

    chosen = chosen_scenario(scenario, change)
    with working(f"writing {out}"):
        path = export_world(chosen, seed, out, fmt)
    models = (out / "models").resolve()
    opens = {
        "gazebo-classic": f"GAZEBO_MODEL_DATABASE_URI= GAZEBO_MODEL_PATH={models} gazebo {path}",
        "gz": f"GZ_SIM_RESOURCE_PATH={models} gz sim {path}",
    }
    tell(f"open it with:  {opens[fmt]}")


@app.command("transfer")
@friendly
def world_transfer(
    scenario: ScenarioArg,
    pictures: Annotated[int, typer.Option(min=1, max=100_000, help="Views at each of h_S and h_C.")] = 100,
    seed: SeedOption = 0,
    change: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print the detector's recall on Gazebo's pictures beside its recall on ours from the same places.

    Example:

        skysweep world transfer clusters --pictures 200
    """
    from scipy.stats import binomtest

    from skysweep.experiments.calibration.gazebo import transfer
    from skysweep.flights.build import make_detector

    chosen = chosen_scenario(scenario, change)
    with bar() as progress:
        task = progress.add_task("views", total=2 * pictures)
        scores = transfer(chosen, make_detector(chosen, 2), pictures, seed, lambda: progress.advance(task))
    table = Table("altitude", "pictures of", "targets", "recall", f"at c_t = {chosen.search.c_t:g}", "false")
    for s in scores:
        shares = []
        for count in (s.n_found, s.n_confirming):
            likely = binomtest(count, s.n_targets).proportion_ci(method="wilson")
            shares.append(f"{count / s.n_targets:.1%} ({likely.low:.1%} to {likely.high:.1%})")
        table.add_row(f"{s.altitude_agl_m:g} m", s.renderer, str(s.n_targets), *shares, str(s.n_false))
    record = {"c_t": chosen.search.c_t, "scores": [asdict(s) | {"recall": s.recall} for s in scores]}
    answer(as_json, record, table)
