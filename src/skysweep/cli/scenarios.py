"""List, show and check scenarios."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer
from rich.table import Table

from skysweep.cli.common import ScenarioArg, console, friendly, tell

app = typer.Typer(no_args_is_help=True, help="List, show and check scenarios.")


@app.command("list")
@friendly
def scenarios_list() -> None:
    """The shipped scenarios."""
    from skysweep.scenarios.files import list_scenarios, load_scenario

    table = Table("name", "area", "targets", "description")
    for name in list_scenarios():
        s = load_scenario(name)
        generated = sum(g.count for g in s.generators if g.kind in s.target_classes)
        table.add_row(
            name, f"{s.area_enu_m.area / 1e4:.1f} ha", str(len(s.targets) + generated), s.description.strip()
        )
    console.print(table)


@app.command("show")
@friendly
def scenarios_show(
    scenario: ScenarioArg,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema instead.")] = False,
) -> None:
    """The whole scenario, every default filled in.

    Example:

        skysweep scenarios show clusters > my-scenario.yaml
    """
    from skysweep.scenarios.files import dump_scenario, json_schema, load_scenario

    text = json.dumps(json_schema(), indent=2) if schema else dump_scenario(load_scenario(scenario))
    sys.stdout.write(text.rstrip() + "\n")


@app.command("validate")
@friendly
def scenarios_validate(files: Annotated[list[str], typer.Argument(help="Scenario files.")]) -> None:
    """Check scenario files; exit code 2 at the first that is wrong."""
    from skysweep.planning.advice import warnings_for
    from skysweep.scenarios.files import load_scenario

    for file in files:
        warnings = warnings_for(load_scenario(file))
        for warning in warnings:
            tell(f"{file}: warning: {warning}")
        tell(f"{file}: {'usable' if warnings else 'good'}")
