"""Which candidates are worth a closer look, and from which side."""

import math

import numpy as np
import pytest
import shapely
from contexts import context_of
from hypothesis import given
from hypothesis import strategies as st

from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.strategies.belief.checks import LOOKS_THERE, Checks
from skysweep.strategies.belief.goal import View
from skysweep.strategies.belief.hypotheses import Hypotheses
from skysweep.strategies.belief.parameters import BeliefParameters

CONTEXT = context_of()
CHECKS = Checks(CONTEXT, BeliefParameters())
CORNERED = Checks(context_of(check_altitude_agl_m=12.0, scan_altitude_agl_m=30.0), BeliefParameters())
places = st.lists(
    st.tuples(st.floats(-200, 200), st.floats(-200, 200), st.floats(0, 500)), min_size=0, max_size=12
)


def test_what_costs_more_than_it_buys_is_left_out():
    near_and_far = np.array([[5.0, 0.0], [400.0, 0.0], [10.0, 0.0]])
    assert CHECKS.route((0.0, 0.0), near_and_far, [30.0, 30.0, 30.0]) == [0, 2]
    assert CHECKS.route((0.0, 0.0), near_and_far, [30.0, 300.0, 30.0]) == [0, 2, 1]
    assert CHECKS.route((0.0, 0.0), near_and_far, [0.5, 0.5, 0.5]) == []
    two_far = np.array([[5.0, 0.0], [400.0, 0.0], [404.0, 0.0]])
    assert CHECKS.route((0.0, 0.0), two_far, [30.0, 30.0, 30.0]) == [0]


@given(places)
def test_a_route_visits_each_place_once_at_most_and_pays(drawn):
    xy = np.array([[x, y] for x, y, _ in drawn]).reshape(-1, 2)
    losses = [loss for *_, loss in drawn]
    route = CHECKS.route((0.0, 0.0), xy, losses)
    assert len(set(route)) == len(route)
    assert all(losses[k] > 1.0 for k in route)
    path = np.vstack([[0.0, 0.0], xy[route]])
    length_m = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    assert length_m / 5.0 <= sum(losses[k] for k in route) + 1e-6


def test_a_look_costs_the_way_and_the_doubt_that_it_leaves():
    signs = Hypotheses(CONTEXT, "stop sign", BeliefParameters())

    def cost_s(loss_s, away_m, above_m=30.0, ways=1):
        return CHECKS.look_costs_s(
            signs, signs.fresh(), 0.2, loss_s, np.zeros(3), away_m, above_m, 4.0, ways=ways
        )

    down_s = (30.0 - 4.0) / CONTEXT.vehicle.descent_speed_mps
    assert down_s < cost_s(0.0, 0.0) < down_s + 6.0
    assert cost_s(0.0, 200.0) - cost_s(0.0, 100.0) == pytest.approx(100.0 / 5.0)
    assert cost_s(0.0, 100.0) < cost_s(1.0, 100.0) < cost_s(0.0, 100.0) + 1.0
    assert cost_s(500.0, 100.0) < cost_s(0.0, 100.0) + 5.0, "another look costs less than that doubt"
    assert cost_s(0.0, 100.0, ways=2) == pytest.approx(2.0 * cost_s(0.0, 100.0))


def test_a_demanded_look_is_no_lower_than_asked_for_unless_that_tells_enough():
    signs = Hypotheses(CONTEXT, "stop sign", BeliefParameters())

    def height_m(confirm_height_max_m, doubt_s, away_m=0.0, above_m=30.0):
        context = context_of(check_altitude_agl_m=4.0, confirm_height_max_m=confirm_height_max_m)
        checks = Checks(context, BeliefParameters())
        return checks.height_m(signs, signs.fresh(), 0.5, doubt_s, np.zeros(3), away_m, above_m)

    assert height_m(12.0, 0.0) == pytest.approx(12.0 - 0.8), "only the close look is lacking"
    assert height_m(28.0, 0.5) == pytest.approx(28.0 - 0.8), "so small a doubt is not worth the way down"
    assert height_m(12.0, 0.0, above_m=4.0) == 4.0, "it is that low already"
    assert height_m(12.0, 0.0, away_m=300.0) == pytest.approx(12.0 - 0.8), "from there it is seen sooner"


def test_the_first_look_is_from_where_it_tells_most_for_its_time():
    """From 2 m a person fills the picture, and the detector sees it worse than from twice as high."""
    context = context_of(scenario="person-wilderness", check_altitude_agl_m=2.0)
    persons, checks = Hypotheses(context, "person", BeliefParameters()), Checks(context, BeliefParameters())

    def height_m(doubt_s, above_m=30.0):
        return checks.height_m(persons, persons.fresh(), 0.5, doubt_s, np.zeros(3), 0.0, above_m)

    assert height_m(50.0) in (3.0, 4.4)
    assert height_m(0.5) == 4.4, "the way down costs more than so small a doubt"
    assert height_m(0.5, above_m=2.0) == 2.0, "it is that low already"


def test_a_place_stays_in_view_for_three_looks():
    at_m = {"scan_altitude_agl_m": 60.0}
    checks = Checks(context_of(check_altitude_agl_m=6.0, **at_m), BeliefParameters(check_speed_mps=10.0))
    assert checks.speed_mps(100.0, 6.0) == 10.0
    slow_mps = checks.speed_mps(0.0, 6.0)
    reach_m = 0.4 * CONTEXT.lens.footprint_m(6.0)[1]
    assert slow_mps == checks.speed_mps(reach_m, 6.0)
    assert 2.0 * reach_m / slow_mps * CONTEXT.looks_hz == pytest.approx(3.0)
    assert slow_mps < checks.speed_mps(reach_m + 2.0, 6.0) < 10.0
    assert checks.speed_mps(0.0, 30.0) == 10.0, "from there it is in view for long"


def test_what_a_tree_hides_is_looked_at_from_beside_it():
    """A crown above a place: it is seen from beside, in the picture; in the open from straight above."""
    wood = {"trees": [{"position_enu_m": [50.0, 40.0], "height_m": 6.0, "crown_radius_m": 1.5}]}
    height_m = 12.0
    wood = change_scenario(load_scenario("clusters"), wood | {"search.check_altitude_agl_m": height_m})
    context = context_of(scenario=wood)
    checks = Checks(context, BeliefParameters())
    across_m, along_m = CONTEXT.lens.footprint_m(height_m)
    hidden, open_ = np.array([50.5, 40.0, 0.0]), np.array([20.0, 20.0, 0.0])
    assert checks.first_view(open_, height_m) == (0.0, 0.0, height_m)
    assert checks.first_view(hidden, height_m + 3.0).height_m == height_m + 3.0
    assert math.hypot(*checks.first_view(hidden, height_m)[:2]) > 1.0
    for place, n_others in ((hidden, 1), (open_, 8)):
        views = views_of(checks, place)
        assert len(views) > n_others
        for view in views:
            assert not context.obstacles.hide(place, place + np.array(view))
            far = math.hypot(*view[:2]) / view.height_m
            assert far < 0.5 * math.hypot(across_m, along_m) / height_m


def views_of(checks, place, loss_s=500.0):
    """One after the other, from where the vehicle then is."""
    signs, views = Hypotheses(CONTEXT, "stop sign", BeliefParameters()), []
    view = checks.first_view(place, 12.0)
    while view is not None:
        views.append(view)
        here = place + np.array(view)
        view = checks.next_view(signs, signs.fresh(), 0.2, loss_s, place, here, views)
    return views


def test_every_view_shows_another_side_or_another_size():
    checks = Checks(context_of(check_altitude_agl_m=12.0, scan_altitude_agl_m=30.0), BeliefParameters())
    views = views_of(checks, np.array([20.0, 20.0, 0.0]))
    assert {round(view.height_m, 1) for view in views} == {12.0, 18.0, 26.4}
    for k, one in enumerate(views):
        for other in views[:k]:
            far, other_far = np.linalg.norm(one), np.linalg.norm(other)
            turned = np.linalg.norm(np.array(one) / far - np.array(other) / other_far)
            assert turned >= 0.2 or abs(math.log(far / other_far)) >= 0.3


def test_no_view_is_from_above_the_scan():
    checks = Checks(context_of(check_altitude_agl_m=12.0, scan_altitude_agl_m=16.0), BeliefParameters())
    assert {view.height_m for view in views_of(checks, np.array([20.0, 20.0, 0.0]))} == {12.0}


def test_no_view_is_from_outside_the_area():
    corner = np.array([0.5, 0.5, 0.0])
    views = views_of(CORNERED, corner)
    assert len(views) > 3
    for view in views[1:]:
        x, y, _ = corner + np.array(view)
        assert shapely.intersects_xy(CONTEXT.area_enu_m, x, y)
    outside = np.array([-1.0, -1.0, 0.0])
    assert CORNERED.first_view(outside, 12.0) == (0.0, 0.0, 12.0), (
        "a candidate's place may be wrong by so much"
    )


def test_a_view_is_worth_the_way_there():
    checks = Checks(context_of(check_altitude_agl_m=12.0, scan_altitude_agl_m=30.0), BeliefParameters())
    signs, place = Hypotheses(CONTEXT, "stop sign", BeliefParameters()), np.array([20.0, 20.0, 0.0])

    def next_from(east_m, loss_s=20.0):
        here = place + np.array([east_m, 0.0, 12.0])
        return checks.next_view(signs, signs.fresh(), 0.2, loss_s, place, here, [View(0.0, 0.0, 12.0)])

    assert next_from(8.0).east_m > 0.0 > next_from(-8.0).east_m
    assert next_from(8.0, loss_s=LOOKS_THERE / CONTEXT.looks_hz) is None, "the looks alone cost as much"


def test_looks_save_less_where_no_side_shows_the_place():
    crown = {"position_enu_m": [50.0, 40.0], "height_m": 12.0, "crown_radius_m": 8.0}
    wood = change_scenario(load_scenario("clusters"), {"trees": [crown]})
    checks = Checks(context_of(scenario=wood), BeliefParameters())
    assert checks.shown(np.array([50.0, 40.0, 0.0])) == 0.2
    assert checks.shown(np.array([20.0, 20.0, 0.0])) == 1.0
    assert CHECKS.shown(np.array([50.0, 40.0, 0.0])) == 1.0, "nothing stands there"
