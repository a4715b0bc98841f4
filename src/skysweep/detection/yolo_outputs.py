"""Output layouts of the YOLO family: recognised from a model's answer to a blank picture, then decoded.

Users need not say which YOLO a file holds. Each recogniser looks at the shapes (and at a few values if the
shapes are ambiguous) and returns an :class:`OutputLayout` or None; the first layout wins. Pixels are those of
the model's input picture.

Sources: the export code or papers of YOLOv3 (arXiv:1804.02767), YOLOv4 (arXiv:2004.10934), YOLOv5/v8/v11
(Ultralytics), YOLOv6 (arXiv:2209.02976), YOLOv7 (arXiv:2207.02696), YOLOv10 (arXiv:2405.14458), YOLOX
(arXiv:2107.08430), DETR (arXiv:2005.12872) and RT-DETR (arXiv:2304.08069).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from skysweep.arrays import F32, I64

Outputs = Mapping[str, F32]
Size = tuple[int, int]

STRIDE_SETS = ((8, 16, 32), (16, 32), (8, 16, 32, 64), (4, 8, 16, 32))

# Anchor boxes (width, height) in pixels for each stride, trained on COCO.
_YOLO3 = {
    8: ((10, 13), (16, 30), (33, 23)),
    16: ((30, 61), (62, 45), (59, 119)),
    32: ((116, 90), (156, 198), (373, 326)),
}
_YOLO4 = {
    8: ((12, 16), (19, 36), (40, 28)),
    16: ((36, 75), (76, 55), (72, 146)),
    32: ((142, 110), (192, 243), (459, 401)),
}
_YOLO3_TINY = {16: ((10, 14), (23, 27), (37, 58)), 32: ((81, 82), (135, 169), (344, 319))}
_YOLO4_TINY = {16: ((23, 27), (37, 58), (81, 82)), 32: ((81, 82), (135, 169), (344, 319))}
_YOLO4_SCALE_XY = {8: 1.2, 16: 1.1, 32: 1.05}


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """How a model wants its pixels: channel order, then ``(value * scale - mean) / std``."""

    bgr: bool = False
    scale: float = 1 / 255
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)


UNIT_RGB = PixelFormat()
BYTE_BGR = PixelFormat(bgr=True, scale=1.0)
IMAGENET_RGB = PixelFormat(mean=(0.485, 0.456, 0.406), std=(0.229, 0.224, 0.225))


@dataclass(frozen=True, slots=True)
class Boxes:
    """Decoded boxes before non-maximum suppression."""

    xyxy_px: F32  # (N, 4) in the input picture
    scores: F32  # (N,) 0..1
    classes: I64  # (N,) indices


@dataclass(frozen=True, slots=True)
class Probe:
    """A model's answer to a blank picture, and what else is known about the model."""

    outputs: Outputs
    input_hw: Size
    n_names: int | None  # classes named in the file, if any
    hint: str  # lower-case file, graph and producer names


@dataclass(frozen=True, slots=True)
class OutputLayout:
    """A recognised output layout."""

    name: str
    n_classes: int
    decode: Callable[[Outputs, Size], Boxes]
    pixels: PixelFormat = UNIT_RGB


def recognise(probe: Probe) -> OutputLayout | None:
    """The layout of a model's outputs, or None if it is unknown."""
    layouts = (recogniser(probe) for recogniser in _RECOGNISERS)
    return next((layout for layout in layouts if layout is not None), None)


def sigmoid(x: F32) -> F32:
    """Logistic function without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)))


def xyxy_from_cxcywh(boxes: F32) -> F32:
    """Corners (N, 4) of boxes (N, 4) given by centre and size."""
    half = boxes[:, 2:4] / 2
    return np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], axis=1)


def cell_centres(input_hw: Size, strides: tuple[int, ...]) -> tuple[F32, F32]:
    """Cell indices (N, 2) as x, y and strides (N, 1) of anchor-free heads, finest stride first."""
    cells, steps = [], []
    for stride in strides:
        ys, xs = np.mgrid[: input_hw[0] // stride, : input_hw[1] // stride]
        cells.append(np.stack([xs.ravel(), ys.ravel()], axis=1))
        steps.append(np.full((xs.size, 1), stride))
    return np.concatenate(cells).astype(np.float32), np.concatenate(steps).astype(np.float32)


def _strides(probe: Probe, rows: int, per_cell: int) -> tuple[int, ...] | None:
    height, width = probe.input_hw
    cells = ((strides, sum((height // s) * (width // s) for s in strides)) for strides in STRIDE_SETS)
    return next((strides for strides, n_cells in cells if rows == per_cell * n_cells), None)


def _best_class(boxes_xyxy_px: F32, class_scores: F32) -> Boxes:
    classes = class_scores.argmax(axis=1)
    return Boxes(boxes_xyxy_px, class_scores[np.arange(len(classes)), classes], classes)


def _size_px(input_hw: Size) -> F32:
    """(width, height, width, height), which turns normalised boxes into pixels."""
    return np.array([input_hw[1], input_hw[0]] * 2, dtype=np.float32)


def _find(probe: Probe, *names: str) -> tuple[str, ...] | None:
    """The outputs whose names contain each of ``names``, in this order, if all exist."""
    found = tuple(next((o for o in probe.outputs if n in o.lower()), "") for n in names)
    return found if all(found) and len(set(found)) == len(names) else None


def _rows(probe: Probe) -> list[tuple[str, int, int]]:
    """Outputs (1, rows, columns) as name, rows, columns."""
    return [(k, v.shape[1], v.shape[2]) for k, v in probe.outputs.items() if v.ndim == 3 and v.shape[0] == 1]


def _labelled_boxes(probe: Probe) -> OutputLayout | None:
    """Boxes (1, K, 4), scores (1, K) and classes or labels (1, K), with or without a count of valid ones.

    YOLOv7 with TensorRT-style NMS, and RT-DETR, which takes the picture's size as a second input.
    """
    names = _find(probe, "boxes", "scores", "classes") or _find(probe, "boxes", "scores", "labels")
    if names is None or probe.outputs[names[1]].ndim != 2 or probe.outputs[names[2]].ndim != 2:
        return None
    boxes, scores, classes = names
    count = _find(probe, "num")

    def decode(outputs: Outputs, _: Size) -> Boxes:
        n = int(outputs[count[0]].ravel()[0]) if count else None
        return Boxes(
            outputs[boxes].reshape(-1, 4)[:n],
            outputs[scores].ravel()[:n],
            outputs[classes].ravel()[:n].astype(np.int64),
        )

    return OutputLayout("YOLOv7 end-to-end" if count else "RT-DETR", probe.n_names or 80, decode)


def _seven_columns(probe: Probe) -> OutputLayout | None:
    """(K, 7): picture, x0, y0, x1, y1, class, score: YOLOv7 with ONNX NMS built in."""
    name, array = next(iter(probe.outputs.items()))
    if len(probe.outputs) != 1 or array.ndim != 2 or array.shape[1] != 7:
        return None

    def decode(outputs: Outputs, _: Size) -> Boxes:
        rows = outputs[name]
        return Boxes(rows[:, 1:5], rows[:, 6], rows[:, 5].astype(np.int64))

    return OutputLayout("YOLOv7 with NMS", probe.n_names or 80, decode)


def _detr(probe: Probe) -> OutputLayout | None:
    """Logits (1, Q, C [+ 1 for nothing]) and boxes (1, Q, 4), centre and size, as shares of the picture."""
    names = _find(probe, "boxes", "logits") or _find(probe, "dets", "labels")
    if names is None or any(probe.outputs[n].ndim != 3 for n in names):
        return None
    boxes, logits = names
    columns = probe.outputs[logits].shape[2]
    softmax = columns == probe.n_names + 1 if probe.n_names else columns in (81, 92)

    def decode(outputs: Outputs, input_hw: Size) -> Boxes:
        z = outputs[logits][0]
        if softmax:
            e = np.exp(z - z.max(axis=1, keepdims=True))
            scores = (e / e.sum(axis=1, keepdims=True))[:, :-1]
        else:
            scores = sigmoid(z)
        return _best_class(xyxy_from_cxcywh(outputs[boxes][0]) * _size_px(input_hw), scores)

    return OutputLayout("DETR", columns - softmax, decode, IMAGENET_RGB)


def _boxes_and_scores(probe: Probe) -> OutputLayout | None:
    """Decoded corners and class scores apart: YOLOv4 and YOLO-NAS.

    (1, N, 1, 4), shares of the picture, and (1, N, C): YOLOv4; (1, N, 4), pixels, and (1, N, C): YOLO-NAS.
    """
    if len(probe.outputs) != 2:
        return None
    for boxes, scores in (tuple(probe.outputs), tuple(probe.outputs)[::-1]):
        b, s = probe.outputs[boxes].shape, probe.outputs[scores].shape
        if len(s) != 3 or b[:2] != s[:2] or b[0] != 1:
            continue
        if b[2:] == (1, 4):
            return OutputLayout("YOLOv4 decoded", s[2], partial(_decode_pair, boxes, scores, shares=True))
        if b[2:] == (4,) and _strides(probe, b[1], 1):
            return OutputLayout("YOLO-NAS", s[2], partial(_decode_pair, boxes, scores, shares=False))
    return None


def _decode_pair(boxes: str, scores: str, outputs: Outputs, input_hw: Size, *, shares: bool) -> Boxes:
    corners = outputs[boxes].reshape(-1, 4)
    return _best_class(corners * _size_px(input_hw) if shares else corners, outputs[scores][0])


def _anchored_rows(probe: Probe) -> OutputLayout | None:
    """(1, N, 5 + C) with three rows a cell, decoded: YOLOv5, YOLOv7 and decoded YOLOv3/v4.

    Such a file may repeat the same as raw grids.
    """
    for name, rows, columns in _rows(probe):
        if columns > 5 and _strides(probe, rows, 3):
            return OutputLayout("YOLOv5", columns - 5, partial(_decode_objectness, name))
    return None


def _decode_objectness(name: str, outputs: Outputs, _: Size) -> Boxes:
    return _objectness_rows(outputs[name][0])


def _objectness_rows(rows: F32) -> Boxes:
    """Rows (N, 5 + C): centre, size, objectness, class scores."""
    return _best_class(xyxy_from_cxcywh(rows), rows[:, 4:5] * rows[:, 5:])


def _cell_columns(probe: Probe) -> OutputLayout | None:
    """(1, 4 + C, N) with one column a cell and no objectness: YOLOv8, v9, v11, v12; also transposed.

    Segmentation models add 32 mask coefficients; a second output (1, 32, h, w) shows that.
    """
    masks = 32 if any(v.ndim == 4 and v.shape[1] == 32 for v in probe.outputs.values()) else 0
    for name, rows, columns in _rows(probe):
        n_classes = rows - 4 - masks
        if _strides(probe, columns, 1) and n_classes > 0:
            return OutputLayout("YOLOv8", n_classes, partial(_decode_columns, name, n_classes, False))
        n_classes = columns - 4 - masks
        if _strides(probe, rows, 1) and n_classes == (probe.n_names or 80):
            return OutputLayout("YOLOv8", n_classes, partial(_decode_columns, name, n_classes, True))
    return None


def _decode_columns(name: str, n_classes: int, transposed: bool, outputs: Outputs, _: Size) -> Boxes:
    p = outputs[name][0] if transposed else outputs[name][0].T
    return _best_class(xyxy_from_cxcywh(p), p[:, 4 : 4 + n_classes])


def _cell_rows(probe: Probe) -> OutputLayout | None:
    """(1, N, 5 + C) with one row a cell: YOLOv6, whose objectness is always 1, or YOLOX, decoded or raw."""
    for name, rows, columns in _rows(probe):
        strides = _strides(probe, rows, 1)
        if strides is None or columns < 6:
            continue
        p = probe.outputs[name][0]
        if np.all(p[:, 4] == 1.0):
            return OutputLayout("YOLOv6", columns - 5, partial(_decode_objectness, name))
        # A raw centre is a small offset from its own cell; a decoded one grows with the cell's place.
        cells, steps = cell_centres(probe.input_hw, strides)
        if np.median(np.abs(p[:, :2] - 0.5)) < np.median(np.abs(p[:, :2] / steps - cells - 0.5)):
            return OutputLayout("YOLOX raw", columns - 5, partial(_decode_yolox, name, strides), BYTE_BGR)
        return OutputLayout("YOLOX", columns - 5, partial(_decode_objectness, name), BYTE_BGR)
    return None


def _decode_yolox(name: str, strides: tuple[int, ...], outputs: Outputs, input_hw: Size) -> Boxes:
    p = outputs[name][0]
    cells, steps = cell_centres(input_hw, strides)
    parts = (p[:, :2] + cells) * steps, np.exp(p[:, 2:4]) * steps, p[:, 4:]
    return _objectness_rows(np.concatenate(parts, axis=1))


def _final_rows(probe: Probe) -> OutputLayout | None:
    """Rows that need no suppression: YOLOv10, exports with NMS, RT-DETR by Ultralytics.

    (1, K, 6): x0, y0, x1, y1, score, class: YOLOv10 and exports with NMS; or (1, K, 4 + C): centre and size
    as shares of the picture, class scores: RT-DETR. K does not match the number of cells.
    """
    if len(probe.outputs) != 1 or not _rows(probe):
        return None
    name, rows, columns = _rows(probe)[0]
    if columns < 5 or rows > 1000:
        return None
    if columns == 6 and np.all(probe.outputs[name][0, :, 5] % 1 == 0):

        def decode(outputs: Outputs, _: Size) -> Boxes:
            p = outputs[name][0]
            return Boxes(p[:, :4], p[:, 4], p[:, 5].astype(np.int64))

        return OutputLayout("YOLOv10", probe.n_names or 80, decode)
    if columns - 4 != (probe.n_names or 80):
        return None

    def decode_shares(outputs: Outputs, input_hw: Size) -> Boxes:
        p = outputs[name][0]
        return _best_class(xyxy_from_cxcywh(p) * _size_px(input_hw), p[:, 4:])

    return OutputLayout("RT-DETR rows", columns - 4, decode_shares)


@dataclass(frozen=True, slots=True)
class _Grid:
    """One raw head: which output, its stride, and the axes that bring it to (3, h, w, 5 + C)."""

    output: str
    stride: int
    columns: int
    axes: str  # "chw": (1, 3 * k, h, w); "hwc": (1, h, w, 3 * k); "ahwk": (1, 3, h, w, k); "hwak"

    def cells(self, outputs: Outputs) -> F32:
        a: F32 = np.asarray(outputs[self.output][0])
        match self.axes:
            case "chw":
                return a.reshape(3, self.columns, *a.shape[1:]).transpose(0, 2, 3, 1)
            case "hwc":
                return a.reshape(*a.shape[:2], 3, self.columns).transpose(2, 0, 1, 3)
            case "hwak":
                return a.transpose(2, 0, 1, 3)
        return a


def _as_grid(name: str, shape: tuple[int, ...], input_hw: Size) -> _Grid | None:
    for axes in ("chw", "hwc") if len(shape) == 4 else ("ahwk", "hwak") if len(shape) == 5 else ():
        h, w = {"chw": shape[2:4], "hwc": shape[1:3], "ahwk": shape[2:4], "hwak": shape[1:3]}[axes]
        k, rest = divmod(shape[1] if axes == "chw" else shape[-1], 3) if len(shape) == 4 else (shape[-1], 0)
        anchors = {"ahwk": shape[1], "hwak": shape[3] if len(shape) == 5 else 3}.get(axes, 3)
        stride = input_hw[0] // h if h else 0
        if rest == 0 and k > 5 and anchors == 3 and stride in (8, 16, 32) and input_hw[1] // stride == w:
            return _Grid(name, stride, k, axes)
    return None


def _raw_grids(probe: Probe) -> OutputLayout | None:
    """Two or three raw heads of three anchors: YOLOv3, v4 (4 or 5 axes), v5 and v7 (1, 3, h, w, 5 + C).

    Shapes do not distinguish v3 from v4, nor v5 from v7, but names in the file may. By default the anchors
    are YOLOv3's, or YOLOv7's if the axes are those of v5 and v7.
    """
    found = [_as_grid(n, v.shape, probe.input_hw) for n, v in probe.outputs.items()]
    grids = sorted((g for g in found if g is not None), key=lambda g: g.stride)
    tiny = len(grids) == 2
    if len(grids) != len(probe.outputs) or len({g.columns for g in grids}) != 1:
        return None
    if tuple(g.stride for g in grids) not in ((8, 16, 32), (16, 32)):
        return None
    squared = grids[0].axes == "ahwk"
    v4 = "v4" in probe.hint or grids[0].axes == "hwak"
    if squared:
        name, anchors = ("YOLOv5 grids", _YOLO3) if "v5" in probe.hint else ("YOLOv7 grids", _YOLO4)
    elif v4:
        name, anchors = ("YOLOv4 grids", _YOLO4_TINY if tiny else _YOLO4)
    else:
        name, anchors = ("YOLOv3 grids", _YOLO3_TINY if tiny else _YOLO3)

    def decode(outputs: Outputs, _: Size) -> Boxes:
        parts = []
        for grid in grids:
            t = grid.cells(outputs)
            ys, xs = np.mgrid[: t.shape[1], : t.shape[2]]
            cell = np.stack([xs, ys], axis=-1)
            anchor = np.array(anchors[grid.stride], dtype=np.float32)[:, None, None]
            if squared:
                centre = sigmoid(t[..., :2]) * 2 - 0.5 + cell
                size = (sigmoid(t[..., 2:4]) * 2) ** 2 * anchor
            else:
                scale = _YOLO4_SCALE_XY[grid.stride] if v4 and not tiny else 1.0
                centre = sigmoid(t[..., :2]) * scale - (scale - 1) / 2 + cell
                size = np.exp(t[..., 2:4]) * anchor
            parts.append(np.concatenate([centre * grid.stride, size, sigmoid(t[..., 4:])], axis=-1))
        rows = np.concatenate([p.reshape(-1, p.shape[-1]) for p in parts])
        return _objectness_rows(rows.astype(np.float32))

    return OutputLayout(name, grids[0].columns - 5, decode)


_RECOGNISERS: tuple[Callable[[Probe], OutputLayout | None], ...] = (
    _labelled_boxes,
    _detr,
    _seven_columns,
    _boxes_and_scores,
    _anchored_rows,
    _cell_columns,
    _cell_rows,
    _final_rows,
    _raw_grids,
)
