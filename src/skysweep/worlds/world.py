"""The true world of a mission. Everything random in it is drawn here, from one seed.

Only simulated sensors and results may look at it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import shapely
from numba import njit
from numpy.typing import ArrayLike

from skysweep.arrays import F64, U8
from skysweep.errors import UserError
from skysweep.geometry.areas import turned_boxes
from skysweep.scenarios.files import ground_files
from skysweep.scenarios.model import (
    DEFAULT_POSE,
    DEFAULT_SIZE_M,
    MARGIN_M,
    MAX_TREES,
    SIZE_OF_AGE_M,
    Forest,
    LandClass,
    Light,
    Motion,
    Scenario,
)
from skysweep.types import XY
from skysweep.worlds.elevation import Elevation, elevation
from skysweep.worlds.land_cover import WORLDCOVER, LandCover, growth, land_cover
from skysweep.worlds.map_features import Box, Notes
from skysweep.worlds.map_features import buildings as buildings_in
from skysweep.worlds.motion import Placing, Track, track_of
from skysweep.worlds.places import Ground, beside_trees, generate_positions, scattered
from skysweep.worlds.rasters import Bounds, GroundPicture, ground_picture

WAY_STEP_S = 2.0  # between the places of a drawn track
HELD_OUT_VARIANTS = 1000  # asset variants from here on never appear in training pictures
STANDING_SIGN_EDGE_M = 2.1  # height of a standing sign's lower edge
_SURFACES_ACROSS = 200  # places over the area at which its surfaces are counted, each way
_FROM_WALLS_M = 1.0  # for what is placed at random: half the length of a person who lies there, and more
_CLEAR_AT_HOME_M = 6.0  # of trees that are drawn


@dataclass(frozen=True, slots=True)
class WorldObject:
    """A target or a distractor. ``variant`` seeds its looks (mesh proportions, colours).

    Where it has a ``track``, it is at ``position_enu_m`` at time 0, and ``World.at`` says where later.
    """

    kind: str
    position_enu_m: F64  # (3,), on the ground
    yaw_rad: float
    size_m: float
    pose: str
    is_target: bool
    variant: int
    clothing: str | None = None  # as ``scenarios.model.Clothing``; None: any, by the variant
    track: Track | None = None  # None: it does not move


@dataclass(frozen=True, slots=True)
class WorldTree:
    """A trunk with a crown. The crown is an ellipsoid (or cone) between 0.35 and 1.0 of the height."""

    position_enu_m: F64  # (3,)
    height_m: float
    crown_radius_m: float
    kind: str
    variant: int


@dataclass(frozen=True, slots=True)
class WorldBuilding:
    """A box ``size_m`` (length, width) with eaves at ``height_m`` and a gable roof."""

    position_enu_m: F64  # (3,)
    size_m: tuple[float, float]
    height_m: float
    yaw_rad: float
    variant: int
    flat_roof: bool = False  # at height_m, instead of the gable


@dataclass(frozen=True, slots=True)
class WorldClutter:
    """A thing that is neither searched for nor a distractor, as ``assets.clutter`` makes it."""

    kind: str
    position_enu_m: F64  # (3,)
    length_m: float
    yaw_rad: float
    variant: int


@dataclass(frozen=True)
class GroundCover:
    """What covers the ground, cell by cell over a regular grid; beyond its edges as at the edge."""

    codes: U8  # (rows south to north, columns west to east), indices of names
    bounds_enu_m: tuple[float, float, float, float]  # west, south, east, north
    names: tuple[str, ...]  # surfaces, as in terrain.surface

    def codes_at(self, xy_enu_m: ArrayLike) -> U8:
        """Indices (N,) into ``names`` at points (N, 2)."""
        xy = np.atleast_2d(np.asarray(xy_enu_m, dtype=float))
        west, south, east, north = self.bounds_enu_m
        rows, columns = self.codes.shape
        i = np.clip((xy[:, 1] - south) / (north - south) * rows, 0, rows - 1).astype(int)
        j = np.clip((xy[:, 0] - west) / (east - west) * columns, 0, columns - 1).astype(int)
        return np.asarray(self.codes[i, j])

    def name_at(self, x_m: float, y_m: float) -> str:
        """The surface at one point."""
        return self.names[int(self.codes_at((x_m, y_m))[0])]


@dataclass(frozen=True)
class TerrainSurface:
    """Ground height over a regular grid, bilinear in between, flat beyond the edges."""

    heights_m: F64  # (rows south to north, columns west to east)
    bounds_enu_m: tuple[float, float, float, float]  # west, south, east, north
    surface: str  # where there is no cover
    cover: GroundCover | None = None

    def surface_at(self, x_m: float, y_m: float) -> str:
        """What covers the ground at one point."""
        return self.surface if self.cover is None else self.cover.name_at(x_m, y_m)

    @property
    def is_flat(self) -> bool:
        return self._level_m is not None

    @cached_property
    def _level_m(self) -> float | None:
        """The height of flat ground."""
        return float(self.heights_m[0, 0]) if np.ptp(self.heights_m) == 0.0 else None

    def height_m(self, xy_enu_m: ArrayLike) -> F64:
        """Ground height (N,) in metres ENU at points (N, 2)."""
        xy = np.atleast_2d(np.asarray(xy_enu_m, dtype=float))
        if self._level_m is not None:
            return np.full(len(xy), self._level_m)
        return bilinear(self.heights_m, self.bounds_enu_m, xy)

    def height_at_m(self, x_m: float, y_m: float) -> float:
        """Ground height in metres ENU at one point; fast, because missions ask at every step."""
        if self._level_m is not None:
            return self._level_m
        return bilinear_at(self.heights_m, self.bounds_enu_m, x_m, y_m)


@njit(cache=True)
def bilinear(heights: F64, bounds: tuple[float, float, float, float], xy: F64) -> F64:
    """Heights (N,) at points (N, 2) of a grid over ``bounds``: west, south, east, north."""
    out = np.empty(len(xy))
    for k in range(len(xy)):
        out[k] = bilinear_at(heights, bounds, xy[k, 0], xy[k, 1])
    return out


@njit(cache=True)
def bilinear_at(heights: F64, bounds: tuple[float, float, float, float], x: float, y: float) -> float:
    """As ``bilinear``, at one point."""
    west, south, east, north = bounds
    rows, columns = heights.shape
    r = min(max((y - south) / (north - south) * (rows - 1), 0.0), rows - 1.0)
    c = min(max((x - west) / (east - west) * (columns - 1), 0.0), columns - 1.0)
    i, j = min(int(r), rows - 2), min(int(c), columns - 2)
    south_share, west_share = 1.0 - (r - i), 1.0 - (c - j)
    north_share, east_share = 1.0 - south_share, 1.0 - west_share
    return float(
        heights[i, j] * south_share * west_share
        + heights[i, j + 1] * south_share * east_share
        + heights[i + 1, j] * north_share * west_share
        + heights[i + 1, j + 1] * north_share * east_share
    )


@dataclass(frozen=True)
class World:
    """Everything that a simulated sensor can see."""

    terrain: TerrainSurface
    objects: tuple[WorldObject, ...]
    trees: tuple[WorldTree, ...]
    buildings: tuple[WorldBuilding, ...]
    light: Light
    seed: int  # of textures and other looks
    ground_picture: GroundPicture | None = None
    clutter: tuple[WorldClutter, ...] = ()  # in the pictures of data sets only
    wind_mps: float = 2.0  # which cools, as the latitude heats: both matter in the infrared only
    latitude_deg: float = 60.0

    @property
    def targets(self) -> tuple[WorldObject, ...]:
        return tuple(o for o in self.objects if o.is_target)

    def at(self, thing: WorldObject, time_s: float) -> WorldObject:
        """An object as it is at a time of the mission, in its place then and facing where it goes."""
        if thing.track is None:
            return thing
        x, y, yaw_rad = thing.track.at(time_s)
        return replace(thing, position_enu_m=_on_ground(self.terrain, (x, y)), yaw_rad=yaw_rad)

    def position(self, thing: WorldObject, time_s: float) -> F64:
        """Where an object is at a time of the mission: (3,), on the ground."""
        return self.at(thing, time_s).position_enu_m

    def way(self, thing: WorldObject, until_s: float) -> tuple[F64, F64]:
        """Times (N,) from 0 on, every WAY_STEP_S and the end, and its places (N, 3) then."""
        times_s = np.append(np.arange(0.0, until_s, WAY_STEP_S), until_s)
        return times_s, np.array([self.position(thing, t) for t in times_s.tolist()])


def build_terrain(scenario: Scenario) -> TerrainSurface:
    """The scenario's ground. Its height at home is 0 unless a heightmap says otherwise.

    Raises UserError where its files are not what they should be, MissingExtraError where rasterio is missing.
    """
    surface = _build_relief(scenario)
    cover = land_cover_of(scenario)
    if cover is None:
        return surface
    return replace(surface, cover=GroundCover(cover.surfaces, cover.bounds_enu_m, cover.names))


def ground_bounds(scenario: Scenario) -> Bounds:
    """West, south, east and north of the area and home with their margin."""
    with_home = shapely.box(*scenario.area_enu_m.bounds).union(shapely.Point(scenario.home.position_enu_m))
    west, south, east, north = with_home.buffer(MARGIN_M).bounds
    return west, south, east, north


def elevation_of(scenario: Scenario) -> Elevation | None:
    """What ``terrain.dem`` says of the ground, if there is one. Raises UserError as ``elevation``."""
    dem = ground_files(scenario).get("terrain.dem")
    if dem is None:
        return None
    unit, frame, home = scenario.terrain.dem_unit, scenario.frame, scenario.home.position_enu_m
    return elevation(dem, unit, frame, ground_bounds(scenario), scenario.area_enu_m, home)


def land_cover_of(scenario: Scenario) -> LandCover | None:
    """What ``terrain.land_cover`` and ``roads_file`` say. Raises UserError as ``land_cover``."""
    files, terrain = ground_files(scenario), scenario.terrain
    map_file, roads_file = files.get("terrain.land_cover"), files.get("roads_file")
    if map_file is None and roads_file is None:
        return None
    frame, bounds = scenario.frame, ground_bounds(scenario)
    return land_cover(map_file, roads_file, classes_of(scenario), terrain.surface, frame, bounds)


def surfaces_of(scenario: Scenario) -> dict[str, float]:
    """Shares of the search area by what covers its ground. Raises UserError as ``land_cover_of``."""
    cover = land_cover_of(scenario)
    if cover is None:
        return {scenario.terrain.surface: 1.0}
    ground = GroundCover(cover.surfaces, cover.bounds_enu_m, cover.names)
    west, south, east, north = scenario.area_enu_m.bounds
    across = [(np.arange(_SURFACES_ACROSS) + 0.5) / _SURFACES_ACROSS] * 2
    share_x, share_y = (share.ravel() for share in np.meshgrid(*across))
    xy = np.column_stack([west + share_x * (east - west), south + share_y * (north - south)])
    inside = shapely.intersects_xy(scenario.area_enu_m, xy)
    codes = ground.codes_at(xy[inside] if inside.any() else xy)
    return {ground.names[code]: float((codes == code).mean()) for code in np.unique(codes).tolist()}


def classes_of(scenario: Scenario) -> Sequence[LandClass]:
    """What the classes of ``terrain.land_cover`` are."""
    return scenario.terrain.land_cover_classes or WORLDCOVER


def ground_picture_of(scenario: Scenario) -> GroundPicture | None:
    """``terrain.orthophoto``, if there is one. Raises UserError as ``ground_picture``."""
    file = ground_files(scenario).get("terrain.orthophoto")
    return None if file is None else ground_picture(file, scenario.frame, ground_bounds(scenario))


def _build_relief(scenario: Scenario) -> TerrainSurface:
    bounds = west, south, east, north = ground_bounds(scenario)
    t = scenario.terrain
    dem = elevation_of(scenario)
    if dem is not None:
        return TerrainSurface(dem.heights_m, bounds, t.surface)
    if t.heightmap_m is not None:
        return TerrainSurface(np.asarray(t.heightmap_m, dtype=float), bounds, t.surface)
    if t.hills_height_m == 0:
        return TerrainSurface(np.zeros((2, 2)), bounds, t.surface)
    step = max(2.0, max(east - west, north - south) / 400)
    columns, rows = len(np.arange(west, east + step, step)), len(np.arange(south, north + step, step))
    X, Y = np.meshgrid(np.linspace(west, east, columns), np.linspace(south, north, rows))
    rng = np.random.default_rng([t.seed, 7])
    h = np.zeros_like(X)
    for octave in range(4):
        k = 2 * np.pi / t.hills_wavelength_m * 2**octave
        for _ in range(5):
            a, phase = rng.uniform(0, 2 * np.pi, 2)
            h += 0.5**octave * np.sin(k * (X * np.cos(a) + Y * np.sin(a)) + phase)
    h = (h - h.min()) / np.ptp(h) * t.hills_height_m
    surface = TerrainSurface(h, bounds, t.surface)
    return TerrainSurface(h - surface.height_at_m(*scenario.home.position_enu_m), bounds, t.surface)


class _Item(NamedTuple):
    """An object before it has its place on the ground and its looks."""

    kind: str
    position_enu_m: XY
    yaw_rad: float
    size_m: float | None
    pose: str | None
    is_target: bool
    clothing: str | None
    motion: Motion | None


def build_world(scenario: Scenario, seed: int) -> World:
    """The world of one mission. The same scenario and seed give the same world.

    Raises UserError where a generator places objects near trees and there are none.
    """
    terrain = build_terrain(scenario)
    trees, buildings = build_trees(scenario, terrain), build_buildings(scenario, terrain)
    outdoors = _outdoors(scenario.area_enu_m, buildings, 0.0)
    clear = _outdoors(scenario.area_enu_m, buildings, _FROM_WALLS_M)
    area = Ground(scenario.area_enu_m if clear.is_empty else clear)
    scatter = np.random.default_rng([seed, 19])
    rng = np.random.default_rng([seed, 11])
    items = _items(scenario, seed, area, trees)
    objects = []
    for index, item in enumerate(items):
        xy = scattered(item.position_enu_m, scenario.scatter_m, area, scatter)
        track = None
        if item.motion is not None:
            of_track = np.random.default_rng([seed, index, 41])
            track = track_of(item.motion, Placing(*xy, item.yaw_rad), scenario.wind, outdoors, of_track)
        thing = WorldObject(
            item.kind,
            _on_ground(terrain, xy),
            item.yaw_rad,
            item.size_m or DEFAULT_SIZE_M[item.kind],
            item.pose or DEFAULT_POSE.get(item.kind, "face-up"),
            item.is_target,
            HELD_OUT_VARIANTS + int(rng.integers(1000)),
            item.clothing,
            track,
        )
        objects.append(thing)
    picture = ground_picture_of(scenario)
    return World(
        terrain,
        tuple(objects),
        trees,
        buildings,
        scenario.light,
        seed,
        picture,
        wind_mps=scenario.wind.mean_speed_mps,
        latitude_deg=scenario.home.latitude_deg,
    )


def _items(scenario: Scenario, seed: int, area: Ground, trees: tuple[WorldTree, ...]) -> list[_Item]:
    """Targets, distractors, and what the generators place."""
    items = [
        _Item(t.kind, t.position_enu_m, np.radians(t.yaw_deg), t.size_m, t.pose, True, t.clothing, t.motion)
        for t in scenario.targets
    ]
    turned = np.random.default_rng([seed, 23]).uniform(0, 2 * np.pi, len(scenario.distractors))
    for d, yaw in zip(scenario.distractors, turned.tolist(), strict=True):
        yaw_rad = yaw if d.yaw_deg is None else np.radians(d.yaw_deg)
        items.append(_Item(d.kind, d.position_enu_m, yaw_rad, d.size_m, None, False, None, d.motion))
    target_kinds = scenario.target_classes
    for index, g in enumerate(scenario.generators):
        g_rng = np.random.default_rng([g.seed if g.seed is not None else seed + 100_000, index, 13])
        places = generate_positions(g, area, g_rng)
        if g.near == "trees":
            if not trees:
                raise UserError(f"generators[{index}].near: there are no trees; write some, or delete near")
            crowns = np.array([(*t.position_enu_m[:2], t.crown_radius_m) for t in trees])
            places = beside_trees(places, crowns, area, g_rng)
        for xy in places:
            pose = str(g_rng.choice(g.poses)) if g.poses else None
            yaw = float(g_rng.uniform(0, 2 * np.pi))
            clothing = str(g_rng.choice(g.clothing)) if g.clothing else None
            size_m = SIZE_OF_AGE_M[g.ages[int(g_rng.integers(len(g.ages)))]] if g.ages else g.size_m
            items.append(_Item(g.kind, xy, yaw, size_m, pose, g.kind in target_kinds, clothing, g.motion))
    return items


def _outdoors(
    area: shapely.Geometry, buildings: tuple[WorldBuilding, ...], away_m: float
) -> shapely.Geometry:
    """The area, so far away from its buildings."""
    walls = turned_boxes(
        [b.position_enu_m[:2] for b in buildings],
        [np.add(b.size_m, 2.0 * away_m) for b in buildings],
        [b.yaw_rad for b in buildings],
    )
    free = area.difference(shapely.union_all(walls)) if len(walls) else area
    shapely.prepare(free)
    return free


def build_trees(scenario: Scenario, terrain: TerrainSurface) -> tuple[WorldTree, ...]:
    """Single trees and forests: the same for every mission seed."""
    trees = [
        WorldTree(_on_ground(terrain, t.position_enu_m), t.height_m, t.crown_radius_m, t.kind, i)
        for i, t in enumerate(scenario.trees)
    ]
    for index, forest in enumerate(scenario.forests):
        trees += _grow(forest, terrain, scenario, index)
    return (*trees, *_grown(scenario, terrain, MAX_TREES - len(trees)))


def build_buildings(scenario: Scenario, terrain: TerrainSurface) -> tuple[WorldBuilding, ...]:
    """The scenario's buildings: the same for every mission seed."""
    own = [
        WorldBuilding(_on_ground(terrain, b.position_enu_m), b.size_m, b.height_m, math.radians(b.yaw_deg), i)
        for i, b in enumerate(scenario.buildings)
    ]
    mapped = [
        WorldBuilding(
            _on_ground(terrain, box.position_enu_m), box.size_m, box.eaves_m, box.yaw_rad, i, box.is_flat
        )
        for i, box in enumerate(mapped_buildings(scenario), len(own))
    ]
    return (*own, *mapped)


def mapped_buildings(scenario: Scenario) -> tuple[Box, ...]:
    """The boxes of ``buildings_file``, if there is one. Raises UserError as ``buildings``."""
    return _mapped_buildings(scenario)[0]


def notes_on_buildings(scenario: Scenario) -> Notes:
    """What of ``buildings_file`` was left out. Raises UserError as ``buildings``."""
    return _mapped_buildings(scenario)[1]


def _mapped_buildings(scenario: Scenario) -> tuple[tuple[Box, ...], Notes]:
    file = ground_files(scenario).get("buildings_file")
    return ((), ()) if file is None else buildings_in(file, scenario.frame, ground_bounds(scenario))


def _on_ground(terrain: TerrainSurface, xy: tuple[float, float]) -> F64:
    return np.array([*xy, terrain.height_at_m(*xy)])


def _grow(forest: Forest, terrain: TerrainSurface, scenario: Scenario, index: int) -> list[WorldTree]:
    rng = np.random.default_rng([forest.seed, index, 17])
    everywhere = scenario.area_enu_m.buffer(MARGIN_M).envelope
    ground = Ground(shapely.Polygon(forest.polygon_enu_m) if forest.polygon_enu_m else everywhere)
    count = round(forest.trees_per_hectare * ground.polygon.area / 1e4)
    clear = shapely.Point(scenario.home.position_enu_m).buffer(_CLEAR_AT_HOME_M)
    shapely.prepare(clear)
    trees: list[WorldTree] = []
    while len(trees) < count:
        x, y = ground.draw(1, rng)[0].tolist()
        height = float(rng.uniform(*forest.height_m))
        radius = float(rng.uniform(*forest.crown_radius_m))
        kind = "conifer" if rng.random() < forest.conifer_fraction else "broadleaf"
        variant = int(rng.integers(1000))
        if shapely.intersects_xy(clear, x, y):
            count -= 1
            continue
        trees.append(WorldTree(_on_ground(terrain, (x, y)), height, radius, kind, variant))
    return trees


def _grown(scenario: Scenario, terrain: TerrainSurface, most: int) -> list[WorldTree]:
    """The trees of the land cover that stand neither at home nor in a building."""
    cover = land_cover_of(scenario)
    if cover is None:
        return []
    g = growth(cover, classes_of(scenario), most, scenario.terrain.seed)
    clear = shapely.Point(scenario.home.position_enu_m).buffer(_CLEAR_AT_HOME_M)
    in_the_way = shapely.union_all([clear, *(box.outline() for box in mapped_buildings(scenario))])
    shapely.prepare(in_the_way)
    stands = ~shapely.intersects_xy(in_the_way, g.xy_enu_m)
    places = np.column_stack([g.xy_enu_m, terrain.height_m(g.xy_enu_m)])[stands]
    looks = [a[stands].tolist() for a in (g.height_m, g.crown_radius_m, g.is_conifer, g.variant)]
    return [
        WorldTree(place, height, radius, "conifer" if conifer else "broadleaf", variant)
        for place, height, radius, conifer, variant in zip(places, *looks, strict=True)
    ]
