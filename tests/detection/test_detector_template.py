import numpy as np

from skysweep.detection.template import RedBlobDetector
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.types import Frame


def test_it_works_as_it_is():
    image = np.full((60, 80, 3), 90, np.uint8)
    image[10:20, 30:50] = (220, 20, 30)
    pose = CameraPose(np.zeros(3), np.eye(3))
    found = RedBlobDetector().detect(Frame(1.0, image, pose, Lens(80, 60, 1.0)))
    np.testing.assert_array_equal(found.boxes_xyxy_px, [[30, 10, 50, 20]])
    assert found.class_names == ("stop sign",)
    assert (
        len(RedBlobDetector().detect(Frame(1.0, np.zeros((60, 80, 3), np.uint8), pose, Lens(80, 60, 1.0))))
        == 0
    )
