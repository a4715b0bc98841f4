"""Against hand computations, scipy and known distributions."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from skysweep.results.reporting.statistics import (
    bca_intervals,
    estimate,
    front_shares,
    holm,
    paired_tests,
    pairs_needed,
    pairs_to_tell,
    pareto_front,
    pointwise_band,
    ratio_of_means,
    resample_counts,
    signed_rank_test,
)


def test_estimate_by_hand():
    e = estimate(np.array([1.0, 2.0, math.nan, 6.0]))
    assert (e.n, e.mean, e.median, e.std) == (3, 3.0, 2.0, pytest.approx(math.sqrt(7)))
    assert 1.0 <= e.low < 3.0 < e.high <= 6.0


def test_one_value_has_no_interval_and_none_has_no_mean():
    one, none = estimate(np.array([4.0])), estimate(np.array([math.nan]))
    assert one.n == 1
    assert one.mean == one.median == 4.0
    assert np.isnan([one.low, one.high, one.std]).all()
    assert none.n == 0
    assert math.isnan(none.mean)


def test_values_that_do_not_vary_give_no_width():
    e = estimate(np.full(30, 0.1))
    assert (e.low, e.high) == (pytest.approx(0.1, abs=1e-15), pytest.approx(0.1, abs=1e-15))


@given(arrays(float, st.integers(2, 40), elements=st.integers(0, 3).map(lambda k: k / 8)))
@settings(max_examples=30)
def test_a_bound_of_zero_is_zero_whatever_the_rounding(values):
    low, high = (float(bound[0]) for bound in bca_intervals(values[:, None] - values.min(), 500))
    assert math.copysign(1.0, low) > 0
    assert low == 0.0 or low > 1e-6
    low, high = (float(bound[0]) for bound in bca_intervals(values[:, None] - values.max(), 500))
    assert high == 0.0 or high < -1e-6


def test_a_ratio_of_means_is_not_the_mean_of_ratios():
    above, below = np.array([1.0, 2.0, 9.0]), np.array([1.0, 1.0, 4.0])
    found = ratio_of_means(above, below)
    assert (found.n, found.mean) == (3, 2.0)
    assert 1.0 <= found.low < 2.0 < found.high <= 2.25


def test_the_interval_of_a_ratio_covers_the_truth():
    """Of 200 samples of pairs with means 3 and 2, about 95 % have 1.5 in the interval."""
    rng = np.random.default_rng(8)
    common = rng.normal(0.0, 0.5, (200, 40))
    above, below = (m + common + rng.normal(0.0, 0.5, (200, 40)) for m in (3.0, 2.0))
    found = [ratio_of_means(a, b) for a, b in zip(above, below, strict=True)]
    assert 0.88 <= np.mean([e.low <= 1.5 <= e.high for e in found]) <= 0.99


def test_one_pair_has_a_ratio_without_interval():
    found = ratio_of_means(np.array([3.0]), np.array([2.0]))
    assert found.mean == 1.5
    assert math.isnan(found.low)
    assert math.isnan(found.high)


def test_resamples_draw_n_of_n_alike_every_time():
    counts = resample_counts(7, 1000)
    assert counts.shape == (1000, 7)
    assert (counts.sum(axis=1) == 7).all()
    assert (counts == resample_counts(7, 1000)).all()
    # each is drawn once on average, with the variance of a multinomial, 1 - 1/n
    assert counts.mean(axis=0) == pytest.approx(np.ones(7), abs=0.15)
    assert counts.var() == pytest.approx(6 / 7, abs=0.05)


@pytest.mark.parametrize("draw", ["exponential", "normal", "poisson"])
def test_bca_is_scipys(draw):
    rng = np.random.default_rng(5)
    sample = {
        "exponential": rng.exponential(10, 40),
        "normal": rng.normal(300, 20, 40),
        "poisson": rng.poisson(1.5, 40).astype(float),
    }[draw]
    ours = bca_intervals(sample[:, None], 80_000)
    theirs = stats.bootstrap(
        (sample,), np.mean, method="BCa", n_resamples=80_000, rng=np.random.default_rng(1)
    ).confidence_interval
    spread = sample.std(ddof=1) / math.sqrt(40)
    assert ours[0][0] == pytest.approx(theirs.low, abs=0.06 * spread)
    assert ours[1][0] == pytest.approx(theirs.high, abs=0.06 * spread)


def test_columns_do_not_touch_each_other():
    values = np.random.default_rng(3).normal(size=(12, 700))
    low, high = bca_intervals(values, 500)
    alone = bca_intervals(values[:, 400:401], 500)
    assert low[400] == pytest.approx(alone[0][0])
    assert high[400] == pytest.approx(alone[1][0])


@pytest.mark.parametrize(
    ("draw", "truth", "n", "at_least"),
    [("normal", 0.0, 30, 0.92), ("exponential", 1.0, 30, 0.90), ("exponential", 1.0, 100, 0.925)],
)
def test_intervals_cover_the_truth_nearly_as_often_as_they_say(draw, truth, n, at_least):
    rng = np.random.default_rng(11)
    samples = rng.normal(size=(n, 2000)) if draw == "normal" else rng.exponential(size=(n, 2000))
    low, high = bca_intervals(samples, 2000)
    covered = ((low <= truth) & (truth <= high)).mean()
    assert at_least < covered < 0.97


def test_band_is_narrow_where_curves_agree():
    t = np.linspace(0, 1, 11)
    curves = np.array([t, t, t**2, np.sqrt(t)])
    low, high = pointwise_band(curves)
    assert low[0] == high[0] == 0.0
    assert low[-1] == high[-1] == 1.0
    assert (low <= curves.mean(axis=0)).all()
    assert (curves.mean(axis=0) <= high).all()
    assert high[5] - low[5] > 0.05
    assert np.isnan(pointwise_band(curves[:1])).all()


def test_paired_test_by_hand():
    # differences 1 2 -3 4 5 and a zero: ranks of the positive 1 + 2 + 4 + 5 = 12 of 15
    (test,) = paired_tests(np.array([[1.0], [2.0], [-3.0], [4.0], [5.0], [0.0]]))
    assert (test.n_pairs, test.n_zero) == (6, 1)
    assert test.mean == pytest.approx(1.5)
    assert test.rank_biserial == pytest.approx((12 - 3) / 15)
    # of 32 signs 5 give a sum of 3 or less: {}, 1, 2, 3, 1+2
    assert test.p == pytest.approx(2 * 5 / 32)
    assert test.cohens_dz == pytest.approx(1.5 / np.std([1, 2, -3, 4, 5, 0], ddof=1))
    assert -3 <= test.low < 1.5 < test.high <= 5


def test_no_difference_is_no_difference():
    (test,) = paired_tests(np.zeros((8, 1)))
    assert (test.p, test.rank_biserial, test.mean, test.low, test.high, test.n_zero) == (1, 0, 0, 0, 0, 8)
    assert math.isnan(test.cohens_dz)


def test_always_the_same_difference_has_no_dz():
    (test,) = paired_tests(np.full((8, 1), 0.1))
    assert test.p == pytest.approx(2 / 2**8)
    assert test.rank_biserial == 1.0
    assert math.isnan(test.cohens_dz)


def test_one_pair_and_none():
    (one,) = paired_tests(np.array([[3.0]]))
    assert (one.n_pairs, one.mean, one.p) == (1, 3.0, 1.0)
    assert np.isnan([one.low, one.high, one.cohens_dz]).all()
    (none,) = paired_tests(np.zeros((0, 1)))
    assert none.n_pairs == 0
    assert math.isnan(none.mean)


@given(
    arrays(float, st.integers(1, 30), elements=st.integers(-5000, 5000).map(lambda k: k / 128), unique=True)
)
def test_wilcoxon_is_scipys_exact_one_without_ties(differences):
    magnitudes = np.abs(differences)
    if (magnitudes == 0).any() or len(np.unique(magnitudes)) < len(magnitudes):
        return
    p, _ = signed_rank_test(differences)
    assert p == pytest.approx(stats.wilcoxon(differences, method="exact").pvalue)


@given(arrays(float, st.integers(1, 9), elements=st.integers(-4, 4).map(float)))
def test_wilcoxon_with_ties_counts_all_signs(differences):
    kept = differences[differences != 0]
    ranks = stats.rankdata(np.abs(kept))
    middle, observed = ranks.sum() / 2, ranks[kept > 0].sum()
    signs = np.array(list(itertools.product([0, 1], repeat=len(kept))))
    expected = (np.abs(signs @ ranks - middle) >= abs(observed - middle) - 1e-9).mean() if len(kept) else 1.0
    assert signed_rank_test(differences)[0] == pytest.approx(expected)


def test_the_last_bits_break_no_tie_and_make_no_difference():
    tenths = np.array([1, -1, 2, 1, 3, -2, 1, 0, 0, 4, 1, 2])
    before = 142.3 + np.arange(len(tenths)) / 10
    exact, noisy = tenths / 10, np.round(before + tenths / 10, 1) - np.round(before, 1)
    noisy[7] = 0.1 + 0.2 - 0.3  # not quite zero
    assert len(np.unique(np.abs(noisy))) > len(np.unique(np.abs(tenths)))
    assert signed_rank_test(noisy) == signed_rank_test(exact) == signed_rank_test(tenths.astype(float))
    assert paired_tests(noisy[:, None])[0].n_zero == 2


def test_the_same_difference_of_large_values_has_no_dz():
    tenths = 90007 + np.arange(8)
    difference = (tenths + 1) / 10 - tenths / 10
    assert difference.std() > 1e-12 * difference.mean()
    (test,) = paired_tests(difference[:, None])
    assert math.isnan(test.cohens_dz)


@pytest.mark.parametrize("n", [51, 120])
def test_wilcoxon_of_many_is_scipys_approximation(n):
    rng = np.random.default_rng(n)
    for differences in (rng.normal(0.2, 1, n), rng.integers(-2, 4, n).astype(float)):
        kept = differences[differences != 0]
        if len(kept) > 50:
            expected = stats.wilcoxon(kept, method="asymptotic", correction=False).pvalue
            assert signed_rank_test(differences)[0] == pytest.approx(expected)


def test_exact_and_approximate_agree_where_they_meet():
    differences = np.random.default_rng(2).normal(0.25, 1, 50)
    exact = signed_rank_test(differences)[0]
    assert exact == pytest.approx(stats.wilcoxon(differences, method="asymptotic").pvalue, rel=0.1)


@given(arrays(float, st.integers(1, 20), elements=st.floats(-9, 9, allow_subnormal=False)))
def test_turning_the_pair_around_turns_the_signs(differences):
    (forth,), (back,) = paired_tests(differences[:, None]), paired_tests(-differences[:, None])
    assert forth.p == pytest.approx(back.p)
    assert forth.rank_biserial == pytest.approx(-back.rank_biserial, abs=1e-12)
    assert -1.0 <= forth.rank_biserial <= 1.0
    assert forth.mean == pytest.approx(-back.mean)


def test_holms_worked_example():
    # ordered .005 .01 .03 .04, times 4 3 2 1: .02 .03 .06 .04, the last raised to .06
    assert holm(np.array([0.01, 0.04, 0.03, 0.005])) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_holm_leaves_out_what_was_not_tested():
    corrected = holm(np.array([0.04, math.nan, 0.02]))
    assert corrected[[0, 2]] == pytest.approx([0.04, 0.04])
    assert math.isnan(corrected[1])


@given(arrays(float, st.integers(1, 30), elements=st.floats(0, 1)))
def test_holm_never_helps_and_keeps_the_order(p):
    corrected = holm(p)
    assert (corrected >= p).all()
    assert (corrected <= 1).all()
    assert (np.diff(corrected[np.argsort(p, kind="stable")]) >= 0).all()
    assert (corrected <= np.minimum(1, p * len(p)) + 1e-12).all()


@pytest.mark.parametrize("family", [1, 2, 15, 1225])
def test_pairs_needed_is_the_first_number_that_can_show_anything(family):
    n = pairs_needed(family)
    assert 2.0 ** (1 - n) * family <= 0.05 < min(1.0, 2.0 ** (2 - n)) * family


@given(
    arrays(float, st.integers(2, 60), elements=st.floats(-9, 9, allow_subnormal=False)),
    st.integers(1, 500),
)
def test_pairs_to_tell_asks_for_more_pairs_where_a_family_hides_a_difference(differences, family):
    (test,) = paired_tests(differences[:, None])
    if test.p * family >= 0.05:
        assert pairs_to_tell(test, family) > test.n_pairs
        assert pairs_to_tell(test, family) >= pairs_needed(family)


def test_pairs_to_tell_is_about_right():
    rng = np.random.default_rng(3)
    few = paired_tests(rng.normal(0.5, 1, (30, 400)))
    median = sorted(few, key=lambda test: test.p)[200]
    n = pairs_to_tell(median, 66)
    assert n > 30
    enough = paired_tests(rng.normal(0.5, 1, (n, 400)))
    assert 0.3 < np.mean([test.p * 66 < 0.05 for test in enough]) < 0.7


def test_smallest_p_is_reached():
    assert signed_rank_test(np.arange(1.0, 8.0))[0] == pytest.approx(2.0**-6)


points = arrays(
    float, st.tuples(st.integers(1, 14), st.integers(1, 3)), elements=st.integers(0, 6).map(float)
)


def dominates(a, b):
    return (a <= b).all() and (a < b).any()


@given(points)
def test_front_dominates_all_others_and_none_of_its_own(costs):
    front = pareto_front(costs)
    assert front.any()
    for k, row in enumerate(costs):
        beaten = any(dominates(member, row) for member in costs[front])
        assert beaten != front[k]


def test_unknown_costs_are_not_on_the_front():
    assert pareto_front(np.array([[1.0, math.nan], [2.0, 2.0], [3.0, 1.0], [3.0, 3.0]])).tolist() == [
        False,
        True,
        True,
        False,
    ]


def test_equal_means_share_the_front_whatever_the_order_of_a_sum():
    recalls = [0.1, 0.2, 0.3], [0.3, 0.2, 0.1]
    misses = [-sum(recall) for recall in recalls]
    assert misses[0] != misses[1]
    assert pareto_front(np.array([[300.0, m] for m in misses])).all()


def test_front_shares():
    rng = np.random.default_rng(4)
    world = rng.normal(0, 5, (40, 1))  # what all members of a seed share
    time = world + np.array([100.0, 100.0, 110.0, 130.0]) + rng.normal(0, 1, (40, 4)) * [1, 1, 1, 0.1]
    misses = np.array([0.5, 0.5, 0.1, 0.4]) + np.zeros((40, 1))
    shares = front_shares(np.stack([time, misses], axis=2))
    assert shares[2] == 1.0
    assert shares[3] == 0.0
    assert shares[0] + shares[1] == pytest.approx(1.0)  # one of the two is faster, never both
    assert np.isnan(front_shares(np.ones((1, 2, 2)))).all()


def test_equal_members_share_the_front():
    costs = np.random.default_rng(6).exponential(size=(20, 1, 2)).repeat(3, axis=1)
    assert front_shares(costs).tolist() == [1.0, 1.0, 1.0]
