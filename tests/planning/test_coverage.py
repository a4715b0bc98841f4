import time

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from skysweep.errors import UserError
from skysweep.geometry.areas import headings_of
from skysweep.geometry.camera import Lens
from skysweep.planning.coverage import MAX_TRANSECTS, footprints, plan_coverage

LENS = Lens(640, 360, 0.7)
U_SHAPE = shapely.Polygon(
    [(0, 0), (200, 0), (200, 200), (140, 200), (140, 60), (60, 60), (60, 200), (0, 200)]
)
RING = shapely.Polygon(shapely.box(0, 0, 200, 150).exterior, [shapely.box(60, 50, 140, 100).exterior.coords])


@st.composite
def areas(draw):
    """Simple polygons around the origin: star-shaped (so mostly concave), often with holes."""
    corners = draw(st.integers(3, 12))
    gaps = draw(st.lists(st.floats(0.2, 1.0), min_size=corners, max_size=corners))
    radii = draw(st.lists(st.floats(15.0, 200.0), min_size=corners, max_size=corners))
    angles = np.cumsum(gaps) * 2 * np.pi / np.sum(gaps)
    area = shapely.Polygon(np.column_stack([radii * np.cos(angles), radii * np.sin(angles)]))
    for _ in range(draw(st.integers(0, 3))):
        x, y = draw(st.floats(-150, 150)), draw(st.floats(-150, 150))
        hole = shapely.Point(x, y).buffer(draw(st.floats(1, 60)), quad_segs=draw(st.integers(1, 4)))
        if area.contains_properly(hole):
            area = area.difference(hole)
    assume(area.geom_type == "Polygon" and area.is_valid and area.area > 10.0)
    return area


@settings(max_examples=150)
@given(
    area=areas(),
    altitude_m=st.floats(8.0, 90.0),
    sidelap=st.floats(0.0, 0.8),
    heading_deg=st.none() | st.floats(0.0, 359.0),
    start=st.none() | st.tuples(st.floats(-300, 300), st.floats(-300, 300)),
)
def test_the_camera_sees_the_whole_area(area, altitude_m, sidelap, heading_deg, start):
    plan = plan_coverage(area, LENS, altitude_m, sidelap, heading_deg, start)
    missed = area.difference(footprints(plan, LENS, altitude_m))
    assert missed.area < 1e-6 * area.area
    assert plan.spacing_m <= plan.swath_m * (1 - sidelap) + 1e-6 or len(plan.transects) == 1


def test_a_plan_with_a_transect_taken_out_does_not_cover():
    plan = plan_coverage(U_SHAPE, LENS, 30.0, 0.2)
    strip = shapely.LineString(plan.transects[3]).buffer(plan.spacing_m / 4)
    others = [shapely.LineString(t).buffer(plan.swath_m / 2) for i, t in enumerate(plan.transects) if i != 3]
    assert strip.difference(shapely.union_all(others)).area > 1.0


@pytest.mark.parametrize("area", [U_SHAPE, RING, shapely.box(0, 0, 120, 80)])
def test_transects_are_the_path_and_share_its_heading(area):
    plan = plan_coverage(area, LENS, 30.0, 0.2, start_xy=(0.0, 0.0))
    assert np.array_equal(np.concatenate(plan.transects), plan.waypoints_xy_enu_m)
    along = headings_of(np.array(plan.transects)) % 180.0
    assert np.cos(np.radians(2 * (along - plan.heading_deg))) == pytest.approx(1.0)
    assert plan.length_m == pytest.approx(shapely.LineString(plan.waypoints_xy_enu_m).length)


def test_a_long_area_is_flown_lengthways():
    for turn_deg in (0.0, 33.0, 120.0):
        area = shapely.affinity.rotate(shapely.box(0, 0, 300, 60), -turn_deg, origin=(0, 0))
        plan = plan_coverage(area, LENS, 30.0, 0.2)
        assert plan.heading_deg == pytest.approx((90.0 + turn_deg) % 180.0, abs=0.01)
        assert len(plan.transects) == 4


def test_the_path_starts_at_the_end_nearest_to_home():
    for home in shapely.box(-20, -20, 140, 100).exterior.coords[:4]:
        plan = plan_coverage(shapely.box(0, 0, 120, 80), LENS, 30.0, 0.2, 90.0, home)
        ends = np.array([[x, y] for x in (3.08, 116.92) for y in (9.52, 70.48)])
        nearest = ends[np.argmin(np.linalg.norm(ends - home, axis=1))]
        assert plan.waypoints_xy_enu_m[0] == pytest.approx(nearest, abs=0.1)


def test_a_concave_area_is_flown_arm_by_arm():
    plan = plan_coverage(U_SHAPE, LENS, 30.0, 0.2, heading_deg=90.0)
    gap = shapely.box(60, 85, 140, 200)
    crossings = shapely.LineString(plan.waypoints_xy_enu_m).intersection(gap)
    assert len(shapely.get_parts(crossings)) == 1


def test_many_holes_are_ordered_without_waste():
    holes = [
        shapely.box(x, y, x + 60, y + 60).exterior.coords for x in (60, 220, 380, 540) for y in (60, 220, 380)
    ]
    area = shapely.Polygon(shapely.box(0, 0, 660, 500).exterior, holes)
    plan = plan_coverage(area, LENS, 30.0, 0.2)
    on_transects = sum(float(np.linalg.norm(t[1] - t[0])) for t in plan.transects)
    assert plan.length_m < 1.35 * on_transects
    assert area.difference(footprints(plan, LENS, 30.0)).area < 1e-6


def test_an_ordinary_area_takes_less_than_50_ms():
    plan_coverage(RING, LENS, 30.0, 0.2)
    times = []
    for _ in range(5):
        begin = time.process_time()
        plan_coverage(RING, LENS, 30.0, 0.2, start_xy=(0, 0))
        times.append(time.process_time() - begin)
    assert min(times) < 0.05


def test_the_same_input_gives_the_same_plan():
    first, second = (plan_coverage(U_SHAPE, LENS, 30.0, 0.2, start_xy=(1, 2)) for _ in range(2))
    assert np.array_equal(first.waypoints_xy_enu_m, second.waypoints_xy_enu_m)


@pytest.mark.parametrize(
    ("area", "altitude_m", "sidelap", "word"),
    [
        (shapely.Polygon([(0, 0), (10, 10), (10, 0), (0, 10)]), 30.0, 0.2, "area"),
        (shapely.Polygon(), 30.0, 0.2, "area"),
        (shapely.MultiPolygon([shapely.box(0, 0, 9, 9), shapely.box(20, 0, 29, 9)]), 30.0, 0.2, "area"),
        (shapely.box(0, 0, 100, 100), 30.0, 1.0, "sidelap"),
        (shapely.box(0, 0, 100, 100), 30.0, float("nan"), "sidelap"),
        (shapely.box(0, 0, 100, 100), 0.0, 0.2, "altitude_agl_m"),
        (shapely.box(0, 0, 100, 100), float("nan"), 0.2, "altitude_agl_m"),
        (shapely.box(0, 0, 9000, 9000), 1.0, 0.2, str(MAX_TRANSECTS)),
    ],
)
def test_bad_input_is_told_in_one_sentence(area, altitude_m, sidelap, word):
    with pytest.raises(UserError, match=word):
        plan_coverage(area, LENS, altitude_m, sidelap)


def comb(teeth, pitch_m, length_m):
    """An area of many corners that falls into many strips."""
    tooth = np.array([[0, 0], [0, length_m], [pitch_m / 2, length_m], [pitch_m / 2, 0]], dtype=float)
    corners = [tooth + np.array([k * pitch_m, 0.0]) for k in range(teeth)]
    return shapely.Polygon(np.concatenate([*corners, [[teeth * pitch_m, -5.0], [0.0, -5.0]]]))


@pytest.mark.parametrize("heading_deg", [None, 90.0])
def test_a_comb_of_two_thousand_corners_is_planned_soon(heading_deg):
    area = comb(500, 50.0, 60.0)
    begun_s = time.process_time()
    plan = plan_coverage(area, LENS, 30.0, 0.2, heading_deg)
    assert time.process_time() - begun_s < 20.0
    assert area.difference(footprints(plan, LENS, 30.0).buffer(1e-6)).area < 1e-3


def test_many_corners_in_many_transects_are_refused():
    with pytest.raises(UserError, match=r"area: 9,603 corners are too many for 2,\d{3} transects"):
        plan_coverage(comb(2400, 1.0, 12_000.0), Lens(640, 360, 0.2), 30.0, 0.2, 90.0)
