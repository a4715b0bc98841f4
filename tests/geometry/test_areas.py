import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from skysweep.geometry.areas import (
    edge_headings,
    heading_axes,
    headings_of,
    intervals_in_bands,
    swept_rectangles,
    turned_boxes,
)


@pytest.mark.parametrize(
    ("heading_deg", "along"), [(0, (0, 1)), (90, (1, 0)), (180, (0, -1)), (270, (-1, 0))]
)
def test_heading_is_a_compass_heading(heading_deg, along):
    axes = heading_axes(heading_deg)
    assert axes[0] == pytest.approx(along)
    assert np.linalg.det(axes) == pytest.approx(1.0)


@given(st.floats(0.0, 359.99), st.floats(0.1, 1e4))
def test_headings_of_legs_are_those_of_their_axes(heading_deg, length_m):
    start = np.array([3.0, -2.0])
    leg = [start, start + length_m * heading_axes(heading_deg)[0]]
    assert headings_of(leg)[0] == pytest.approx(heading_deg, abs=1e-6)


@settings(max_examples=50)
@given(st.integers(0, 10_000), st.floats(0.0, 3.0))
def test_many_corners_span_what_few_do(seed, min_gap):
    rng = np.random.default_rng(seed)
    radii = rng.uniform(5.0, 20.0, 14)
    ring = np.column_stack([radii * np.cos(np.arange(14) * 0.448), radii * np.sin(np.arange(14) * 0.448)])
    area = shapely.Polygon(ring, [0.3 * ring[::-1]])
    finer = area.segmentize(0.1)
    assert shapely.get_num_coordinates(finer) > 500
    bands = np.column_stack([np.arange(-20.0, 20.0, 1.7), np.arange(-20.0, 20.0, 1.7) + 1.7])
    few, many = (intervals_in_bands(a, bands, min_gap) for a in (area, finer))
    for expected, found in zip(few, many, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_edge_headings_come_longest_first_and_include_holes():
    area = shapely.box(0, 0, 30, 10).difference(shapely.Polygon([(10, 4), (14, 4), (12, 6)]))
    headings = edge_headings(area)
    assert len(headings) == 4 + 3
    assert headings[:2] == pytest.approx([90.0, 90.0])
    assert sorted(headings[-3:]) == pytest.approx([45.0, 90.0, 135.0])


def test_a_swept_rectangle_reaches_half_its_size_beyond_the_leg():
    swept = swept_rectangles([[[0.0, 0.0], [0.0, 10.0]]], 0.0, width_m=6.0, height_m=4.0)[0]
    assert swept.bounds == pytest.approx((-3.0, -2.0, 3.0, 12.0))
    sideways = swept_rectangles([[[0.0, 0.0], [10.0, 0.0]]], 0.0, width_m=6.0, height_m=4.0)[0]
    assert sideways.bounds == pytest.approx((-3.0, -2.0, 13.0, 2.0))
    still = swept_rectangles([[[5.0, 5.0], [5.0, 5.0]]], 90.0, width_m=6.0, height_m=4.0)[0]
    assert still.bounds == pytest.approx((3.0, 2.0, 7.0, 8.0))


def test_bands_give_what_the_area_spans_and_join_narrow_gaps():
    area = shapely.box(0, 0, 30, 20).difference(shapely.box(10, -1, 14, 9))
    bands = [[0.0, 10.0], [10.0, 20.0], [20.0, 30.0]]
    split = intervals_in_bands(area, bands, min_gap=3.0)
    assert split[0].tolist() == [[0.0, 30.0]]  # above y = 9 the two parts are one
    low = intervals_in_bands(area, [[0.0, 8.0]], min_gap=3.0)[0]
    assert low.tolist() == [[0.0, 10.0], [14.0, 30.0]]
    assert intervals_in_bands(area, [[0.0, 8.0]], min_gap=4.0)[0].tolist() == [[0.0, 30.0]]
    assert split[1].tolist() == [[0.0, 30.0]]
    assert split[2].shape == (0, 2)


def test_a_box_is_turned_about_its_centre():
    one, other = turned_boxes([(5.0, 6.0), (0.0, 0.0)], [(4.0, 2.0), (4.0, 2.0)], [np.pi / 2, np.pi / 4])
    assert one.bounds == pytest.approx((4.0, 4.0, 6.0, 8.0))
    assert other.area == pytest.approx(8.0)
    assert other.covers(shapely.Point(1.3, 1.3))
    assert not other.covers(shapely.Point(1.3, -1.3))
    assert len(turned_boxes([], [], [])) == 0
