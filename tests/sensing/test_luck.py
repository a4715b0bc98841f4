"""What looks tell of an object's luck with the detector."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.sensing.statistical.luck import (
    ASPECT_LAPSES,
    EVER_LAPSES,
    LAPSE,
    NOW_LAPSES,
    WEIGHT,
    kept_since,
    unseen,
    update,
)

THRESHOLD, HIGH = 0.0, 3.0  # of the score; of an object whose score is above it in any case


def sight(turned_rad):
    """From an object to a camera, so far to the east of straight above."""
    return math.sin(turned_rad), 0.0, math.cos(turned_rad)


def likelihood(looks, of_object, of_aspect, lapse=0.2, turn_rad=0.0):
    """Of a chain of hits (1) and misses (0), in which the score tells nothing, and the belief after it."""
    belief, hits = unseen(()), sum(looks)
    for k, hit in enumerate(looks):
        seen = 30.0, sight(k * turn_rad), 0.1, 1.0
        luck = 0.0, 0.0, of_object, of_aspect, 0.0
        update(belief, *seen, HIGH, 0.5, lapse, *luck, HIGH if hit else math.nan, THRESHOLD)
    of_score = 0.97 / math.sqrt(2.0 * math.pi * 0.25) + 0.03 * 0.2
    return math.exp(belief[WEIGHT]) / of_score**hits, belief


@pytest.mark.parametrize("looks", [(0,), (0, 0, 0), (1, 1, 1), (1, 0), (0, 1, 0)])
def test_lapses_of_their_own_look_multiply(looks):
    found, belief = likelihood(looks, 0.0, 0.0)
    assert belief[[LAPSE, EVER_LAPSES, NOW_LAPSES, ASPECT_LAPSES]].tolist() == [0.2, 0.0, 0.0, 0.0]
    assert found == pytest.approx(0.8 ** sum(looks) * 0.2 ** (len(looks) - sum(looks)), rel=1e-3)


def test_an_object_that_is_never_reported_stays_so():
    assert likelihood((0, 0, 0, 0), 1.0, 0.0)[0] == pytest.approx(0.2, rel=1e-3)
    assert likelihood((1, 1, 1, 1), 1.0, 0.0)[0] == pytest.approx(0.8, rel=1e-3)
    assert likelihood((1, 0), 1.0, 0.0)[0] == pytest.approx(0.0, abs=1e-3)
    assert likelihood((0,) * 20, 0.5, 0.0, turn_rad=2.0)[0] == pytest.approx(0.1, rel=1e-3)


@pytest.mark.parametrize("lapses", [(0.2, 0.02) * 5, (0.1, 0.3, 0.1, 0.2, 0.3), (0.3, 0.2, 0.1)])
def test_an_object_lapses_wherever_lapses_are_as_frequent(lapses):
    """Its own lapses: all looks miss it where the least frequent one does, and hits tell as much."""
    for looks, expected in (([0] * len(lapses), min(lapses)), ([1] * len(lapses), 1.0 - max(lapses))):
        belief = unseen(())
        for hit, lapse in zip(looks, lapses, strict=True):
            seen, luck = (30.0, sight(0.0), 0.1, 1.0), (0.0, 0.0, 1.0, 0.0, 0.0)
            score = HIGH if hit else math.nan
            update(belief, *seen, HIGH, 0.5, lapse, *luck, score, THRESHOLD)
        of_score = 0.97 / math.sqrt(2.0 * math.pi * 0.25) + 0.03 * 0.2
        assert math.exp(belief[WEIGHT]) / of_score ** sum(looks) == pytest.approx(expected, rel=1e-3)


def test_what_lapses_in_one_aspect_is_reported_in_another():
    near = [likelihood((0, 0), 0.0, 1.0, turn_rad=turn)[0] for turn in (0.0, 0.05, 2.0)]
    expected = [0.2 * (left + (1.0 - left) * 0.2) for left in (1.0, math.exp(-0.5), 0.0)]
    assert near == pytest.approx(expected, rel=1e-3)


def test_an_aspect_fades_as_the_line_of_sight_turns_and_as_the_object_grows():
    belief = unseen(())
    assert kept_since(belief, 30.0, sight(0.0), 0.5, 0.8) == 0.0, "nobody has looked"
    luck = 0.0, 0.0, 0.0, 0.0, 0.0
    update(belief, 30.0, sight(0.3), 0.5, 0.8, HIGH, 0.5, 0.0, *luck, HIGH, THRESHOLD)
    for turned_rad, grown in ((0.0, 1.0), (0.2, 1.0), (0.0, 2.0), (0.2, 0.5)):
        left = kept_since(belief, 30.0 * grown, sight(0.3 + turned_rad), 0.5, 0.8)
        expected = math.exp(-turned_rad / 0.5 - abs(math.log(grown)) / 0.8)
        assert left == pytest.approx(expected, rel=1e-3)


@given(
    st.lists(
        st.tuples(st.booleans(), st.floats(0.0, 0.9), st.floats(0.0, 1.5), st.floats(4.0, 200.0)),
        min_size=1,
        max_size=6,
    ),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
)
def test_all_that_can_happen_sums_to_one(steps, of_object, share):
    """Chances of a miss and a hit in the next look, whatever came before and however lapses change."""
    belief, of_aspect = unseen(()), (1.0 - of_object) * share
    for missed, lapse, turned_rad, pixels in steps:
        after, seen = belief.copy(), (pixels, sight(turned_rad), 0.3, 0.8)
        luck = 0.0, 0.0, of_object, of_aspect, 0.0
        update(after, *seen, HIGH, 0.5, lapse, *luck, math.nan, THRESHOLD)
        chance_of_miss = math.exp(after[WEIGHT] - belief[WEIGHT])
        hit = belief.copy()
        middle, variance = update(hit, *seen, HIGH, 0.5, lapse, *luck, HIGH, THRESHOLD)
        density = 0.97 / math.sqrt(2.0 * math.pi * variance) + 0.03 * 0.2
        chance_of_hit = math.exp(hit[WEIGHT] - belief[WEIGHT]) / density
        assert 0.0 <= chance_of_miss <= 1.0
        assert chance_of_miss + chance_of_hit == pytest.approx(1.0, abs=1e-6)
        assert middle == HIGH
        assert 0.0 <= after[EVER_LAPSES] <= after[EVER_LAPSES] + after[NOW_LAPSES] <= 1.0 + 1e-9
        assert 0.0 <= after[ASPECT_LAPSES] <= 1.0
        belief = after if missed and chance_of_miss > 1e-9 else hit
        if not np.isfinite(belief).all():
            break
