"""Distances to trees and buildings, against shapely and against many points."""

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.worlds.obstacles import came_near, known_obstacles
from skysweep.worlds.world import build_world

BASE = {"name": "village", "area": {"polygon_enu_m": [[0, 0], [100, 0], [100, 100], [0, 100]]}}
TREE = {"position_enu_m": [30, 30], "height_m": 10, "crown_radius_m": 3}
HOUSE = {"position_enu_m": [60, 40], "size_m": [20, 8], "height_m": 5, "yaw_deg": 30}
VILLAGE = {"trees": [TREE], "buildings": [HOUSE]}
TREE_TOP_M, ROOF_M = 10.0, 9.0  # of the house: eaves and half the width


def obstacles(**changes):
    return known_obstacles(Scenario.model_validate(BASE | VILLAGE | changes))


place = st.tuples(st.floats(0, 100), st.floats(0, 100))
height = st.floats(0, 20)


@given(place, st.floats(0, 10))
def test_tops_are_found_within_a_distance_of_their_outlines(xy, distance_m):
    known = obstacles()
    gaps_m = shapely.distance(known.outlines(), shapely.Point(xy))
    if np.abs(gaps_m - distance_m).min() < 0.1:  # shapely's circles are polygons
        return
    near = [top for gap, top in zip(gaps_m, (TREE_TOP_M, ROOF_M), strict=True) if gap < distance_m]
    assert known.top_within_m(np.array([xy]), distance_m)[0] == max(near, default=-math.inf)


@given(place, st.floats(0, 10))
def test_what_a_beam_may_meet_reaches_from_the_lowest_ground_to_the_highest_top(xy, distance_m):
    known = obstacles(terrain={"hills_height_m": 20.0, "hills_wavelength_m": 40.0})
    lowest_m, highest_m = known.heights_within_m(xy, distance_m)
    around = np.array(xy) + distance_m * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    ground_m = known.terrain.height_m(around)
    top_m = known.top_within_m(np.array([xy]), distance_m)[0]
    assert lowest_m <= ground_m.min()
    assert highest_m >= max(ground_m.max(), top_m)
    if distance_m == 0.0:
        assert (lowest_m, highest_m) == (ground_m[0], max(ground_m[0], top_m))


@given(place, place)
def test_a_leg_is_kept_above_all_that_is_near_it(start, end):
    assume(math.dist(start, end) > 0.1)
    known = obstacles()
    _, least_m = known.heights_along(start, end, 2.0, 2.0, math.inf, 1.0)
    gaps_m = shapely.distance(known.outlines(), shapely.LineString([start, end]))
    if np.abs(gaps_m - 2.0).min() < 0.1:
        return
    near = [top + 2.0 for gap, top in zip(gaps_m, (TREE_TOP_M, ROOF_M), strict=True) if gap < 2.0]
    assert least_m == max(near, default=-math.inf)


def test_a_climb_begins_in_time_and_only_what_is_near_is_urgent():
    for away_m, aim_m, least_m in [
        (50.0, 12.0 - 0.5 * 42.0, -math.inf),
        (12.0, 10.0, -math.inf),
        (5.0, 12.0, 12.0),
    ]:
        aim, least = obstacles().heights_along((30.0, 25.0 - away_m), (30.0, 60.0), 2.0, 2.0, 8.0, 0.5)
        assert (aim, least) == (pytest.approx(aim_m, abs=0.3), least_m)


def test_behind_the_end_of_a_leg_nothing_counts():
    assert obstacles().heights_along((30.0, 10.0), (30.0, 24.0), 2.0, 2.0, 9.0, 0.5) == (-math.inf, -math.inf)


def test_a_hillside_beside_and_before_the_leg_counts():
    rows = [[0.0] * 23, [0.0] * 23, *[[0.0] * 12 + [40.0] * 11] * 21]
    known = obstacles(trees=[], buildings=[], terrain={"heightmap_m": rows})
    west_m, south_m, east_m, north_m = known.terrain.bounds_enu_m
    foot = west_m + (east_m - west_m) / 2
    y = (south_m + north_m) / 2
    _, least_m = known.heights_along((foot - 3.0, y), (foot - 3.0, y + 20.0), 8.0, 2.0, 10.0, 0.5)
    assert least_m > 20.0
    aim_m, least_m = known.heights_along((foot - 40.0, y), (foot + 20.0, y), 2.0, 2.0, 5.0, 0.5)
    assert least_m == pytest.approx(2.0)
    assert aim_m > 15.0


@settings(max_examples=30)
@given(st.lists(st.tuples(st.floats(0, 100), st.floats(0, 100), height), min_size=2, max_size=5))
def test_the_clearance_of_a_track_is_that_of_its_nearest_point(corners):
    known, track = obstacles(), np.array(corners)
    found = known.clearances_m(track, np.zeros(len(track), dtype=bool))
    fine = np.concatenate([np.linspace(a, b, 400) for a, b in pairwise(track)])
    for k, top_m in enumerate((TREE_TOP_M, ROOF_M)):
        beside = shapely.distance(known.outlines()[k], shapely.points(fine[:, :2]))
        expected = np.hypot(beside, np.maximum(fine[:, 2] - top_m, 0.0)).min()
        assert found[k] == pytest.approx(expected, abs=0.12)
    assert found[-1] == math.inf


def test_collisions_are_distinct_things_that_were_touched_and_the_ground_counts_in_between():
    known = obstacles()
    through = np.array([[20.0, 30.0, 5.0], [40.0, 30.0, 5.0], [20.0, 30.0, 5.0], [60.0, 40.0, 5.0]])
    assert came_near(known, through, ["CHECK"] * 4) == {"collisions": 2, "min_clearance_m": 0.0}
    over = through + np.array([0.0, 0.0, 8.0])
    assert came_near(known, over, ["CHECK"] * 4) == {"collisions": 0, "min_clearance_m": 3.0}
    low = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 7.0]])
    assert came_near(known, low, ["TAKEOFF", "SCAN"]) == {"collisions": 0, "min_clearance_m": 7.0}
    assert came_near(known, low, ["SCAN", "SCAN"]) == {"collisions": 1, "min_clearance_m": 0.0}
    assert came_near(known, np.zeros((0, 3)), []) == {"collisions": 0, "min_clearance_m": None}


@pytest.mark.parametrize(
    ("place", "eye", "hidden"),
    [
        ((30.0, 30.0), (30.0, 30.0, 20.0), True),  # below the crown, from above it
        ((32.0, 30.0), (37.0, 30.0, 8.0), False),  # from beside, below the crown
        ((25.0, 30.0), (35.0, 30.0, 9.0), True),  # through the crown
        ((50.0, 30.0), (50.0, 30.0, 20.0), False),
        ((60.0, 34.0), (62.0, 46.0, 10.0), True),  # behind the house
    ],
)
def test_crowns_and_houses_hide_what_is_behind_them(place, eye, hidden):
    assert obstacles().hide(np.array([*place, 0.0]), np.array(eye)) == hidden


@pytest.mark.parametrize(
    ("place", "share"),
    [((30.0, 30.0), 0.0), ((50.0, 30.0), 1.0), ((27.2, 30.0), 0.2)],
)
def test_of_a_place_below_the_edge_of_a_crown_a_part_is_shown(place, share):
    assert obstacles().shown_share(np.array([*place, 0.0]), np.array([*place, 20.0])) == pytest.approx(share)


@pytest.mark.parametrize("name", ["person-wilderness", "buildings"])
def test_what_is_known_is_what_stands_there_whatever_the_seed(name):
    scenario = load_scenario(name)
    for seed in (0, 1):
        world, known = build_world(scenario, seed), known_obstacles(scenario)
        stand = [*world.trees, *world.buildings]
        assert known.solids[:, :2].tolist() == [s.position_enu_m[:2].tolist() for s in stand]
        assert (known.solids[:, 8] > [s.position_enu_m[2] + 0.99 * s.height_m for s in stand]).all()
