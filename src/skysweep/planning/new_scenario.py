"""A scenario over real ground, drafted from an area and the files of its ground."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import shapely

from skysweep.errors import UserError
from skysweep.files.plain_yaml import dump_yaml
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.area_files import fence_of, plain_name, read_area
from skysweep.planning.flight_plan import FlightEstimate, plan_scenario
from skysweep.planning.qgc import read_plan
from skysweep.scenarios.files import parse_scenario, with_paths_beside
from skysweep.scenarios.model import DEFAULT_SIZE_M, Scenario, TargetClass
from skysweep.types import XY
from skysweep.worlds.obstacles import Obstacles, known_obstacles
from skysweep.worlds.world import elevation_of, ground_picture_of, land_cover_of, mapped_buildings

_CAMERA = {"width_px": 3840, "height_px": 2160, "hfov_rad": 1.2, "rate_hz": 2.0}
_VEHICLE = {"cruise_speed_mps": 10.0, "battery_wh": 400.0}
_DETECTOR = {"rate_hz": 0.5}
_SCAN_PX, _CHECK_PX = 24.0, 110.0
_HIGHEST_SCAN_M = 80.0
_OVER_TREES_M = 8.0
_TARGETS = 3
_OUTSIDE_M = 15.0  # of the area, where home is looked for
_HOMES = 300
_STEEPEST_HOME_DEG = 8.0
_CLEAR_M = 12.0  # of trees and buildings around home
_HEADER = (
    "# Written by 'skysweep scenarios new'. The vehicle and the camera are examples: write yours, then try\n"
    "#   skysweep plan {name}\n"
)


@dataclass(frozen=True)
class Draft:
    """A scenario and the text of its file."""

    text: str
    scenario: Scenario
    estimate: FlightEstimate


def draft_scenario(
    area: Path,
    files: Mapping[str, Path],
    out: Path,
    target: str,
    home_lat_lon: tuple[float, float] | None = None,
    dem_unit: str | None = None,
) -> Draft:
    """A scenario that searches an area for ``target`` and can be flown, to be written to ``out``.

    ``files`` are those of the ground by field, as ``ground_files`` has them, ``terrain.dem`` among them. Home
    is the one given, that of a ``.plan``, or open, level and dry ground just outside the area, near its
    middle. A plan's fence is kept. Raises UserError where a file is not what it should be, or does not cover
    the area.
    """
    if target not in get_args(TargetClass):
        raise UserError(
            f"--target {target}: is nothing to search for; write {', '.join(get_args(TargetClass))}"
        )
    folder = out.absolute().parent
    fields: dict[str, Any] = {
        "name": plain_name(out),
        "description": f"A search for a {target} in {area.stem}",
        "area": {"file": _beside(area, folder)},
        "home": {},
        "terrain": {"surface": "water"} if target == "boat" else {},
    }
    for field, path in files.items():
        section = fields["terrain"] if field.startswith("terrain.") else fields
        section[field.removeprefix("terrain.")] = _beside(path, folder)
    if dem_unit is not None:
        fields["terrain"]["dem_unit"] = dem_unit
    fields["generators"] = [{"class": target, "pattern": "uniform", "count": _TARGETS, "seed": None}]
    fields |= {"camera": dict(_CAMERA), "vehicle": dict(_VEHICLE), "detector": dict(_DETECTOR)}

    def scenario_of(text: str) -> Scenario:
        return with_paths_beside(parse_scenario(text, str(out), folder), folder)

    plan = read_plan(area) if area.suffix.lower() == ".plan" else None
    if home_lat_lon is None and plan is not None:
        home_lat_lon = plan.mission.plannedHomePosition[:2]
    if home_lat_lon is None:
        home_lat_lon = _home(fields, area, scenario_of)
    latitude_deg, longitude_deg = (round(degrees, 7) for degrees in home_lat_lon)
    fields["home"] = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg}
    ground = elevation_of(scenario_of(dump_yaml(fields)))
    assert ground is not None
    home_amsl_m = fields["home"]["altitude_amsl_m"] = round(ground.home_amsl_m, 1)
    if plan is not None:
        fields |= fence_of(area, plan, LocalFrame(latitude_deg, longitude_deg, home_amsl_m))
    fields["search"] = _search(target, scenario_of(dump_yaml(fields)))
    _, estimate = plan_scenario(scenario_of(dump_yaml(fields)))
    fields["vehicle"]["batteries"] = estimate.batteries + 1  # checks take theirs
    text = _HEADER.format(name=out.name) + dump_yaml(fields)
    return Draft(text, scenario_of(text), estimate)


@dataclass(frozen=True)
class Understood:
    """What the files of a scenario's ground hold. Of those that are not given, nothing is known (None)."""

    dem_crs: str
    dem_pixel_m: float
    dem_states_unit: bool  # of its heights; else metres are assumed
    lowest_amsl_m: float
    highest_amsl_m: float
    filled: float  # share of the ground without a height in the file
    orthophoto_crs: str | None
    orthophoto_pixel_m: float | None
    surfaces: dict[str, float] | None  # their shares of the ground
    land_covered: float | None  # share of the ground that the land cover tells of
    trees: int
    buildings: int


def understood(scenario: Scenario) -> Understood:
    """What was made of the files of a drafted scenario's ground."""
    dem, cover, picture = elevation_of(scenario), land_cover_of(scenario), ground_picture_of(scenario)
    assert dem is not None
    surfaces = None
    if cover is not None:
        shares = np.bincount(cover.surfaces.ravel(), minlength=len(cover.names)) / cover.surfaces.size
        surfaces = {
            name: float(share) for name, share in zip(cover.names, shares, strict=True) if share > 0.0
        }
    obstacles = known_obstacles(scenario)
    buildings = len(scenario.buildings) + len(mapped_buildings(scenario))
    return Understood(
        dem.source.crs.name,
        dem.source.pixel_m,
        dem.states_unit,
        float(dem.heights_m.min()) + dem.home_amsl_m,
        float(dem.heights_m.max()) + dem.home_amsl_m,
        dem.filled,
        None if picture is None else picture.source.crs.name,
        None if picture is None else picture.pixel_m,
        surfaces,
        None if cover is None else cover.covered,
        len(obstacles.solids) - buildings,
        buildings,
    )


def _search(target: str, scenario: Scenario) -> dict[str, float]:
    """Heights from which the smallest target spans enough pixels, above all trees; n_c as in the examples.

    The scan is as fast as the vehicle keeps up against the wind.
    """
    obstacles = known_obstacles(scenario)
    against_wind_mps = scenario.safety.air_speed_max_mps - scenario.wind.mean_speed_mps
    focal_px = _CAMERA["width_px"] / 2 / math.tan(_CAMERA["hfov_rad"] / 2)
    size_m = DEFAULT_SIZE_M[target]
    tops_m = obstacles.solids[:, 8] - obstacles.terrain.height_m(obstacles.solids[:, :2])
    lowest_m, ceiling_m = float(tops_m.max(initial=0.0)) + _OVER_TREES_M, scenario.safety.altitude_max_agl_m
    if lowest_m >= ceiling_m:
        place = [[*obstacles.solids[np.argmax(tops_m), :2], 0.0]]
        latitude, longitude, _ = scenario.frame.geodetic_from_enu(place)[0].tolist()
        raise UserError(
            f"{scenario.buildings_file}: holds a building of {tops_m.max():.0f} m at {latitude:.5f}, "
            f"{longitude:.5f}, and the ceiling is {ceiling_m:g} m (safety.altitude_max_agl_m): draw the area "
            "clear of it, leave it out here, and keep away from it with safety.no_fly_enu_m"
        )
    scan_m = math.floor(max(min(size_m * focal_px / _SCAN_PX, _HIGHEST_SCAN_M), lowest_m))
    check_m = math.floor(min(max(size_m * focal_px / _CHECK_PX, scan_m / 3), 0.75 * scan_m))
    return {
        "n_c": 3.0,
        "scan_altitude_agl_m": float(scan_m),
        "check_altitude_agl_m": float(check_m),
        "scan_speed_mps": math.floor(10.0 * min(scenario.vehicle.cruise_speed_mps, against_wind_mps)) / 10.0,
        "check_speed_mps": 4.0,
    }


def _home(
    fields: Mapping[str, Any], area: Path, scenario_of: Callable[[str], Scenario]
) -> tuple[float, float]:
    """Latitude and longitude of open, level ground outside the area, as near to its middle as can be."""
    polygon, frame = read_area(area)
    middle = {"latitude_deg": frame.latitude_deg, "longitude_deg": frame.longitude_deg}
    obstacles = known_obstacles(scenario_of(dump_yaml({**fields, "home": middle})))
    terrain = obstacles.terrain
    round_it = shapely.Polygon(polygon.exterior).buffer(_OUTSIDE_M).exterior
    places = shapely.get_coordinates(
        shapely.line_interpolate_point(
            round_it, np.linspace(0.0, 1.0, _HOMES, endpoint=False), normalized=True
        )
    )
    away_m = np.hypot(*(places - shapely.get_coordinates(polygon.centroid)[0]).T)
    on_water = None
    for k in np.argsort(away_m, kind="stable"):
        x, y = places[k].tolist()
        is_open = obstacles.top_within_m(places[k : k + 1], _CLEAR_M)[0] == -math.inf
        if is_open and _slope_deg(obstacles, (x, y)) <= _STEEPEST_HOME_DEG:
            latitude, longitude, _ = frame.geodetic_from_enu([[x, y, 0.0]])[0].tolist()
            if terrain.surface_at(x, y) != "water":
                return latitude, longitude
            on_water = on_water or (latitude, longitude)
    if on_water and fields["terrain"].get("surface") == "water":  # where no land cover tells of land
        return on_water
    raise UserError(
        f"{area}: has no open and level ground beside it to take off from; choose a place with --home"
    )


def _slope_deg(obstacles: Obstacles, xy: XY) -> float:
    steps = _CLEAR_M * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    east, west, north, south = obstacles.terrain.height_m(np.array(xy) + steps)
    return math.degrees(math.atan(math.hypot(east - west, north - south) / (2 * _CLEAR_M)))


def _beside(path: Path, folder: Path) -> str:
    """The path from the scenario's folder, so that both can be moved together."""
    try:
        return Path(os.path.relpath(path.absolute(), folder)).as_posix()
    except ValueError:  # another drive
        return str(path.absolute())
