"""Which of many points may be in a picture, found without a look at the others: a tree of bounding boxes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from skysweep.arrays import F64, I64

_LEAF = 8  # points


class PointTree(NamedTuple):
    """Points (N, 3) by boxes that hold ever fewer of them, in preorder, for compiled code."""

    low: F64  # (M, 3) corners of each box
    high: F64
    spans: I64  # (M, 2) its part of the order
    following: I64  # (M,) the box that comes after all within this one
    order: I64  # (N,) indices of the points

    @classmethod
    def of(cls, points: F64) -> PointTree:
        """The tree of points (N, 3)."""
        order = np.arange(len(points))
        low: list[F64] = []
        high: list[F64] = []
        spans: list[tuple[int, int]] = []
        following: list[int] = []

        def add(first: int, end: int) -> None:
            mine = points[order[first:end]]
            node = len(low)
            low.append(mine.min(axis=0))
            high.append(mine.max(axis=0))
            spans.append((first, end))
            following.append(0)
            if end - first > _LEAF:
                axis = int(np.argmax(high[node] - low[node]))
                order[first:end] = order[first:end][np.argsort(mine[:, axis], kind="stable")]
                middle = (first + end) // 2
                add(first, middle)
                add(middle, end)
            following[node] = len(low)

        if len(points):
            add(0, len(points))
        return cls(
            np.array(low, dtype=float).reshape(-1, 3),
            np.array(high, dtype=float).reshape(-1, 3),
            np.array(spans, dtype=np.int64).reshape(-1, 2),
            np.array(following, dtype=np.int64),
            order.astype(np.int64),
        )


@njit(cache=True)
def in_view(
    found: I64, tree: PointTree, eye: F64, R_camera_to_enu: F64, across: float, up: float, margin_m: float
) -> int:
    """Write, in ascending order, the points that may be in a picture; how many they are.

    ``across`` and ``up`` are half of the picture's width and height over the focal length. None is left out
    that is at most ``margin_m`` beside the picture's edge, along its axes; some that are farther are not.
    """
    R = R_camera_to_enu
    n, node = 0, 0
    while node < len(tree.following):
        if _is_outside(tree.low[node], tree.high[node], eye, R, across, up, margin_m):
            node = tree.following[node]
            continue
        if tree.following[node] == node + 1:
            for k in range(tree.spans[node, 0], tree.spans[node, 1]):
                found[n] = tree.order[k]
                n += 1
        node += 1
    found[:n] = np.sort(found[:n])
    return n


@njit(cache=True)
def _is_outside(low: F64, high: F64, eye: F64, R: F64, across: float, up: float, margin_m: float) -> bool:
    """Whether a box is beyond one of the picture's four edges or behind the camera."""
    for side in range(5):
        farthest = margin_m if side < 4 else 0.0
        for k in range(3):
            if side == 4:
                normal = R[k, 2]
            else:
                axis, reach = (0, across) if side < 2 else (1, up)
                normal = (R[k, axis] if side % 2 == 0 else -R[k, axis]) + reach * R[k, 2]
            farthest += normal * ((high[k] if normal > 0.0 else low[k]) - eye[k])
        if farthest < 0.0:
            return True
    return False
