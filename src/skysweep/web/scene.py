"""What the page draws before anything has happened: area, ground, objects, camera, search."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from skysweep.errors import UserError
from skysweep.files.line_file import scan_lines
from skysweep.geometry.grids import utm_of
from skysweep.results.journal_lines import can_be_told
from skysweep.results.run_folder import CONFIG_FILE, JOURNAL_FILE, digest_of_config
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.web.coverage import grid_of
from skysweep.web.feed import is_finite
from skysweep.web.places import refuse_link
from skysweep.web.versions import newer_version
from skysweep.worlds.world import TerrainSurface, World, build_terrain, build_world

_MOST_HEIGHTS = 200  # a side
_HEAD_BYTES = 1 << 13  # of a journal: more than its first two lines have
_MOST_OBJECTS = 20_000


def head_of(folder: Path) -> dict[str, Any]:
    """The fields of a journal's first line and of its ``start``; empty where there are none yet.

    Raises UserError if a later skysweep wrote them, they are no mission's, or the configuration is not that
    of the journal.
    """
    for name in (JOURNAL_FILE, CONFIG_FILE):
        refuse_link(folder / name)
    if not (folder / JOURNAL_FILE).is_file():
        return {}
    try:
        with (folder / JOURNAL_FILE).open("rb") as file:
            records = scan_lines(file.read(_HEAD_BYTES)).records
    except OSError:
        return {}
    head: dict[str, Any] = {}
    for record in records:
        if record.get("kind") in ("setup", "start"):
            head |= record
            if not (can_be_told(record) and is_finite(record)):
                raise UserError(f"{JOURNAL_FILE} was not written by a mission.")
    newer = newer_version(head)
    if newer is not None:
        raise UserError(newer)
    if "config" in head and (folder / CONFIG_FILE).is_file() and head["config"] != digest_of_config(folder):
        raise UserError(f"{CONFIG_FILE} was changed after the mission began; put the original back.")
    return head


def scenario_of(folder: Path) -> Scenario:
    """The scenario of a run folder. Raises UserError if there is none that can be read."""
    if not (folder / CONFIG_FILE).is_file():
        raise UserError(f"There is no {CONFIG_FILE}: this is not the folder of a mission.")
    head_of(folder)
    return load_scenario(folder / CONFIG_FILE)


def scene_of(folder: Path, ended_s: float | None) -> dict[str, Any]:
    """The scene of a run that ended at that time of its journal; None: it has not.

    The truth is in it only where the mission was simulated and has ended.

    Raises UserError as ``scenario_of``.
    """
    scenario, head = scenario_of(folder), head_of(folder)
    seed = int(head.get("seed", 0))
    terrain = build_terrain(scenario)
    simulated = bool(head.get("truth", True))
    world = build_world(scenario, seed)
    lens, camera = scenario.camera.lens, scenario.camera
    area, home = scenario.area_enu_m, scenario.home
    search = scenario.search
    return {
        "name": folder.name,
        "scenario": scenario.name,
        "description": scenario.description,
        "strategy": head.get("strategy", search.strategy),
        "sensor": head.get("sensor"),
        "seed": seed,
        "version": head.get("version"),
        "simulated": simulated,
        "external": not head.get("replays", True),
        "origin": {
            "latitude_deg": home.latitude_deg,
            "longitude_deg": home.longitude_deg,
            "altitude_amsl_m": home.altitude_amsl_m,
        },
        "utm": _utm_zone(home.latitude_deg, home.longitude_deg),
        "bounds_enu_m": list(terrain.bounds_enu_m),
        "area_enu_m": _ring(area.exterior),
        "holes_enu_m": [_ring(hole) for hole in area.interiors],
        "no_fly_enu_m": scenario.safety.no_fly_enu_m,
        "geofence_enu_m": scenario.geofence_enu_m,
        "altitude_max_agl_m": scenario.safety.altitude_max_agl_m,
        "home_enu_m": list(home.position_enu_m),
        "camera": {
            "width_px": lens.width_px,
            "height_px": lens.height_px,
            "fx_px": lens.focal_px,
            "fy_px": lens.focal_px,
            "cx_px": lens.width_px / 2,
            "cy_px": lens.height_px / 2,
            "rate_hz": camera.rate_hz,
        },
        "search": {
            "scan_altitude_agl_m": search.scan_altitude_agl_m,
            "check_altitude_agl_m": search.check_altitude_agl_m,
            "c_t": search.c_t,
            "n_c": _finite(search.n_c),
            "d_c_m": _finite(search.d_c_m),
        },
        "battery_capacity_wh": scenario.vehicle.battery_wh,
        "batteries": scenario.vehicle.batteries,
        "hover_power_w": scenario.vehicle.hover_power_w,
        "classes": list(scenario.target_classes),
        "objects": _objects(world),
        "targets": _targets(world, ended_s) if simulated and ended_s is not None else [],
        "coverage": grid_of(scenario),
    }


def heights_of(scenario: Scenario) -> dict[str, Any]:
    """The ground's heights on a grid over the scene's bounds, row 0 in the south."""
    terrain = build_terrain(scenario)
    west, south, east, north = terrain.bounds_enu_m
    rows, columns = _grid(terrain)
    x, y = np.meshgrid(np.linspace(west, east, columns), np.linspace(south, north, rows))
    heights = terrain.height_m(np.column_stack([x.ravel(), y.ravel()]))
    return {
        "bounds_enu_m": [west, south, east, north],
        "rows": rows,
        "columns": columns,
        "heights_m": np.round(heights, 2).tolist(),
    }


def _grid(terrain: TerrainSurface) -> tuple[int, int]:
    if terrain.is_flat:
        return 2, 2
    rows, columns = terrain.heights_m.shape
    west, south, east, north = terrain.bounds_enu_m
    step = max(east - west, north - south) / _MOST_HEIGHTS
    wanted = math.ceil((north - south) / step), math.ceil((east - west) / step)
    return max(2, min(wanted[0], 4 * rows)), max(2, min(wanted[1], 4 * columns))


def _objects(world: World) -> list[dict[str, Any]]:
    trees = [
        {
            "kind": "tree",
            "shape": t.kind,
            "position_enu_m": _rounded(t.position_enu_m),
            "size_m": _rounded([2 * t.crown_radius_m, 2 * t.crown_radius_m, t.height_m]),
            "yaw_rad": 0.0,
        }
        for t in world.trees[:_MOST_OBJECTS]
    ]
    buildings = [
        {
            "kind": "building",
            "position_enu_m": _rounded(b.position_enu_m),
            "size_m": _rounded([*b.size_m, b.height_m]),
            "yaw_rad": b.yaw_rad,
        }
        for b in world.buildings
    ]
    return [*buildings, *trees]


def _targets(world: World, ended_s: float) -> list[dict[str, Any]]:
    """``way`` of those that move: times, eastings and northings, linear in between."""
    found = []
    for thing in world.targets:
        found.append({"class_name": thing.kind, "position_enu_m": _rounded(thing.position_enu_m)})
        if thing.track is not None:
            times_s, places = world.way(thing, ended_s)
            found[-1]["way"] = [_rounded(p) for p in np.column_stack([times_s, places[:, :2]])]
    return found


def _utm_zone(latitude_deg: float, longitude_deg: float) -> dict[str, Any] | None:
    """None near the poles, where there is no UTM."""
    place = utm_of(latitude_deg, longitude_deg)
    return None if place is None else {"zone": int(place[:2]), "letter": place[2]}


def _ring(ring: shapely.LinearRing) -> list[list[float]]:
    return [[x, y] for x, y in ring.coords[:-1]]


def _rounded(values: Any) -> list[float]:
    return [round(float(v), 2) for v in values]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
