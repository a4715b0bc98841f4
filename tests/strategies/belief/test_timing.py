"""When a candidate is looked at: now, from the scan to come, or after it."""

import numpy as np
import pytest
from contexts import context_of
from hypothesis import given
from hypothesis import strategies as st

from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.strategies.belief.timing import Timing

CONTEXT = context_of(scenario="clusters")  # from 30 m down to 4 m, scanned at 5 m/s
TIMING = Timing(CONTEXT, BeliefParameters(check_speed_mps=5.0))
LANES = [(0.0, 0.0), (2000.0, 0.0), (2000.0, 40.0), (0.0, 40.0)]


def saved_s(place, waiting, here=(0.0, 0.0), above_m=30.0, scan=LANES, others=()):
    places = np.array([place, *others], dtype=float)
    return TIMING.visits(here, above_m, scan, places, np.full(len(places), waiting)).saved_s[0]


def test_the_scan_lasts_as_long_as_its_way_takes():
    assert TIMING.scan_s(LANES) == pytest.approx(4040.0 / CONTEXT.search.scan_speed_mps)
    assert TIMING.scan_s(LANES[:1]) == 0.0


def test_nothing_is_urgent_while_waiting_is_free():
    """Beside another candidate, which the tour comes by anyway."""
    beside = [(-20.0, 0.0), (-20.0, 5.0)]
    assert saved_s((-20.0, 0.0), 0.0, others=beside[1:]) < 0.0
    assert saved_s((-20.0, 0.0), 0.1, others=beside[1:]) > 0.0


def test_a_visit_after_the_scan_costs_what_is_waited_until_then():
    """Too far for the lanes, and beside another that is looked at after the scan."""
    after_s = 50.0 / 5.0 + 0.01 * TIMING.scan_s(LANES)
    assert saved_s((0.0, -200.0), 0.01, others=[(0.0, -250.0)]) == pytest.approx(after_s - 2 * 40.0 - 8.0)


def test_what_was_passed_is_nearest_now():
    """Five seconds later it is 25 m further away; but after the scan it lies on the way, if that may be."""
    assert saved_s((-100.0, 0.0), 1.0) == pytest.approx(5.0 + 2 * 5.0)
    assert saved_s((-100.0, 0.0), 0.0, others=[(-100.0, 5.0)]) < 0.0


def test_what_the_next_lane_comes_by_waits_for_it():
    """Some 250 s until the lane home comes by, or 400 m back now."""
    here = (1600.0, 0.0)
    scan = [here, *LANES[1:]]
    assert saved_s((1200.0, 40.0), 0.05, here, scan=scan) < 0.0
    assert saved_s((1200.0, 40.0), 2.0, here, scan=scan) > 0.0


def test_down_there_the_next_one_is_near():
    high, low = saved_s((0.0, 60.0), 0.05), saved_s((0.0, 60.0), 0.05, above_m=4.0)
    assert low > high


@given(
    st.floats(-500, 500),
    st.floats(-500, 500),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.floats(4.0, 30.0),
)
def test_more_haste_never_makes_it_wait(x, y, waiting, more, above_m):
    assert (
        saved_s((x, y), waiting + more, above_m=above_m) >= saved_s((x, y), waiting, above_m=above_m) - 1e-9
    )
