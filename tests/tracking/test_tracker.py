"""Pixels to ground and one candidate per thing."""

import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from skysweep.geometry.camera import CameraPose, Lens, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.tracking.georeference import pixels_to_ground
from skysweep.tracking.tracker import GroundTracker
from skysweep.types import Detections

LENS = Lens(640, 360, 1.2)


def flat(xy):
    return np.zeros(len(xy))


def hilly(xy):
    return 3.0 * np.sin(xy[:, 0] / 20.0) + 2.0 * np.cos(xy[:, 1] / 15.0)


def pose(x=0.0, y=0.0, z=30.0, yaw=0.0, pitch=-np.pi / 2):
    return CameraPose(np.array([x, y, z]), rotation_camera_to_enu(yaw, pitch))


def look(camera, points, t=0.0, confidence=0.8, size=10.0, name="stop sign"):
    """Detections of ground points, as a perfect detector would give them."""
    centres, _ = project(LENS, camera, points)
    boxes = np.hstack([centres - size / 2, centres + size / 2])
    n = len(boxes)
    return Detections(t, boxes, np.full(n, confidence), (name,) * n, camera, LENS)


@given(
    st.floats(-80, 80),
    st.floats(-80, 80),
    st.floats(0, 6.28),
    st.floats(-np.pi / 2, -0.6),
    st.floats(5, 635),
    st.floats(5, 355),
)
def test_ground_point_projects_back_to_its_pixel(x, y, yaw, pitch, u, v):
    camera = pose(x, y, 40.0, yaw, pitch)
    for ground in (flat, hilly):
        point = pixels_to_ground(LENS, camera, [[u, v]], ground)
        if np.isnan(point).any():
            continue
        assert abs(point[0, 2] - ground(point[:, :2])[0]) < 0.01
        back, depth = project(LENS, camera, point)
        assert depth[0] > 0
        np.testing.assert_allclose(back[0], [u, v], atol=0.05)


def test_the_horizon_has_no_ground():
    level = pose(pitch=0.0)
    assert np.isnan(pixels_to_ground(LENS, level, [[320, 10]], flat)).all()


def test_a_sighting_has_its_box_and_whether_an_edge_of_the_picture_cuts_it():
    points = pixels_to_ground(LENS, pose(), [[320, 180], [636, 180]], flat)
    whole, cut = GroundTracker(flat).update(look(pose(), points))
    np.testing.assert_allclose(whole.box_xyxy_px, (315.0, 175.0, 325.0, 185.0), atol=0.05)
    assert (whole.is_cut, cut.is_cut) == (False, True)


def test_repeated_sightings_are_one_candidate_and_get_better():
    rng = np.random.default_rng(0)
    tracker = GroundTracker(flat)
    target = np.array([[3.0, 2.0, 0.0]])
    for k in range(20):
        (sighting,) = tracker.update(look(pose(x=-5 + k / 2), target + rng.normal(0, 0.4, 3) * [1, 1, 0], k))
        assert sighting.is_new == (k == 0)
    (candidate,) = tracker.candidates().values()
    assert np.hypot(*(candidate.position_enu_m - target[0])[:2]) < 0.4
    assert len(candidate.confidences) == 20
    assert candidate.covariance_m2.trace() < 0.6
    assert candidate.last_seen_s == 19


def test_two_things_in_one_picture_stay_two():
    tracker = GroundTracker(flat)
    pair = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    for k in range(5):
        tracker.update(look(pose(y=k / 5), pair, k))
    positions = sorted(c.position_enu_m[0] for c in tracker.candidates().values())
    np.testing.assert_allclose(positions, [0.0, 2.0], atol=0.1)


def test_a_sighting_far_outside_the_gate_opens_a_second_candidate():
    tracker = GroundTracker(flat)
    tracker.update(look(pose(), [[0.0, 0.0, 0.0]]))
    (sighting,) = tracker.update(look(pose(), [[6.0, 0.0, 0.0]], 1.0))
    assert sighting.is_new


def test_low_sightings_outweigh_high_ones():
    tracker = GroundTracker(flat)
    tracker.update(look(pose(z=30.0), [[1.0, 0.0, 0.0]]))
    tracker.update(look(pose(z=4.0), [[0.0, 0.0, 0.0]], 1.0))
    (candidate,) = tracker.candidates().values()
    assert candidate.position_enu_m[0] < 0.45


def test_another_class_is_another_candidate():
    tracker = GroundTracker(flat)
    tracker.update(look(pose(), [[0.0, 0.0, 0.0]]))
    (sighting,) = tracker.update(look(pose(), [[0.0, 0.0, 0.0]], 1.0, name="person"))
    assert sighting.is_new


def test_nothing_seen_is_nothing_tracked():
    tracker = GroundTracker(flat)
    assert tracker.update(look(pose(), np.zeros((0, 3)))) == ()
    assert tracker.candidates() == {}


def test_a_restored_tracker_goes_on_as_if_it_had_never_stopped():
    rng = np.random.default_rng(5)
    frames = []
    for k in range(12):
        camera = pose(2.0 * k, 0.0)
        points = rng.uniform([2.0 * k - 8, -8, 0], [2.0 * k + 8, 8, 0], (3, 3))
        frames.append(look(camera, points, 0.2 * k, name="person" if k % 3 else "boat"))
    whole, first, second = (GroundTracker(hilly) for _ in range(3))
    expected = [whole.update(frame) for frame in frames]
    for frame in frames[:6]:
        first.update(frame)
    text = json.dumps(first.snapshot())
    second.restore(json.loads(text))
    held = second.candidates()
    assert repr([second.update(frame) for frame in frames[6:]]) == repr(expected[6:])
    assert repr(second.candidates()) == repr(whole.candidates())
    assert repr(held) == repr(first.candidates()), "what was handed on is not written to"


def test_a_new_tracker_is_restored_too():
    tracker = GroundTracker(flat)
    tracker.restore(GroundTracker(flat).snapshot())
    assert tracker.update(look(pose(), np.array([[1.0, 2.0, 0.0]])))[0].is_new


def test_a_box_far_too_small_or_large_for_a_target_is_none():
    def sightings(span_m, **sizes):
        tracker = GroundTracker(flat, sizes or {"stop sign": (0.8, 1.0)})
        return tracker.update(look(pose(z=4.0), [[0.5, 0.5, 0.0]], size=span_m * LENS.focal_px / 4.0))

    assert [len(sightings(span)) for span in (0.1, 0.2, 0.9, 4.5, 5.5)] == [0, 1, 1, 1, 0]
    assert sightings(0.1, person=(1.7, 1.8))
