"""Where the pictures of a flight were taken, on a map: a scenario around them, and the pose of each."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from skysweep.arrays import F64
from skysweep.files.models import validated
from skysweep.flights.photographed.shots import Shot
from skysweep.geometry.camera import FLATTEST_RAD, CameraPose, Lens, rays_enu
from skysweep.geometry.frames import LocalFrame
from skysweep.scenarios.model import MARGIN_M, Scenario
from skysweep.worlds.elevation import elevation
from skysweep.worlds.world import World

_USUAL_HEIGHT_M = 100.0  # for a first outline, of a picture that says its height above the sea alone
_BORDER_M = 5.0  # of searched area around what the pictures show
_CHECK_M = 4.0


def scenario_of(shots: Sequence[Shot], name: str, detector: dict[str, Any], dem: Path | None) -> Scenario:
    """A scenario whose area is what the pictures show; its camera is theirs, its home below the first.

    Raises UserError where they show more than a scenario's area may be, or ``dem`` has no heights there.
    """
    latitude_deg, longitude_deg = shots[0].taken.lat_lon_deg
    frame = LocalFrame(latitude_deg, longitude_deg)
    heights_m = [_outline_height_m(shot) for shot in shots]
    outlines = [_outline(shot, frame, h) for shot, h in zip(shots, heights_m, strict=True)]
    area = shapely.MultiPolygon(outlines).convex_hull.buffer(_BORDER_M, quad_segs=2)
    corners = [(round(x, 2), round(y, 2)) for x, y in area.exterior.coords[:-1]]
    usual_m = float(np.clip(np.median(heights_m), 1.0, 500.0))
    fields: dict[str, Any] = {
        "name": re.sub(r"[^A-Za-z0-9 ._-]", "-", name).lstrip(" ._-")[:80] or "pictures",
        "description": "What a detector finds in the pictures of a flight",
        "area": {"polygon_enu_m": corners},
        "home": {
            "latitude_deg": latitude_deg,
            "longitude_deg": longitude_deg,
            "altitude_amsl_m": _ground_amsl_m(shots[0]),
        },
        "camera": {
            "width_px": shots[0].size_px[0],
            "height_px": shots[0].size_px[1],
            "hfov_rad": float(np.median([shot.lens.hfov_rad for shot in shots])),
            "latency_s": 0.0,
            "pose_delay_s": 0.0,
        },
        "detector": detector,
        "search": {
            "scan_altitude_agl_m": round(usual_m, 1),
            "check_altitude_agl_m": min(_CHECK_M, round(usual_m, 1)),
        },
        "safety": {"altitude_max_agl_m": 600.0, "descent_floor_agl_m": 0.0},
    }
    if dem is not None:
        west, south, east, north = area.bounds
        bounds = west - MARGIN_M, south - MARGIN_M, east + MARGIN_M, north + MARGIN_M
        ground = elevation(dem, None, frame, bounds, area, (0.0, 0.0))
        fields["home"]["altitude_amsl_m"] = round(ground.home_amsl_m, 1)
        fields["terrain"] = {"dem": str(dem.absolute())}
    return validated(Scenario, fields, "the pictures")


def pose_of(shot: Shot, scenario: Scenario, world: World) -> CameraPose:
    """The camera's pose in the scenario's frame.

    A measured height counts from the ground below, one above take-off from that at home, below the first
    picture; without either the altitude above the sea counts.
    """
    taken, home_amsl_m = shot.taken, scenario.home.altitude_amsl_m
    assert taken.R_camera_to_enu is not None
    x, y = scenario.frame.enu_from_geodetic([(*taken.lat_lon_deg, home_amsl_m)])[0, :2].tolist()
    if taken.altitude_agl_m is not None:
        z = float(world.terrain.height_m((x, y))[0]) + taken.altitude_agl_m
    elif taken.height_m is not None:
        z = float(world.terrain.height_m((0.0, 0.0))[0]) + taken.height_m
    else:
        assert taken.altitude_amsl_m is not None
        z = taken.altitude_amsl_m - home_amsl_m
    return CameraPose(np.array([x, y, z]), taken.R_camera_to_enu)


def _outline_height_m(shot: Shot) -> float:
    height_m = shot.taken.over_ground_m
    return _USUAL_HEIGHT_M if height_m is None or height_m <= 0.0 else height_m


def _ground_amsl_m(shot: Shot) -> float:
    """Of the ground, where a picture says its height above it and above the sea; else 0."""
    altitude_m, height_m = shot.taken.altitude_amsl_m, shot.taken.over_ground_m
    known = altitude_m is not None and height_m is not None
    return float(np.clip(round(altitude_m - height_m, 1), -430.0, 8850.0)) if known else 0.0  # type: ignore[operator]


def _outline(shot: Shot, frame: LocalFrame, height_m: float) -> shapely.Polygon:
    """Level ground in a picture, out to ``FLATTEST_RAD`` below the horizon."""
    taken = shot.taken
    assert taken.R_camera_to_enu is not None
    x, y = frame.enu_from_geodetic([(*taken.lat_lon_deg, 0.0)])[0, :2].tolist()
    pose = CameraPose(np.array([x, y, height_m]), taken.R_camera_to_enu)
    rays = rays_enu(shot.lens, pose, _border(shot.lens))
    points = [np.array([x, y]) + _reach(ray, height_m) for ray in rays]
    return shapely.MultiPoint(points).convex_hull.buffer(0.5, quad_segs=1)


def _border(lens: Lens) -> F64:
    """Corners and middles of the sides (8, 2)."""
    shares = np.array([(0, 0), (0.5, 0), (1, 0), (1, 0.5), (1, 1), (0.5, 1), (0, 1), (0, 0.5)])
    return shares * [lens.width_px, lens.height_px]


def _reach(ray: F64, height_m: float) -> F64:
    """East and north to where a ray meets level ground; flatter ones as far as the flattest that counts."""
    flat = math.hypot(ray[0], ray[1])
    steepness = max(-float(ray[2]) / flat, math.tan(FLATTEST_RAD)) if flat > 1e-9 else math.inf
    return np.asarray(ray[:2] / max(flat, 1e-9) * height_m / steepness)
