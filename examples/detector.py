"""A detector of your own: every red blob is a stop sign.

ss.run("clusters", detector=RedBlobs)   or, as one that is made already:  detector=RedBlobs(min_px=20)
"""

import cv2
import numpy as np

import skysweep as ss


class RedBlobs:
    class_names = ("stop sign",)

    def __init__(self, scenario=None, min_px=6):
        self.min_px = min_px

    def detect(self, frame):
        red, green, blue = np.moveaxis(frame.image.astype(int), 2, 0)
        mask = (red - np.maximum(green, blue) > 50).astype(np.uint8)
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((7, 7)))  # white letters are no gap
        _, _, blobs, _ = cv2.connectedComponentsWithStats(mask)
        left, top, width, height, area = blobs[1:][blobs[1:, cv2.CC_STAT_AREA] >= self.min_px].T
        boxes = np.column_stack([left, top, left + width, top + height]).astype(float)
        confidences = area / (area + 20.0)
        names = self.class_names * len(boxes)
        return ss.Detections(frame.time_s, boxes, confidences, names, frame.camera, frame.lens)
