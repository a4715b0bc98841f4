"""Drawing on pictures (H, W, 3) RGB: smooth shapes, and text in one go."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import matplotlib
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.typing import ColorType
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from skysweep.arrays import F64, U8

Rgb = tuple[int, int, int]

_FRACTION_BITS = 4  # of a pixel, in coordinates that OpenCV takes as integers
_FARTHEST_PX = 2**15  # beyond it they overflow
_CHIP_PX = (6, 3)  # around a text on a dark ground


def rgb(colour: ColorType) -> Rgb:
    """Matplotlib's colour as 8-bit RGB, without its opacity."""
    red, green, blue = (round(255 * share) for share in to_rgb(colour))
    return red, green, blue


def line(picture: U8, points_px: F64, colour: Rgb, width_px: float, closed: bool = False) -> None:
    """Draw through points (N, 2)."""
    if len(points_px) > 1:
        cv2.polylines(picture, [_fixed(points_px)], closed, colour, max(1, round(width_px)), *_SMOOTH)


def area(picture: U8, points_px: F64, colour: Rgb, opacity: float) -> None:
    """Tint a polygon (N, 2)."""
    height, width = picture.shape[:2]
    low = np.clip(np.floor(points_px.min(axis=0)), 0, (width, height)).astype(int)
    high = np.clip(np.ceil(points_px.max(axis=0)) + 1, 0, (width, height)).astype(int)
    if (high <= low).any():
        return
    part = picture[low[1] : high[1], low[0] : high[0]]
    tinted = part.copy()
    cv2.fillPoly(tinted, [_fixed(points_px - low)], colour, *_SMOOTH)
    cv2.addWeighted(tinted, opacity, part, 1.0 - opacity, 0.0, dst=part)


def disc(picture: U8, centre_px: ArrayLike, radius_px: float, colour: Rgb, width_px: int = -1) -> None:
    """Draw a disc, or a ring of ``width_px``."""
    x, y = _fixed(np.array([centre_px], dtype=float))[0]
    if max(abs(int(x)), abs(int(y))) < _FARTHEST_PX << _FRACTION_BITS:
        radius = round(radius_px * 2**_FRACTION_BITS)
        cv2.circle(picture, (int(x), int(y)), radius, colour, width_px, *_SMOOTH)


_SMOOTH = (cv2.LINE_AA, _FRACTION_BITS)


def _fixed(points_px: F64) -> Any:
    near = np.clip(points_px, -_FARTHEST_PX, _FARTHEST_PX)
    return np.round((near - 0.5) * 2**_FRACTION_BITS).astype(np.int32)


class Label(NamedTuple):
    """A text. ``anchor`` is Pillow's: l, m or r, then a(scender), m(iddle) or s (baseline)."""

    x_px: float
    y_px: float
    text: str
    size_px: float
    colour: Rgb
    anchor: str = "ls"
    bold: bool = False
    chip: bool = False  # on a dark ground of its own
    most_px: float = np.inf  # width beyond which it is cut off


def write(picture: U8, labels: Iterable[Label]) -> U8:
    """The picture with texts."""
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image, "RGBA")
    for label in labels:
        font = _font(round(label.size_px), label.bold)
        text = label.text
        while text and draw.textlength(text, font) > label.most_px:
            text = f"{text[:-2].rstrip()}…"
        place = label.x_px, label.y_px
        if label.chip:
            left, top, right, bottom = draw.textbbox(place, text, font, label.anchor)
            dx, dy = _CHIP_PX
            draw.rounded_rectangle((left - dx, top - dy, right + dx, bottom + dy), 4, (20, 26, 30, 175))
        draw.text(place, text, label.colour, font, label.anchor)
    return np.array(image)


@cache
def _font(size_px: int, bold: bool) -> ImageFont.FreeTypeFont:
    """The font of the reports' figures, which Matplotlib brings."""
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(folder / f"DejaVuSans{'-Bold' if bold else ''}.ttf", max(size_px, 6))
