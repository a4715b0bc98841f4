"""A camera that is a video source: here, a file."""

import itertools

import cv2
import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.sensing.cameras.video import VideoCamera
from skysweep.types import VehicleState

LENS = Lens(160, 96, 1.0)


@pytest.fixture
def film(tmp_path):
    """A red picture, 200 times."""
    path = str(tmp_path / "film.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (160, 96))
    red_bgr = np.zeros((96, 160, 3), dtype=np.uint8)
    red_bgr[:, :, 2] = 230
    for _ in itertools.repeat(None, 200):
        writer.write(red_bgr)
    writer.release()
    return path


def state(time_s: float = 3.0) -> VehicleState:
    pose = CameraPose(np.array([1.0, 2.0, 30.0]), np.eye(3))
    return VehicleState(time_s, np.zeros(3), np.zeros(3), np.eye(3), pose, 1.0, 0.0, True)


def test_a_picture_is_rgb_and_carries_the_pose_of_the_state(film):
    camera = VideoCamera(film, LENS)
    frame = camera.capture(state())
    camera.close()
    assert frame.image.shape == (96, 160, 3)
    assert frame.image[48, 80] == pytest.approx([230, 0, 0], abs=12)
    assert frame.time_s == 3.0
    assert frame.camera.position_enu_m[2] == 30.0


def test_a_source_that_stops_is_said_so(film, monkeypatch):
    monkeypatch.setattr("skysweep.sensing.cameras.video.FRESH_S", 0.2)
    camera = VideoCamera(film, LENS)
    looks = (camera.capture(state()) for _ in range(1_000_000))
    with pytest.raises(ConnectionError, match="no picture"):
        sum(look.time_s for look in looks)
    camera.close()


def test_pictures_of_another_size_say_what_to_write(film):
    with pytest.raises(UserError, match=r"160 x 96; write camera.width_px: 160"):
        VideoCamera(film, Lens(640, 360, 2.0))


def test_a_source_that_is_not_there_is_one_sentence(tmp_path):
    with pytest.raises(UserError, match="cannot be opened"):
        VideoCamera(str(tmp_path / "none.avi"), LENS)
