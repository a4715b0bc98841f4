"""Plan a search with a prior."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from rich.table import Table

from skysweep.arrays import F64
from skysweep.cli.answers import answer, figures_table
from skysweep.cli.common import counting, lon_lat_of, refuse_to_replace, warn
from skysweep.cli.searched import coverage_of_searches
from skysweep.errors import UserError
from skysweep.files.writing import whole_files
from skysweep.geometry.frames import LocalFrame
from skysweep.mission.fence import Fence
from skysweep.planning.advice import beyond_ground
from skysweep.planning.area_files import scenario_over
from skysweep.planning.flight_plan import leg_time_s
from skysweep.planning.prior.checks import positive
from skysweep.planning.prior.map_files import read_map, write_map
from skysweep.planning.prior.maps import FARTHEST_M, ProbabilityMap
from skysweep.planning.prior.picture import draw_sortie
from skysweep.planning.prior.planned_sortie import PlannedSortie, plan_sortie
from skysweep.planning.qgc import plan_for_qgc, warnings_for_file, write_plan
from skysweep.scenarios.files import change_scenario
from skysweep.scenarios.model import Home, Scenario
from skysweep.sensing.statistical.model import model_for
from skysweep.sensing.statistical.sweep_width import sweep_width_m
from skysweep.text import percent
from skysweep.types import XY
from skysweep.worlds.world import build_terrain

_WORTH_SAYING = 0.05  # of the map, that lies outside the area
_OPTIONS = {
    "budget_m": "--budget-m",
    "sweep_width_m": "--sweep-width-m",
    "n_uavs": "--uavs",
    "seed": "--seed",
}
MAP_AFTER, REPORT = "after.npz", "sortie.json"


@dataclass(frozen=True)
class SearchOptions:
    """What the command was told of a search with a prior."""

    prior: Path
    budget_m: float
    sweep_width_m: float
    uavs: int
    start_lon_lat: str | None
    searched: list[Path]
    sweep_width_of_runs_m: float | None  # of those searched; None is that of each run's own sensor
    seed: int


def plan_with_prior(
    as_json: bool,
    options: SearchOptions,
    scenario: Scenario | None,
    changes: dict[str, float | None],
    out: Path,
) -> None:
    """Plan a sortie over a map, within the area of a scenario where there is one; write and answer it."""
    positive(options.sweep_width_m, "--sweep-width-m")
    cells = read_map(options.prior, None if scenario is None else scenario.frame)
    start = _start(options, scenario, cells.frame)
    fence = None if scenario is None else _fence(options, scenario, start)
    with _fields_as_options(options.prior):
        cells = _left_of(cells, options, scenario, None if fence is None else fence.reached_from(_xy(start)))
    way = None if fence is None else fence.way
    with counting("paths") as count, _fields_as_options(options.prior):
        sortie = plan_sortie(
            cells, start, options.budget_m, options.sweep_width_m, options.uavs, options.seed, count, way
        )
    chosen = scenario or change_scenario(_scenario_of(options.prior, sortie), changes)
    field = "safety.no_fly_enu_m" if options.start_lon_lat is None else f"--start {options.start_lon_lat}"
    for unknown in beyond_ground(field, sortie.hull, build_terrain(chosen)):
        raise UserError(unknown)  # a plan file would lead through hills there
    plans = [f"{chosen.name}-{k + 1}.plan" for k in range(options.uavs)]
    flown = None if scenario is None else scenario.search.plan
    written = [*plans, f"{chosen.name}.png", MAP_AFTER, REPORT]
    refuse_to_replace([options.prior, *options.searched, flown], *(out / name for name in written))
    drawn = [plan_for_qgc(chosen, sortie.as_coverage(k)) for k in range(options.uavs)]
    for warning in dict.fromkeys(w for plan in drawn for w in warnings_for_file(chosen, plan)):
        warn(warning)
    with whole_files(out) as unfinished:
        for name, plan in zip(plans, drawn, strict=True):
            write_plan(unfinished / name, plan)
        draw_sortie(unfinished / f"{chosen.name}.png", chosen.name, sortie)
        write_map(unfinished / MAP_AFTER, sortie.after)
        (unfinished / REPORT).write_text(json.dumps(sortie.as_json(), indent=2) + "\n", encoding="utf-8")
    paths = [str(out / name) for name in plans]
    picture, report, after = f"{out / chosen.name}.png", str(out / REPORT), str(out / MAP_AFTER)
    record = {"plans": paths, "picture": picture, "report": report, "map_after": after}
    answer(
        as_json,
        record | sortie.as_json(),
        _told(sortie, chosen.search.scan_speed_mps),
        f"plans: {', '.join(paths)}",
        f"picture: {picture}",
        f"report: {report}",
        f"map if nothing is found: {after}",
    )


@contextmanager
def _fields_as_options(prior: Path) -> Iterator[None]:
    """Errors name what the user wrote."""
    written = _OPTIONS | {"prior": f"--prior {prior}"}
    try:
        yield
    except UserError as error:
        field, colon, rest = str(error).partition(":")
        raise UserError(f"{written.get(field, field)}{colon}{rest}") from error


def width_of_sensor(scenario: Scenario | None) -> float:
    """The effective sweep width of a scenario's sensor, metres."""
    if scenario is None:
        raise UserError(
            "--sweep-width-m: is missing; write the sensor's effective sweep width, or name a scenario"
        )
    if beyond := model_for(scenario).beyond_calibration(scenario):
        warn(f"--sweep-width-m: is missing, and the sensor's is a guess. {beyond}")
    return sweep_width_m(scenario)


def _left_of(
    cells: ProbabilityMap, options: SearchOptions, scenario: Scenario | None, free: shapely.Geometry | None
) -> ProbabilityMap:
    """What is left of a map where a vehicle may fly (None: everywhere), after what was searched."""
    if scenario is not None:
        outside = 1.0 - cells.share_within(scenario.area_enu_m)
        cells = cells.within(scenario.area_enu_m)
        if outside > _WORTH_SAYING:
            left_out = percent(outside)
            warn(f"--prior {options.prior}: {left_out} of the map lies outside the area and is left out")
        if free is not None:
            closed = 1.0 - cells.share_within(free)
            if closed >= 1.0 - 1e-12:
                raise UserError(
                    f"--prior {options.prior}: lies within the area only where nobody may fly or get to; cut "
                    "safety.no_fly_enu_m, widen geofence_enu_m, or give a map of other places"
                )
            cells = cells.within(free)
            if closed > _WORTH_SAYING:
                warn(
                    f"--prior {options.prior}: {percent(closed)} of the map in the area lies in or behind "
                    "no-fly areas or outside the geofence and is left out"
                )
    coverage, _ = coverage_of_searches(
        cells, options.searched, options.sweep_width_of_runs_m, options.sweep_width_m
    )
    return cells.after_coverage(coverage)


def _fence(options: SearchOptions, scenario: Scenario, start: F64) -> Fence | None:
    """The drawn geofence and no-fly areas; None where all ways are straight."""
    fence = Fence(scenario, path_xy_enu_m=start[None])
    if fence.is_straight:
        return None
    if not fence.allows(_xy(start)):
        field = "home" if options.start_lon_lat is None else f"--start {options.start_lon_lat}"
        raise UserError(f"{field}: lies in a no-fly area or outside the geofence; start elsewhere")
    return fence


def _xy(place: F64) -> XY:
    return float(place[0]), float(place[1])


def _start(options: SearchOptions, scenario: Scenario | None, frame: LocalFrame) -> F64:
    if options.start_lon_lat is None:
        if scenario is None:
            raise UserError("--start: is missing; write where the vehicles start as LON,LAT in degrees")
        return np.array(scenario.home.position_enu_m, dtype=float)
    longitude, latitude = lon_lat_of(options.start_lon_lat, "--start")
    from_origin = frame.enu_from_geodetic([[latitude, longitude, frame.altitude_m]])
    if np.linalg.norm(from_origin) > FARTHEST_M:
        raise UserError(
            f"--start {options.start_lon_lat}: is more than {FARTHEST_M / 1e3:.0f} km from the map's origin; "
            "write LON,LAT, the longitude first, or start nearer"
        )
    return np.asarray(from_origin[0, :2])


def _scenario_of(prior: Path, sortie: PlannedSortie) -> Scenario:
    """Around the paths, as a map's file says nothing of an area."""
    frame, start = sortie.before.frame, sortie.paths_xy_m[0][0]
    home = Home(
        latitude_deg=frame.latitude_deg,
        longitude_deg=frame.longitude_deg,
        position_enu_m=(float(start[0]), float(start[1])),
    )
    corners = [(float(x), float(y)) for x, y in list(sortie.hull.exterior.coords)[:-1]]
    return scenario_over(prior, home, corners)


def _told(sortie: PlannedSortie, speed_mps: float) -> Table:
    expected = sortie.expected
    longest_s = max(
        float(leg_time_s(np.linalg.norm(np.diff(path, axis=0), axis=1), speed_mps).sum())
        for path in sortie.paths_xy_m
    )
    table = figures_table()
    table.add_row("sweep width", f"{sortie.sweep_width_m:.1f} m")
    table.add_row("paths", f"{len(sortie.paths_xy_m)}, {expected.length_m[-1]:.0f} m together")
    if sortie.unused_m > 0.0:
        table.add_row(
            "unused",
            f"{sortie.unused_m:.0f} m of the budget; bound of all of it {sortie.bound_of_budget:.1%}",
        )
    table.add_row("time", f"{longest_s / 60:.1f} min for the longest, without take-off and return")
    table.add_row("expected POS", f"{expected.pos[-1]:.1%} (exponential detection)")
    table.add_row(
        "bound", f"{expected.bound[-1]:.1%}; {expected.bound_from_start[-1]:.1%} after the way there"
    )
    table.add_row("definite range", f"{expected.definite_pos:.1%} of at most {expected.definite_bound:.1%}")
    return table
