"""What is said of a candidate's probability, and of the looks that moved it."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.strategies.belief.account import CLEAR, MOVED, Account, within_clear


@pytest.mark.parametrize(
    ("looks", "words"),
    [
        ([], ""),
        ([(28.2, 0.834)], "found with 0.83 from 28 m"),
        ([(28.0, None)], "missed from 28 m"),
        ([(28.0, None)] * 4, "missed in 4 looks from 28 m"),
        ([(30.0, 0.4), (8.0, None), (12.0, 0.6)], "found in 2 of 3 looks from 8 to 30 m, at best with 0.60"),
    ],
)
def test_looks_in_words(looks, words):
    account = Account()
    for height_m, confidence in looks:
        account.look(height_m, confidence)
    assert account.words() == words


@given(st.floats(-20, 20), st.floats(-20, 20))
def test_it_is_told_again_where_that_changes_what_one_would_think(told, now):
    account = Account(within_clear(told))
    assert account.has_moved(now) == account.has_moved(within_clear(now))
    if abs(told) <= CLEAR and abs(now) <= CLEAR:
        assert account.has_moved(now) == (abs(now - told) >= MOVED)
    if min(told, now) >= CLEAR or max(told, now) <= -CLEAR:
        assert not account.has_moved(now)


def test_the_step_is_as_documented():
    def probability(log_odds):
        return 1.0 / (1.0 + math.exp(-log_odds))

    assert probability(MOVED) == pytest.approx(0.82, abs=0.005)
    assert probability(CLEAR) == pytest.approx(0.993, abs=0.0005)
