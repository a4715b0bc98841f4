"""Worlds for other simulators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from skysweep.cli.common import ScenarioArg, SeedOption, SetOption, changes_of, console, errors, friendly

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
    from skysweep.scenarios.files import change_scenario, load_scenario

    chosen = change_scenario(load_scenario(scenario), changes_of(change))
    with errors.status(f"writing {out}"):
        path = export_world(chosen, seed, out, fmt)
    models = (out / "models").resolve()
    opens = {
        "gazebo-classic": f"GAZEBO_MODEL_DATABASE_URI= GAZEBO_MODEL_PATH={models} gazebo {path}",
        "gz": f"GZ_SIM_RESOURCE_PATH={models} gz sim {path}",
    }
    console.print(f"open it with:  {opens[fmt]}", soft_wrap=True, highlight=False)
