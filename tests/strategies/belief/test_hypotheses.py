"""How likely each hypothesis makes the looks at a candidate."""

import math

import numpy as np
import pytest
from contexts import context_of
from hypothesis import given
from hypothesis import strategies as st

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.statistical.model import StatisticalModel
from skysweep.strategies.belief.hypotheses import Hypotheses
from skysweep.strategies.belief.parameters import BeliefParameters

DOWN = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # camera to ENU, straight down
PLACE = np.zeros(3)
CONTEXT = context_of()
SIGNS = Hypotheses(CONTEXT, "stop sign", BeliefParameters())


def above(height_m, east_m=0.0):
    return CameraPose(np.array([east_m, 0.0, height_m]), DOWN)


def after(looks, hypotheses=SIGNS):
    """The belief after looks of (height, score or None, metres to the east)."""
    belief = hypotheses.fresh()
    for height_m, score, east_m in looks:
        hypotheses.look(belief, above(height_m, east_m), PLACE, score, widened=1.0, others=0)
    return belief


def evidence(looks):
    """Log likelihood ratio of looks: a target, or nine other things and one that is nothing."""
    target, thing, nothing, *_ = SIGNS.evidence(after(looks), np.zeros(3), shift=0.0)
    return target - np.logaddexp(thing + math.log(0.9), nothing + math.log(0.1))


def test_a_miss_through_leaves_counts_by_how_probably_it_would_have_shown_something():
    def after_misses(shown):
        belief = SIGNS.fresh()
        for _ in range(3):
            SIGNS.look(belief, above(6.0), PLACE, None, widened=1.0, others=0, shown=shown)
        target, _, nothing, *_ = SIGNS.evidence(belief, np.zeros(3), shift=0.0)
        return target - nothing

    before = after_misses(0.0)
    target, _, nothing, *_ = SIGNS.evidence(SIGNS.fresh(), np.zeros(3), shift=0.0)
    assert before == pytest.approx(target - nothing), "what shows nothing tells nothing"
    odds = [after_misses(shown) - before for shown in (0.2, 0.6, 1.0)]
    assert -2.0 < odds[0] < -0.1
    assert odds[2] < odds[1] - 1.0 < odds[0] - 2.0


def test_at_sea_what_scores_like_a_skerry_is_no_boat():
    """A rock of 8 m, 40 m below, spans as many pixels as a boat and is reported as one, with lower scores."""
    boats = Hypotheses(context_of(scenario="maritime"), "boat", BeliefParameters())

    def evidence_of(score):
        looks = [(40.0, score, east_m) for east_m in (-4.0, 0.0, 4.0)]
        target, thing, *_ = boats.evidence(after(looks, boats), PLACE, shift=0.0)
        return target - thing

    assert evidence_of(0.0) < -1.0
    assert evidence_of(0.4) < 1.0
    assert evidence_of(1.3) > 2.0


def test_what_every_look_of_a_passing_finds_may_still_be_clothing():
    """Ten more hits tell something, but not as much as if each look at a look-alike lapsed by itself."""
    persons = Hypotheses(context_of(scenario="person-wilderness"), "person", BeliefParameters())

    def evidence_of(n):
        looks = [(20.0, 0.8, 0.8 * (k - n / 2)) for k in range(n)]
        target, thing, *_ = persons.evidence(after(looks, persons), PLACE, shift=0.0)
        return target - thing

    assert 1.0 < evidence_of(14) - evidence_of(3) < 3.0


def test_low_scores_speak_for_a_target_in_the_shade_of_a_tree():
    """The sun stands in the south-east: the shadow falls to the north-west."""
    tree = {"position_enu_m": [100.0, 100.0], "height_m": 12.0, "crown_radius_m": 3.0}
    plain = load_scenario("person-wilderness").model_dump()
    with_tree = Scenario.model_validate(plain | {"forests": [], "trees": [tree]})
    persons = Hypotheses(context_of(scenario=with_tree), "person", BeliefParameters())
    to_sun = np.array(with_tree.light.to_sun_enu)
    shadow = 100.0 - 8.0 * to_sun[:2] / to_sun[2]

    def evidence_at(place, score):
        belief = persons.fresh()
        for _ in range(2):
            eye = CameraPose(np.array([*place, 12.0]), DOWN)
            persons.look(belief, eye, np.array([*place, 0.0]), score, widened=1.0, others=0)
        place_enu_m = np.array([*place, 0.0])
        target, _, nothing, *_ = persons.evidence(belief, place_enu_m, shift=0.0)
        return target - nothing + persons.clutter(place_enu_m)

    for score in (None, -0.3):
        assert evidence_at(shadow, score) > evidence_at((150.0, 150.0), score) + 0.02
    assert evidence_at((101.0, 100.0), None) > evidence_at((150.0, 150.0), None) + 0.02, "beside the crown"


def test_false_reports_are_as_dense_as_the_trees():
    """A candidate on a tree is nothing more often than one in the open; without trees all are alike."""
    tree = {"position_enu_m": [100.0, 100.0], "height_m": 12.0, "crown_radius_m": 3.0}
    plain = load_scenario("person-wilderness").model_dump() | {"forests": []}
    trees = [tree | {"position_enu_m": [100.0 + 9.0 * k, 100.0]} for k in range(10)]

    def clutter(east_m, **more):
        scenario = Scenario.model_validate(plain | more)
        persons = Hypotheses(context_of(scenario=scenario), "person", BeliefParameters())
        return persons.clutter(np.array([east_m, 100.0, 0.0]))

    assert clutter(100.0, trees=trees) > 1.0 > 0.0 > clutter(60.0, trees=trees)
    assert clutter(100.0, trees=trees[:1]) > clutter(103.0, trees=trees[:1]) > clutter(60.0, trees=trees[:1])
    assert clutter(100.0, trees=[]) == clutter(60.0, trees=[]) == pytest.approx(0.0)


def test_of_crowns_an_edge_of_the_picture_cuts_more_than_of_targets():
    """What only an edge reported is nothing more readily on a tree, and as readily in the open."""
    trees = [{"position_enu_m": [100.0, 100.0], "height_m": 12.0, "crown_radius_m": 3.0}]
    plain = load_scenario("person-wilderness").model_dump() | {"forests": [], "trees": trees}
    persons = Hypotheses(context_of(scenario=Scenario.model_validate(plain)), "person", BeliefParameters())
    on_it, in_the_open = np.array([100.0, 100.0, 0.0]), np.array([60.0, 100.0, 0.0])
    assert persons.clutter(on_it, only_cut=True) > persons.clutter(on_it) + 0.5
    assert persons.clutter(in_the_open, only_cut=True) == pytest.approx(persons.clutter(in_the_open))


def test_what_a_scan_seldom_reports_counts_for_more_once_it_was():
    """A target is reported in any case; of look-alikes fewer are, the faster the scan flies."""

    def likely(speed_mps):
        context = context_of(scan_speed_mps=speed_mps)
        signs = Hypotheses(context, "stop sign", BeliefParameters())
        target, thing, nothing, *_ = signs.evidence(signs.fresh(), np.zeros(3), shift=0.0)
        return target, thing, nothing

    slow, fast = likely(2.0), likely(8.0)
    assert (slow[0], fast[0]) == pytest.approx((0.0, 0.0), abs=0.01)
    assert math.log(2.0) < slow[1] < fast[1] - 0.1
    assert math.log(2.0) < slow[2] < fast[2] - 0.1


def test_sure_looks_from_close_by_make_a_target_and_missing_ones_do_not():
    assert evidence([(6.0, 2.7, 0.0)] * 3) > 2.0
    assert evidence([(6.0, None, 0.0)] * 3) < -5.0


def test_looks_at_one_aspect_are_fewer_witnesses_than_looks_at_several():
    one = evidence([(30.0, 1.6, 0.0)] * 8)
    many = evidence([(30.0, 1.6, 12.0 * (-1) ** k) for k in range(8)])
    assert 0.0 < one < 0.9 * many


def test_the_offsets_are_those_of_the_normal_distribution_given_the_scores():
    """What looks from one place say of the object's own offset and of the aspect, by linear algebra."""
    model = StatisticalModel.load()
    sure = Hypotheses(context_of(), "stop sign", BeliefParameters(model_std=0.0, lapse=0.0001))
    kind = next(k for k in model.kinds if (k.kind, k.pose) == ("stop sign", "face-up"))
    height_m = CONTEXT.lens.focal_px * 0.9 / 14.0  # 0.9 m span 14 pixels, a node of the grid
    node = model.pixels.index(14.0)
    colours = next(c for c in model.contrasts if (c.kind, c.pose) == ("stop sign", "face-up"))
    contrast, contrast_std = colours.surfaces["grass"]
    mean = kind.score[node] + kind.grounds["grass"] + kind.contrast * (contrast - 30.0) / 20.0
    own = math.hypot(math.sqrt(kind.object_share) * kind.spread[node], kind.contrast * contrast_std / 20.0)
    common = math.sqrt(kind.aspect_share) * kind.spread[node]
    rest = (1.0 - kind.object_share - kind.aspect_share) * kind.spread[node] ** 2
    scores = mean + np.array([0.3, -0.1, 0.2, 0.4])
    covariance = np.full((4, 4), own**2 + common**2) + rest * np.eye(4)
    weights = np.linalg.solve(covariance, np.ones(4))
    _, told_own, told_aspect, own_var, _, aspect_var, *_ = after([(height_m, s, 0.0) for s in scores], sure)[
        0
    ]
    assert told_own == pytest.approx(own * weights @ (scores - mean), rel=0.05)
    assert told_aspect == pytest.approx(common * weights @ (scores - mean), rel=0.05)
    assert own_var == pytest.approx(1.0 - own**2 * weights.sum(), rel=0.05)
    assert aspect_var == pytest.approx(1.0 - common**2 * weights.sum(), rel=0.05)


@given(
    st.lists(
        st.tuples(st.floats(2.0, 60.0), st.none() | st.floats(-1.0, 5.0), st.floats(-90.0, 90.0)),
        min_size=1,
        max_size=40,
    )
)
def test_any_looks_leave_a_belief_that_is_one(looks):
    belief = after(looks)
    assert np.isfinite(belief[:, :6]).all()
    assert (belief[:, 3] > -1e-9).all(), "variance of the own offset"
    assert (belief[:, 5] > -1e-9).all(), "variance of the aspect"
    assert belief[:, 0].max() <= 1e-9


def test_going_down_tells_a_sign_from_what_looks_like_one():
    belief = after([(30.0, 1.3, 0.0)] * 3)
    high = SIGNS.confusion(belief, above(30.0), PLACE, 0.2)
    low = SIGNS.confusion(belief, above(6.0), PLACE, 0.2)
    assert 0.0 < low < 0.5 * high <= 0.5


def test_a_class_that_the_sensor_model_does_not_know_is_refused():
    model = StatisticalModel.load()
    others = model.model_copy(update={"kinds": [k for k in model.kinds if k.kind != "stop sign"]})
    context = context_of()
    object.__setattr__(context, "load_sensor_model", lambda: others)
    with pytest.raises(
        UserError, match="needs a sensor model of 'stop sign'; write one with 'skysweep calibrate'"
    ):
        Hypotheses(context, "stop sign", BeliefParameters())
