"""Which detection is of which label.

The most confident detections choose first; each label is matched once (the COCO and PASCAL VOC rule).
"""

from __future__ import annotations

import numpy as np

from skysweep.arrays import F64, I64


def _intersections(a: F64, b: F64) -> F64:
    corner = np.maximum(a[:, None, :2], b[None, :, :2])
    extent = np.clip(np.minimum(a[:, None, 2:], b[None, :, 2:]) - corner, 0, None)
    return np.asarray(extent.prod(axis=2))


def _areas(boxes: F64) -> F64:
    return np.asarray((boxes[:, 2:] - boxes[:, :2]).prod(axis=1))


def iou(a: F64, b: F64) -> F64:
    """Intersection over union (N, M) of boxes (N, 4) and (M, 4)."""
    shared = _intersections(a, b)
    return shared / np.maximum(_areas(a)[:, None] + _areas(b)[None] - shared, 1e-12)


def intersection_shares(a: F64, b: F64) -> F64:
    """Share (N, M) of each box of ``a`` that lies in each box of ``b``."""
    return _intersections(a, b) / np.maximum(_areas(a)[:, None], 1e-12)


def match(boxes: F64, confidences: F64, labels: F64, iou_min: float) -> I64:
    """For each label (M, 4) the index of its detection, or -1. The most confident detections choose first."""
    matched = np.full(len(labels), -1, dtype=np.int64)
    overlap = iou(boxes, labels)
    for index in np.argsort(-confidences, kind="stable"):
        free = np.where(matched < 0, overlap[index], 0.0)
        if len(free) and free.max() >= iou_min:
            matched[free.argmax()] = index
    return matched


def strongest(boxes: F64, confidences: F64, iou_max: float) -> I64:
    """Indices of the boxes that no more confident box overlaps by more than ``iou_max``, strongest first."""
    kept: list[int] = []
    overlap = iou(boxes, boxes)
    for index in np.argsort(-confidences, kind="stable").tolist():
        if not kept or overlap[index, kept].max() <= iou_max:
            kept.append(index)
    return np.array(kept, dtype=np.int64)
