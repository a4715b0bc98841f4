"""What is believed of a candidate, by the looks that found it and those that did not."""

from dataclasses import replace

import numpy as np
import pytest
from contexts import context_of

from skysweep.geometry.camera import CameraPose, Lens
from skysweep.strategies.belief.candidates import Suspects
from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.types import Candidate, Look, Sighting

DOWN = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # camera to ENU, straight down
LENS = Lens(640, 360, 1.4)
PLACE, FAR_M = np.array([10.0, 20.0, 0.0]), 80.0


def look(time_s, away_m, height_m, confidence=None, candidate_id=1, place=PLACE, is_cut=False):
    """From east of the place; with a confidence, one that finds a sign there."""
    camera = CameraPose(PLACE + np.array([away_m, 0.0, height_m]), DOWN)
    hit = Sighting(candidate_id, False, time_s, place, confidence, height_m, is_cut=is_cut)
    return Look(time_s, camera, LENS, (hit,) if confidence else ())


def candidate(candidate_id=1, place=PLACE):
    return Candidate(candidate_id, "stop sign", place, 0.05 * np.eye(2), 0.0, 0.0, (0.3,))


def believed(looks, candidates=None, **search):
    """The probability of candidate 1 after looks, in their order."""
    suspects = Suspects(context_of(**search), BeliefParameters())
    for seen in looks:
        suspects.take(seen, candidates or {1: candidate()}, ())
    return suspects.probability(1)


LATE = look(90.0, 0.0, 10.0, confidence=0.3)
EARLY = [look(float(t), 0.0, 30.0) for t in range(3)]
ELSEWHERE = look(10.0, FAR_M, 30.0)


def test_looks_of_an_earlier_passing_that_missed_it_count():
    new = believed([LATE])
    assert believed([ELSEWHERE, LATE]) == pytest.approx(new, rel=1e-9), "what did not show the place does not"
    assert believed([*EARLY, ELSEWHERE, LATE]) < 0.5 * new
    assert believed([*EARLY, LATE]) == pytest.approx(believed([*EARLY, ELSEWHERE, LATE]), rel=1e-9)


def test_of_what_may_move_only_the_looks_of_this_passing_count():
    new = believed([LATE], target_speed_mps=0.5)
    assert believed([*EARLY, ELSEWHERE, LATE], target_speed_mps=0.5) == pytest.approx(new, rel=1e-9)
    assert believed([*EARLY, LATE], target_speed_mps=0.5) < 0.5 * new


def test_looks_need_not_report_what_only_an_edge_of_the_picture_cut():
    """What it scored where it was cut tells nothing; once a look shows it whole, it is as found by that."""
    cut, surer = (look(0.0, 0.0, 30.0, confidence, is_cut=True) for confidence in (0.5, 0.9))
    whole, missed = look(1.0, 0.0, 30.0, 0.5), look(2.0, 0.0, 30.0)
    assert believed([cut]) == pytest.approx(BeliefParameters().target_share, abs=0.01)
    assert believed([surer]) == believed([cut])
    assert believed([cut, missed]) == pytest.approx(believed([whole, missed]), rel=0.5)
    for looks in ([cut, whole], [whole, cut]):
        assert believed(looks) == pytest.approx(believed([whole]), rel=0.01)


def test_a_detector_that_reports_nothing_but_signs_needs_no_look_alikes():
    context = context_of()
    signs = [kind for kind in context.sensor_model.kinds if kind.kind == "stop sign"]
    model = context.sensor_model.model_copy(update={"kinds": signs})
    suspects = Suspects(replace(context, load_sensor_model=lambda: model), BeliefParameters())
    for seen in (look(0.0, 0.0, 30.0, 0.5, is_cut=True), look(1.0, 0.0, 30.0, 0.9)):
        suspects.take(seen, {1: candidate()}, ())
        assert 0.0 < suspects.probability(1) < 1.0


@pytest.mark.parametrize(("apart_m", "may_be_same"), [(0.4, True), (0.8, False)])
def test_two_boxes_of_one_picture_may_be_of_one_sign_if_they_are_near_each_other(apart_m, may_be_same):
    suspects = Suspects(context_of(), BeliefParameters())
    places = {1: PLACE, 2: PLACE + np.array([apart_m, 0.0, 0.0])}
    both = {k: candidate(k, place) for k, place in places.items()}
    hits = [look(0.0, 0.0, 10.0, 0.8, k, place).hits[0] for k, place in places.items()]
    suspects.take(look(0.0, 0.0, 10.0)._replace(hits=tuple(hits)), both, ())
    assert suspects.may_be_same(1, 2, both) == may_be_same


def test_a_look_that_found_it_as_another_candidate_did_not_miss_it():
    both = {1: candidate(), 2: candidate(2, PLACE + np.array([0.6, 0.0, 0.0]))}
    found = [look(float(t), 0.0, 30.0, 0.8, 2, both[2].position_enu_m) for t in range(3)]
    apart = {1: candidate(), 2: candidate(2, PLACE + np.array([8.0, 0.0, 0.0]))}
    other = [look(float(t), 0.0, 30.0, 0.8, 2, apart[2].position_enu_m) for t in range(3)]
    assert believed([*found, ELSEWHERE, LATE], both) > 2.0 * believed([*other, ELSEWHERE, LATE], apart)


def test_of_two_that_may_be_one_the_likelier_is_looked_at():
    """1 and 2 lie beside each other, 3 does not; 2 was found more surely."""
    places = {1: PLACE, 2: PLACE + np.array([0.5, 0.0, 0.0]), 3: PLACE + np.array([8.0, 0.0, 0.0])}
    three = {k: candidate(k, place) for k, place in places.items()}
    suspects = Suspects(context_of(), BeliefParameters())
    for t, (k, confidence) in enumerate([(1, 0.3), (3, 0.3), (2, 0.8), (2, 0.8)]):
        suspects.take(look(float(t), 0.0, 20.0, confidence, k, places[k]), three, ())
    assert suspects.shadowed([1, 2, 3], [], three) == {1}
    assert suspects.shadowed([1, 3], [], three) == set()
    assert suspects.shadowed([1, 3], [2], three) == {1}, "2 is confirmed"
    assert suspects.shadowed([2, 3], [1], three) == {2}
    assert suspects.shadowed([], [1], three) == set()
