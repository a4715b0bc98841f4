"""Pictures from low altitudes are given to the detector at half of their size, or less."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from skysweep.detection.halving import LEAST_SIDE_PX, HalvingDetector, halved_below_m, n_halvings
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.scenarios.model import CameraModel, DetectorModel, Gimbal
from skysweep.types import Detections, Frame

WIDE = CameraModel(width_px=3840, height_px=2160, hfov_rad=1.2)
GROUND_M = 100.0


@given(
    st.integers(64, 8000),
    st.integers(64, 8000),
    st.floats(0.1, 20.0),
    st.floats(1.0, 500.0),
    st.floats(1, 300),
)
def test_the_smallest_target_keeps_half_of_the_pixels_that_are_enough(
    width_px, height_px, smallest_m, above_px, height_m
):
    camera = CameraModel(width_px=width_px, height_px=height_px, hfov_rad=1.2)
    spans_px = float(camera.lens.pixels_on_target(smallest_m, height_m))
    halvings = n_halvings(
        halved_below_m(camera, DetectorModel(halve_above_px=above_px), smallest_m), height_m
    )
    if halvings:
        assert max(width_px, height_px) >> halvings >= LEAST_SIDE_PX
        assert spans_px / 2**halvings > above_px / 2 * (1 - 1e-9)
    may_be_smaller = max(width_px, height_px) >> halvings + 1 >= LEAST_SIDE_PX
    assert spans_px / 2**halvings <= above_px * (1 + 1e-9) or not may_be_smaller


def test_pictures_of_the_calibrated_size_and_targets_without_size_are_never_halved():
    assert halved_below_m(CameraModel(), DetectorModel(), 1.75) == ()
    assert halved_below_m(WIDE, DetectorModel(), 0.0) == ()
    assert n_halvings(halved_below_m(WIDE, DetectorModel(halve_above_px=math.inf), 1.75), 1.0) == 0
    assert halved_below_m(WIDE, DetectorModel(tiles=2), 1.75) == ()


def test_through_a_tilted_camera_the_ground_is_farther_away():
    tilted = WIDE.model_copy(update={"gimbal": Gimbal(pitch_deg=-30.0)})
    down, ahead = (halved_below_m(camera, DetectorModel(), 1.75) for camera in (WIDE, tilted))
    assert ahead == pytest.approx([0.5 * height_m for height_m in down])


def test_a_scenario_says_when_in_numbers():
    assert DetectorModel(halve_above_px=64).model_dump()["halve_above_px"] == 64.0
    assert "halve_above_px" not in DetectorModel().model_dump(), "older scenarios have the same key"
    for wrong in (True, math.nan, 0.0):
        with pytest.raises(ValidationError, match="halve_above_px"):
            DetectorModel(halve_above_px=wrong)


class Corner:
    """Reports the whole picture that it gets, and keeps its mean."""

    class_names = ("person",)
    interrupted = False

    def detect(self, frame):
        height, width = frame.image.shape[:2]
        self.size, self.mean = (width, height), float(frame.image.mean())
        boxes = np.array([[0.0, 0.0, width, height / 2]])
        return Detections(frame.time_s, boxes, np.array([0.9]), ("person",), frame.camera, frame.lens)

    def interrupt(self):
        self.interrupted = True


def frame(height_agl_m, width_px=1281, height_px=722):
    image = np.random.default_rng(0).integers(0, 255, (height_px, width_px, 3), np.uint8)
    pose = CameraPose(np.array([3.0, 4.0, GROUND_M + height_agl_m]), np.eye(3))
    return Frame(2.0, image, pose, Lens(width_px, height_px, 1.2))


@pytest.mark.parametrize(
    ("height_agl_m", "size"), [(20.0, (1281, 722)), (9.9, (640, 361)), (4.9, (320, 180))]
)
def test_boxes_are_in_pixels_of_the_whole_picture(height_agl_m, size):
    inner, shown = Corner(), frame(height_agl_m)
    detector = HalvingDetector(inner, (10.0, 5.0), lambda x, y: GROUND_M if (x, y) == (3.0, 4.0) else 0.0)
    found = detector.detect(shown)
    assert inner.size == size
    assert inner.mean == pytest.approx(shown.image.mean(), abs=1.0)
    np.testing.assert_allclose(found.boxes_xyxy_px, [[0, 0, 1281, 361]], rtol=1e-12)
    assert (found.time_s, found.lens, found.camera) == (shown.time_s, shown.lens, shown.camera)
    assert detector.class_names == ("person",)


def test_a_look_is_broken_off_in_the_detector_behind_it():
    inner = Corner()
    HalvingDetector(inner, (10.0,), lambda x, y: 0.0).interrupt()
    assert inner.interrupted
    del Corner.interrupt
    HalvingDetector(inner, (10.0,), lambda x, y: 0.0).interrupt()  # one that cannot is left alone
