"""QGroundControl ``.plan`` files, read and written.

The models below are the file: one class for each JSON object, with QGroundControl's own key names, as in its
developer guide ("Plan File Format") and as its versions since 4.2 save them: plan 1, mission 2, survey 5,
TransectStyleComplexItem 2, CameraCalc 2, geofence 2, rally points 2. Keys that are not ours to understand
are kept. Coordinates are WGS 84 latitude and longitude in degrees; altitudes say above what by the item's
MAV_FRAME or the survey's DistanceMode.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.files.json_files import parse_json
from skysweep.files.models import dotted
from skysweep.files.reading import read_limited
from skysweep.files.writing import whole_files
from skysweep.geometry.areas import headings_of
from skysweep.geometry.camera import Lens
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.coverage import CoveragePlan
from skysweep.scenarios.model import Scenario
from skysweep.worlds.world import TerrainSurface, build_terrain, elevation_of

MAX_PLAN_BYTES = 20_000_000
MAX_WAYPOINTS = 10_000
SENSOR_WIDTH_MM = (
    6.3  # of a 1/2.3 inch sensor; QGroundControl wants one, only its ratio to the focal length counts
)

Latitude = Annotated[float, Field(ge=-90, le=90)]
Longitude = Annotated[float, Field(ge=-180, le=180)]
LatLon = tuple[Latitude, Longitude]
LatLonAlt = tuple[Latitude, Longitude, float]
Above = Literal["home", "sea level", "terrain"]

WAYPOINT, RETURN, TAKEOFF, CHANGE_SPEED, MOUNT_CONTROL = 16, 20, 22, 178, 205  # MAV_CMD
_FLY_THROUGH = {16, 17, 18, 19, 31, 82}  # waypoint, loiters, spline: commands with a place on the path
_FRAME_ABOVE: dict[int, Above] = {
    0: "sea level",
    5: "sea level",
    3: "home",
    6: "home",
    10: "terrain",
    11: "terrain",
}
_STRAIGHT_M = 0.02
_STEP_M = 2.5  # along a leg, to look at the ground
_LEAST_PROFILE_M, _PROFILE_M = 0.5, 5.0  # off what is needed, about
_GLOBAL, _MISSION, _RELATIVE = 0, 2, 3  # MAV_FRAME
_MODE_ABOVE: dict[int, Above] = {1: "home", 2: "sea level", 3: "terrain", 4: "terrain"}
_ABOVE_HOME, _CALCULATED_ABOVE_TERRAIN = 1, 3  # QGroundControl's altitude modes


class _Object(BaseModel):
    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False)

    @model_serializer(mode="wrap")
    def _without_absent_fields(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields = type(self).model_fields
        return {k: v for k, v in write(self).items() if v is not None or k not in fields}


class SimpleItem(_Object):
    """One MAVLink command. ``params`` are its seven, null where the vehicle's own value stays."""

    type: Literal["SimpleItem"] = "SimpleItem"
    command: int
    frame: int
    params: Annotated[list[float | None], Field(min_length=7, max_length=7)]
    autoContinue: bool = True
    doJumpId: int | None = None

    @model_validator(mode="after")
    def _is_on_earth(self) -> SimpleItem:
        latitude, longitude = self.params[4:6]
        if self.command in _FLY_THROUGH and (abs(latitude or 0.0) > 90 or abs(longitude or 0.0) > 180):
            raise ValueError(f"latitude {latitude}, longitude {longitude} is no place on earth")
        return self


class CameraSettings(_Object):
    """The camera, and how far from the ground it is carried."""

    version: Literal[1, 2] = 2
    CameraName: str = "Manual (no camera specs)"
    AdjustedFootprintSide: float
    AdjustedFootprintFrontal: float
    DistanceToSurface: Annotated[float, Field(gt=0)]
    DistanceMode: int | None = None
    DistanceToSurfaceRelative: bool | None = None  # version 1's DistanceMode

    @property
    def above(self) -> Above:
        """What DistanceToSurface is measured from."""
        if self.DistanceMode is None:
            return "sea level" if self.DistanceToSurfaceRelative is False else "home"
        return _MODE_ABOVE.get(self.DistanceMode, "home")


class Transects(_Object):
    """TransectStyleComplexItem: the path of a survey or a corridor scan."""

    version: Literal[1, 2] = 2
    CameraCalc: CameraSettings
    CameraShots: int | None = 0
    CameraTriggerInTurnAround: bool = False
    HoverAndCapture: bool = False
    Refly90Degrees: bool = False
    TurnAroundDistance: float = 0.0
    VisualTransectPoints: list[LatLon]
    Items: list[SimpleItem]


class Survey(_Object):
    """A complex item that covers ground along transects."""

    type: Literal["ComplexItem"] = "ComplexItem"
    complexItemType: Literal["survey", "CorridorScan"] = "survey"
    version: Annotated[int, Field(ge=1, le=5)] = 5
    angle: float = 0.0
    entryLocation: int = 0
    flyAlternateTransects: bool = False
    splitConcavePolygons: bool = False
    polygon: list[LatLon] = Field(default_factory=list)
    TransectStyleComplexItem: Transects


class MissionItems(_Object):
    """The mission: where home is and what is flown."""

    version: Literal[2] = 2
    firmwareType: int = 12  # MAV_AUTOPILOT_PX4
    vehicleType: int = 2  # MAV_TYPE_QUADROTOR
    cruiseSpeed: float = 15.0
    hoverSpeed: float = 5.0
    globalPlanAltitudeMode: int = 0
    plannedHomePosition: tuple[Latitude, Longitude, Annotated[float, Field(ge=-430, le=8850)]]
    items: list[Annotated[SimpleItem | Survey, Field(discriminator="type")]]


class FencePolygon(_Object):
    """Stay inside (inclusion) or outside of these corners."""

    version: Literal[1] = 1
    inclusion: bool = True
    polygon: Annotated[list[LatLon], Field(min_length=3)]


class Circle(_Object):
    """About a point; its radius is in metres."""

    center: LatLon
    radius: Annotated[float, Field(gt=0)]


class FenceCircle(_Object):
    """Stay inside (inclusion) or outside of this circle; its radius is in metres."""

    version: Literal[1] = 1
    inclusion: bool = True
    circle: Circle


class GeoFence(_Object):
    """Where the vehicle may fly: within each inclusion, outside of each exclusion."""

    version: Literal[2] = 2
    circles: list[FenceCircle] = Field(default_factory=list)
    polygons: list[FencePolygon] = Field(default_factory=list)


class RallyPoints(_Object):
    """Where to land in need; altitudes are above home."""

    version: Literal[2] = 2
    points: list[LatLonAlt] = Field(default_factory=list)


class QgcPlan(_Object):
    """A whole ``.plan`` file."""

    fileType: Literal["Plan"] = "Plan"
    groundStation: str = "QGroundControl"
    version: Literal[1] = 1
    mission: MissionItems
    geoFence: GeoFence = GeoFence()
    rallyPoints: RallyPoints = RallyPoints()

    @property
    def surveys(self) -> tuple[Survey, ...]:
        """The surveys and corridor scans in flight order."""
        return tuple(item for item in self.mission.items if isinstance(item, Survey))

    @property
    def waypoints(self) -> tuple[PlanPoint, ...]:
        """Everything that is flown through, in order, without take-off, return and landing."""
        return tuple(_points(self.mission.items))


@dataclass(frozen=True, slots=True)
class PlanPoint:
    """A place on the drawn path and above what its altitude is measured."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    above: Above


def read_plan(path: str | Path) -> QgcPlan:
    """Read a ``.plan`` file. Raises UserError naming the file, the field and the way out."""
    data = parse_json(read_limited(path, MAX_PLAN_BYTES), path, "save the plan again in QGroundControl")
    if not isinstance(data, dict) or data.get("fileType") != "Plan":
        raise UserError(f'{path}: fileType is not "Plan"; give a plan file saved by QGroundControl')
    items = data.get("mission", {}).get("items") if isinstance(data.get("mission"), dict) else None
    for i, item in enumerate(items if isinstance(items, list) else []):
        kind = item.get("complexItemType") if isinstance(item, dict) else None
        if kind is not None and kind not in ("survey", "CorridorScan"):
            raise UserError(
                f"{path}: mission.items[{i}] is a {kind!r}, which shows the camera no ground from above; "
                "draw a Survey or a Corridor Scan instead"
            )
    try:
        plan = QgcPlan.model_validate(data)
    except ValidationError as error:
        detail = error.errors()[0]
        tags = ("SimpleItem", "ComplexItem")
        field = dotted(tuple(part for part in detail["loc"] if part not in tags))
        what = detail["msg"].removeprefix("Value error, ")
        raise UserError(
            f"{path}: {field}: {what[0].lower()}{what[1:]}; "
            "correct it, or save the plan again with QGroundControl 4.2 or newer"
        ) from None
    if len(plan.waypoints) > MAX_WAYPOINTS:
        raise UserError(
            f"{path}: mission.items: has {len(plan.waypoints):,} waypoints; draw at most {MAX_WAYPOINTS:,}"
        )
    return plan


def write_plan(path: str | Path, plan: QgcPlan) -> Path:
    """Write a ``.plan`` file whole or not at all. Raises UserError when the place cannot be written."""
    path = Path(path)
    with whole_files(path.parent) as unfinished:
        text = json.dumps(plan.model_dump(mode="json"), indent=4) + "\n"
        (unfinished / path.name).write_text(text, encoding="utf-8")
    return path


def plan_for_qgc(scenario: Scenario, plan: CoveragePlan, altitude_agl_m: float | None = None) -> QgcPlan:
    """A plan file's content: take-off, scan speed, gimbal, the survey, return; with the scenario's fence.

    Over flat ground altitudes are above home. Over hills they are above sea level: the path follows the
    ground, nowhere nearer to it than ``altitude_agl_m`` (default: the scan altitude), also on the way out
    and home. For that it has more waypoints; those of the ways are items of the survey beside its transects.
    """
    height = scenario.search.scan_altitude_agl_m if altitude_agl_m is None else altitude_agl_m
    frame, terrain = scenario.frame, build_terrain(scenario)
    home_xy = np.array([scenario.home.position_enu_m], dtype=float)
    home = _geodetic(frame, home_xy)[0]
    home_ground = float(terrain.height_m(home_xy)[0])
    dem = elevation_of(scenario)
    sea_level_m = scenario.home.altitude_amsl_m if dem is None else dem.home_amsl_m
    path, rises_m = plan.waypoints_xy_enu_m, height
    if terrain.is_flat:
        frame_id, mode, flown, heights = _RELATIVE, _ABOVE_HOME, path, np.full(len(path), height)
    else:
        frame_id, mode = _GLOBAL, _CALCULATED_ABOVE_TERRAIN
        room_m = scenario.safety.altitude_max_agl_m - height
        ways = _over_ground(terrain, plan, home_xy[0], height, room_m)
        path, rises_m = ways.path[0], float(ways.out[1][0]) - home_ground
        flown, above_enu_m = (np.concatenate(parts)[1:] for parts in zip(*ways, strict=True))
        above_ellipsoid_m = frame.geodetic_from_enu(np.column_stack([flown, above_enu_m]))[:, 2]
        heights = sea_level_m + above_ellipsoid_m - frame.altitude_m  # the earth curves away below the frame

    def command(number: int, *params: float | None, frame: int = _MISSION) -> dict[str, Any]:
        return {"command": number, "frame": frame, "params": [*params, *[0.0] * (7 - len(params))]}

    first = [
        command(TAKEOFF, 0.0, 0.0, 0.0, None, *home, rises_m, frame=_RELATIVE),
        command(CHANGE_SPEED, 1.0, scenario.search.scan_speed_mps, -1.0),
        command(MOUNT_CONTROL, scenario.camera.gimbal.pitch_deg, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0),
    ]
    survey_items = [
        command(WAYPOINT, 0.0, 0.0, 0.0, None, *point, float(z), frame=frame_id)
        for point, z in zip(_geodetic(frame, flown), heights, strict=True)
    ]
    for i, item in enumerate([*first, *survey_items], 1):
        item["doJumpId"] = i
    last = {**command(RETURN), "doJumpId": 1 + len(first) + len(survey_items)}
    style = Transects(
        CameraCalc=_camera_calc(scenario, plan, height, mode),
        VisualTransectPoints=_geodetic(frame, path),
        Items=[SimpleItem.model_validate(item) for item in survey_items],
        **(_terrain_keys(scenario) if mode == _CALCULATED_ABOVE_TERRAIN else {}),
    )
    corners = shapely.get_coordinates(scenario.area_enu_m.exterior.normalize())[:-1]
    survey = Survey(angle=plan.heading_deg, polygon=_geodetic(frame, corners), TransectStyleComplexItem=style)
    fences = [
        FencePolygon(inclusion=False, polygon=_geodetic(frame, np.array(ring)))
        for ring in scenario.safety.no_fly_enu_m
    ]
    if scenario.geofence_enu_m is not None:
        fences.insert(0, FencePolygon(polygon=_geodetic(frame, np.array(scenario.geofence_enu_m))))
    return QgcPlan(
        mission=MissionItems(
            cruiseSpeed=scenario.vehicle.cruise_speed_mps,
            hoverSpeed=scenario.search.scan_speed_mps,
            plannedHomePosition=(*home, sea_level_m + home_ground),
            items=[*[SimpleItem.model_validate(i) for i in first], survey, SimpleItem.model_validate(last)],
        ),
        geoFence=GeoFence(polygons=fences),
    )


def warnings_for_file(scenario: Scenario, plan: QgcPlan) -> Iterator[str]:
    """A sentence where a vehicle that flies what ``plan_for_qgc`` made gets above the ceiling."""
    if build_terrain(scenario).is_flat:
        return
    highest_m, ceiling_m = _highest_agl_m(scenario, plan), scenario.safety.altitude_max_agl_m
    if highest_m > ceiling_m + 2.0 * _LEAST_PROFILE_M:
        yield (
            f"safety.altitude_max_agl_m: is {ceiling_m:g}, and who flies the .plan file gets to "
            f"{highest_m:.0f} m above ground where hills are steep; scan lower, or let skysweep fly the "
            "mission"
        )


def _highest_agl_m(scenario: Scenario, plan: QgcPlan) -> float:
    """The greatest height above ground on a path of ``plan_for_qgc`` over hills, from home and back."""
    frame, terrain = scenario.frame, build_terrain(scenario)
    home = np.array(scenario.home.position_enu_m, dtype=float)
    home_ground = float(terrain.height_m(home[None])[0])
    sea_level_m = plan.mission.plannedHomePosition[2] - home_ground
    (survey,), takeoff = plan.surveys, plan.mission.items[0]
    places = np.array([item.params[4:] for item in survey.TransectStyleComplexItem.Items], dtype=float)
    places[:, 2] += frame.altitude_m - sea_level_m
    xyz = frame.enu_from_geodetic(places)
    assert isinstance(takeoff, SimpleItem)
    rises_m = home_ground + (takeoff.params[6] or 0.0)
    path, over = np.concatenate([home[None], xyz[:, :2]]), np.append(rises_m, xyz[:, 2])
    highest = -math.inf
    for (start, end), (low, high) in zip(pairwise(path), pairwise(over.tolist()), strict=True):
        along, ground_m = _needed(terrain, start, end, 0.0)
        highest = max(highest, float((np.linspace(low, high, len(along)) - ground_m).max()))
    return highest


def coverage_from_qgc(plan: QgcPlan, frame: LocalFrame, lens: Lens, altitude_agl_m: float) -> CoveragePlan:
    """The drawn path as a coverage plan in the ENU metres of ``frame``, seen from ``altitude_agl_m``.

    Waypoints on a straight line between their neighbours are dropped. Transects are the legs that run along
    a survey's angle, or every leg of a path of plain waypoints.
    Raises UserError when the plan has no path.
    """
    points = np.array([(p.latitude_deg, p.longitude_deg, frame.altitude_m) for p in plan.waypoints])
    if len(points) < 2:
        raise UserError("mission.items: there is no path to fly; draw a Survey or at least 2 waypoints")
    xy = frame.enu_from_geodetic(points)[:, :2]
    xy = xy[_bends(xy, _STRAIGHT_M)]
    legs = np.stack([xy[:-1], xy[1:]], axis=1)
    lengths = np.linalg.norm(legs[:, 1] - legs[:, 0], axis=1)
    headings = headings_of(legs)
    angles = [a for s in plan.surveys if s.complexItemType == "survey" for a in _transect_angles(s)]
    along = np.array([[abs((h - a + 90) % 180 - 90) < 5 for a in angles] for h in headings]).any(axis=1)
    if not angles or not along.any():
        along = np.ones(len(legs), dtype=bool)
    swath = lens.footprint_m(altitude_agl_m)[0]
    spacings = [s.TransectStyleComplexItem.CameraCalc.AdjustedFootprintSide for s in plan.surveys]
    heading = float(headings[along][np.argmax(lengths[along])] % 180.0)
    return CoveragePlan(
        xy, tuple(legs[along]), max(spacings, default=swath), swath, heading, float(lengths.sum())
    )


def _bends(path_xy: F64, tolerance_m: float) -> NDArray[np.int_]:
    """Which points of a path (N, 2) keep it within the tolerance (Douglas and Peucker, 1973): first to last.

    Not recursive: a zigzag is as deep as it is long.
    """
    kept = [len(path_xy) - 1]
    todo = [(0, len(path_xy) - 1)]
    while todo:
        first, last = todo.pop()
        straight, between = path_xy[last] - path_xy[first], path_xy[first + 1 : last] - path_xy[first]
        share = np.clip(between @ straight / max(straight @ straight, 1e-12), 0.0, 1.0)
        off_m = np.linalg.norm(between - share[:, None] * straight, axis=1)
        if off_m.max(initial=0.0) > tolerance_m:
            middle = first + 1 + int(off_m.argmax())
            todo += [(first, middle), (middle, last)]
        else:
            kept.append(first)
    return np.sort(kept)


def survey_polygons(plan: QgcPlan) -> list[shapely.Polygon]:
    """The surveys' areas, with longitude as x and latitude as y in degrees."""
    return [
        shapely.Polygon([(lon, lat) for lat, lon in s.polygon]) for s in plan.surveys if len(s.polygon) >= 3
    ]


def _points(items: list[SimpleItem | Survey]) -> Iterator[PlanPoint]:
    for item in items:
        if isinstance(item, SimpleItem):
            latitude, longitude, altitude = item.params[4:]
            if item.command in _FLY_THROUGH and latitude is not None and longitude is not None:
                yield PlanPoint(latitude, longitude, altitude or 0.0, _FRAME_ABOVE.get(item.frame, "home"))
            continue
        style = item.TransectStyleComplexItem
        if not style.VisualTransectPoints:
            yield from _points(list(style.Items))
        for latitude, longitude in style.VisualTransectPoints:
            yield PlanPoint(latitude, longitude, style.CameraCalc.DistanceToSurface, style.CameraCalc.above)


def _transect_angles(survey: Survey) -> list[float]:
    refly = survey.TransectStyleComplexItem.Refly90Degrees
    return [survey.angle, survey.angle + 90.0] if refly else [survey.angle]


def _geodetic(frame: LocalFrame, xy_enu_m: F64) -> list[LatLon]:
    xyz = np.column_stack([xy_enu_m, np.zeros(len(xy_enu_m))])
    return [(float(lat), float(lon)) for lat, lon, _ in frame.geodetic_from_enu(xyz)]


class _Ways(NamedTuple):
    """Places (N, 2) and heights (N,), ENU, of a path over hills, of the way to it, and of the way home."""

    out: tuple[F64, F64]
    path: tuple[F64, F64]
    home: tuple[F64, F64]


def _over_ground(
    terrain: TerrainSurface, plan: CoveragePlan, home_xy: F64, height_m: float, room_m: float
) -> _Ways:
    """A path along a plan's, ``height_m`` or more above ground, from and to home.

    It is no lower than the plan's profiles, from which all of the area is seen, and closer to these the less
    ``room_m`` the vehicle may fly higher.
    """
    near_m = min(max(_LEAST_PROFILE_M, room_m / 3.0), _PROFILE_M)
    xy, profiles = plan.waypoints_xy_enu_m, {p.leg_xy_enu_m.tobytes(): p for p in plan.profiles}
    around = np.concatenate([home_xy[None], xy, home_xy[None]])
    places, heights, n_bends = [around[:1]], [np.full(1, -math.inf)], []
    for start, end in pairwise(around):
        along, needed_m = _needed(terrain, start, end, height_m)
        profile = profiles.get(np.array([start, end]).tobytes())
        if profile is not None:
            stations_m = np.linspace(0.0, profile.length_m, len(along))
            needed_m = np.maximum(needed_m, np.interp(stations_m, profile.along_m, profile.height_m))
        flown_m = np.linspace(0.0, float(np.linalg.norm(end - start)), len(along))
        kept = _bends(np.column_stack([flown_m, needed_m]), near_m)
        lifted = needed_m[kept]
        for k, (i, j) in enumerate(pairwise(kept.tolist())):
            short_m = (needed_m[i : j + 1] - np.linspace(needed_m[i], needed_m[j], j - i + 1)).max()
            lifted[k : k + 2] = np.maximum(lifted[k : k + 2], needed_m[[i, j]] + short_m)
        heights[-1][-1] = max(heights[-1][-1], lifted[0])
        places.append(along[kept[1:]])
        heights.append(lifted[1:])
        n_bends.append(len(kept) - 1)
    flown, over = np.concatenate(places), np.concatenate(heights)
    first, last = n_bends[0], len(flown) - n_bends[-1]
    parts = slice(0, first), slice(first, last), slice(last, None)
    return _Ways(*((flown[part], over[part]) for part in parts))


def _needed(terrain: TerrainSurface, start: F64, end: F64, height_m: float) -> tuple[F64, F64]:
    """Places (N, 2) along a leg, and how high it has to be flown there (N,)."""
    steps = max(1, math.ceil(float(np.linalg.norm(end - start)) / _STEP_M))
    along = start + np.linspace(0.0, 1.0, steps + 1)[:, None] * (end - start)
    return along, terrain.height_m(along) + height_m


def _camera_calc(scenario: Scenario, plan: CoveragePlan, height_m: float, mode: int) -> CameraSettings:
    lens = scenario.camera.lens
    focal_mm = SENSOR_WIDTH_MM * lens.focal_px / lens.width_px
    picture_height = lens.footprint_m(height_m)[1]
    return CameraSettings(
        CameraName="Custom Camera",
        AdjustedFootprintSide=plan.spacing_m,
        AdjustedFootprintFrontal=picture_height,
        DistanceToSurface=height_m,
        DistanceMode=mode,
        **{
            "FixedOrientation": False,
            "FocalLength": focal_mm,
            "FrontalOverlap": 0.0,
            "ImageDensity": 100.0 * lens.gsd_m(height_m),
            "ImageHeight": lens.height_px,
            "ImageWidth": lens.width_px,
            "Landscape": True,
            "MinTriggerInterval": 0.0,
            "SensorHeight": SENSOR_WIDTH_MM * lens.height_px / lens.width_px,
            "SensorWidth": SENSOR_WIDTH_MM,
            "SideOverlap": 100.0 * max(0.0, 1.0 - plan.spacing_m / plan.swath_m),
            "ValueSetIsDistance": True,
        },
    )


def _terrain_keys(scenario: Scenario) -> dict[str, float]:
    return {
        "TerrainAdjustTolerance": 10.0,
        "TerrainAdjustMaxClimbRate": 0.0,
        "TerrainAdjustMaxDescentRate": 0.0,
        "TerrainFlightSpeed": scenario.search.scan_speed_mps,
    }
