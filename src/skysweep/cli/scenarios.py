"""List, show, check and write scenarios."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.table import Table

from skysweep.cli.answers import JsonOption, answer, figures_table
from skysweep.cli.common import (
    ScenarioArg,
    friendly,
    lat_lon_of,
    refuse_to_replace,
    tell,
    warn,
    working,
)

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
    """Check scenario files without flying; exit code 2 at the first that is wrong or cannot be flown.

    Example:

        skysweep scenarios validate my-scenario.yaml other.yaml
    """
    from skysweep.errors import UserError
    from skysweep.flights.refusals import refuse_unflyable, unusable_sensors
    from skysweep.planning.advice import warnings_for
    from skysweep.scenarios.files import load_scenario
    from skysweep.strategies.fields import checked

    told = []
    for file in files:
        scenario = load_scenario(file)
        try:
            warnings = [*warnings_for(checked(scenario)), *unusable_sensors(scenario)]
            refuse_unflyable(scenario)
        except UserError as error:
            raise UserError(f"{file}: {error}") from None
        told.append({"file": file, "warnings": warnings})
        if not as_json:
            for warning in warnings:
                tell(f"{file}: warning: {warning}")
            tell(f"{file}: {'usable' if warnings else 'good'}")
    answer(as_json, {"files": told})


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
    target: Annotated[str, typer.Option(help="What is searched for: person, boat or stop sign.")] = "person",
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
    refuse_to_replace([area, *files.values()], out)
    place = None if home is None else lat_lon_of(home, "--home")
    with working("reading the ground"):
        draft = draft_scenario(area, files, out, target, place, dem_unit)
    scenario, estimate = draft.scenario, draft.estimate
    for warning in warnings_for(scenario):
        warn(warning)
    replace_file(out, draft.text.encode("utf-8"))
    found, home_at = understood(scenario), scenario.home
    record = {
        "scenario": str(out),
        **asdict(found),
        "area_m2": estimate.area_m2,
        "home_lat_lon_deg": [home_at.latitude_deg, home_at.longitude_deg],
        "home_altitude_amsl_m": home_at.altitude_amsl_m,
        "scan_altitude_agl_m": scenario.search.scan_altitude_agl_m,
        "pixels_on_target": estimate.pixels_on_target,
        "time_s": estimate.time_s,
        "batteries": estimate.batteries,
    }
    table = figures_table()
    table.add_row("elevation", f"{found.dem_crs}, every {found.dem_pixel_m:.2g} m")
    assumed = "" if found.dem_states_unit else "; the file states no unit: if they are feet, --dem-unit feet"
    table.add_row("heights", f"{found.lowest_amsl_m:.0f} to {found.highest_amsl_m:.0f} m AMSL{assumed}")
    table.add_row("holes filled", f"{found.filled:.2%} of the ground" if found.filled else "none")
    if found.orthophoto_pixel_m is not None:
        table.add_row(
            "orthophoto", f"{found.orthophoto_crs}, {100 * found.orthophoto_pixel_m:.3g} cm a pixel"
        )
    if found.surfaces is not None and found.land_covered is not None:
        most = sorted(found.surfaces.items(), key=lambda each: -each[1])
        shares = ", ".join(f"{share:.0%} {name}" for name, share in most if share >= 0.005)
        table.add_row("land cover", f"{shares}; known of {found.land_covered:.0%} of the ground")
    table.add_row("trees, buildings", f"{found.trees:,}, {found.buildings:,}")
    table.add_row("area", f"{estimate.area_m2 / 1e4:.2f} ha")
    table.add_row(
        "home",
        f"{home_at.latitude_deg:.5f}, {home_at.longitude_deg:.5f}, {home_at.altitude_amsl_m:.0f} m AMSL",
    )
    table.add_row(
        "scan",
        f"from {scenario.search.scan_altitude_agl_m:g} m, {estimate.pixels_on_target:.0f} px on a {target}",
    )
    table.add_row("plan", f"{estimate.time_s / 60:.0f} min, batteries: {estimate.batteries}")
    answer(as_json, record, table, f"scenario: {out}")
