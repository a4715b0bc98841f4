"""Which of many points may be in a picture, found without a look at the others: a tree of bounding boxes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from skysweep.arrays import F64, I64

_LEAF = 16  # points


class PointTree(NamedTuple):
    """Points (N, 3) by boxes that hold ever fewer of them, in preorder: plain arrays for compiled code."""

    boxes: F64  # (M, 6) low and high corner of each
    nodes: I64  # (M, 3) its part of the order, and the box that comes after all within this one
    order: I64  # (N,) indices of the points

    @classmethod
    def of(cls, points: F64, height_m: float = 0.0) -> PointTree:
        """The tree of points (N, 3), each the foot of something of that height."""
        order = np.arange(len(points))
        boxes: list[F64] = []
        nodes: list[tuple[int, int, int]] = []

        def add(first: int, end: int) -> None:
            mine, node = points[order[first:end]], len(nodes)
            low, high = mine.min(axis=0), mine.max(axis=0)
            boxes.append(np.concatenate([low, high]))
            nodes.append((first, end, 0))
            if end - first > _LEAF:
                along = mine[:, int(np.argmax(high - low))]
                order[first:end] = order[first:end][np.argsort(along, kind="stable")]
                middle = (first + end) // 2
                add(first, middle)
                add(middle, end)
            nodes[node] = first, end, len(nodes)

        if len(points):
            add(0, len(points))
        return cls(
            np.array(boxes, dtype=float).reshape(-1, 6) + np.array([0.0, 0.0, 0.0, 0.0, 0.0, height_m]),
            np.array(nodes, dtype=np.int64).reshape(-1, 3),
            order.astype(np.int64),
        )


@njit(cache=True)
def refit(boxes: F64, nodes: I64, order: I64, points: F64) -> None:
    """Fit the boxes of a tree to the same points (N, 3) after some of them have moved."""
    for node in range(len(nodes) - 1, -1, -1):
        first, end, following = nodes[node]
        box = boxes[node]
        if following == node + 1:
            box[:3] = box[3:] = points[order[first]]
            for k in order[first + 1 : end]:
                for axis in range(3):
                    box[axis] = min(box[axis], points[k, axis])
                    box[axis + 3] = max(box[axis + 3], points[k, axis])
        else:
            left, right = boxes[node + 1], boxes[nodes[node + 1, 2]]
            for axis in range(3):
                box[axis] = min(left[axis], right[axis])
                box[axis + 3] = max(left[axis + 3], right[axis + 3])


@njit(cache=True)
def in_view(
    found: I64,
    boxes: F64,
    nodes: I64,
    order: I64,
    eye: F64,
    R_camera_to_enu: F64,
    across: float,
    up: float,
    margin_m: float,
) -> int:
    """Write, in ascending order, the points of a tree that may be in a picture; how many they are.

    ``across`` and ``up`` are half of the picture's width and height over the focal length. None is left out
    that is at most ``margin_m`` beside the picture's edge, along its axes; some that are farther are not.
    """
    n, node = 0, 0
    while node < len(nodes):
        first, end, following = nodes[node]
        if _is_outside(boxes[node], eye, R_camera_to_enu, across, up, margin_m):
            node = following
            continue
        if following == node + 1:
            for k in range(first, end):
                found[n] = order[k]
                n += 1
        node += 1
    found[:n] = np.sort(found[:n])
    return n


@njit(cache=True)
def _is_outside(box: F64, eye: F64, R: F64, across: float, up: float, margin_m: float) -> bool:
    """Whether a box is beyond one of the picture's four edges or behind the camera."""
    for side in range(5):
        farthest = margin_m if side < 4 else 0.0
        for k in range(3):
            if side == 4:
                normal = R[k, 2]
            else:
                axis, reach = (0, across) if side < 2 else (1, up)
                normal = (R[k, axis] if side % 2 == 0 else -R[k, axis]) + reach * R[k, 2]
            farthest += normal * (box[k + 3 if normal > 0.0 else k] - eye[k])
        if farthest < 0.0:
            return True
    return False
