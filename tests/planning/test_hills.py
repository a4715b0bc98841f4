import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.flown_path import FlownPath, hidden_from
from skysweep.planning.following import Following
from skysweep.planning.proof import prove
from skysweep.planning.sight import View, least_heights
from skysweep.scenarios.model import Area, CameraModel, Safety, Scenario, Terrain, VehicleLimits
from skysweep.worlds.world import build_terrain

HALF_VIEW = math.tan(0.6)  # across, of the camera below


def scenario(heights_m, altitude_m=40.0, corners=((0, 0), (300, 0), (300, 200), (0, 200)), **search):
    s = Scenario(
        name="hills",
        area=Area(polygon_enu_m=list(corners)),
        terrain=Terrain(heightmap_m=np.asarray(heights_m).tolist()),
        camera=CameraModel(width_px=1280, height_px=720, hfov_rad=1.2),
        vehicle=VehicleLimits(cruise_speed_mps=8.0, battery_wh=5000.0),
        safety=Safety(altitude_max_agl_m=600.0),
    )
    return s.with_search(
        **{"scan_altitude_agl_m": altitude_m, "scan_speed_mps": 8.0, "check_altitude_agl_m": 5.0} | search
    )


@st.composite
def rough_ground(draw):
    """Heightmaps from gentle to steeper than 45 degrees, with steps."""
    rows, columns = draw(st.integers(2, 24)), draw(st.integers(2, 24))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    noise = rng.normal(size=(rows, columns))
    for _ in range(draw(st.integers(0, 3))):  # smoother
        padded = np.pad(noise, 1, mode="edge")
        noise = (
            padded[1:-1, 1:-1] + padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
        ) / 5
    slope = draw(st.floats(-0.5, 0.5))
    tilt = slope * np.linspace(0, 300, columns)[None, :]
    step = draw(st.floats(0.0, 40.0)) * (np.arange(rows) > rows / 2)[:, None]
    return noise * draw(st.floats(0.0, 30.0)) + tilt + step


def sees(s, terrain, eye, heading_deg, place):
    """Whether a picture straight down shows a place, by steps of a quarter metre along the line of sight."""
    heading = math.radians(heading_deg)
    dx, dy = place[:2] - eye[:2]
    along, across = (
        dx * math.sin(heading) + dy * math.cos(heading),
        dx * math.cos(heading) - dy * math.sin(heading),
    )
    depth_m = eye[2] - place[2]
    half_height = HALF_VIEW * s.camera.height_px / s.camera.width_px
    if abs(across) > HALF_VIEW * depth_m + 0.01 or abs(along) > half_height * depth_m + 0.01:
        return False
    share = np.linspace(0.0, 1.0, max(3, math.ceil(math.hypot(dx, dy) / 0.25)))[1:-1, None]
    between = place + share * (eye - place)
    return bool((terrain.height_m(between[:, :2]) <= between[:, 2] + 0.5).all())


@settings(max_examples=200)
@given(heights=rough_ground(), altitude_m=st.floats(25.0, 80.0), sidelap=st.floats(0.0, 0.6))
def test_no_cell_of_the_area_lies_outside_every_footprint(heights, altitude_m, sidelap):
    s = scenario(heights, altitude_m, sidelap=sidelap)
    plan, _ = plan_scenario(s)
    terrain = build_terrain(s)
    proof = prove(plan, s, terrain)
    assert proof.seen.all()
    assert not proof.unseen_places()
    for profile in plan.profiles:
        share = np.linspace(0.0, 1.0, 2000)[:, None]
        xy = profile.leg_xy_enu_m[0] + share * np.diff(profile.leg_xy_enu_m, axis=0)
        flown = np.interp(share[:, 0] * profile.length_m, profile.along_m, profile.height_m)
        assert (flown >= terrain.height_m(xy) + altitude_m - 1e-6).all()


LEDGE = np.repeat([[0.0, 0.0], [31.0, 31.0]], [12, 11], axis=0)


@settings(max_examples=10)
@given(heights=rough_ground())
@example(heights=LEDGE)  # its edge hides what lies below it from the next transect
def test_what_the_proof_calls_seen_is_seen_by_rays(heights):
    s = scenario(heights)
    plan, _ = plan_scenario(s)
    terrain = build_terrain(s)
    proof = prove(plan, s, terrain)
    places = proof.cells.centres_enu_m[:: max(1, len(proof.seen) // 25)]
    stations = [np.column_stack([p.xy_enu_m(), p.height_m]) for p in plan.profiles] or [
        np.column_stack([t, terrain.height_m(t) + 40.0]) for t in plan.transects
    ]
    fine = [
        np.column_stack([np.interp(np.linspace(0, len(a) - 1, 400), np.arange(len(a)), c) for c in a.T])
        for a in stations
    ]
    for place in places:
        near = sorted(np.concatenate(fine), key=lambda eye: math.dist(eye[:2], place[:2]))[:250]
        assert any(sees(s, terrain, eye, plan.heading_deg, place) for eye in near)


def clears_m(terrain, place, over):
    """From what height above a point a place is seen: samples, and denser ones around what hides it most."""
    samples = [np.linspace(0.0, 1.0, 20_001)[1:], np.geomspace(1e-5, 1.0, 20_000)]
    for _ in range(2):
        share = np.unique(np.concatenate(samples))
        ground = terrain.height_m(place[:2] + share[:, None] * (over - place[:2]))
        heights = place[2] + (ground - 0.02 - place[2]) / share
        k = int(heights.argmax())
        samples = [np.linspace(share[max(k - 1, 0)], share[min(k + 1, len(share) - 1)], 2_000)]
    return float(heights.max())


@settings(max_examples=100)
@given(heights=rough_ground(), seed=st.integers(0, 2**32 - 1))
def test_the_least_height_clears_all_ground_in_between_and_no_more(heights, seed):
    terrain = build_terrain(scenario(heights))
    rng = np.random.default_rng(seed)
    a, b = rng.uniform((-80, -80), (380, 280), (2, 2))
    place = np.array([*a, terrain.height_m(a)[0]])
    view = View(1e6, 1e6, 0.0, 1.0)  # shows everything
    (least,) = least_heights(terrain, view, place[None], b[None])
    needed = max(place[2], clears_m(terrain, place, b))
    assert needed - 1e-6 <= least <= needed + 0.05


@settings(max_examples=100)
@given(heights=rough_ground(), seed=st.integers(0, 2**32 - 1), antenna_m=st.floats(0.0, 30.0))
def test_no_ground_between_antenna_and_vehicle_is_missed(heights, seed, antenna_m):
    """Against dense samples; the vehicle is just above or below the height that clears them."""
    terrain = build_terrain(scenario(heights))
    assume(not terrain.is_flat)
    rng = np.random.default_rng(seed)
    a, b = rng.uniform((-80, -80), (380, 280), (2, 2))
    mast = np.array([*a, terrain.height_m(a)[0] + antenna_m])
    needed = clears_m(terrain, mast, b)
    for height_m, is_hidden in ((needed - 1e-3, True), (needed + 0.05, False)):
        one = np.zeros(1)
        path = FlownPath(one, b[None], one, np.array([height_m]), slice(0, 1))
        assert hidden_from(mast, path, terrain).tolist() == [is_hidden]


def test_a_ridge_as_sharp_as_the_posts_allow_hides():
    """Its edge, 8 m above the line of sight, lies between places that are half a post apart on the way."""
    heights = np.zeros((21, 31))
    heights[:, 15] = 50.0
    terrain = build_terrain(scenario(heights))
    west, _, east, _ = terrain.bounds_enu_m
    mast, vehicle = np.array([west + 4.0, 100.0, 42.0]), np.array([[east - 6.0, 100.0]])
    path = FlownPath(np.zeros(1), vehicle, np.zeros(1), np.full(1, 42.0), slice(0, 1))
    assert hidden_from(mast, path, terrain).all()


def test_the_proof_finds_what_is_missed():
    s = scenario(np.zeros((2, 2)))
    plan, _ = plan_scenario(s)
    terrain = build_terrain(s)
    assert prove(plan, s, terrain).share == 1.0
    left_out = replace(plan, transects=plan.transects[:2] + plan.transects[3:])
    proof = prove(left_out, s, terrain)
    assert 0.6 < proof.share < 0.95
    (place, area_m2), *others = proof.unseen_places()
    assert not others
    assert shapely.LineString(plan.transects[2]).distance(place) < plan.spacing_m / 2
    assert area_m2 == pytest.approx((~proof.seen).sum() * proof.cells.size_m**2, rel=1e-3)


def test_a_ridge_hides_what_a_plan_at_constant_height_does_not_see():
    """Beside the tracks, a wall as high as the vehicle flies."""
    heights = np.zeros((41, 41))
    heights[16] = 60.0
    s = scenario(heights, 60.0, sidelap=0.0, transect_heading_deg=90.0)
    plan, _ = plan_scenario(s)
    highest = max(float((p.height_m - p.ground_m).max()) for p in plan.profiles)
    assert highest > 1.1 * 60.0
    assert prove(plan, s, build_terrain(s)).share == 1.0


def test_gentle_hills_and_flat_ground_have_plain_plans():
    flat, _ = plan_scenario(scenario(np.zeros((2, 2))))
    tilted, _ = plan_scenario(scenario(0.05 * np.linspace(0, 420, 8)[None, :].repeat(6, axis=0)))
    assert flat.profiles == tilted.profiles == ()
    assert np.array_equal(flat.waypoints_xy_enu_m, tilted.waypoints_xy_enu_m)


def test_the_profile_keeps_the_vehicles_rates_and_slows_down_on_steep_ground():
    s = scenario(0.5 * np.linspace(0, 420, 30)[None, :].repeat(6, axis=0), transect_heading_deg=90.0)
    plan, _ = plan_scenario(s)
    slowest = 8.0
    for p in plan.profiles:
        took_s = np.diff(p.along_m) / (0.5 * (p.speed_mps[1:] + p.speed_mps[:-1]))
        rates = np.diff(p.height_m) / took_s
        assert rates.max() <= s.vehicle.climb_speed_mps
        assert rates.min() >= -s.vehicle.descent_speed_mps
        assert (p.height_m <= p.ground_m + 1.3 * 40.0).all()
        slowest = min(slowest, p.speed_mps.min())
        assert p.lost_s(8.0) > 0.0
    assert 1.6 <= slowest < 4.0


def test_steep_ground_beside_takes_more_transects_rather_than_much_height():
    steep = 0.9 * np.linspace(0, 320, 30)[:, None].repeat(6, axis=1)
    s = scenario(steep, transect_heading_deg=90.0, sidelap=0.1)
    plan, _ = plan_scenario(s)
    flat, _ = plan_scenario(scenario(np.zeros((2, 2)), transect_heading_deg=90.0, sidelap=0.1))
    assert len(plan.transects) > len(flat.transects)
    assert all(np.median(p.height_m - p.ground_m) < 1.25 * 40.0 for p in plan.profiles)


def test_a_ceiling_leaves_cells_unseen_and_the_proof_says_so():
    steep = 1.5 * np.linspace(0, 320, 30)[:, None].repeat(6, axis=1)
    s = scenario(steep, transect_heading_deg=90.0, sidelap=0.0)
    low = s.model_copy(update={"safety": Safety(altitude_max_agl_m=42.0)})
    plan, _ = plan_scenario(low)
    assert max(float((p.height_m - p.ground_m).max()) for p in plan.profiles) <= 42.0 + 1e-6
    proof = prove(plan, low, build_terrain(low))
    assert 0.3 < proof.share < 1.0
    assert proof.unseen_places()[0][1] > 0.0


def test_a_vehicle_on_its_way_finds_the_height_and_speed_of_its_place():
    s = scenario(0.5 * np.linspace(0, 420, 30)[None, :].repeat(6, axis=0), transect_heading_deg=90.0)
    profile = plan_scenario(s)[0].profiles[0]
    following = Following([profile.leg_xy_enu_m], [profile], 3.0)
    (x0, y0), end = profile.leg_xy_enu_m.tolist()
    to = tuple(end)
    planned = following.at((x0, y0 + 3.0), to, 0.0)
    assert planned.height_m == planned.ahead_height_m == pytest.approx(profile.height_m[0])
    assert planned.speed_mps == pytest.approx(profile.speed_mps[0])
    whole_way = following.at((x0, y0), to, 1e6)
    assert whole_way.ahead_height_m == pytest.approx(profile.height_m.max())
    assert whole_way.speed_mps == pytest.approx(profile.speed_mps[-1])
    assert planned.ahead_xy_enu_m == (x0, y0)
    assert math.dist(whole_way.ahead_xy_enu_m, (x0, y0)) == pytest.approx(2.0 * whole_way.speed_mps)
    beside = following.at((x0, y0 + 30.0), to, 20.0)
    assert beside[:3] == (-math.inf, -math.inf, math.inf)
    assert beside.ahead_xy_enu_m == pytest.approx((x0 + 20.0, y0))
    assert following.at((x0, y0 + 60.0), to, 20.0) is None
    assert following.at((x0, y0), (0.0, 1.0), 0.0) is None
    on_its_way_there = following.at((x0, y0 + 50.0), (x0, y0), 10.0)
    climbed_m = pytest.approx(profile.height_m[0] - 4 * 0.8 * 6.0)
    assert on_its_way_there == (-math.inf, climbed_m, math.inf, None)
    assert following.at((x0, y0 + 8.0), (x0, y0), 10.0).ahead_height_m == pytest.approx(profile.height_m[0])


def test_a_tiny_area_is_proven_too():
    s = scenario(np.random.default_rng(1).uniform(0, 5, (9, 9)), corners=((0, 0), (3, 0), (3, 2), (0, 2)))
    plan, _ = plan_scenario(s)
    proof = prove(plan, s, build_terrain(s))
    assert len(proof.seen) > 50
    assert proof.seen.all()
    assert Following(plan.transects, plan.profiles, 3.0).at((1.0, 1.0), (9.0, 9.0), 10.0) is None


def test_a_long_transect_over_level_ground_is_flown_along_a_short_one_to_its_end():
    long, short = np.array([[0.0, 0.0], [300.0, 0.0]]), np.array([[300.0, 40.0], [100.0, 40.0]])
    following = Following([long, short], (), 3.0)
    assert following.at((100.0, 15.0), (300.0, 0.0), 16.0) == (-math.inf, -math.inf, math.inf, (116.0, 0.0))
    assert following.at((290.0, 1.0), (300.0, 0.0), 16.0).ahead_xy_enu_m == (300.0, 0.0)
    assert following.at((200.0, 45.0), (100.0, 40.0), 16.0) is None
