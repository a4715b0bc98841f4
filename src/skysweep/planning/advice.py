"""What is odd about a valid scenario: the mission can fly, but hardly as its author meant."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import get_args

import numpy as np
import shapely
from numpy.typing import NDArray

from skysweep.errors import UserError
from skysweep.geometry.areas import turned_boxes
from skysweep.planning.flight_plan import FlightEstimate, plan_scenario
from skysweep.scenarios.model import (
    DEFAULT_SIZE_M,
    MARGIN_M,
    MAX_BATTERIES,
    MAX_TREES,
    Scenario,
    Search,
    TargetClass,
)
from skysweep.worlds.land_cover import wanted_trees
from skysweep.worlds.obstacles import known_obstacles
from skysweep.worlds.weather import sine_of_declination
from skysweep.worlds.world import (
    TerrainSurface,
    build_terrain,
    classes_of,
    elevation_of,
    ground_bounds,
    ground_picture_of,
    land_cover_of,
    mapped_buildings,
    notes_on_buildings,
)

UNSEEN_BELOW_PX = 8.0  # a small detector finds next to nothing on fewer pixels
WISHED_AT_SCAN_PX = 12.0
WISHED_AT_CHECK_PX = 30.0  # from here on a detector tells a target from what looks like one
_WORTH_SAYING = 0.005  # of the area
_ALTITUDE_OFF_M = 15.0
_FOOT_M, _LIKE_FEET = 0.3048, 0.03
_DECLINATION_MAX_DEG = 24.0  # the sun's is 23.4, and scenarios are rounded
_CROSSES_M = 1.0
_CONTRAST_MIN = 0.5  # below, detectors see clearly less
_SIMULATED_MAX_MPS = 12.0  # PX4's MPC_XY_VEL_MAX
_RASTER = 316  # points across an area


def warnings_for(scenario: Scenario, cover_altitude_agl_m: float | None = None) -> list[str]:
    """One sentence for each thing that will probably spoil the mission; empty when all is well.

    ``cover_altitude_agl_m`` is the height from which the area is covered, by default the scan altitude.
    """
    return [*warnings_for_plan(scenario, cover_altitude_agl_m), *_about_targets(scenario)]


def warnings_for_plan(scenario: Scenario, cover_altitude_agl_m: float | None = None) -> list[str]:
    """Those that need no targets."""
    return [
        *_about_plan(scenario.search, cover_altitude_agl_m),
        *warnings_for_batteries(scenario, cover_altitude_agl_m),
        *_about_way(scenario),
        *_about_footprints(scenario),
        *warnings_for_any_path(scenario),
    ]


def warnings_for_any_path(scenario: Scenario) -> list[str]:
    """Those that need no transects either."""
    return [
        *_about_ground(scenario),
        *_about_resolution(scenario),
        *_about_gimbal(scenario),
        *_about_obstacles(scenario),
        *_about_speeds(scenario),
        *_about_sun(scenario),
        *_about_haze(scenario),
    ]


def warnings_for_batteries(scenario: Scenario, altitude_agl_m: float | None = None) -> list[str]:
    """Whether the scenario's batteries last for the plan, and what would do; empty if they do.

    ``altitude_agl_m`` is the height from which the area is covered, by default the scan altitude. A plan that
    cannot be flown at all is refused elsewhere.
    """
    search, given = scenario.search, scenario.vehicle.batteries
    altitude = search.scan_altitude_agl_m if altitude_agl_m is None else altitude_agl_m
    needed = _estimate(scenario, altitude)
    if needed is None or needed.batteries <= given:
        return []
    cures = [f"vehicle.batteries: {needed.batteries}"] if needed.batteries <= MAX_BATTERIES else []
    highest_m = math.floor(
        min(altitude * needed.pixels_on_target / WISHED_AT_SCAN_PX, scenario.safety.altitude_max_agl_m)
    )
    may_rise = search.plan is None and altitude == search.scan_altitude_agl_m < highest_m
    higher = _estimate(scenario, highest_m) if may_rise else None
    if higher is not None and higher.batteries <= given:
        cures.append(f"search.scan_altitude_agl_m: {highest_m}")
    fastest_mps = min(scenario.vehicle.cruise_speed_mps, _held_mps(scenario))
    may_hasten = fastest_mps > search.scan_speed_mps
    faster = _estimate(scenario.with_search(scan_speed_mps=fastest_mps), altitude) if may_hasten else None
    if faster is not None and faster.batteries <= given:
        cures.append(f"search.scan_speed_mps: {fastest_mps:g}")
    lasts = "1 battery lasts" if given == 1 else f"{given} batteries last"
    long_h = needed.time_s / 3600.0
    how_long = f"{long_h:.1f} h" if long_h >= 1.0 else f"{60.0 * long_h:.0f} min"
    return [
        f"vehicle.batteries: {lasts} for {needed.shares_flown[given - 1]:.0%} of the plan, where the search "
        f"ends; the whole plan takes {needed.batteries} ({how_long} with the swaps), checks not counted; "
        f"{'write ' + ', or '.join(cures) if cures else 'search a smaller area'}"
    ]


def _estimate(scenario: Scenario, altitude_agl_m: float) -> FlightEstimate | None:
    """Of the plan at a height; None if it cannot be flown."""
    try:
        return plan_scenario(scenario, altitude_agl_m)[1]
    except UserError:
        return None


def _about_plan(search: Search, cover_altitude_agl_m: float | None) -> Iterator[str]:
    """A drawn plan that is for another height than its strategy's."""
    if search.plan is not None and cover_altitude_agl_m not in (None, search.scan_altitude_agl_m):
        yield (
            f"search.plan: is not flown: {search.strategy} covers the area from {cover_altitude_agl_m:g} m, "
            f"and plans are flown at search.scan_altitude_agl_m ({search.scan_altitude_agl_m:g}); take "
            "another strategy, or delete it"
        )


def _about_way(scenario: Scenario) -> Iterator[str]:
    """A path through no-fly areas, and a mast and ways beyond the ground that is known."""
    rings, mast = scenario.safety.no_fly_enu_m, scenario.safety.radio_mast_enu_m
    if scenario.search.plan is None and not rings and mast is None:
        return
    terrain = build_terrain(scenario)
    known = shapely.box(*terrain.bounds_enu_m)
    if mast is not None and not terrain.is_flat and (away_m := known.distance(shapely.Point(mast))) > 0.0:
        yield (
            f"safety.radio_mast_enu_m: stands {away_m:.0f} m beyond the ground that is known, which ends "
            f"{MARGIN_M:g} m around area and home; there it is taken to be as high as its edge, and what "
            "hides the mast there is not known: place it nearer, or enlarge the area"
        )
    if scenario.search.plan is None and not rings:
        return
    try:
        path = plan_scenario(scenario)[0].waypoints_xy_enu_m
    except UserError:
        return  # refused elsewhere
    kept_out = [shapely.Polygon(ring) for ring in rings]
    through_m = shapely.LineString(path).intersection(shapely.union_all(kept_out)).length
    if through_m > _CROSSES_M:
        yield (
            f"safety.no_fly_enu_m: the path leads {through_m:.0f} m through it; a mission flies round, and "
            "the ground there is not seen: leave it out of the area (area.holes_enu_m)"
        )
    around = shapely.MultiPoint(path).convex_hull
    ways = [("search.plan", around)] + [
        ("safety.no_fly_enu_m", ring) for ring in kept_out if ring.intersects(around)
    ]
    for field, way in ways:
        yield from beyond_ground(field, way, terrain)


def beyond_ground(field: str, way: shapely.Geometry, terrain: TerrainSurface) -> Iterator[str]:
    """A sentence where a way over hills leads beyond the ground that is known."""
    known = shapely.box(*terrain.bounds_enu_m)
    away_m = 0.0 if terrain.is_flat else shapely.hausdorff_distance(way.union(known), known)
    if away_m > _CROSSES_M:
        yield (
            f"{field}: leads up to {away_m:.0f} m beyond the ground that is known, which ends "
            f"{MARGIN_M:g} m around area and home; there it is taken to be as high as its edge: keep the "
            "way nearer, or enlarge the area"
        )


def localisation_std_m(scenario: Scenario, altitude_agl_m: float) -> float:
    """Standard deviation of a sighting's place on the ground in steady flight, metres, horizontal.

    GNSS error, attitude error times the height, and the way flown while the believed pose is late.
    """
    vehicle, camera = scenario.vehicle, scenario.camera
    return math.hypot(
        vehicle.position_noise_m,
        altitude_agl_m * math.radians(vehicle.attitude_noise_deg),
        scenario.search.scan_speed_mps * camera.pose_delay_s,
    )


def _about_ground(scenario: Scenario) -> Iterator[str]:
    dem, cover, picture = elevation_of(scenario), land_cover_of(scenario), ground_picture_of(scenario)
    if dem is not None:
        yield from dem.notes
        told_m, is_m = scenario.home.altitude_amsl_m, dem.home_amsl_m
        if abs(told_m - is_m) > _ALTITUDE_OFF_M:
            in_feet = told_m != 0.0 and abs(is_m / told_m * _FOOT_M - 1.0) < _LIKE_FEET
            cure = (
                "its heights are probably in feet: write terrain.dem_unit: feet" if in_feet else "write that"
            )
            yield (f"home.altitude_amsl_m: is {told_m:g} m, but terrain.dem has {is_m:.1f} m there; {cure}")
    if scenario.terrain.heightmap_m is not None:
        above_m = build_terrain(scenario).height_at_m(*scenario.home.position_enu_m)
        if abs(above_m) > _ALTITUDE_OFF_M:
            yield (
                f"terrain.heightmap_m: is {above_m:.0f} m at home, and heights count from "
                f"home.altitude_amsl_m, the ground's there; take {above_m:.0f} from all of them"
            )
    if cover is not None:
        yield from cover.notes
        grown = sum(wanted_trees(cover, classes_of(scenario)))
        if grown > MAX_TREES:
            yield (
                f"terrain.land_cover: grows {grown:,.0f} trees, of which {MAX_TREES:,} are drawn, so that "
                "woods are thinner than they are; search a smaller area, or write fewer trees_per_hectare"
            )
    yield from notes_on_buildings(scenario)
    if picture is not None:
        ground = shapely.box(*ground_bounds(scenario))
        share = picture.source.covered(ground).area / ground.area
        if share < 1.0 - _WORTH_SAYING:
            yield f"terrain.orthophoto: pictures {share:.0%} of the ground; the rest is drawn as the surface"
        if not picture.source.is_coarse_too:
            yield (
                "terrain.orthophoto: has no overviews, so that looks from high up read much of the file; "
                "add them with  gdaladdo"
            )


def _about_gimbal(scenario: Scenario) -> Iterator[str]:
    gimbal = scenario.camera.gimbal
    if not gimbal.looks_down:
        yield (
            f"camera.gimbal.pitch_deg: at {gimbal.pitch_deg:g} the camera does not look straight down, as "
            "the plan assumes: its transects, pixels and probabilities are those of -90, and how much of the "
            "area is seen is not known before it is flown; write -90"
        )


def _about_sun(scenario: Scenario) -> Iterator[str]:
    """A thermal camera sees the day behind the moment, which there is only of a sun that there may be."""
    light, latitude_deg = scenario.light, scenario.home.latitude_deg
    sine = sine_of_declination(light, math.radians(latitude_deg))
    if scenario.camera.kind == "thermal" and abs(sine) > math.sin(math.radians(_DECLINATION_MAX_DEG)):
        yield (
            f"light.sun_elevation_deg: the sun never stands {light.sun_elevation_deg:g} degrees high at "
            f"light.sun_heading_deg {light.sun_heading_deg:g} at home's latitude ({latitude_deg:.1f}), so "
            "temperatures are those of no real day; write both as  skysweep plan --at  prints them"
        )


def _about_haze(scenario: Scenario) -> Iterator[str]:
    """Contrast falls with distance as Koschmieder (1924) has it: to 2 % at the visibility."""
    visibility_m, height_m = scenario.light.visibility_m, scenario.search.scan_altitude_agl_m
    left = math.exp(-3.912 * height_m / visibility_m)
    if scenario.camera.kind == "visible" and left < _CONTRAST_MIN:
        highest_m = math.floor(-visibility_m * math.log(_CONTRAST_MIN) / 3.912)
        yield (
            f"light.visibility_m: from {height_m:g} m haze leaves {left:.0%} of the contrast, so pictures "
            "show less, while the statistical sensor draws looks as without haze; scan from "
            f"{highest_m} m or lower"
        )


def _about_resolution(scenario: Scenario) -> Iterator[str]:
    search = scenario.search
    h_s, h_c = search.scan_altitude_agl_m, search.check_altitude_agl_m
    px_s, px_c = scenario.pixels_on_target(h_s), scenario.pixels_on_target(h_c)
    if px_s < UNSEEN_BELOW_PX:
        yield (
            f"search.scan_altitude_agl_m: the smallest target spans only {px_s:.1f} pixels from {h_s:g} m; "
            f"scan from {h_s * px_s / WISHED_AT_SCAN_PX:.1f} m for {WISHED_AT_SCAN_PX:g} pixels, "
            "or write a narrower camera.hfov_rad"
        )
    if px_c < WISHED_AT_CHECK_PX:
        yield (
            f"search.check_altitude_agl_m: the smallest target spans only {px_c:.1f} pixels from {h_c:g} m, "
            "too few to tell it from what looks like it; "
            f"check from {h_c * px_c / WISHED_AT_CHECK_PX:.1f} m for {WISHED_AT_CHECK_PX:g} pixels"
        )


def _about_footprints(scenario: Scenario) -> Iterator[str]:
    search, lens = scenario.search, scenario.camera.lens
    h_s, h_c = search.scan_altitude_agl_m, search.check_altitude_agl_m
    error_m = 2 * localisation_std_m(scenario, h_s)
    half_m = min(lens.footprint_m(h_c)) / 2
    if half_m < error_m:
        yield (
            f"search.check_altitude_agl_m: from {h_c:g} m the picture reaches {half_m:.1f} m from its "
            f"centre, less than the {error_m:.1f} m (2 sigma) by which a candidate may be misplaced; "
            f"check from {h_c * error_m / half_m:.1f} m or higher"
        )
    step_m = search.scan_speed_mps / min(scenario.detector.rate_hz, scenario.camera.rate_hz)
    along_m = lens.footprint_m(h_s)[1]
    if step_m > along_m:
        yield (
            f"detector.rate_hz: the vehicle flies {step_m:.1f} m between two pictures that cover "
            f"{along_m:.1f} m, so strips are never looked at; "
            "write a higher rate or a lower search.scan_speed_mps"
        )
    largest_m = max([t.size_m or DEFAULT_SIZE_M[t.kind] for t in scenario.targets], default=0.0)
    widest_m = max(lens.footprint_m(h_c))
    if largest_m > widest_m:
        yield (
            f"search.check_altitude_agl_m: a target of {largest_m:g} m does not fit in the "
            f"{widest_m:.1f} m wide picture from {h_c:g} m; check from {h_c * 2 * largest_m / widest_m:.0f} m"
        )


def _about_targets(scenario: Scenario) -> Iterator[str]:
    generated = any(g.kind in get_args(TargetClass) for g in scenario.generators)
    if not scenario.targets and not generated:
        yield "targets: there are none, so nothing can be found; write targets or generators"
    area, own = scenario.area_enu_m, scenario.buildings
    places, sizes = [b.position_enu_m for b in own], [b.size_m for b in own]
    houses = [*turned_boxes(places, sizes, np.radians([b.yaw_deg for b in own]))]
    houses += [box.outline() for box in mapped_buildings(scenario)] if scenario.targets else []
    for index, target in enumerate(scenario.targets):
        place = shapely.Point(target.position_enu_m)
        x, y = target.position_enu_m
        if not area.covers(place):
            yield f"targets[{index}]: lies outside the area at [{x:g}, {y:g}] and will not be searched for"
        elif shapely.covers(houses, place).any():
            yield f"targets[{index}]: lies inside a building at [{x:g}, {y:g}] and cannot be seen"


def _about_obstacles(scenario: Scenario) -> Iterator[str]:
    tops = [("a building", b.height_m + b.size_m[1] / 2) for b in scenario.buildings]
    tops += [("a tree", t.height_m) for t in scenario.trees]
    tops += [("a forest", f.height_m[1]) for f in scenario.forests]
    tops += [("a building", b.top_m) for b in mapped_buildings(scenario)]
    if scenario.terrain.land_cover is not None:
        tops += [("a forest", c.height_m[1]) for c in classes_of(scenario) if c.trees_per_hectare > 0.0]
    if not tops:
        return
    what, top_m = max(tops, key=lambda top: top[1])
    h_s, h_c = scenario.search.scan_altitude_agl_m, scenario.search.check_altitude_agl_m
    keep_m = scenario.safety.clearance_m
    if top_m + keep_m > h_s:
        where = "above" if top_m >= h_s else f"nearer than safety.clearance_m ({keep_m:g} m) to"
        yield (
            f"search.scan_altitude_agl_m: {what} may reach {top_m:g} m, {where} the scan at {h_s:g} m; "
            f"scan from {math.ceil(top_m + max(5.0, keep_m))} m or higher"
        )
    known = known_obstacles(scenario)
    outlines = known.outlines()
    above_ground_m = known.solids[:, 8] - known.terrain.height_m(known.solids[:, :2])
    share = _share_near(scenario.area_enu_m, outlines[above_ground_m + keep_m > h_c], keep_m)
    if share >= _WORTH_SAYING:
        yield (
            f"safety.clearance_m: in {share:.0%} of the area trees or buildings are nearer than {keep_m:g} m "
            f"to a check at {h_c:g} m; candidates there are checked from beside or from higher, or not at all"
        )
    if shapely.dwithin(outlines, shapely.Point(scenario.home.position_enu_m), keep_m).any():
        yield (
            f"home.position_enu_m: trees or buildings are nearer than safety.clearance_m ({keep_m:g} m) to "
            "take-off and landing; move home into the open"
        )


def _share_near(area: shapely.Polygon, outlines: NDArray[np.object_], distance_m: float) -> float:
    """How much of an area lies within a distance of outlines, by a raster: to unite 50,000 takes long."""
    places = _raster(area)
    near, _ = shapely.STRtree(outlines).query(places, predicate="dwithin", distance=distance_m)
    return len(np.unique(near)) / max(len(places), 1)


@lru_cache(maxsize=1)  # tuning asks about one area at many altitudes
def _raster(area: shapely.Polygon) -> NDArray[np.object_]:
    west, south, east, north = area.bounds
    middles = (np.arange(_RASTER) + 0.5) / _RASTER
    x, y = np.meshgrid(west + middles * (east - west), south + middles * (north - south))
    inside = shapely.contains_xy(area, x, y)
    places: NDArray[np.object_] = shapely.points(x[inside], y[inside])
    return places


def _held_mps(scenario: Scenario) -> float:
    """The scan speed that the vehicle holds against the mean wind."""
    sustained_mps = scenario.safety.air_speed_max_mps - scenario.wind.mean_speed_mps
    return min(_SIMULATED_MAX_MPS, math.floor(10.0 * sustained_mps) / 10.0)


def _about_speeds(scenario: Scenario) -> Iterator[str]:
    cruise, scan_mps = scenario.vehicle.cruise_speed_mps, scenario.search.scan_speed_mps
    mean_mps, air_mps = scenario.wind.mean_speed_mps, scenario.safety.air_speed_max_mps
    if scan_mps > _SIMULATED_MAX_MPS:
        yield (
            f"search.scan_speed_mps: is {scan_mps:g}, and the simulated vehicle flies at most at "
            f"{_SIMULATED_MAX_MPS:g} m/s, as PX4 does unless MPC_XY_VEL_MAX is raised"
        )
    if air_mps > (usual_mps := type(scenario.safety).model_fields["air_speed_max_mps"].default):
        yield (
            f"safety.air_speed_max_mps: is {air_mps:g}; the simulated vehicle sustains {usual_mps:g} m/s, "
            "and against the wind it is slower than planned"
        )
    wind, most_mps = mean_mps + 2 * scenario.wind.gust_std_mps, scenario.safety.wind_max_mps
    if mean_mps > most_mps:
        yield (
            f"wind.mean_speed_mps: is {mean_mps:g}, above safety.wind_max_mps ({most_mps:g}): nothing takes "
            "off; wait for less wind"
        )
    elif wind >= 2 * cruise:
        yield (
            f"wind.mean_speed_mps: with gusts it blows at {wind:g} m/s, too much for a vehicle that "
            f"cruises at {cruise:g} m/s"
        )
    elif scan_mps + mean_mps > air_mps:
        held_mps = _held_mps(scenario)
        yield (
            f"search.scan_speed_mps: {scan_mps:g} m/s against a wind of {mean_mps:g} m/s is more than the "
            f"vehicle sustains (safety.air_speed_max_mps: {air_mps:g}), and it is blown off its transects; "
            + (f"write {held_mps:g} or less" if held_mps > 0.0 else "wait for less wind")
        )
