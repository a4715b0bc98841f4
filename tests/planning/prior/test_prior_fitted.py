"""Patterns that are fitted to where an ideal searcher searches."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from maps_of_all_kinds import MAPS, gaussian

from skysweep.planning.prior.coverage import length_of
from skysweep.planning.prior.fitted import best_pattern


@settings(max_examples=40)
@given(
    rows=st.integers(1, 30),
    columns=st.integers(1, 30),
    start=st.tuples(st.floats(-300.0, 600.0), st.floats(-300.0, 600.0)),
    each_m=st.floats(50.0, 20_000.0),
    n=st.integers(1, 5),
    width_m=st.sampled_from([2.0, 10.0, 35.0, 400.0]),
)
def test_paths_begin_at_the_start_and_are_within_the_budget(rows, columns, start, each_m, n, width_m):
    for paths in best_pattern(np.ones((rows, columns)), 10.0, np.array(start), each_m, n, width_m):
        assert len(paths) == n
        for path in paths:
            assert np.isfinite(path).all()
            assert path[0].tolist() == list(start)
            assert length_of(path) <= each_m * (1.0 + 1e-9)


def test_consecutive_parts_cover_an_even_map_together():
    """A hundred legs' worth, shared out among four, with their ways."""
    ((*paths,),) = best_pattern(np.ones((40, 40)), 10.0, np.zeros(2), 6_000.0, 4, 20.0)
    assert [length_of(path) for path in paths] == pytest.approx([6_000.0] * 4, rel=0.02)


def test_where_peaks_are_far_apart_no_pattern_fits():
    two = gaussian(20, 20, 3) + gaussian(100, 100, 3)
    assert best_pattern(two, 10.0, np.array([600.0, 600.0]), 5_000.0, 1, 10.0) == []
    assert best_pattern(MAPS["peak"], 10.0, np.array([600.0, 600.0]), 5_000.0, 1, 10.0)
