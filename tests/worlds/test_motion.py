"""Objects that move: never faster than told, in the area if asked, the same in any order of questions."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.leeway import LEEWAY, leeway_mps
from skysweep.scenarios.model import DriftMotion, PathMotion, Scenario, WalkMotion, Wind
from skysweep.worlds.motion import Placing, track_of
from skysweep.worlds.rendering.renderer import make_renderer
from skysweep.worlds.world import build_world

AREA = shapely.Polygon([(0, 0), (80, 0), (80, 30), (30, 30), (30, 70), (0, 70)])  # concave
START = Placing(10.0, 10.0, 0.3)
times = st.lists(st.floats(0.0, 4000.0), min_size=2, max_size=12)
walks = st.builds(
    WalkMotion,
    kind=st.just("walk"),
    speed_mps=st.floats(0.05, 5.0),
    straight_s=st.floats(1.0, 100.0),
    turn_deg=st.floats(0.0, 180.0),
    rest_share=st.floats(0.0, 0.9),
)
paths = st.builds(
    PathMotion,
    kind=st.just("path"),
    waypoints_enu_m=st.lists(st.tuples(st.floats(-200, 200), st.floats(-200, 200)), min_size=1, max_size=6),
    speed_mps=st.floats(0.05, 10.0),
    at_end=st.sampled_from(["stop", "loop"]),
)
drifts = st.builds(
    DriftMotion,
    kind=st.just("drift"),
    current_mps=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    leeway=st.sampled_from(sorted(LEEWAY)),
)


def track(motion, seed=0):
    return track_of(motion, START, Wind(mean_speed_mps=6.0), AREA, np.random.default_rng(seed))


@settings(max_examples=60)
@given(motion=st.one_of(walks, paths), asked=times)
def test_nothing_is_faster_than_its_speed(motion, asked):
    mine = track(motion)
    for a, b in zip(sorted(asked)[:-1], sorted(asked)[1:], strict=True):
        moved_m = math.dist(mine.at(a)[:2], mine.at(b)[:2])
        assert moved_m <= motion.speed_mps * (b - a) * (1 + 1e-9) + 1e-6


@settings(max_examples=60)
@given(motion=st.one_of(walks, paths, drifts), asked=times, seed=st.integers(0, 99))
def test_where_it_is_does_not_depend_on_the_order_of_the_questions(motion, asked, seed):
    forth, back = track(motion, seed), track(motion, seed)
    there = {t: forth.at(t) for t in asked}
    assert {t: back.at(t) for t in sorted(asked, reverse=True)} == there
    assert back.at(0.0)[:2] == START[:2]
    assert back.at(-5.0)[:2] == START[:2]


@settings(max_examples=40)
@given(motion=walks, asked=times, seed=st.integers(0, 99))
def test_a_walk_stays_in_the_area(motion, asked, seed):
    mine = track(motion, seed)
    assert all(AREA.buffer(1e-6).covers(shapely.Point(mine.at(t)[:2])) for t in asked)


def test_a_walk_that_may_leave_the_area_does():
    free = track(WalkMotion(kind="walk", stays_in_area=False))
    assert not AREA.covers(shapely.Point(free.at(4000.0)[:2]))


def test_a_path_is_walked_to_its_end_or_round():
    there = [(40.0, 10.0), (40.0, 50.0)]
    once = track(PathMotion(kind="path", waypoints_enu_m=there, speed_mps=2.0))
    assert once.at(15.0) == pytest.approx((40.0, 10.0, np.pi / 2))
    assert once.at(10.0) == pytest.approx((30.0, 10.0, 0.0))
    assert once.at(1000.0)[:2] == pytest.approx((40.0, 50.0))
    loop = track(PathMotion(kind="path", waypoints_enu_m=there, speed_mps=2.0, at_end="loop"))
    round_s = (30 + 40 + 50) / 2.0
    assert loop.at(7 * round_s + 10.0)[:2] == pytest.approx((30.0, 10.0))


def test_what_drifts_goes_with_the_current_and_its_own_leeway():
    still = track_of(
        DriftMotion(kind="drift", current_mps=(0.2, -0.1), leeway="PIW-2"),
        START, Wind(mean_speed_mps=0.0), AREA, np.random.default_rng(1),
    )  # fmt: skip
    error = np.random.default_rng(1)
    to_right, errors = error.random(1) < 0.5, error.normal(size=(2, 1))
    own = leeway_mps(LEEWAY["PIW-2"], np.zeros((1, 2)), to_right, errors)[0]
    assert still.at(100.0) == pytest.approx((30.0 + 100 * own[0], 100 * own[1], 0.3))
    drifted = {track(DriftMotion(kind="drift"), seed).at(600.0) for seed in range(5)}
    assert len(drifted) == 5
    downwind = np.mean(
        [
            np.subtract(track(DriftMotion(kind="drift", leeway="SKIFF-1"), k).at(600.0)[:2], START[:2])
            for k in range(40)
        ],
        axis=0,
    )
    from_240 = np.array([np.sin(np.radians(60.0)), np.cos(np.radians(60.0))])
    assert downwind @ from_240 / np.linalg.norm(downwind) > 0.95
    assert 0.02 * 6.0 * 600 < np.linalg.norm(downwind) < 0.045 * 6.0 * 600


def living(**more):
    return Scenario.model_validate(
        {
            "name": "living",
            "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 60], [0, 60]]},
            "targets": [
                {
                    "class": "person",
                    "pose": "walking",
                    "position_enu_m": [10, 30],
                    "motion": {"kind": "path", "waypoints_enu_m": [[50, 30]], "speed_mps": 1.0},
                },
                {"class": "person", "pose": "sitting", "position_enu_m": [30, 50], "clothing": "bright"},
            ],
            **more,
        }
    )


def test_old_scenarios_are_written_as_before():
    old = Scenario.model_validate(
        {
            "name": "old",
            "area": {"polygon_enu_m": [[0, 0], [9, 0], [9, 9]]},
            "targets": [{"class": "person", "position_enu_m": [3, 1]}],
            "distractors": [{"class": "rock", "position_enu_m": [4, 1]}],
            "generators": [{"class": "rock", "pattern": "uniform", "count": 2}],
        }
    )
    told = old.model_dump(by_alias=True)
    keys = {k for part in ("targets", "distractors", "generators") for k in told[part][0]} | set(
        told["search"]
    )
    assert not keys & {"motion", "clothing", "ages", "near", "target_speed_mps"}
    assert Scenario.model_validate(told) == old


def test_motion_survives_the_file():
    scenario = living()
    assert Scenario.model_validate(scenario.model_dump(by_alias=True)) == scenario


@pytest.mark.parametrize("backend", ["gl", "embree"])
def test_pictures_show_a_walker_where_it_is(backend):
    world = build_world(living(), 0)
    walker = world.targets[0]
    lens = Lens(240, 240, 1.2)
    pose = CameraPose(np.array([30.0, 30.0, 44.0]), rotation_camera_to_enu(np.pi / 2, -np.pi / 2, 0.0))
    renderer = make_renderer(world, backend)
    first = renderer.render(lens, pose, 0.0)
    for time_s in (0.0, 12.0, 35.0):
        seen = renderer.render_ids(lens, pose, time_s=time_s)
        rows, columns = np.nonzero(seen == 1)
        x_m = world.position(walker, time_s)[0]
        assert x_m == pytest.approx(10.0 + time_s)
        assert columns.mean() == pytest.approx(120 + lens.focal_px * (x_m - 30.0) / 44.0, abs=2.5)
        assert rows.mean() == pytest.approx(120, abs=2.5)
    later = renderer.render(lens, pose, 35.0)
    assert (later != first).any()
    assert (renderer.render(lens, pose, 0.0) == first).all()
    renderer.close()


def test_places_beside_trees_and_ages():
    trees = [{"position_enu_m": [15, 15], "crown_radius_m": 3}, {"position_enu_m": [45, 40]}]
    people = {"class": "person", "pattern": "uniform", "count": 30, "near": "trees", "min_separation_m": 0}
    more = {"generators": [{**people, "ages": ["child", "adult"], "clothing": ["red", "muted"]}]}
    world = build_world(living(trees=trees, **more), 0)
    placed = world.targets[2:]
    for thing in placed:
        away_m = [
            np.hypot(*(thing.position_enu_m - t.position_enu_m)[:2]) / t.crown_radius_m for t in world.trees
        ]
        assert min(away_m) <= 1.16
    assert {t.size_m for t in placed} == {1.2, 1.75}
    assert {t.clothing for t in placed} == {"red", "muted"}
    with pytest.raises(UserError, match=r"generators\[0\]\.near: there are no trees"):
        build_world(living(**more), 0)
