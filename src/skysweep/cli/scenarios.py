"""List, show, check and write scenarios."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.table import Table

from skysweep.cli.answers import JsonOption, answer, figures_table
from skysweep.cli.common import ScenarioArg, friendly, lat_lon_of, tell, warn, working
from skysweep.scenarios.model import TargetClass

app = typer.Typer(no_args_is_help=True, help="List, show, check and write scenarios.")


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


@app.command("new")
@friendly
def scenarios_new(
    area: Annotated[Path, typer.Option(help="Area: GeoJSON, KML, KMZ or QGroundControl .plan.")],
    dem: Annotated[Path, typer.Option(help="Digital elevation model, a GeoTIFF in any CRS.")],
    out: Annotated[Path, typer.Option(help="The scenario file to write.")],
    dem_unit: Annotated[
        Literal["metres", "feet"] | None, typer.Option(help="Of its heights. Default: what it says.")
    ] = None,
    ortho: Annotated[Path | None, typer.Option(help="Orthophoto, a GeoTIFF.")] = None,
    landcover: Annotated[
        Path | None, typer.Option(help="Land cover with the classes of ESA WorldCover, a GeoTIFF.")
    ] = None,
    buildings: Annotated[
        Path | None, typer.Option(help="Footprints with OpenStreetMap's names, GeoJSON.")
    ] = None,
    roads: Annotated[Path | None, typer.Option(help="Roads with OpenStreetMap's names, GeoJSON.")] = None,
    target: Annotated[TargetClass, typer.Option(help="What is searched for.")] = "person",
    home: Annotated[
        str | None,
        typer.Option(metavar="LAT,LON", help="Take-off place. Default: open ground beside the area."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the scenario file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a scenario of your own place, from an area and an elevation model.

    Example:

        skysweep scenarios new --area area.kml --dem dem.tif --landcover worldcover.tif --out my-search.yaml
    """
    from skysweep.errors import UserError
    from skysweep.files.writing import replace_file
    from skysweep.planning.advice import warnings_for
    from skysweep.planning.new_scenario import draft_scenario, understood

    if out.exists() and not overwrite:
        raise UserError(f"--out {out}: exists; write another, or --overwrite to replace it")
    if not out.absolute().parent.is_dir():
        raise UserError(f"--out {out}: there is no folder {out.parent}; make it, or choose another")
    given = {
        "terrain.dem": dem,
        "terrain.land_cover": landcover,
        "terrain.orthophoto": ortho,
        "buildings_file": buildings,
        "roads_file": roads,
    }
    files = {field: path for field, path in given.items() if path is not None}
    place = None if home is None else lat_lon_of(home, "--home")
    with working("reading the ground"):
        draft = draft_scenario(area, files, out, target, place, dem_unit)
    scenario, estimate = draft.scenario, draft.estimate
    for warning in warnings_for(scenario):
        warn(warning)
    replace_file(out, draft.text.encode("utf-8"))
    found = dict(understood(scenario))
    at, search = scenario.home, scenario.search
    found |= {
        "area": f"{estimate.area_m2 / 1e4:.2f} ha",
        "home": f"{at.latitude_deg:.5f}, {at.longitude_deg:.5f}, {at.altitude_amsl_m:.0f} m AMSL",
        "scan": f"from {search.scan_altitude_agl_m:g} m, {estimate.pixels_on_target:.0f} px on a {target}",
        "plan": f"{estimate.time_s / 60:.0f} min, batteries: {estimate.batteries}",
    }
    table = figures_table()
    for what, value in found.items():
        table.add_row(what, value)
    answer(as_json, {"scenario": str(out), **found}, table, f"scenario: {out}")
