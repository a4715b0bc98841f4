"""What simple solids hide, and how large things look."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.geometry.camera import Lens
from skysweep.scenarios.model import Light
from skysweep.worlds.occlusion import Occluders, middle_enu_m, pixels_on_target, shape_of
from skysweep.worlds.world import TerrainSurface, World, WorldBuilding, WorldObject, WorldTree

LENS = Lens(640, 360, 1.2)
FLAT = TerrainSurface(np.zeros((2, 2)), (-100, -100, 100, 100), "grass")


def thing(x=0.0, y=0.0, pose="lying", size=1.75):
    return WorldObject("person", np.array([x, y, 0.0]), 0.0, size, pose, True, 1000)


def tree(x, y, height=10.0, radius=2.0):
    return WorldTree(np.array([x, y, 0.0]), height, radius, "broadleaf", 0)


def house(x, y, size=(10.0, 6.0), height=5.0, yaw=0.0):
    return WorldBuilding(np.array([x, y, 0.0]), size, height, yaw, 0)


def visible(camera, at=None, trees=(), buildings=()):
    world = World(FLAT, (), tuple(trees), tuple(buildings), Light(), 0)
    return Occluders(world).visible_fraction(np.array(camera, dtype=float), at or thing())


def test_open_ground_hides_nothing():
    assert visible([0, 0, 30]) == 1.0
    assert visible([50, 20, 4]) == 1.0


def test_a_crown_above_hides_what_is_below():
    assert visible([0, 0, 30], trees=[tree(0, 0)]) == 0.0
    assert visible([0, 0, 30], trees=[tree(6, 0)]) == 1.0


def test_a_crown_hides_only_from_its_side():
    trees = [tree(5, 0)]
    assert visible([12, 0, 14], trees=trees) < 1.0
    assert visible([-12, 0, 14], trees=trees) == 1.0


def test_a_camera_below_the_crown_sees_under_it():
    assert visible([0, 0, 2], trees=[tree(0, 0)]) == 1.0


def test_a_thing_half_under_a_crown_is_partly_visible():
    share = visible([0, 0, 1000], trees=[tree(2.0, 0)], at=thing(size=3.0))
    assert 0.0 < share < 1.0


def test_a_house_hides_what_is_behind_it_and_not_what_is_before_it():
    buildings = [house(8, 0)]
    assert visible([30, 0, 5], buildings=buildings) == 0.0
    assert visible([-30, 0, 5], buildings=buildings) == 1.0
    assert visible([0, 0, 30], buildings=buildings) == 1.0


def test_a_turned_house_hides_along_its_length():
    camera = [0, 30, 3.0]
    assert visible(camera, at=thing(4.0, 0), buildings=[house(0, 10, (12.0, 2.0))]) == 0.0
    assert visible(camera, at=thing(4.0, 0), buildings=[house(0, 10, (12.0, 2.0), yaw=np.pi / 2)]) == 1.0


@given(st.floats(-15, 15), st.floats(-15, 15), st.floats(1, 40), st.floats(0.5, 4))
def test_one_more_tree_never_shows_more(x, y, height, radius):
    camera = [8.0, -5.0, 25.0]
    few = [tree(3, 1)]
    assert visible(camera, trees=[*few, tree(x, y, height, radius)]) <= visible(camera, trees=few)


@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(3, 80))
def test_a_sampled_ray_agrees_with_the_crown(x, y, z):
    """The ellipsoid's closed form against points along the line of sight."""
    camera, crown = np.array([x, y, z]), tree(2.0, -1.0, 9.0, 2.5)
    at = replace(thing(), size_m=1e-6)
    start = at.position_enu_m + np.array([0, 0, 0.1])
    line = start + np.linspace(0, 1, 4001)[:, None] * (camera - start)
    half = 0.325 * crown.height_m
    centre = crown.position_enu_m + np.array([0, 0, crown.height_m - half])
    depth = (((line - centre) / [2.5, 2.5, half]) ** 2).sum(axis=1).min()
    if abs(depth - 1.0) > 0.02:
        assert visible(camera, at=at, trees=[crown]) == (0.0 if depth < 1.0 else 1.0)


def extent_m(seen, camera):
    """At the focal length of one pixel a metre."""
    ray = middle_enu_m(seen) - np.array(camera, dtype=float)
    return pixels_on_target(1.0, shape_of(seen), seen.size_m, *ray, 1.0)


def test_a_standing_person_is_shoulders_from_above_and_tall_from_the_side():
    standing = thing(pose="standing")
    assert extent_m(standing, [0, 0, 30]) == pytest.approx(0.3 * 1.75)
    assert extent_m(standing, [100, 0, 0.01]) == pytest.approx(1.75, rel=1e-3)
    assert extent_m(thing(pose="lying"), [0, 0, 30]) == 1.75
    assert extent_m(thing(pose="floating"), [0, 0, 30]) < 1.0


def test_a_standing_person_is_seen_at_the_angle_of_the_middle():
    assert extent_m(thing(pose="standing"), [2, 0, 4]) == pytest.approx(1.75 * 2 / np.hypot(2, 4 - 1.75 / 2))


def test_pixels_on_target_are_the_lens_own_for_flat_things():
    from_above = pixels_on_target(LENS.focal_px, shape_of(thing()), 0.9, 0.0, 0.0, -30.0, 30.0)
    assert from_above == pytest.approx(float(LENS.pixels_on_target(0.9, 30.0)))
