"""A mission that goes on judges its pictures as if it had never been broken off."""

import numpy as np
import pytest
from test_camera_watch import FLAT, LENS, PERIOD_S, pictures, there_and_back

from skysweep.detection.template import RedBlobDetector
from skysweep.sensing.camera_watch import CameraWatch
from skysweep.sensing.exposures import Exposures
from skysweep.sensing.imaging import Answer, ImagingSensor
from skysweep.types import Frame, VehicleState

POSES = there_and_back()


@pytest.fixture(scope="module")
def images():
    """Of a flight that stands on its head from look 55 to look 62."""
    sound = pictures(POSES)
    return [image[::-1, ::-1] if 55 <= k < 62 else image for k, image in enumerate(sound)]


class Album:
    """Shows known pictures, one after the other; remembers which were taken."""

    renderer = None

    def __init__(self, images):
        self.images, self.next, self.taken = images, 0, []

    def capture(self, state):
        self.taken.append(self.next)
        image = np.ascontiguousarray(self.images[self.next])
        self.next += 1
        return Frame(state.time_s, image, state.camera, LENS)

    def skip(self, state):
        self.next += 1
        return Frame(state.time_s, np.empty((0, 0, 3), np.uint8), state.camera, LENS)

    def close(self):
        pass


def looked(images, recalled=()):
    """The looks of a flight, and the pictures that were taken."""
    album = Album(images)
    exposures = Exposures(1.0 / PERIOD_S, 0.0)
    sensor = ImagingSensor(album, RedBlobDetector(), exposures, 0.0, watch=CameraWatch(FLAT))
    sensor.recall(recalled)
    looks = []
    for k, pose in enumerate(POSES):
        state = VehicleState(k * PERIOD_S, pose.position_enu_m, np.zeros(3), np.eye(3), pose, 1.0, 0.0, True)
        looks.append(sensor.sense(state))
    sensor.close()
    return looks, album.taken


@pytest.mark.parametrize("broken_off", [10, 50, 57, 70])
def test_doubts_go_on(images, broken_off):
    whole, _ = looked(images)
    assert any(look.doubt is not None for look in whole)
    recalled = [
        Answer(look.boxes_xyxy_px, look.confidences, look.class_names, doubt=look.doubt)
        for look in whole[:broken_off]
    ]
    again, taken = looked(images, recalled)
    assert [look.doubt for look in again] == [look.doubt for look in whole]
    assert taken[-1] == len(images) - 1
    assert (len(taken) < len(images)) == (broken_off > 30), "pictures that nobody needs were taken"
