"""List, show and check scenarios."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer
from rich.table import Table

from skysweep.cli.answers import JsonOption, answer
from skysweep.cli.common import ScenarioArg, friendly, tell

app = typer.Typer(no_args_is_help=True, help="List, show and check scenarios.")


@app.command("list")
@friendly
def scenarios_list(as_json: JsonOption = False) -> None:
    """The shipped scenarios.

    Examples:

        skysweep scenarios list

        skysweep scenarios list --json
    """
    from skysweep.scenarios.files import list_scenarios, load_scenario

    shipped = []
    for name in list_scenarios():
        s = load_scenario(name)
        generated = sum(g.count for g in s.generators if g.kind in s.target_classes)
        targets = len(s.targets) + generated
        described = {"area_m2": s.area_enu_m.area, "targets": targets, "description": s.description.strip()}
        shipped.append({"name": name, **described})
    table = Table("name", "area", "targets", "description")
    for each in shipped:
        table.add_row(
            each["name"], f"{each['area_m2'] / 1e4:.1f} ha", str(each["targets"]), each["description"]
        )
    answer(as_json, {"scenarios": shipped}, table)


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
def scenarios_validate(
    files: Annotated[list[str], typer.Argument(help="Scenario files.")], as_json: JsonOption = False
) -> None:
    """Check scenario files; exit code 2 at the first that is wrong.

    Example:

        skysweep scenarios validate my-scenario.yaml other.yaml
    """
    from skysweep.planning.advice import warnings_for
    from skysweep.scenarios.files import load_scenario

    checked = []
    for file in files:
        warnings = warnings_for(load_scenario(file))
        checked.append({"file": file, "warnings": warnings})
        if not as_json:
            for warning in warnings:
                tell(f"{file}: warning: {warning}")
            tell(f"{file}: {'usable' if warnings else 'good'}")
    answer(as_json, {"files": checked})
