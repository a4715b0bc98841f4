"""Scenario files: pydantic models with units in the field names.

A scenario says everything about one mission: the area, what is out there, the vehicle, the camera, the
detector and the search parameters. Local coordinates are ENU metres with home's origin at (0, 0);
an area may be given in latitude/longitude instead. ``Scenario.model_json_schema()`` is the JSON schema.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal, get_args

import numpy as np
import shapely
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from skysweep.geometry.camera import Lens
from skysweep.geometry.frames import LocalFrame
from skysweep.scenarios.leeway import LEEWAY

MAX_AREA_KM2 = 25.0
MAX_DISTANCE_FROM_HOME_KM = 50.0
MAX_CORNERS = 10_000  # of an area
MAX_FENCE_CORNERS = 1000
MAX_TREES, MAX_BUILDINGS, MAX_OBJECTS, MAX_BATTERIES = 50_000, 5000, 5000, 100
MAX_HOVER_H = 48.0
HALVE_ABOVE_PX = 128.0  # beyond which the shipped detector sees persons better at half of the size
MAX_WAITING_PX = 300_000_000  # of pictures between exposure and answer
GIMBAL_PITCH_DEG = (-90.0, 45.0)  # limits, above the horizon
DOWN_WITHIN_DEG = 1.0  # of straight down
ALTITUDE_TOLERANCE_M = 0.8  # within which a height is kept: PX4 NAV_MC_ALT_RAD
MAX_CURRENT_MPS = 10.0
SUN_LEAST_DEG = 3.0  # elevation, for visible pictures
MARGIN_M = 60.0  # of world around the area, so that pictures near the edge are not empty

CameraKind = Literal["visible", "thermal"]
TargetClass = Literal["stop sign", "person", "boat"]
DistractorClass = Literal[
    "red bucket", "red round sign", "rock", "stump", "clothing", "buoy", "sheep", "deer", "dog"
]
ObjectPose = Literal["face-up", "standing", "lying", "floating", "sitting", "crouching", "walking", "waving"]
Clothing = Literal[
    "bright", "muted", "black", "blue", "brown", "green", "grey", "orange", "red", "white", "yellow"
]
Age = Literal["child", "teenager", "adult"]

# Size means: across the flats (sign), body height (person), length (boat, clothing, animals), diameter (the
# rest).
DEFAULT_SIZE_M: dict[str, float] = {
    "stop sign": 0.75,
    "person": 1.75,
    "boat": 5.0,
    "red bucket": 0.35,
    "red round sign": 0.6,
    "rock": 1.0,
    "stump": 0.6,
    "clothing": 0.9,
    "buoy": 0.6,
    "sheep": 1.2,
    "deer": 1.6,
    "dog": 0.9,
}
SIZE_OF_AGE_M: dict[Age, float] = {"child": 1.2, "teenager": 1.55, "adult": 1.75}  # 6, 13 years; grown up
DEFAULT_POSE: dict[str, str] = {"person": "lying"}
SHARE_FROM_ABOVE = {  # of its size that an object spans in a pose, seen straight down; all of it in others
    **dict.fromkeys(("standing", "walking", "waving"), 0.3),  # shoulders against body height
    "floating": 0.4,  # head, shoulders and arms
    "sitting": 0.55,  # from the back to the feet, or to the head
    "crouching": 0.42,
}
USUAL_POSES = ("face-up", "standing", "lying", "floating")  # what is believed where a scenario says nothing

_OF_FILES = {
    "dem",
    "dem_unit",
    "land_cover",
    "land_cover_classes",
    "orthophoto",
    "buildings_file",
    "roads_file",
}

_OF_HEAT = ("air_temperature_c", "cloud_cover")

PointXY = tuple[float, float]
ObjectSpeed = Annotated[float, Field(gt=0, le=20, description="A walking adult: 1.4")]
Speed = Annotated[float, Field(ge=0.1, le=20)]
TreeHeight = Annotated[float, Field(gt=0.3, le=60)]
CrownRadius = Annotated[float, Field(gt=0.1, le=15)]
SideOfBuilding = Annotated[float, Field(gt=0, le=1000)]
LatLon = tuple[Annotated[float, Field(ge=-90, le=90)], Annotated[float, Field(ge=-180, le=180)]]


class Model(BaseModel):
    """Strict base: unknown fields are errors, NaN and infinity are refused unless a field says otherwise."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Area(Model):
    """Where to search: a polygon, concave if need be, with holes that need no search."""

    polygon_enu_m: list[PointXY] | None = Field(None, description="Corners, east and north of the origin")
    polygon_lat_lon_deg: list[LatLon] | None = Field(None, description="Corners, latitude and longitude")
    file: str | None = Field(
        None,
        description="GeoJSON, KML, KMZ or .plan (without its fence) with one polygon, read with the scenario",
    )
    holes_enu_m: list[list[PointXY]] = Field(
        default_factory=list, description="Corners of each hole, east and north of the origin"
    )
    holes_lat_lon_deg: list[list[LatLon]] = Field(
        default_factory=list, description="Corners of each hole, latitude and longitude"
    )

    @model_validator(mode="after")
    def _one_kind_of_corner(self) -> Area:
        if [self.polygon_enu_m, self.polygon_lat_lon_deg, self.file].count(None) != 2:
            raise ValueError("write exactly one of polygon_enu_m, polygon_lat_lon_deg and file")
        if self.file is not None:
            raise ValueError(
                "file: is read with a scenario file and stands alone; delete the other fields of area"
            )
        if self.polygon_enu_m is None and self.holes_enu_m:
            raise ValueError("the polygon is in latitude/longitude: write the holes as holes_lat_lon_deg")
        if self.polygon_enu_m is not None and self.holes_lat_lon_deg:
            raise ValueError("the polygon is in ENU metres: write the holes as holes_enu_m")
        outer = self.polygon_enu_m or self.polygon_lat_lon_deg or []
        holes = [*self.holes_enu_m, *self.holes_lat_lon_deg]
        if any(len(hole) < 3 for hole in holes):
            raise ValueError("a hole has less than 3 corners; write at least 3, or delete it")
        corners = sum(map(len, [outer, *holes]))
        if corners > MAX_CORNERS:
            raise ValueError(f"has {corners:,} corners; simplify it to {MAX_CORNERS:,} or fewer")
        return self


class Home(Model):
    """Take-off and landing place; the ENU origin sits at its latitude, longitude and altitude."""

    latitude_deg: float = Field(60.4490, ge=-90, le=90, description="Of the ENU origin")
    longitude_deg: float = Field(22.2966, ge=-180, le=180, description="Of the ENU origin")
    altitude_amsl_m: float = Field(30.0, ge=-430, le=8850, description="Of the ground at the origin")
    position_enu_m: PointXY = Field((0.0, 0.0), description="Take-off place, east and north of the origin")


def _ascending(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError(f"is [{limits[0]:g}, {limits[1]:g}]; write the smallest, then the largest")
    return limits


Surface = Literal["grass", "forest floor", "rock", "sand", "snow", "water", "asphalt"]
TreesPerHectare = Annotated[float, Field(le=2000)]
TreeHeights = Annotated[
    tuple[TreeHeight, TreeHeight], Field(description="Smallest and largest"), AfterValidator(_ascending)
]
CrownRadii = Annotated[
    tuple[CrownRadius, CrownRadius], Field(description="Smallest and largest"), AfterValidator(_ascending)
]
ConiferFraction = Annotated[float, Field(ge=0, le=1, description="The rest is broadleaf")]


class LandClass(Model):
    """What a class of a land cover map is: the ground's surface, and the trees on it."""

    code: int = Field(ge=0, le=65_535, description="The map's value")
    surface: Surface
    trees_per_hectare: TreesPerHectare = Field(0.0, ge=0)
    height_m: TreeHeights = (5.0, 12.0)
    crown_radius_m: CrownRadii = (1.2, 2.8)
    conifer_fraction: ConiferFraction = 0.5


class Terrain(Model):
    """Ground shape and what covers it."""

    surface: Surface = Field(
        "grass", description="What the ground looks like, where land_cover and roads_file say nothing"
    )
    heightmap_m: list[list[float]] | None = Field(
        None,
        description="Rows south to north, columns west to east, stretched over the area's bounding box "
        "(with home) and its margin",
    )
    hills_height_m: float = Field(0.0, ge=0, le=500, description="Random hills up to this height")
    hills_wavelength_m: float = Field(150.0, ge=20, le=5000, description="Distance from one hill to the next")
    seed: int = Field(0, ge=0, description="Another seed, other hills and other trees of land_cover")
    dem: str | None = Field(
        None, description="Digital elevation model, a GeoTIFF in any CRS; the ground at home is height 0"
    )
    dem_unit: Literal["metres", "feet"] | None = Field(
        None, description="What the heights of dem are in; default: what the file says"
    )
    land_cover: str | None = Field(
        None, description="Map of classes, a GeoTIFF in any CRS; becomes surfaces and trees"
    )
    land_cover_classes: list[LandClass] | None = Field(
        None,
        min_length=1,
        max_length=255,
        description="What the classes of land_cover are; default: those of ESA WorldCover",
    )
    orthophoto: str | None = Field(
        None, description="The ground's picture, a GeoTIFF in any CRS with colours of 8 or 16 bits"
    )

    @model_serializer(mode="wrap")
    def _without_files(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A terrain without files is written as before there were any."""
        return {k: v for k, v in write(self).items() if k not in _OF_FILES or v is not None}

    @model_validator(mode="after")
    def _one_ground(self) -> Terrain:
        if self.dem is not None and (self.heightmap_m is not None or self.hills_height_m > 0):
            raise ValueError("dem: is the ground's shape; delete heightmap_m and hills_height_m")
        if self.dem is None and self.dem_unit is not None:
            raise ValueError("dem_unit: is that of dem, which is missing; write dem")
        if self.land_cover_classes is not None:
            if self.land_cover is None:
                raise ValueError("land_cover_classes: are those of land_cover, which is missing; write it")
            codes = [each.code for each in self.land_cover_classes]
            twice = next((code for code in codes if codes.count(code) > 1), None)
            if twice is not None:
                raise ValueError(f"land_cover_classes: {twice} is written twice; keep one")
        return self

    @field_validator("heightmap_m")
    @classmethod
    def _rectangular(cls, rows: list[list[float]] | None) -> list[list[float]] | None:
        if rows is not None and (len(rows) < 2 or len(rows[0]) < 2 or len({len(r) for r in rows}) != 1):
            raise ValueError("write at least 2 rows of at least 2 heights, all rows equally long")
        return rows


class Tree(Model):
    """One tree: it occludes; the vehicle flies round or over it, never below."""

    position_enu_m: PointXY = Field(description="Of the trunk")
    height_m: TreeHeight = 8.0
    crown_radius_m: CrownRadius = 2.0
    kind: Literal["broadleaf", "conifer", "bush"] = "broadleaf"


class Forest(Model):
    """Trees scattered by seed over the area and its margin, or inside a polygon."""

    trees_per_hectare: TreesPerHectare = Field(gt=0)
    polygon_enu_m: list[PointXY] | None = Field(
        None, max_length=MAX_FENCE_CORNERS, description="Where it grows; default: area and margin"
    )
    height_m: TreeHeights = (5.0, 12.0)
    crown_radius_m: CrownRadii = (1.2, 2.8)
    conifer_fraction: ConiferFraction = 0.5
    seed: int = Field(0, ge=0)

    @field_validator("polygon_enu_m")
    @classmethod
    def _simple(cls, corners: list[PointXY] | None) -> list[PointXY] | None:
        if corners is not None and (len(corners) < 3 or not shapely.Polygon(corners).is_valid):
            raise ValueError("write at least 3 corners, in order around it")
        return corners


class Building(Model):
    """A box with a gable roof: it occludes; the vehicle flies round or over it."""

    position_enu_m: PointXY = Field(description="Of the centre")
    size_m: tuple[SideOfBuilding, SideOfBuilding] = Field((10.0, 8.0), description="Length and width")
    height_m: float = Field(4.0, gt=0, le=120, description="Of the eaves")
    yaw_deg: float = Field(0.0, description="Of the length, counter-clockwise from east")


class PathMotion(Model):
    """Along straight lines, from where the object is placed through the waypoints."""

    kind: Literal["path"]
    waypoints_enu_m: list[PointXY] = Field(
        min_length=1, max_length=1000, description="East and north of the origin, in this order"
    )
    speed_mps: ObjectSpeed = 1.4
    at_end: Literal["stop", "loop"] = Field(
        "stop", description="loop: back to where it was placed, and round again"
    )


class WalkMotion(Model):
    """A correlated random walk, another one for each object and mission seed.

    Straight stretches, exponentially distributed in time, with a normally distributed turn after each.
    """

    kind: Literal["walk"]
    speed_mps: ObjectSpeed = 1.4
    straight_s: float = Field(20.0, ge=1, le=3600, description="Mean time of a stretch")
    turn_deg: float = Field(
        60.0, ge=0, le=180, description="Standard deviation of the turn between stretches"
    )
    rest_share: float = Field(0.0, ge=0, lt=1, description="Share of the time spent standing still")
    stays_in_area: bool = Field(
        True, description="Whether it turns at the edge of the area if it starts in it"
    )


class DriftMotion(Model):
    """Adrift in the water: the current and, in the scenario's mean wind, leeway with an error of its own."""

    kind: Literal["drift"]
    current_mps: PointXY = Field((0.0, 0.0), description="Surface current, east and north, where it flows to")
    leeway: str = Field("PIW-1", description="Class of Allen and Plourde: docs/prior.md")

    @field_validator("current_mps")
    @classmethod
    def _flows(cls, current: PointXY) -> PointXY:
        if math.hypot(*current) > MAX_CURRENT_MPS:
            raise ValueError(f"is faster than {MAX_CURRENT_MPS:g} m/s; write east and north in m/s")
        return current

    @field_validator("leeway")
    @classmethod
    def _known(cls, name: str) -> str:
        if name not in LEEWAY:
            raise ValueError(f"'{name}' is not in the table; write one of {', '.join(LEEWAY)}")
        return name


Motion = Annotated[PathMotion | WalkMotion | DriftMotion, Field(discriminator="kind")]


class _Placed(Model):
    """What moves, or is dressed. A file that does not use these has the same keys as before they existed."""

    @model_serializer(mode="wrap")
    def _without_what_is_open(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: v for k, v in write(self).items() if k not in _OPEN_UNLESS_TOLD or v is not None}


HowItMoves = Annotated[
    Motion | None, Field(description="How it moves from mission time 0; default: not at all")
]
_OPEN_UNLESS_TOLD = ("motion", "clothing", "ages", "near")


def _only_of_a_person(name: str, kind: str) -> str:
    return f"{name}: only a person has one; delete it from the {kind}"


def _refuse_pose(name: str, pose: ObjectPose | None, kind: str) -> None:
    if pose in ("sitting", "crouching", "walking", "waving") and kind != "person":
        raise ValueError(f"{name}: {pose} is of a person only; delete it from the {kind}")


class Target(_Placed):
    """Something to find."""

    kind: TargetClass = Field(alias="class")
    position_enu_m: PointXY
    yaw_deg: float = Field(0.0, description="Counter-clockwise from east")
    size_m: float | None = Field(None, gt=0.05, le=60, description="Default depends on the class")
    pose: ObjectPose | None = Field(None, description="Default depends on the class")
    clothing: Clothing | None = Field(None, description="Of a person; default: any")
    motion: HowItMoves = None

    model_config = ConfigDict(populate_by_name=True)

    @model_validator(mode="after")
    def _dressed(self) -> Target:
        if self.clothing and self.kind != "person":
            raise ValueError(_only_of_a_person("clothing", self.kind))
        _refuse_pose("pose", self.pose, self.kind)
        return self


class Distractor(_Placed):
    """Something that resembles a target from above but not up close."""

    kind: DistractorClass = Field(alias="class")
    position_enu_m: PointXY
    yaw_deg: float | None = Field(
        None, description="Counter-clockwise from east; default another one for every mission seed"
    )
    size_m: float | None = Field(None, gt=0.05, le=60, description="Default depends on the class")
    motion: HowItMoves = None

    model_config = ConfigDict(populate_by_name=True)


class Generator(_Placed):
    """Places objects at random, the same ones for the same seed.

    ``uniform``: anywhere in the area; ``clustered``: around ``clusters`` centres with a standard deviation of
    ``spread_m``; ``sparse``: as far apart as the area allows (best candidate sampling).
    ``seed`` null means: another layout for every mission seed.
    """

    kind: TargetClass | DistractorClass = Field(alias="class")
    pattern: Literal["uniform", "clustered", "sparse"] = Field(description="How the objects are spread")
    count: int = Field(ge=1, le=2000)
    clusters: int = Field(
        2, ge=1, le=100, description="How many centres to draw, where centres_enu_m is not given"
    )
    centres_enu_m: list[PointXY] | None = Field(
        None, min_length=1, max_length=100, description="Centres of the clusters"
    )
    spread_m: float = Field(8.0, gt=0, le=1000, description="Standard deviation around a centre")
    min_separation_m: float = Field(
        2.0, ge=0, le=1000, description="Between two of these objects, where there is room for it"
    )
    size_m: float | None = Field(None, gt=0.05, le=60, description="Default depends on the class")
    poses: list[ObjectPose] | None = Field(None, description="Poses to draw from, one for each object")
    clothing: list[Clothing] | None = Field(
        None, min_length=1, description="Of persons, to draw from; default: any"
    )
    ages: list[Age] | None = Field(
        None, min_length=1, description="Of persons without size_m, to draw from; default: adult"
    )
    near: Literal["trees"] | None = Field(
        None, description="Moves each object to the crown of the nearest tree, which hides a part of it"
    )
    seed: int | None = Field(0, ge=0, description="null: another layout for every mission seed")
    motion: HowItMoves = None

    model_config = ConfigDict(populate_by_name=True)

    @property
    def sizes_m(self) -> list[float | None]:
        """The sizes of its objects; None is the default of the class."""
        return [SIZE_OF_AGE_M[age] for age in self.ages] if self.ages else [self.size_m]

    @model_validator(mode="after")
    def _one_size(self) -> Generator:
        if self.ages and self.size_m is not None:
            raise ValueError("ages: size_m gives the size already; delete one of them")
        for name in ("ages", "clothing"):
            if getattr(self, name) and self.kind != "person":
                raise ValueError(_only_of_a_person(name, self.kind))
        for pose in self.poses or []:
            _refuse_pose("poses", pose, self.kind)
        if self.centres_enu_m is not None and self.pattern != "clustered":
            raise ValueError(f"centres_enu_m: pattern {self.pattern} has none; write pattern: clustered")
        return self


class Wind(Model):
    """Mean wind and gusts (first-order Gauss-Markov, after the Dryden model's length scale)."""

    mean_speed_mps: float = Field(2.0, ge=0, le=25)
    from_heading_deg: float = Field(240.0, ge=0, lt=360, description="Direction that the wind comes from")
    gust_std_mps: float = Field(0.5, ge=0, le=8, description="Standard deviation of the gusts")


class Light(Model):
    """Sun and air."""

    sun_elevation_deg: float = Field(
        45.0, ge=-90, le=90, description=f"A visible camera needs {SUN_LEAST_DEG:g} or more; below 0 is night"
    )
    sun_heading_deg: float = Field(150.0, ge=0, lt=360, description="Direction of the sun")
    visibility_m: float = Field(3000.0, ge=50, description="Haze hides everything farther away")
    air_temperature_c: float = Field(15.0, ge=-40, le=50, description="Seen by a thermal camera only")
    cloud_cover: float = Field(
        0.0, ge=0, le=1, description="Of the past day: less sun, less cold at night; thermal camera only"
    )

    @property
    def to_sun_enu(self) -> tuple[float, float, float]:
        """Direction to the sun, of length 1."""
        elevation, heading = math.radians(self.sun_elevation_deg), math.radians(self.sun_heading_deg)
        level = math.cos(elevation)
        return level * math.sin(heading), level * math.cos(heading), math.sin(elevation)

    @model_serializer(mode="wrap")
    def _without_what_is_open(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Light for a visible camera has the same keys as before there were these fields."""
        of_heat = {name: type(self).model_fields[name].default for name in _OF_HEAT}
        return {k: v for k, v in write(self).items() if k not in of_heat or v != of_heat[k]}


class VehicleLimits(Model):
    """The vehicle. Defaults are PX4's (v1.17) and fit its SIH quadrotor."""

    cruise_speed_mps: Speed = Field(
        5.0, description="On the way home and to where a search goes on; advice and tuning stay below"
    )
    climb_speed_mps: float = Field(3.0, ge=0.01, le=8)
    descent_speed_mps: float = Field(1.5, ge=0.01, le=4)
    battery_wh: float = Field(98.0, gt=1, le=5000)
    hover_power_w: float = Field(190.0, gt=1, le=20000, description="Power drawn from the battery in hover")
    batteries: int = Field(
        1,
        ge=1,
        le=MAX_BATTERIES,
        description="How many there are: with more than one it flies as many sorties",
    )
    swap_s: float = Field(
        120.0, ge=0, le=3600, description="On the ground between two sorties, to change the battery"
    )
    position_noise_m: float = Field(0.3, ge=0, le=20, description="Standard deviation of the slow GNSS error")
    attitude_noise_deg: float = Field(
        0.3, ge=0, le=10, description="Standard deviation of the slow attitude error"
    )

    @model_validator(mode="after")
    def _lands_some_day(self) -> VehicleLimits:
        hover_h = self.battery_wh / self.hover_power_w
        if hover_h > MAX_HOVER_H:
            raise ValueError(
                f"battery_wh: {self.battery_wh:g} Wh hover for {hover_h:.0f} h at hover_power_w "
                f"({self.hover_power_w:g} W); write less than lasts {MAX_HOVER_H:g} h, or more power"
            )
        return self

    @model_serializer(mode="wrap")
    def _without_other_batteries(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A vehicle with one battery has the same keys as before there were these fields."""
        of_sorties = {"batteries": 1, "swap_s": type(self).model_fields["swap_s"].default}
        return {k: v for k, v in write(self).items() if of_sorties.get(k) != v}


class Gimbal(Model):
    """3-axis gimbal. The mission believes the pitch that its joints report."""

    pitch_deg: float = Field(
        GIMBAL_PITCH_DEG[0],
        ge=GIMBAL_PITCH_DEG[0],
        le=GIMBAL_PITCH_DEG[1],
        description="-90 looks straight down",
    )
    max_rate_dps: float = Field(180.0, gt=1, le=1000, description="Largest turning rate")
    lag_s: float = Field(0.028, ge=0, le=2, description="Time constant of the stabilisation loop")

    @property
    def pitch_rad(self) -> float:
        """The pitch above the horizon."""
        return math.radians(self.pitch_deg)

    @property
    def looks_down(self) -> bool:
        """Whether the camera looks straight down, as plans assume."""
        return self.pitch_deg - GIMBAL_PITCH_DEG[0] <= DOWN_WITHIN_DEG


class CameraModel(Model):
    """Camera; the default is that of PX4's Typhoon H480 in Gazebo.

    A thermal camera sees the long-wave infrared, white hot; its defaults are those of a common core, 640 x
    512 pixels of 12 um behind 13.5 mm.
    """

    kind: CameraKind = Field("visible", description="thermal: other defaults, see docs/thermal.md")
    width_px: int = Field(640, ge=64, le=8192)
    height_px: int = Field(360, ge=64, le=8192)
    hfov_rad: float = Field(2.0, gt=0.02, lt=3.0, description="Horizontal field of view")
    rate_hz: float = Field(10.0, ge=0.1, le=60, description="Pictures a second")
    exposure_s: float = Field(1 / 500, gt=0, le=0.1, description="Longer: brighter but blurred in motion")
    noise_std: float = Field(2.0, ge=0, le=50, description="Grey levels (0..255); of a visible camera")
    netd_k: float = Field(
        0.05, ge=0, le=2, description="Noise of a thermal camera, as a temperature difference (NETD)"
    )
    jpeg_quality: int = Field(90, ge=10, le=100)
    latency_s: float = Field(0.2, ge=0, le=5, description="From exposure until the detection arrives")
    pose_delay_s: float = Field(
        0.1, ge=0, le=2, description="Age of the believed pose when the picture is taken"
    )
    gimbal: Gimbal = Gimbal()

    @model_validator(mode="before")
    @classmethod
    def _of_its_kind(cls, data: Any) -> Any:
        is_thermal = isinstance(data, dict) and data.get("kind") == "thermal"
        return {**_THERMAL_CAMERA, **data} if is_thermal else data

    @model_validator(mode="after")
    def _noise_of_its_kind(self) -> CameraModel:
        other, own = ("netd_k", "noise_std") if self.kind == "visible" else ("noise_std", "netd_k")
        if getattr(self, other) != type(self).model_fields[other].default:
            raise ValueError(f"{other}: is not of a {self.kind} camera; delete it, or write {own}")
        return self

    @model_serializer(mode="wrap")
    def _without_other_kinds(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A visible camera has the same keys as before there was another."""
        left_out = ("kind", "netd_k") if self.kind == "visible" else ("noise_std",)
        return {k: v for k, v in write(self).items() if k not in left_out}

    @property
    def lens(self) -> Lens:
        """The lens as the geometry module wants it."""
        return Lens(self.width_px, self.height_px, self.hfov_rad)


OWN_DETECTORS: dict[CameraKind, str] = {
    "visible": "skysweep",
    "thermal": "skysweep-thermal",
}  # by the kind of the camera
_THERMAL_CAMERA = {"width_px": 640, "height_px": 512, "hfov_rad": 0.554, "exposure_s": 0.01}


class DetectorModel(Model):
    """Which detector, and how often it looks."""

    model: str = Field(
        "skysweep",
        description="'skysweep', for a thermal camera 'skysweep-thermal' (ours, shipped), or the path of an "
        "ONNX file",
    )
    rate_hz: float = Field(2.5, ge=0.1, le=60, description="Looks a second, at most the camera's rate")
    confidence_min: float = Field(0.25, ge=0.01, le=0.99, description="Detections below are dropped")
    iou_max: float = Field(0.5, gt=0, le=1, description="Boxes of one class that overlap more are one thing")
    tiles: int = Field(
        1, ge=1, le=8, description="Split the picture into tiles x tiles, each scaled to the model's input"
    )
    halve_above_px: float = Field(
        HALVE_ABOVE_PX,
        gt=0,
        allow_inf_nan=True,
        description="Give a model that takes any size a picture of 1280 pixels or more at half of its size "
        "while the smallest target is longer than this in it; .inf: never",
    )
    boxes: Literal["pixels", "normalised"] | None = Field(
        None, description="What the model's boxes are measured in, where its file leaves that open"
    )
    pixels: Literal["0..255", "0..1", "imagenet"] | None = Field(
        None, description="What pixel values the model takes, if not those of its family's exports"
    )
    channels: Literal["rgb", "bgr"] | None = Field(
        None, description="The order of the pixels' channels, if not that of its family's exports"
    )
    statistical_model: str | None = Field(
        None,
        description="YAML file of 'skysweep calibrate', to fly without pictures; default: the shipped one",
    )

    @field_validator("halve_above_px", mode="before")
    @classmethod
    def _no_truth(cls, value: Any) -> Any:
        return _number_or_inf(value)

    @model_serializer(mode="wrap")
    def _without_what_is_open(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A scenario that leaves them open has the same keys as before there were these fields."""
        open_so = {"boxes": None, "pixels": None, "channels": None, "halve_above_px": HALVE_ABOVE_PX}
        return {k: v for k, v in write(self).items() if k not in open_so or v != open_so[k]}


def _number_or_inf(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("write a number > 0, or .inf")
    return value


PositiveOrInf = Annotated[float, Field(gt=0, allow_inf_nan=True)]


class Search(Model):
    """Strategy and its parameters (Algorithm 1 of the paper). ``n_c`` and ``d_c_m`` may be ``.inf``."""

    strategy: str = Field(
        "scan-check",
        description="scan-check, belief, scan-only, low-only, an installed one, or your own as MODULE:NAME",
    )
    n_c: PositiveOrInf = Field(5.0, description="Check after this many candidates")
    d_c_m: PositiveOrInf = Field(
        math.inf, description="Check when this far from the place where the last one was seen"
    )
    c_t: float = Field(0.6, gt=0, lt=1, description="Confidence at h_C that confirms")
    scan_altitude_agl_m: float = Field(30.0, gt=0, le=500, description="h_S")
    check_altitude_agl_m: float = Field(4.0, gt=0, le=200, description="h_C")
    scan_speed_mps: Speed = Field(5.0, description="In SCAN")
    check_speed_mps: Speed = Field(1.0, description="In CHECK")
    sidelap: float = Field(
        0.2, ge=0, lt=0.95, description="Share of a picture's width that neighbouring transects share"
    )
    transect_heading_deg: float | None = Field(None, ge=0, lt=360, description="Default: the best angle")
    plan: str | None = Field(None, description="A QGroundControl .plan whose survey becomes F")
    confirm_height_max_m: float | None = Field(
        None,
        gt=0,
        description="Largest height above a candidate from which a look may confirm it; null: any. "
        "A strategy of your own must heed it itself",
    )
    target_speed_mps: float = Field(
        0.0,
        ge=0,
        le=20,
        description="How fast targets may move: sightings that far apart may be of one candidate",
    )
    parameters: dict[str, float | bool | str] = Field(
        default_factory=dict, description="The strategy's own, by name"
    )

    @model_serializer(mode="wrap")
    def _without_what_is_open(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A scenario whose targets stand still has the same keys as before there was this field."""
        return {k: v for k, v in write(self).items() if k != "target_speed_mps" or v}

    @field_validator("n_c", "d_c_m", mode="before")
    @classmethod
    def _no_truth(cls, value: Any) -> Any:
        return _number_or_inf(value)

    @field_validator("n_c", "d_c_m")
    @classmethod
    def _no_nan(cls, value: float) -> float:
        if math.isnan(value):
            raise ValueError("write a number > 0, or .inf")
        return value

    @field_validator("n_c")
    @classmethod
    def _whole(cls, value: float) -> float:
        if math.isfinite(value) and value != round(value):
            raise ValueError("write a whole number of candidates, or .inf")
        return value

    @model_validator(mode="after")
    def _check_below_scan(self) -> Search:
        if self.check_altitude_agl_m >= self.scan_altitude_agl_m:
            raise ValueError(
                f"check_altitude_agl_m: is {self.check_altitude_agl_m:g}; write less than "
                f"scan_altitude_agl_m ({self.scan_altitude_agl_m:g})"
            )
        least_m = self.check_altitude_agl_m + ALTITUDE_TOLERANCE_M
        if not self.may_confirm_from(least_m):
            raise ValueError(
                f"confirm_height_max_m: is {self.confirm_height_max_m:g}, and checks are flown at "
                f"check_altitude_agl_m ({self.check_altitude_agl_m:g}); write {least_m:g} or more"
            )
        return self

    def may_confirm_from(self, height_m: float) -> bool:
        """Whether a look from this height above a candidate may confirm it."""
        return self.confirm_height_max_m is None or height_m <= self.confirm_height_max_m


class Safety(Model):
    """Limits at which the mission holds, turns home or lands by itself: docs/safety.md."""

    no_fly_enu_m: list[list[PointXY]] = Field(
        default_factory=list, description="Corners of each area that is not flown over"
    )
    fence_tolerance_m: float = Field(
        5.0,
        ge=0,
        le=100,
        description="Outside the fence, inside a no-fly area or above the ceiling by more: home",
    )
    fence_margin_m: float | None = Field(
        30.0,
        ge=5,
        le=10_000,
        description="Without geofence_enu_m: largest distance from area, path, home and take-off; null: any",
    )
    clearance_m: float = Field(
        2.0, ge=0, le=100, description="Distance kept from trees, buildings and hillsides in every direction"
    )
    descent_floor_agl_m: float = Field(
        2.0,
        ge=0,
        le=100,
        description="Lowest height of a descent, to keep clear of unknown objects",
    )
    check_outside_area: bool = Field(
        False, description="Whether candidates outside the area, or in a hole of it, are checked"
    )
    altitude_max_agl_m: float = Field(120.0, gt=0, le=600, description="Ceiling above ground")
    altitude_min_agl_m: float = Field(1.0, ge=0, le=100, description="Lower than this while searching: home")
    radio_mast_enu_m: tuple[float, float, Annotated[float, Field(ge=0, le=500)]] | None = Field(
        None,
        description="The radio's antenna: east, north, and height above the ground; default 2 m above home",
    )
    battery_low: float = Field(0.15, ge=0, lt=1, description="Share of the battery left: home")
    battery_critical: float = Field(0.05, ge=0, lt=1, description="Share of the battery left: land at once")
    landing_reserve: float = Field(
        0.1, ge=0, lt=1, description="Share of the battery that is left after the way home and landing"
    )
    battery_unknown_s: float = Field(
        30.0, ge=0, le=3600, description="The vehicle does not report its battery for longer: home"
    )
    battery_estimated: bool = Field(
        False,
        description="Fly a vehicle that never reports its battery, as if it were full at take-off",
    )
    air_speed_max_mps: float = Field(
        9.8, gt=0, le=50, description="Speed that the vehicle can sustain in level flight"
    )
    stuck_return_s: float = Field(
        60.0,
        gt=0,
        le=3600,
        description="No nearer to its waypoint, or with its nose turned away, for longer: home",
    )
    wind_max_mps: float = Field(9.0, gt=0, le=50, description="Estimated mean wind above: hold")
    wind_hold_s: float = Field(60.0, ge=0, le=3600, description="Wind above the limit for longer: home")
    position_std_max_m: float = Field(
        5.0, gt=0, le=100, description="Claimed horizontal standard deviation above: hold"
    )
    position_jump_m: float = Field(10.0, ge=2, le=1000, description="Not explained by the velocity: hold")
    position_hold_s: float = Field(
        30.0, ge=0, le=3600, description="No position for longer: land; position that stays displaced: home"
    )
    link_hold_s: float = Field(1.0, gt=0, le=60, description="Telemetry silent for longer: hold")
    link_return_s: float = Field(60.0, gt=0, le=3600, description="Telemetry silent for longer: home")
    detector_silent_s: float = Field(
        2.0,
        gt=0,
        le=60,
        description="Answers missing for longer: the stretch flown meanwhile is scanned again",
    )
    detector_dead_s: float = Field(60.0, gt=0, le=3600, description="No answer for longer: home")

    @model_serializer(mode="wrap")
    def _without_no_mast(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Without a mast, the keys are those from before there was this field."""
        return {k: v for k, v in write(self).items() if k != "radio_mast_enu_m" or v is not None}

    @model_validator(mode="after")
    def _lands_at_home(self) -> Safety:
        for name in ("landing_reserve", "battery_low"):
            if self.battery_critical > getattr(self, name):
                raise ValueError(
                    f"battery_critical: is {self.battery_critical:g}; write at most {name} "
                    f"({getattr(self, name):g}), or raise that: it lands on the way home otherwise"
                )
        return self

    @model_validator(mode="after")
    def _areas_are_simple(self) -> Safety:
        corners = sum(map(len, self.no_fly_enu_m))
        if corners > MAX_FENCE_CORNERS:
            raise ValueError(
                f"no_fly_enu_m: has {corners:,} corners, too many to find ways round; "
                f"simplify it to {MAX_FENCE_CORNERS:,} or fewer"
            )
        for index, ring in enumerate(self.no_fly_enu_m):
            if len(ring) < 3 or not shapely.Polygon(ring).is_valid:
                raise ValueError(f"no_fly_enu_m[{index}]: write at least 3 corners, in order around it")
        return self


class Scenario(Model):
    """One mission, whole."""

    name: str = Field(min_length=1, max_length=80, pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]*$")
    description: str = Field("", description="One line for lists and reports")
    area: Area
    home: Home = Home()
    geofence_enu_m: list[PointXY] | None = Field(
        None,
        max_length=MAX_FENCE_CORNERS,
        description="Corners of the area that the vehicle may not leave; contains home and area",
    )
    terrain: Terrain = Terrain()
    trees: list[Tree] = Field(default_factory=list, description="Single trees")
    forests: list[Forest] = Field(default_factory=list, description="Trees at random")
    buildings: list[Building] = Field(
        default_factory=list,
        max_length=MAX_BUILDINGS,
        description="Buildings occlude; the vehicle keeps clear of them",
    )
    buildings_file: str | None = Field(
        None,
        description="More buildings: GeoJSON of footprints with OpenStreetMap's names (building, height, "
        "building:levels, roof:shape)",
    )
    roads_file: str | None = Field(
        None,
        description="Roads: GeoJSON of lines with OpenStreetMap's names (highway, width, surface)",
    )
    targets: list[Target] = Field(default_factory=list, description="What to find, placed by hand")
    distractors: list[Distractor] = Field(
        default_factory=list, description="Objects that resemble a target from above, placed by hand"
    )
    generators: list[Generator] = Field(
        default_factory=list, description="Targets and distractors placed at random"
    )
    scatter_m: float = Field(
        0.0,
        ge=0,
        le=1000,
        description="Standard deviation by which each target and distractor is moved, anew for each seed",
    )
    wind: Wind = Wind()
    light: Light = Light()
    vehicle: VehicleLimits = VehicleLimits()
    camera: CameraModel = CameraModel()
    detector: DetectorModel = DetectorModel()
    search: Search = Search()
    safety: Safety = Safety()

    @model_serializer(mode="wrap")
    def _without_files(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A scenario without files is written as before there were any."""
        return {k: v for k, v in write(self).items() if k not in _OF_FILES or v is not None}

    @model_validator(mode="before")
    @classmethod
    def _detector_of_the_camera(cls, data: Any) -> Any:
        """Without ``detector.model``, that of the camera's kind."""
        if not isinstance(data, dict):
            return data
        camera, detector = data.get("camera"), data.get("detector", {})
        kind = camera.get("kind") if isinstance(camera, dict) else getattr(camera, "kind", None)
        if kind == "thermal" and isinstance(detector, dict):
            return {**data, "detector": {"model": OWN_DETECTORS["thermal"], **detector}}
        return data

    @model_validator(mode="after")
    def _detector_sees_the_camera(self) -> Scenario:
        kind, model = self.camera.kind, self.detector.model
        if model in OWN_DETECTORS.values() and model != OWN_DETECTORS[kind]:
            raise ValueError(
                f"detector.model: {model} does not know the pictures of a {kind} camera; write "
                f"{OWN_DETECTORS[kind]} or the path of an ONNX file"
            )
        return self

    @property
    def frame(self) -> LocalFrame:
        """The ENU frame. Altitudes are AMSL throughout (no geoid model: the origin's own is kept)."""
        return LocalFrame(self.home.latitude_deg, self.home.longitude_deg, self.home.altitude_amsl_m)

    @property
    def area_enu_m(self) -> shapely.Polygon:
        """The search area as a polygon in ENU metres."""
        if self.area.polygon_enu_m is not None:
            return shapely.Polygon(self.area.polygon_enu_m, self.area.holes_enu_m)

        def enu(corners: list[PointXY]) -> list[PointXY]:
            geodetic = [(lat, lon, self.home.altitude_amsl_m) for lat, lon in corners]
            return [(float(p[0]), float(p[1])) for p in self.frame.enu_from_geodetic(geodetic)]

        assert self.area.polygon_lat_lon_deg is not None
        return shapely.Polygon(
            enu(self.area.polygon_lat_lon_deg), [enu(hole) for hole in self.area.holes_lat_lon_deg]
        )

    @model_validator(mode="after")
    def _area_is_searchable(self) -> Scenario:
        corners = self.area.polygon_enu_m or self.area.polygon_lat_lon_deg or []
        if len(corners) < 3:
            raise ValueError("area: write at least 3 corners")
        polygon = self.area_enu_m
        if polygon.convex_hull.area < 1.0:
            raise ValueError("area: the polygon is empty (less than 1 m2); check the corners")
        if not polygon.is_valid:
            reason = shapely.is_valid_reason(polygon)
            raise ValueError(
                f"area: the polygon is not simple ({reason}); list the corners in order around it"
            )
        if polygon.area < 1.0:
            raise ValueError("area: the holes leave nothing to search; make them smaller")
        if polygon.area > MAX_AREA_KM2 * 1e6:
            raise ValueError(
                f"area: {polygon.area / 1e6:.0f} km2 is more than one vehicle can search "
                f"({MAX_AREA_KM2:g} km2); split it, or check the units (metres)"
            )
        distance_km = polygon.distance(shapely.Point(self.home.position_enu_m)) / 1000
        if not distance_km <= MAX_DISTANCE_FROM_HOME_KM:
            raise ValueError(
                f"home: lies {distance_km:.0f} km from the area; write home's latitude_deg, longitude_deg "
                f"and position_enu_m within {MAX_DISTANCE_FROM_HOME_KM:g} km of it"
            )
        return self

    @model_validator(mode="after")
    def _home_inside_fence(self) -> Scenario:
        if self.geofence_enu_m is not None:
            if len(self.geofence_enu_m) < 3:
                raise ValueError("geofence_enu_m: write at least 3 corners")
            fence = shapely.Polygon(self.geofence_enu_m)
            if not fence.is_valid:
                raise ValueError(
                    "geofence_enu_m: the polygon crosses itself; list the corners in order around it"
                )
            if not fence.covers(shapely.Point(self.home.position_enu_m)):
                raise ValueError(
                    "home.position_enu_m: lies outside geofence_enu_m; move home or widen the fence"
                )
            if not fence.covers(self.area_enu_m):
                raise ValueError("geofence_enu_m: the search area reaches outside the fence; widen the fence")
        return self

    @model_validator(mode="after")
    def _may_be_flown(self) -> Scenario:
        home = shapely.Point(self.home.position_enu_m)
        for index, corners in enumerate(self.safety.no_fly_enu_m):
            if shapely.Polygon(corners).covers(home):
                raise ValueError(f"home.position_enu_m: lies in safety.no_fly_enu_m[{index}]; move home")
        if self.search.scan_altitude_agl_m > self.safety.altitude_max_agl_m:
            raise ValueError(
                f"search.scan_altitude_agl_m: is {self.search.scan_altitude_agl_m:g}; write at most "
                f"safety.altitude_max_agl_m ({self.safety.altitude_max_agl_m:g}), or raise that"
            )
        room_m = self.safety.altitude_max_agl_m + self.safety.fence_tolerance_m - ALTITUDE_TOLERANCE_M
        if self.search.scan_altitude_agl_m > room_m:
            raise ValueError(
                f"search.scan_altitude_agl_m: is {self.search.scan_altitude_agl_m:g}; write at most "
                f"{room_m:g}, or raise safety.altitude_max_agl_m or safety.fence_tolerance_m: heights are "
                f"kept within {ALTITUDE_TOLERANCE_M:g} m"
            )
        for name in ("descent_floor_agl_m", "altitude_min_agl_m"):
            if self.search.check_altitude_agl_m < getattr(self.safety, name):
                raise ValueError(
                    f"search.check_altitude_agl_m: is {self.search.check_altitude_agl_m:g}; write at least "
                    f"safety.{name} ({getattr(self.safety, name):g}), or lower that"
                )
        return self

    @model_validator(mode="after")
    def _is_light_enough(self) -> Scenario:
        elevation = self.light.sun_elevation_deg
        if self.camera.kind == "visible" and elevation < SUN_LEAST_DEG:
            raise ValueError(
                f"light.sun_elevation_deg: is {elevation:g}; write {SUN_LEAST_DEG:g} or more, or "
                "camera.kind: thermal"
            )
        return self

    @model_validator(mode="after")
    def _can_be_placed(self) -> Scenario:
        area = self.area_enu_m
        for index, generator in enumerate(self.generators):
            for x, y in generator.centres_enu_m or []:
                if area.distance(shapely.Point(x, y)) > generator.spread_m:
                    raise ValueError(
                        f"generators[{index}].centres_enu_m: [{x:g}, {y:g}] lies outside the area; "
                        "write centres inside it"
                    )
        return self

    @model_validator(mode="after")
    def _fits_in_memory(self) -> Scenario:
        west, south, east, north = self.area_enu_m.bounds
        around_m2 = (east - west + 2 * MARGIN_M) * (north - south + 2 * MARGIN_M)
        trees = float(len(self.trees))
        for index, forest in enumerate(self.forests):
            ground_m2 = shapely.Polygon(forest.polygon_enu_m).area if forest.polygon_enu_m else around_m2
            trees += forest.trees_per_hectare * ground_m2 / 1e4
            if trees > MAX_TREES:
                raise ValueError(
                    f"forests[{index}].trees_per_hectare: makes {trees:.0f} trees with all before it, more "
                    f"than can be drawn ({MAX_TREES}); write fewer, or a smaller polygon_enu_m"
                )
        objects = len(self.targets) + len(self.distractors) + sum(g.count for g in self.generators)
        if objects > MAX_OBJECTS:
            raise ValueError(
                f"generators: make {objects} objects with targets and distractors; "
                f"write at most {MAX_OBJECTS} in all"
            )
        camera = self.camera
        looks = camera.latency_s * min(camera.rate_hz, self.detector.rate_hz)
        if looks * camera.width_px * camera.height_px > MAX_WAITING_PX:
            raise ValueError(
                f"camera.latency_s: {looks:.0f} pictures wait for their answers, more than fit in memory; "
                "write a smaller latency_s, width_px or height_px"
            )
        return self

    @property
    def target_classes(self) -> tuple[str, ...]:
        """The classes that this mission searches for."""
        classes = get_args(TargetClass)
        kinds = {t.kind for t in self.targets} | {g.kind for g in self.generators if g.kind in classes}
        return tuple(sorted(kinds)) or classes

    def pixels_on_target(self, altitude_agl_m: float) -> float:
        """Pixels that the smallest target spans in its pose, seen straight down from ``altitude_agl_m``."""
        return float(np.asarray(self.camera.lens.pixels_on_target(self.smallest_extent_m, altitude_agl_m)))

    @property
    def smallest_extent_m(self) -> float:
        """What the smallest target spans in its pose, seen straight down."""
        return min(SHARE_FROM_ABOVE.get(pose, 1.0) * size_m for _, pose, size_m in self._searched())

    @property
    def smallest_size_m(self) -> float:
        """That of the smallest target."""
        return min(size_m for _, _, size_m in self._searched())

    @property
    def target_poses(self) -> dict[str, tuple[str, ...]]:
        """Poses of the searched objects, by class."""
        return {
            kind: tuple(sorted({pose for other, pose, _ in self._searched() if other == kind}))
            for kind in self.target_classes
        }

    @property
    def target_sizes_m(self) -> dict[str, tuple[float, float]]:
        """Smallest and largest size of the searched objects, by class."""
        found: dict[str, tuple[float, float]] = {}
        for kind in self.target_classes:
            sizes = [size_m for other, _, size_m in self._searched() if other == kind]
            found[kind] = min(sizes), max(sizes)
        return found

    def _searched(self) -> Iterator[tuple[str, str, float]]:
        """Class, pose and size of what is searched for; the usual ones where nothing is told."""
        for kind in self.target_classes:
            told: list[tuple[str | None, float | None]] = [
                (t.pose, t.size_m) for t in self.targets if t.kind == kind
            ]
            for g in self.generators:
                if g.kind == kind:
                    told += itertools.product(g.poses or (None,), g.sizes_m)
            for pose, size_m in told or [(None, None)]:
                yield kind, pose or DEFAULT_POSE.get(kind, "face-up"), size_m or DEFAULT_SIZE_M[kind]

    def with_search(self, **changes: Any) -> Scenario:
        """A copy with other search parameters, validated again."""
        data = self.model_dump(by_alias=True)
        data["search"].update(changes)
        return Scenario.model_validate(data)
