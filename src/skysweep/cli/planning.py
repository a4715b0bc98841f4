"""Plan the coverage of an area."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from skysweep.cli import completion
from skysweep.cli.answers import JsonOption, add_cost, answer, figures_table
from skysweep.cli.common import counting, friendly, refuse_to_replace, scenario_or_area, warn
from skysweep.files.writing import whole_files


@friendly
def plan(
    source: Annotated[
        str | None,
        typer.Argument(
            help="Scenario (name or YAML) or area (GeoJSON, KML, KMZ, QGroundControl .plan).",
            autocompletion=completion.scenarios,
        ),
    ] = None,
    altitude: Annotated[float | None, typer.Option(help="Scan altitude, m above ground.")] = None,
    sidelap: Annotated[float | None, typer.Option(help="Share of the swath that neighbours share.")] = None,
    heading: Annotated[float | None, typer.Option(help="Compass heading of the transects.")] = None,
    hfov: Annotated[float | None, typer.Option(help="Horizontal field of view of the camera, rad.")] = None,
    speed: Annotated[float | None, typer.Option(help="Scan speed, m/s.")] = None,
    prior: Annotated[
        Path | None,
        typer.Option(help="Map of where the target may be (.tif, .npz, .csv): search where it pays."),
    ] = None,
    budget_m: Annotated[float | None, typer.Option(help="Length of all paths, m.")] = None,
    sweep_width_m: Annotated[
        float | None,
        typer.Option(help="Effective sweep width, m. Default: of the scenario's calibrated sensor."),
    ] = None,
    uavs: Annotated[int, typer.Option(help="Vehicles that share the budget.")] = 1,
    start: Annotated[
        str | None, typer.Option(metavar="LON,LAT", help="Where they start. Default: the scenario's home.")
    ] = None,
    searched: Annotated[
        list[Path] | None,
        typer.Option(
            help="Run folder or .plan that was flown and found nothing; may be repeated.",
            autocompletion=completion.runs,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Which of equally good paths.")] = 0,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="Of take-off, as 2026-10-03T15:30+02:00: where the sun stands then."
        ),
    ] = None,
    advise: Annotated[
        bool, typer.Option("--advise", help="Compare altitudes, speeds and overlaps before any is flown.")
    ] = False,
    gaps: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="RUN_DIR",
            help="A flown mission: plan what it missed, to fly it again; repeat it for all flights so far.",
            autocompletion=completion.runs,
        ),
    ] = None,
    pod: Annotated[
        float | None,
        typer.Option(
            help="Probability of detection: wanted of --advise (default 0.8); less is a gap (default 0.5)."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the .plan files and the picture. Default: plan.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Plan the coverage of an area: length, time, batteries, a QGroundControl plan and a picture.

    The area is covered from the altitude of the scenario's strategy. It also says which ground no picture
    shows, how high the vehicle flies over hills, and where the radio does not reach it. With --prior: the
    paths that probably find most within a length, what they may find, and the map if they find nothing.

    Examples:

        skysweep plan clusters

        skysweep plan my-area.kml --altitude 40 --sidelap 0.3 --out saturday

        skysweep plan clusters --advise

        skysweep plan --gaps runs/monday --pod 0.6 --out tuesday

        skysweep plan --prior map.tif --budget-m 20000 --sweep-width-m 30 --uavs 2 --start 22.1,60.2
    """
    from skysweep.errors import UserError
    from skysweep.planning.advice import warnings_for_any_path, warnings_for_plan
    from skysweep.planning.assessment import assess
    from skysweep.planning.flight_plan import plan_scenario
    from skysweep.planning.picture import draw_plan
    from skysweep.planning.qgc import plan_for_qgc, warnings_for_file, write_plan
    from skysweep.planning.sun import moment_of
    from skysweep.scenarios.files import change_scenario
    from skysweep.strategies.covering import as_covered

    changes = {
        "search.scan_altitude_agl_m": altitude,
        "search.sidelap": sidelap,
        "search.transect_heading_deg": heading,
        "search.scan_speed_mps": speed,
        "camera.hfov_rad": hfov,
    }
    folder = out or Path("plan")
    if pod is not None:
        from skysweep.cli.plan_gaps import refuse_pod

        refuse_pod(pod)
        if not advise and not gaps:
            raise UserError("--pod: belongs to --advise and --gaps; add one of them, or leave it out")
    of_prior = uavs != 1 or searched or any(v is not None for v in (budget_m, sweep_width_m, start))
    if gaps:
        of_plan = advise or any(v is not None for v in (source, prior, at, *changes.values()))
        if of_plan or of_prior:
            raise UserError("--gaps: flies a run's own scenario again; write only --pod and --out beside it")
        from skysweep.cli.plan_gaps import plan_gaps

        plan_gaps(as_json, gaps, 0.5 if pod is None else pod, folder)
        return
    chosen = None
    if source is not None:
        chosen = change_scenario(scenario_or_area(source), changes)
    if prior is not None:
        if advise or at is not None:
            raise UserError("--advise, --at: are of transects, which --prior has none of; leave them out")
        if sidelap is not None or heading is not None:
            raise UserError(
                "--sidelap, --heading: are of transects, which --prior has none of; leave them out"
            )
        if budget_m is None:
            raise UserError("--budget-m: is missing; write the length of all paths in metres")
        from skysweep.cli.plan_prior import SearchOptions, plan_with_prior, width_of_sensor

        for warning in warnings_for_any_path(chosen) if chosen is not None else []:
            warn(warning)
        width_m = sweep_width_m if sweep_width_m is not None else width_of_sensor(chosen)
        options = SearchOptions(prior, budget_m, width_m, uavs, start, searched or [], sweep_width_m, seed)
        plan_with_prior(as_json, options, chosen, changes, folder)
        return
    if of_prior:
        raise UserError(
            "--prior: is missing; name the map of where the target may be, or leave its options out"
        )
    if chosen is None or source is None:
        raise UserError("SOURCE: is missing; write a scenario or an area, or a map with --prior")
    if advise:
        if out is not None or at is not None:
            raise UserError("--out, --at: belong to a plan, which --advise writes none of; leave them out")
        from skysweep.cli.plan_advice import answer_advice

        given = {"--heading": heading, "--hfov": hfov}
        words = "".join(f" {name} {value:g}" for name, value in given.items() if value is not None)
        answer_advice(as_json, source, chosen, 0.8 if pod is None else pod, words)
        return
    picture, plan_file = (folder / f"{chosen.name}.{kind}" for kind in ("png", "plan"))
    refuse_to_replace([source, chosen.search.plan], picture, plan_file)
    covered = as_covered(chosen)
    for warning in warnings_for_plan(chosen, covered.search.scan_altitude_agl_m):
        warn(warning)
    moment = None if at is None else moment_of(at, "--at")
    with counting(f"planning {chosen.name}") as count:
        count(0, 3)
        coverage, estimate = plan_scenario(covered)
        count(1, 3)
        judged = assess(coverage, covered, moment)
        count(2, 3)
        with whole_files(folder) as unfinished:
            draw_plan(unfinished / picture.name, covered, coverage, estimate)
            drawn = plan_for_qgc(covered, coverage)
            write_plan(unfinished / plan_file.name, drawn)
        count(3, 3)
    for warning in (*judged.warnings(), *warnings_for_file(covered, drawn)):
        warn(warning)
    table = figures_table()
    table.add_row("area", f"{estimate.area_m2 / 1e4:.2f} ha")
    table.add_row("transects", f"{estimate.n_transects}, heading {coverage.heading_deg:.0f}\N{DEGREE SIGN}")
    add_cost(table, chosen, estimate)
    table.add_row("ground sample distance", f"{estimate.gsd_cm:.1f} cm")
    table.add_row("pixels on the smallest target", f"{estimate.pixels_on_target:.1f}")
    for name, value in judged.rows():
        table.add_row(name, value)
    written = {"plan": str(plan_file), "picture": str(picture)}
    figures = {**asdict(estimate), "heading_deg": coverage.heading_deg, **judged.record()}
    record = {"scenario": chosen.name, **figures, **written}
    answer(as_json, record, table, *(f"{what}: {path}" for what, path in written.items()))
