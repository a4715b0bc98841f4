"""Plan a flight over what a mission missed."""

from __future__ import annotations

from pathlib import Path

from skysweep.cli.answers import answer, figures_table
from skysweep.errors import UserError
from skysweep.files.writing import whole_files
from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.picture import draw_plan
from skysweep.planning.qgc import plan_for_qgc, write_plan
from skysweep.results.gaps import gaps_geojson, gaps_kml, gaps_of, path_over
from skysweep.results.pod import coverage_of
from skysweep.results.run_folder import load_run
from skysweep.scenarios.files import change_scenario, dump_scenario, with_paths_beside


def plan_gaps(as_json: bool, run_folder: Path, least_pod: float, out: Path) -> None:
    """Write the gaps of a run, and a scenario that flies over them alone; answer what they are."""
    run = load_run(run_folder)
    coverage, scenario = coverage_of(run), run.scenario
    gaps = gaps_of(coverage, scenario, least_pod)
    pod = coverage.pod()[coverage.inside]
    area_m2 = sum(gap.polygon.area for gap in gaps)
    record = {
        "run": str(run_folder),
        "least_pod": least_pod,
        "mean_pod": float(pod.mean()),
        "gaps": [{"area_m2": gap.polygon.area, "mean_pod": gap.mean_pod} for gap in gaps],
    }
    table = figures_table()
    table.add_row("mean POD", f"{pod.mean():.1%} of the area")
    if not gaps:
        table.add_row("gaps", f"none with a POD below {100 * least_pod:.2g} %")
        answer(as_json, record, table)
        return
    name = f"{scenario.name[:74]} gaps"
    names = {kind: f"gaps.{kind}" for kind in ("yaml", "plan", "geojson", "kml", "png")}
    with whole_files(out) as unfinished:
        write_plan(unfinished / names["plan"], plan_for_qgc(scenario, path_over(gaps, scenario)))
        changes = {"name": name, "search.plan": str(unfinished / names["plan"])}
        again = change_scenario(with_paths_beside(scenario, Path.cwd()), changes)
        plan, estimate = plan_scenario(again)
        draw_plan(unfinished / names["png"], again, plan, estimate)
        again = change_scenario(again, {"search.plan": names["plan"]})
        (unfinished / names["yaml"]).write_text(dump_scenario(again), encoding="utf-8")
        (unfinished / names["geojson"]).write_bytes(gaps_geojson(gaps, scenario.frame))
        (unfinished / names["kml"]).write_bytes(gaps_kml(gaps, scenario.frame, scenario.name))
    low = f"{len(gaps)} with a POD below {100 * least_pod:.2g} %"
    table.add_row("gaps", f"{low}, {area_m2 / 1e4:.2f} ha together")
    table.add_row("path length", f"{estimate.path_length_m:.0f} m")
    table.add_row("time", f"{estimate.time_s / 60:.1f} min with take-off, return and landing, without checks")
    written = {kind: str(out / file) for kind, file in names.items()}
    record |= {"path_length_m": estimate.path_length_m, "time_s": estimate.time_s, **written}
    answer(as_json, record, table, *(f"{kind}: {path}" for kind, path in written.items()))


def refuse_pod(pod: float) -> None:
    """Raises UserError for what is no probability."""
    if not 0.0 < pod < 1.0:
        raise UserError(f"--pod: {pod:g} is no probability of detection; write a number between 0 and 1")
