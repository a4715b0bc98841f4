"""Geofence and no-fly areas: what is inside, and the way round."""

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import dijkstra

from skysweep.errors import UserError
from skysweep.mission.fence import Fence, Router
from skysweep.scenarios.model import Scenario

SQUARE = [(0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0)]
POND = [(40.0, -10.0), (60.0, -10.0), (60.0, 80.0), (40.0, 80.0)]
TOWER = [(20.0, 40.0), (30.0, 40.0), (30.0, 50.0), (20.0, 50.0)]


def fence(geofence=None, no_fly=(), margin_m=None, path=()):
    data = {
        "name": "fence",
        "area": {"polygon_enu_m": [[5, 5], [15, 5], [15, 15], [5, 15]]},
        "home": {"position_enu_m": [2, 2]},
        "geofence_enu_m": geofence,
        "safety": {"no_fly_enu_m": list(no_fly), "fence_margin_m": margin_m},
    }
    return Fence(Scenario.model_validate(data), path_xy_enu_m=np.array(path).reshape(-1, 2))


def test_more_corners_than_a_way_is_found_round_are_refused():
    trees = shapely.buffer(shapely.points(*np.mgrid[0:500:10, 0:500:10].reshape(2, -1)), 2.0)
    scenario = {"name": "low", "area": {"polygon_enu_m": [[5, 5], [15, 5], [15, 15], [5, 15]]}}
    with pytest.raises(UserError, match=r"safety\.altitude_max_agl_m: what is too high .* raise it"):
        Fence(Scenario.model_validate(scenario), list(trees))


def test_without_fence_everything_is_inside_and_straight():
    everywhere = fence()
    assert not everywhere.exists
    assert everywhere.allows((1e5, -1e5))
    assert everywhere.outside_m((1e5, 0.0)) == 0.0
    assert everywhere.way((0, 0), (900, 900)) == [(900, 900)]


def test_a_no_fly_area_is_outside_even_without_a_geofence():
    f = fence(no_fly=[TOWER])
    assert not f.allows((25, 45))
    assert math.isclose(f.outside_m((25, 43)), 3.0, abs_tol=0.1)
    assert f.allows((5000, 5000))


def test_where_no_fence_is_drawn_area_path_and_home_are_kept_near():
    f = fence(margin_m=30.0, path=[(10, 40), (10, 5)])
    assert f.allows((10.0, 69.0))
    assert not f.allows((10.0, 71.0))
    assert not f.allows((10.0, -30.0))
    assert math.isclose(f.outside_m((10.0, 80.0)), 10.0, abs_tol=0.1)
    assert math.isclose(f.room_m((10.0, 40.0)), 30.0, abs_tol=0.1)
    assert f.room_m((10.0, 80.0)) == 0.0
    assert f.way((2, 2), (10, 60)) == [(10, 60)]
    assert f.way((2, 2), (10, 80)) == []


def test_a_drawn_fence_takes_the_place_of_that_margin():
    f = fence(SQUARE, margin_m=5.0)
    assert f.allows((99.0, 99.0))
    assert not f.allows((-1.0, 5.0))


BLOCKS = [[(x, y), (x + 12, y), (x + 12, y + 9), (x, y + 9)] for x in (8, 33, 62) for y in (10, 35, 70)]
PLACES = st.tuples(st.floats(1, 99), st.floats(1, 99))


@settings(max_examples=40)
@given(PLACES, PLACES)
def test_no_way_over_the_corners_is_shorter(start, goal):
    f = fence(SQUARE, no_fly=[POND, *BLOCKS])
    way = f.way(start, goal)
    if not f.allows(start) or not f.allows(goal) or way == [goal]:
        return
    places = np.array([start, *f._corners, goal])
    a, b = np.repeat(places, len(places), axis=0), np.tile(places, (len(places), 1))
    free = shapely.covers(f._free, shapely.linestrings(np.stack([a, b], axis=1)))
    lengths = np.where(free, np.linalg.norm(a - b, axis=1), 0.0).reshape(len(places), -1)
    shortest_m = dijkstra(lengths, indices=0)[-1]
    assert math.isclose(sum(math.dist(*leg) for leg in pairwise([start, *way])), shortest_m)


@settings(max_examples=60)
@given(st.tuples(st.floats(-25, 40), st.floats(-25, 40)), st.floats(0, 2 * math.pi), st.floats(0, 1))
def test_nobody_leaves_the_fence_within_the_room_there_is(here, heading, share):
    f = fence(margin_m=30.0, no_fly=[TOWER])
    reach = share * f.room_m(here)
    there = here[0] + reach * math.cos(heading), here[1] + reach * math.sin(heading)
    assert f.outside_m(there) < 1e-6 or not f.allows(here)


def test_there_is_room_for_the_way_round_what_reaches_into_the_surroundings():
    wall = [(-200.0, 3.0), (200.0, 3.0), (200.0, 4.0), (-200.0, 4.0)]
    way = fence(no_fly=[wall], margin_m=10.0).way((2.0, 2.0), (10.0, 10.0))
    assert way[-1] == (10.0, 10.0)
    assert max(abs(x) for x, _ in way) > 200.0


def test_how_far_outside():
    f = fence(SQUARE)
    assert f.outside_m((50, 50)) == 0.0
    assert math.isclose(f.outside_m((107, 50)), 7.0, abs_tol=0.1)


def test_the_way_leads_round_a_no_fly_area_and_keeps_away_from_it():
    f = fence(SQUARE, [POND])
    way = f.way((20, 20), (80, 20))
    assert way[-1] == (80, 20)
    assert len(way) == 3
    assert all(y > 80.0 for _, y in way[:-1])
    assert shapely.LineString([(20, 20), *way]).distance(shapely.Polygon(POND)) > 1.0


def test_from_outside_it_leads_back_inside_first():
    way = fence(SQUARE).way((120, 50), (50, 50))
    assert np.allclose(way[0], (98, 50)), "and 2 m beyond the edge"
    assert way[-1] == (50, 50)


@settings(max_examples=100)
@given(st.tuples(st.floats(-40, 140), st.floats(-40, 140)), st.floats(0, math.pi))
def test_from_outside_of_a_fence_of_any_direction_a_way_leads_inside(start, turned_rad):
    """The nearest place of a slanted edge is by rounding outside, and was sought again without an end."""
    square, tower = (
        shapely.affinity.rotate(shapely.Polygon(corners), turned_rad, (50, 50), use_radians=True)
        for corners in (SQUARE, TOWER)
    )
    middle = {"polygon_enu_m": [[45, 45], [55, 45], [55, 55], [45, 55]]}
    data = {
        "name": "turned",
        "area": middle,
        "home": {"position_enu_m": [50, 50]},
        "geofence_enu_m": list(square.exterior.coords)[:-1],
        "safety": {"no_fly_enu_m": [list(tower.exterior.coords)[:-1]]},
    }
    f = Fence(Scenario.model_validate(data))
    way = f.way(start, (50.0, 50.0))
    assert way[-1] == (50.0, 50.0)
    assert all(f.allows(place) for place in way)
    inside = way if not f.allows(start) else [start, *way]
    assert all(f.sees(a, b) for a, b in pairwise(inside))


def test_who_is_elsewhere_is_led_from_there():
    """It was not heard, and the autopilot flew it to the other side; the goal is the same."""
    router = Router(fence(SQUARE, [POND]))
    assert router.next_xy((70.0, 20.0), (80.0, 20.0)) == (80.0, 20.0)
    assert router.next_xy((71.0, 20.0), (80.0, 20.0)) == (80.0, 20.0)
    assert router.next_xy((20.0, 20.0), (80.0, 20.0))[1] > 80.0


def test_no_way_to_a_place_outside_or_cut_off():
    f = fence(SQUARE, [[(40.0, -10.0), (60.0, -10.0), (60.0, 110.0), (40.0, 110.0)]])
    assert f.way((20, 20), (150, 20)) == []
    assert f.way((20, 20), (80, 20)) == []


def test_the_router_gives_one_corner_after_another():
    f = fence(SQUARE, [POND])
    router, here, visited = Router(f), (20.0, 20.0), []
    for _ in range(10):
        here = router.next_xy(here, (80.0, 20.0))
        visited.append(here)
        if here == (80.0, 20.0):
            break
    assert visited == f.way((20, 20), (80, 20))


xy = st.tuples(st.floats(-20, 120), st.floats(-20, 120))


@settings(max_examples=60)
@given(xy, xy)
def test_every_way_stays_inside(start, goal):
    f = fence(SQUARE, [POND, TOWER])
    way = f.way(start, goal)
    free = shapely.difference(
        shapely.Polygon(SQUARE), shapely.union_all([shapely.Polygon(POND), shapely.Polygon(TOWER)])
    ).buffer(0.2)
    if not f.allows(goal):
        assert way == []
        return
    assert way[-1] == goal
    inside = way if not f.allows(start) else [start, *way]
    for a, b in pairwise(inside):
        assert free.covers(shapely.LineString([a, b]))
