"""How a detector looks at a picture: whole or in overlapping tiles, each scaled to the model's input."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F64, I64

TILE_OVERLAP = 0.2
_CUT_WITHIN_PX = 3.0  # of a tile's edge: so near ends a box that it cuts
_SAME_SHARE = 0.5  # of a cut box lies in the box of the same thing
STRIDE = 32

TilePx = tuple[int, int, int, int]  # left, top, right, bottom
FixedSides = tuple[int | None, int | None]  # height and width of a model's input; None takes any


def tiles_px(width_px: int, height_px: int, tiles: int) -> list[TilePx]:
    """Left, top, right and bottom of each of ``tiles`` x ``tiles`` overlapping parts of a picture."""
    side_w, side_h = (math.ceil(s / (tiles - (tiles - 1) * TILE_OVERLAP)) for s in (width_px, height_px))
    return [
        (left, top, left + side_w, top + side_h)
        for top in np.linspace(0, height_px - side_h, tiles).astype(int).tolist()
        for left in np.linspace(0, width_px - side_w, tiles).astype(int).tolist()
    ]


def cut_copies(
    boxes: F64, classes: I64, of_tile: I64, tiles: Sequence[TilePx], size_px: tuple[int, int]
) -> NDArray[np.bool_]:
    """Which boxes (N, 4) show, cut by their tile's edge, a part of what another tile shows more of.

    ``of_tile`` (N,) tells which of ``tiles`` each was found in. An edge of the picture of ``size_px`` cuts
    what no other tile shows.
    """
    edges = np.array(tiles, dtype=float)[of_tile]
    inner = (edges > 0.0) & (edges < np.array(size_px * 2))
    is_cut = (inner & (np.abs(boxes - edges) <= _CUT_WITHIN_PX)).any(axis=1)
    copies = np.zeros(len(boxes), dtype=np.bool_)
    areas = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    for k in np.flatnonzero(is_cut).tolist():
        others = (of_tile != of_tile[k]) & (classes == classes[k]) & (areas > areas[k])
        low, high = np.maximum(boxes[k, :2], boxes[others, :2]), np.minimum(boxes[k, 2:], boxes[others, 2:])
        shares = (high - low).clip(0.0).prod(axis=1) / areas[k]
        copies[k] = bool((shares > _SAME_SHARE).any())
    return copies


def takes_any_size(fixed_hw: FixedSides) -> bool:
    """Whether a model gets pictures as large as they are."""
    return fixed_hw == (None, None)


def input_hw_for(fixed_hw: FixedSides, picture_hw: tuple[int, int], stride: int = STRIDE) -> tuple[int, int]:
    """An input's (height, width): the model's own, else the picture's rounded up to whole strides.

    Where the model fixes one side alone, the other keeps the picture's shape.
    """
    (fixed_h, fixed_w), (picture_h, picture_w) = fixed_hw, picture_hw
    height = picture_h if fixed_w is None else picture_h * fixed_w / picture_w
    width = picture_w if fixed_h is None else picture_w * fixed_h / picture_h
    return fixed_h or _whole_strides(height, stride), fixed_w or _whole_strides(width, stride)


def fitting_scale(picture_hw: tuple[int, int], input_hw: tuple[int, int]) -> float:
    """The input's pixels for one of a picture that just fits into it."""
    return min(input_hw[0] / picture_hw[0], input_hw[1] / picture_hw[1])


def _whole_strides(side_px: float, stride: int) -> int:
    return max(1, math.ceil(side_px / stride)) * stride
