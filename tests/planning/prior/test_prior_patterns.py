"""The patterns of the IAMSAR Manual."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from skysweep.errors import UserError
from skysweep.planning.prior.patterns import (
    creeping_line,
    expanding_square,
    parallel_track,
    sector_search,
)

headings = st.floats(-360.0, 720.0)


def legs_of(path):
    return np.diff(path, axis=0)


@pytest.mark.parametrize("pattern", [parallel_track, creeping_line])
@given(heading=headings, spacing=st.floats(5.0, 60.0))
def test_legs_sweep_their_rectangle(pattern, heading, spacing):
    path = pattern((30.0, -20.0), 400.0, 150.0, spacing, heading)
    rectangle = shapely.affinity.translate(shapely.box(-75, -200, 75, 200), 30.0, -20.0)
    rectangle = shapely.affinity.rotate(rectangle, -heading, origin=(30.0, -20.0))
    swept = shapely.LineString(path).buffer(spacing / 2 + 1e-6, cap_style="square", join_style="mitre")
    assert rectangle.difference(swept).area < 1e-3
    assert rectangle.buffer(1e-6).covers(shapely.LineString(path))


def test_parallel_legs_follow_the_longer_side_and_creeping_ones_the_shorter():
    parallel, creeping = (p((0, 0), 400.0, 150.0, 30.0, 0.0) for p in (parallel_track, creeping_line))
    assert legs_of(parallel)[0] == pytest.approx([0.0, 370.0])
    assert parallel[0] == pytest.approx([-60.0, -185.0])
    assert abs(legs_of(creeping)[0]) == pytest.approx([150.0 - 400.0 / 14, 0.0])
    assert creeping[-1, 1] > creeping[0, 1]


def test_an_expanding_square_goes_round_its_datum():
    path = expanding_square((5.0, 5.0), 100.0, 50.0, 0.0)
    assert np.linalg.norm(legs_of(path), axis=1) == pytest.approx([50, 50, 100, 100, 150, 150, 200, 200])
    assert path[:4] - 5.0 == pytest.approx(np.array([[0, 0], [0, 50], [50, 50], [50, -50]]))
    left = expanding_square((5.0, 5.0), 100.0, 50.0, 0.0, "left")
    assert left[2] - 5.0 == pytest.approx([-50, 50])


@given(heading=headings, turn=st.sampled_from(["right", "left"]))
def test_a_sector_search_crosses_its_datum_three_times(heading, turn):
    path = sector_search((7.0, -3.0), 200.0, heading, turn)
    assert np.linalg.norm(legs_of(path), axis=1) == pytest.approx(np.full(9, 200.0))
    at_datum = np.linalg.norm(path - (7.0, -3.0), axis=1) < 1e-6
    assert np.flatnonzero(at_datum).tolist() == [0, 3, 6, 9]
    first = legs_of(path)[0] / 200.0
    assert first == pytest.approx([np.sin(np.radians(heading)), np.cos(np.radians(heading))], abs=1e-9)
    ends = path[[1, 2, 4, 5, 7, 8]] - (7.0, -3.0)
    angles = np.sort(np.degrees(np.arctan2(*ends.T)) % 360.0)
    assert np.diff(angles) == pytest.approx(np.full(5, 60.0))


@pytest.mark.parametrize(
    ("call", "word"),
    [
        (lambda: parallel_track((0, 0), 100.0, 200.0, 10.0, 0.0), "length_m: is shorter"),
        (lambda: creeping_line((0, 0), 100.0, 200.0, 10.0, 0.0), "length_m: is shorter"),
        (lambda: parallel_track((0, 0), 100.0, 0.0, 10.0, 0.0), "width_m"),
        (lambda: creeping_line((0, 0), 200.0, 100.0, 1e-3, 0.0), "spacing_m: makes 200,000 legs"),
        (lambda: expanding_square((0, 0), 100.0, -1.0, 0.0), "spacing_m"),
        (lambda: sector_search((0, 0), float("nan"), 0.0), "radius_m"),
        (lambda: sector_search((0,), 100.0, 0.0), "datum_xy_m"),
    ],
)
def test_bad_patterns_are_told_in_one_sentence(call, word):
    with pytest.raises(UserError, match=word):
        call()


def test_a_turn_is_to_the_left_or_to_the_right():
    for pattern in (lambda: sector_search((0, 0), 100.0, 0.0, turn="Right"),
                    lambda: expanding_square((0, 0), 100.0, 20.0, 0.0, turn="links")):  # fmt: skip
        with pytest.raises(UserError, match=r"turn: is '(Right|links)'; write 'right' or 'left'"):
            pattern()
