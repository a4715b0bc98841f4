"""Plan a flight over what missions missed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from skysweep.cli.answers import add_cost, answer, figures_table
from skysweep.cli.common import refuse_to_replace, warn
from skysweep.errors import UserError
from skysweep.files.writing import whole_files
from skysweep.planning.advice import warnings_for_plan
from skysweep.planning.assessment import assess
from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.picture import draw_plan
from skysweep.planning.qgc import plan_for_qgc, warnings_for_file, write_plan
from skysweep.results.gaps import (
    Gap,
    flown_again,
    gaps_geojson,
    gaps_kml,
    gaps_of,
    path_over,
)
from skysweep.results.pod import coverage_of_flights
from skysweep.results.reporting.wording import moving_words
from skysweep.results.run_folder import Run, load_run
from skysweep.scenarios.files import change_scenario, dump_scenario, with_paths_beside
from skysweep.scenarios.model import Scenario


def plan_gaps(as_json: bool, run_folders: Sequence[Path], least_pod: float, out: Path) -> None:
    """Write the gaps that runs left, and a scenario that flies over them alone; answer what they are."""
    runs = [load_run(folder) for folder in run_folders]
    coverage = coverage_of_flights(runs)
    scenario = flown_again(runs[0].scenario)
    gaps = gaps_of(coverage, scenario, least_pod)
    _warn_of_runs(runs, scenario)
    pod, low = coverage.pod()[coverage.inside], f"with a POD below {100 * least_pod:.2g} %"
    record = {
        "runs": list(map(str, run_folders)),
        "least_pod": least_pod,
        "mean_pod": float(pod.mean()),
        "gaps": [{"area_m2": gap.area_m2, "mean_pod": gap.mean_pod} for gap in gaps.to_fly],
        "small": {"patches": len(gaps.small), "area_m2": _area_m2(gaps.small)},
        "no_fly": {"patches": len(gaps.no_fly), "area_m2": _area_m2(gaps.no_fly)},
    }
    table = figures_table()
    table.add_row("mean POD", f"{pod.mean():.1%} of the area")
    together = f", {_area_m2(gaps.to_fly):,.0f} m2 together" if gaps.to_fly else ""
    table.add_row(
        "gaps", f"{len(gaps.to_fly) or ('none' if not any(gaps) else 'none to fly')} {low}{together}"
    )
    if gaps.small:
        table.add_row("small patches", f"{_patches(gaps.small)} below too, and not flown")
    if gaps.no_fly:
        table.add_row("no-fly areas", f"{_patches(gaps.no_fly)} below too, and cannot be flown")
    if not gaps.to_fly:
        answer(as_json, record, table)
        return
    name = f"{scenario.name[:74]} gaps"
    names = {kind: f"gaps.{kind}" for kind in ("yaml", "plan", "geojson", "kml", "png")}
    refuse_to_replace([run.scenario.search.plan for run in runs], *(out / name for name in names.values()))
    with whole_files(out) as unfinished:
        drawn = plan_for_qgc(scenario, path_over(gaps.to_fly, scenario))
        write_plan(unfinished / names["plan"], drawn)
        changes = {"name": name, "search.plan": str(unfinished / names["plan"])}
        again = change_scenario(with_paths_beside(scenario, Path.cwd()), changes)
        plan, estimate = plan_scenario(again)
        for warning in (
            *warnings_for_plan(again),
            *assess(plan, again).warnings(),
            *warnings_for_file(again, drawn),
        ):
            warn(warning)
        draw_plan(unfinished / names["png"], again, plan, estimate)
        again = change_scenario(again, {"search.plan": names["plan"]})
        (unfinished / names["yaml"]).write_text(dump_scenario(again), encoding="utf-8")
        (unfinished / names["geojson"]).write_bytes(gaps_geojson(gaps, scenario.frame))
        (unfinished / names["kml"]).write_bytes(gaps_kml(gaps, scenario.frame, scenario.name))
    add_cost(table, again, estimate)
    written = {kind: str(out / file) for kind, file in names.items()}
    cost = {
        "path_length_m": estimate.path_length_m,
        "time_s": estimate.time_s,
        "energy_wh": estimate.energy_wh,
        "batteries": estimate.batteries,
    }
    answer(as_json, record | cost | written, table, *(f"{kind}: {path}" for kind, path in written.items()))


def _warn_of_runs(runs: Sequence[Run], again: Scenario) -> None:
    """What of the runs is not in the figures."""
    searches = [run.scenario.search for run in runs]
    if all(search.plan is not None for search in searches):
        warn(
            f"--gaps {runs[0].folder}: flew search.plan alone; if others flew before, name them, too, each "
            "with --gaps"
        )
    if again is not runs[0].scenario:
        warn(
            f"search.strategy: {searches[0].strategy} flies no drawn plan; gaps.yaml flies scan-only at the "
            f"height from which it covers the area ({again.search.scan_altitude_agl_m:g} m)"
        )
    moving = next(filter(None, (moving_words(run.scenario) for run in runs)), None)
    if moving:
        warn(moving)


def _area_m2(gaps: Sequence[Gap]) -> float:
    return sum(gap.area_m2 for gap in gaps)


def _patches(gaps: Sequence[Gap]) -> str:
    many = len(gaps) > 1
    return f"{_area_m2(gaps):,.0f} m2 in {len(gaps)} patch{'es' * many} {'are' if many else 'is'}"


def refuse_pod(pod: float) -> None:
    """Raises UserError for what is no probability."""
    if not 0.0 < pod < 1.0:
        raise UserError(f"--pod: {pod:g} is no probability of detection; write a number between 0 and 1")
