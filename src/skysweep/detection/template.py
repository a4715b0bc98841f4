"""A detector to copy: fill in ``detect``.

Register a callable that takes the scenario and returns a detector under the entry point group
``skysweep.detectors``. Its name there is the scenario's ``detector.model``.
"""

from __future__ import annotations

import numpy as np

from skysweep.types import Detections, Frame


class RedBlobDetector:
    """Reports the red pixels of a frame as one stop sign."""

    class_names = ("stop sign",)

    def detect(self, frame: Frame) -> Detections:
        """One box around all red pixels, if there are any."""
        red, green, blue = np.moveaxis(frame.image.astype(int), 2, 0)
        ys, xs = np.nonzero((red > 150) & (red > 2 * green) & (red > 2 * blue))
        boxes = np.array(
            [[xs.min(), ys.min(), xs.max() + 1, ys.max() + 1]] if len(xs) else np.zeros((0, 4)), float
        )
        confidences = np.full(len(boxes), 0.5)
        return Detections(
            frame.time_s, boxes, confidences, self.class_names * len(boxes), frame.camera, frame.lens
        )
