"""What looks tell of an object's luck with the detector."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.sensing.statistical.luck import (
    EVER_LAPSES,
    LAPSE,
    NOW_LAPSES,
    PASS_LAPSES,
    WEIGHT,
    unseen,
    update,
)

THRESHOLD, HIGH = 0.0, 3.0  # of the score; of an object whose score is above it in any case


def likelihood(looks, of_object, of_pass, lapse=0.2, moved_px=0.0):
    """Of a chain of hits (1) and misses (0), in which the score tells nothing, and the belief after it."""
    belief, hits = unseen(()), sum(looks)
    for hit in looks:
        luck = 0.0, 0.0, of_object, of_pass, 0.0
        update(belief, 30.0, moved_px, 50.0, HIGH, 0.5, lapse, *luck, HIGH if hit else math.nan, THRESHOLD)
    of_score = 0.97 / math.sqrt(2.0 * math.pi * 0.25) + 0.03 * 0.2
    return math.exp(belief[WEIGHT]) / of_score**hits, belief


@pytest.mark.parametrize("looks", [(0,), (0, 0, 0), (1, 1, 1), (1, 0), (0, 1, 0)])
def test_lapses_of_their_own_look_multiply(looks):
    found, belief = likelihood(looks, 0.0, 0.0)
    assert belief[[LAPSE, EVER_LAPSES, NOW_LAPSES, PASS_LAPSES]].tolist() == [0.2, 0.0, 0.0, 0.0]
    assert found == pytest.approx(0.8 ** sum(looks) * 0.2 ** (len(looks) - sum(looks)), rel=1e-3)


def test_an_object_that_is_never_reported_stays_so():
    assert likelihood((0, 0, 0, 0), 1.0, 0.0)[0] == pytest.approx(0.2, rel=1e-3)
    assert likelihood((1, 1, 1, 1), 1.0, 0.0)[0] == pytest.approx(0.8, rel=1e-3)
    assert likelihood((1, 0), 1.0, 0.0)[0] == pytest.approx(0.0, abs=1e-3)
    assert likelihood((0,) * 20, 0.5, 0.0, moved_px=math.inf)[0] == pytest.approx(0.1, rel=1e-3)


@pytest.mark.parametrize("lapses", [(0.2, 0.02) * 5, (0.1, 0.3, 0.1, 0.2, 0.3), (0.3, 0.2, 0.1)])
def test_an_object_lapses_wherever_lapses_are_as_frequent(lapses):
    """Its own lapses: all looks miss it where the least frequent one does, and hits tell as much."""
    for looks, expected in (([0] * len(lapses), min(lapses)), ([1] * len(lapses), 1.0 - max(lapses))):
        belief = unseen(())
        for hit, lapse in zip(looks, lapses, strict=True):
            luck = 0.0, 0.0, 1.0, 0.0, 0.0
            score = HIGH if hit else math.nan
            update(belief, 30.0, math.inf, 50.0, HIGH, 0.5, lapse, *luck, score, THRESHOLD)
        of_score = 0.97 / math.sqrt(2.0 * math.pi * 0.25) + 0.03 * 0.2
        assert math.exp(belief[WEIGHT]) / of_score ** sum(looks) == pytest.approx(expected, rel=1e-3)


def test_what_a_pass_lapses_in_another_reports():
    near = [likelihood((0, 0), 0.0, 1.0, moved_px=moved)[0] for moved in (0.0, 25.0, math.inf)]
    expected = [0.2 * (kept + (1.0 - kept) * 0.2) for kept in (1.0, math.exp(-0.5), 0.0)]
    assert near == pytest.approx(expected, rel=1e-3)


@given(
    st.lists(st.tuples(st.booleans(), st.floats(0.0, 0.9), st.floats(0.0, 200.0)), min_size=1, max_size=6),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
)
def test_all_that_can_happen_sums_to_one(steps, of_object, share):
    """Chances of a miss and a hit in the next look, whatever came before and however lapses change."""
    belief, of_pass = unseen(()), (1.0 - of_object) * share
    for missed, lapse, moved_px in steps:
        after = belief.copy()
        luck = 0.0, 0.0, of_object, of_pass, 0.0
        update(after, 30.0, moved_px, 50.0, HIGH, 0.5, lapse, *luck, math.nan, THRESHOLD)
        chance_of_miss = math.exp(after[WEIGHT] - belief[WEIGHT])
        hit = belief.copy()
        middle, variance = update(hit, 30.0, moved_px, 50.0, HIGH, 0.5, lapse, *luck, HIGH, THRESHOLD)
        density = 0.97 / math.sqrt(2.0 * math.pi * variance) + 0.03 * 0.2
        chance_of_hit = math.exp(hit[WEIGHT] - belief[WEIGHT]) / density
        assert 0.0 <= chance_of_miss <= 1.0
        assert chance_of_miss + chance_of_hit == pytest.approx(1.0, abs=1e-6)
        assert middle == HIGH
        assert 0.0 <= after[EVER_LAPSES] <= after[EVER_LAPSES] + after[NOW_LAPSES] <= 1.0 + 1e-9
        assert 0.0 <= after[PASS_LAPSES] <= 1.0
        belief = after if missed and chance_of_miss > 1e-9 else hit
        if not np.isfinite(belief).all():
            break
