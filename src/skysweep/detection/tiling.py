"""How a detector looks at a picture: whole or in overlapping tiles, each scaled to the model's input."""

from __future__ import annotations

import math

import numpy as np

TILE_OVERLAP = 0.2
STRIDE = 32

FixedSides = tuple[int | None, int | None]  # height and width of a model's input; None takes any


def tiles_px(width_px: int, height_px: int, tiles: int) -> list[tuple[int, int, int, int]]:
    """Left, top, right and bottom of each of ``tiles`` x ``tiles`` overlapping parts of a picture."""
    side_w, side_h = (math.ceil(s / (tiles - (tiles - 1) * TILE_OVERLAP)) for s in (width_px, height_px))
    return [
        (left, top, left + side_w, top + side_h)
        for top in np.linspace(0, height_px - side_h, tiles).astype(int).tolist()
        for left in np.linspace(0, width_px - side_w, tiles).astype(int).tolist()
    ]


def input_hw_for(fixed_hw: FixedSides, picture_hw: tuple[int, int]) -> tuple[int, int]:
    """An input's (height, width): the model's own, else the picture's rounded up to whole strides.

    Where the model fixes one side alone, the other keeps the picture's shape.
    """
    (fixed_h, fixed_w), (picture_h, picture_w) = fixed_hw, picture_hw
    height = picture_h if fixed_w is None else picture_h * fixed_w / picture_w
    width = picture_w if fixed_h is None else picture_w * fixed_h / picture_h
    return fixed_h or _whole_strides(height), fixed_w or _whole_strides(width)


def fitting_scale(picture_hw: tuple[int, int], input_hw: tuple[int, int]) -> float:
    """The input's pixels for one of a picture that just fits into it."""
    return min(input_hw[0] / picture_hw[0], input_hw[1] / picture_hw[1])


def _whole_strides(side_px: float) -> int:
    return max(1, math.ceil(side_px / STRIDE)) * STRIDE
