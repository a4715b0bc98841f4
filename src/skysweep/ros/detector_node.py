"""A detector as a node: pictures in, detections out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skysweep.geometry.camera import CameraPose, Lens
from skysweep.ros import messages as m
from skysweep.ros import topics
from skysweep.ros.link import RosLink
from skysweep.ros.parts import publish_detections
from skysweep.types import Detector, Frame

_POLL_S = 0.5
_ANY_HFOV_RAD = 1.0  # a detector works in pixels
_NOWHERE = CameraPose(np.zeros(3), np.eye(3))


def serve_detector(
    link: RosLink,
    detector: Detector,
    image_topic: str,
    patience_s: float,
    on_answer: Callable[[int, int], None] = lambda _pictures, _boxes: None,
) -> None:
    """Answer the newest picture, on ``detections`` and ``detections_standard``, until interrupted.

    Pictures that arrive while the detector works are skipped. ``on_answer`` gets the number of pictures
    answered and of boxes found so far. Raises UserError if nobody publishes pictures within ``patience_s`` or
    one cannot be read.
    """
    link.advertise(topics.DETECTIONS, topics.STANDARD_DETECTIONS)
    pictures = link.listen(image_topic, [m.IMAGE], patience_s)
    last = answered = boxes = 0
    while True:
        arrival = pictures.wait(lambda a, last=last: a.number > last, _POLL_S)  # type: ignore[misc]
        if arrival is None:
            continue
        arrival = pictures.newest() or arrival
        last = arrival.number
        message = arrival.message
        image = m.read_image(message, pictures.name)
        lens = Lens(message.width, message.height, _ANY_HFOV_RAD)
        found = detector.detect(Frame(m.seconds(message.header.stamp), image, _NOWHERE, lens))
        publish_detections(link, found)
        answered, boxes = answered + 1, boxes + len(found)
        on_answer(answered, boxes)
