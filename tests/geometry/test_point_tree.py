"""A tree of points leaves out none that a picture shows."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from skysweep.geometry.camera import CameraPose, Lens, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.geometry.point_tree import PointTree, in_view, refit

LENS = Lens(640, 360, 1.4)
ACROSS, UP = 320 / LENS.focal_px, 180 / LENS.focal_px

poses = st.builds(
    lambda x, y, z, yaw, pitch: CameraPose(np.array([x, y, z]), rotation_camera_to_enu(yaw, pitch)),
    st.floats(-50, 550),
    st.floats(-50, 550),
    st.floats(1, 200),
    st.floats(-math.pi, math.pi),
    st.floats(-math.pi / 2, 0.3),
)


def found_in(tree, pose, margin_m=0.0):
    found = np.empty(len(tree.order), dtype=np.int64)
    return found[: in_view(found, *tree, *pose, ACROSS, UP, margin_m)]


def shown(points, pose):
    uv, depth = project(LENS, pose, points)
    return np.flatnonzero((depth > 1e-6) & (uv > 0).all(axis=1) & (uv < (640, 360)).all(axis=1))


@settings(max_examples=60)
@given(st.integers(0, 300), st.integers(0, 5), poses)
def test_it_finds_all_that_is_in_the_picture_in_order(n, seed, pose):
    points = np.random.default_rng(seed).uniform((0, 0, -20), (500, 500, 40), (n, 3))
    found = found_in(PointTree.of(points), pose)
    assert (np.diff(found) > 0).all()
    assert set(shown(points, pose).tolist()) <= set(found.tolist())


def test_it_looks_at_little_more_than_is_in_the_picture():
    points = np.random.default_rng(0).uniform((0, 0, 0), (5000, 5000, 0), (50_000, 3))
    pose = CameraPose(np.array([2500.0, 2500.0, 100.0]), rotation_camera_to_enu(0.0, -math.pi / 2))
    in_picture = len(shown(points, pose))
    assert 20 < in_picture <= len(found_in(PointTree.of(points), pose)) < in_picture + 200


def test_what_stands_on_a_point_counts_with_its_height():
    tower = PointTree.of(np.array([[0.0, 30.0, 0.0]]), 40.0)
    pose = CameraPose(np.array([0.0, 0.0, 35.0]), rotation_camera_to_enu(math.pi / 2, 0.0))
    assert len(found_in(tower, pose)) == 1
    assert len(found_in(PointTree.of(np.array([[0.0, 30.0, 0.0]])), pose)) == 0


@settings(max_examples=30)
@given(st.integers(1, 200), poses)
def test_after_points_have_moved_it_finds_them_where_they_are(n, pose):
    rng = np.random.default_rng(n)
    points = rng.uniform((0, 0, 0), (500, 500, 10), (n, 3))
    tree = PointTree.of(points)
    points += rng.uniform(-200, 200, points.shape)
    refit(*tree, points)
    assert set(shown(points, pose).tolist()) <= set(found_in(tree, pose).tolist())
