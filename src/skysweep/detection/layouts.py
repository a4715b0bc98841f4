"""What a recognised model is: how it wants its pixels, what its boxes are measured in, how it is decoded."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from skysweep.arrays import F32, I64

Outputs = Mapping[str, F32]
Size = tuple[int, int]
BoxUnit = Literal["pixels", "normalised"]
PixelRange = Literal["0..255", "0..1", "imagenet"]
Channels = Literal["rgb", "bgr"]

STRIDE_SETS = ((8, 16, 32), (16, 32), (8, 16, 32, 64), (4, 8, 16, 32))
_MANY = 20  # boxes that do not all lie within the first two pixels, unless they are normalised
NORMALISED_MAX = 2.0  # a normalised box may reach beyond the picture
ROUNDING = 1e-3  # of a score in half precision
NAMED_NAS = re.compile(r"(?:yolo|(?<![a-z]))[-_ ]?nas(?![a-z])")


class Unclear(ValueError):
    """What a model's outputs leave open, as the rest of a sentence that begins with 'the model'."""


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """How a model wants its pixels: channel order, then in that order ``(value * scale - mean) / std``."""

    bgr: bool = False
    scale: float = 1 / 255
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def told(self, values: PixelRange | None, channels: Channels | None) -> PixelFormat:
        """The same with other values or another channel order; None changes nothing."""
        one = self if values is None else _RANGES[values]
        bgr = self.bgr if channels is None else channels == "bgr"
        turned = one if one.bgr == bgr else replace(one, mean=one.mean[::-1], std=one.std[::-1])
        return replace(turned, bgr=bgr)


UNIT_RGB = PixelFormat()
BYTE_RGB = PixelFormat(scale=1.0)
BYTE_BGR = PixelFormat(bgr=True, scale=1.0)
IMAGENET_RGB = PixelFormat(mean=(0.485, 0.456, 0.406), std=(0.229, 0.224, 0.225))
NANODET_BGR = PixelFormat(True, 1.0, (103.53, 116.28, 123.675), (57.375, 57.12, 58.395))
_RANGES: dict[PixelRange, PixelFormat] = {"0..255": BYTE_RGB, "0..1": UNIT_RGB, "imagenet": IMAGENET_RGB}


class Told(NamedTuple):
    """What the user says of a model, where its file leaves it open."""

    boxes: BoxUnit | None = None
    pixels: PixelRange | None = None
    channels: Channels | None = None


@dataclass(frozen=True, slots=True)
class Boxes:
    """Decoded boxes before non-maximum suppression."""

    xyxy_px: F32  # (N, 4) in the input picture; a decoder's are in its layout's unit
    scores: F32  # (N,) 0..1
    classes: I64  # (N,) indices


@dataclass(frozen=True, slots=True)
class Probe:
    """A model's answer to a blank picture, and what else is known about the model."""

    outputs: Outputs
    input_hw: Size
    names: tuple[str, ...] = ()  # of the classes, if the file or another beside it has them
    hint: str = ""  # lower-case file, graph and producer names
    task: str = ""  # of the metadata, as Ultralytics writes it
    told_size: bool = False  # another input takes the picture's size
    anchors_px: tuple[float, ...] = ()  # of the file beside the model

    @property
    def n_names(self) -> int | None:
        """How many classes are named; None if none."""
        return len(self.names) or None


@dataclass(frozen=True, slots=True)
class OutputLayout:
    """A recognised output layout.

    ``boxes`` is what the family's exports use, or None if the boxes are built from the grid. ``pixels`` is
    None if the outputs leave the range open; ``bgr`` then is the order of channels, or None if that is open.
    """

    name: str
    n_classes: int
    decode: Callable[[Outputs, Size], Boxes]
    pixels: PixelFormat | None = UNIT_RGB
    boxes: BoxUnit | None = "pixels"
    suppressed: bool = False  # the model has removed duplicates itself
    anchors: str = "none"
    bgr: bool | None = False


def unit_of(found: Boxes, usual: BoxUnit, told: BoxUnit | None = None) -> BoxUnit | None:
    """What boxes are measured in, as far as is ``told``; None if there are none and nothing is.

    Of many boxes a single one may reach anywhere, where it has no score. Raises Unclear if they contradict
    what is told; also if they are few, lie where only normalised boxes do, and the family's exports use
    pixels.
    """
    real = found.xyxy_px[np.any(found.xyxy_px != 0, axis=1) & np.isfinite(found.xyxy_px).all(axis=1)]
    if len(real) == 0:
        return told
    real = np.unique(real, axis=0)  # lists may be padded with one box
    reach = np.abs(real).max(axis=1)
    are_many = len(real) >= _MANY
    are_pixels = (np.median(reach) if are_many else reach.max()) > NORMALISED_MAX
    shown: BoxUnit = "pixels" if are_pixels else "normalised"
    if are_many and told not in (None, shown):
        raise Unclear(f"answers boxes that are {shown}; leave out detector.boxes, or write {shown}")
    if told or are_many or are_pixels or usual == "normalised":
        return told or shown
    raise Unclear(
        f"answers boxes within the first {NORMALISED_MAX:g} pixels; write detector.boxes: normalised if "
        "they are shares of the picture, else detector.boxes: pixels"
    )


def refuse_logits(scores: F32) -> None:
    """Raises Unclear if scores lie below 0."""
    if np.any(scores < -ROUNDING):
        raise Unclear("answers scores below 0; export it with its last activation (sigmoid or softmax)")


def whole(classes: F32) -> I64:
    """Class numbers as integers. Raises Unclear if one is no whole number."""
    broken = classes[~(classes % 1 == 0)]
    if len(broken):
        raise Unclear(f"answers the class number {broken[0]:.3g}, which is no whole number; export it again")
    return classes.astype(np.int64)


def sigmoid(x: F32) -> F32:
    """Logistic function without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)))


def softmax(z: F32) -> F32:
    """Softmax over the last axis."""
    e = np.exp(z - z.max(axis=-1, keepdims=True))
    return np.asarray(e / e.sum(axis=-1, keepdims=True))


def xyxy_from_cxcywh(boxes: F32) -> F32:
    """Corners (N, 4) of boxes (N, 4) given by centre and size."""
    half = boxes[:, 2:4] / 2
    return np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], axis=1)


def size_px(input_hw: Size) -> F32:
    """(width, height, width, height), which turns normalised boxes into pixels."""
    return np.array([input_hw[1], input_hw[0]] * 2, dtype=np.float32)


def best_class(boxes_xyxy: F32, class_scores: F32) -> Boxes:
    """Each box (N, 4) with the class that scores (N, C) best."""
    classes = class_scores.argmax(axis=1)
    return Boxes(boxes_xyxy, class_scores[np.arange(len(classes)), classes], classes)


def cell_centres(input_hw: Size, strides: tuple[int, ...]) -> tuple[F32, F32]:
    """Cell indices (N, 2) as x, y and strides (N, 1) of anchor-free heads, finest stride first."""
    cells, steps = [], []
    for stride in strides:
        ys, xs = np.mgrid[: -(-input_hw[0] // stride), : -(-input_hw[1] // stride)]
        cells.append(np.stack([xs.ravel(), ys.ravel()], axis=1))
        steps.append(np.full((xs.size, 1), stride))
    return np.concatenate(cells).astype(np.float32), np.concatenate(steps).astype(np.float32)


def strides_of(probe: Probe, rows: int, per_cell: int) -> tuple[int, ...] | None:
    """The strides at which a picture has so many rows, or None."""
    height, width = probe.input_hw
    cells = ((s_set, sum(-(-height // s) * -(-width // s) for s in s_set)) for s_set in STRIDE_SETS)
    return next((s_set for s_set, n_cells in cells if rows == per_cell * n_cells), None)


def find_outputs(probe: Probe, *names: str) -> tuple[str, ...] | None:
    """The outputs whose names contain each of ``names``, in this order, if all exist."""
    found = tuple(next((o for o in probe.outputs if n in o.lower()), "") for n in names)
    return found if all(found) and len(set(found)) == len(names) else None


def row_outputs(probe: Probe) -> list[tuple[str, int, int]]:
    """Outputs (1, rows, columns) as name, rows, columns."""
    return [(k, v.shape[1], v.shape[2]) for k, v in probe.outputs.items() if v.ndim == 3 and v.shape[0] == 1]
