"""Layouts with a row for each cell of the grids: YOLOv5 to v12 without NMS, YOLOX, YOLO-NAS, NanoDet.

Sources: the export code or papers of YOLOv5/v8/v11 (Ultralytics), YOLOv6 (arXiv:2209.02976), YOLOv7
(arXiv:2207.02696), YOLOX (arXiv:2107.08430), DAMO-YOLO (arXiv:2211.15444), PP-YOLOE (arXiv:2203.16250) and
NanoDet-Plus (RangiLyu/nanodet).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from skysweep.arrays import F32
from skysweep.detection.coco import COCO_80
from skysweep.detection.layouts import (
    BYTE_BGR,
    BYTE_RGB,
    NAMED_NAS,
    NANODET_BGR,
    ROUNDING,
    UNIT_RGB,
    Boxes,
    OutputLayout,
    Outputs,
    PixelFormat,
    Probe,
    Size,
    Unclear,
    best_class,
    cell_centres,
    row_outputs,
    size_px,
    softmax,
    strides_of,
    xyxy_from_cxcywh,
)

_NANODET_BINS = (8, 11)  # of the distance to each side


def boxes_and_scores(probe: Probe) -> OutputLayout | None:
    """Decoded corners and class scores apart.

    (1, N, 1, 4), normalised, and (1, N, C): YOLOv4; (1, N, 4), pixels, and (1, N, C): YOLO-NAS (0..1) and
    DAMO-YOLO (0..255), told apart by name; (1, N, 4) and (1, C, N): PP-YOLOE without NMS.
    """
    if len(probe.outputs) != 2:
        return None
    for boxes, scores in (tuple(probe.outputs), tuple(probe.outputs)[::-1]):
        b, s = probe.outputs[boxes].shape, probe.outputs[scores].shape
        if len(s) != 3 or b[0] != 1 or s[0] != 1:
            continue
        decode = partial(_decode_pair, boxes, scores, False)
        if b[1:] == (s[1], 1, 4):
            return OutputLayout("YOLOv4 decoded", s[2], decode, boxes="normalised")
        if b[2:] != (4,) or strides_of(probe, b[1], 1) is None:
            continue
        if b == s:
            raise Unclear(
                f"answers {boxes} and {scores} of one shape {b}, which does not say which of them holds the "
                "boxes; export it with NMS"
            )
        if s[1] == b[1]:
            family, pixels = _family_of_pair(probe.hint)
            return OutputLayout(family, s[2], decode, pixels)
        if s[2] == b[1]:
            return OutputLayout("PP-YOLOE", s[1], partial(_decode_pair, boxes, scores, True), None)
    return None


def _family_of_pair(hint: str) -> tuple[str, PixelFormat | None]:
    if "damo" in hint:
        return "DAMO-YOLO", BYTE_RGB
    if NAMED_NAS.search(hint):
        return "YOLO-NAS", UNIT_RGB
    return "YOLO-NAS or DAMO-YOLO", None


def _decode_pair(boxes: str, scores: str, transposed: bool, outputs: Outputs, _: Size) -> Boxes:
    s = outputs[scores][0]
    return best_class(outputs[boxes].reshape(-1, 4), s.T if transposed else s)


def anchored_rows(probe: Probe) -> OutputLayout | None:
    """(1, N, 5 + C) with three rows a cell, decoded: YOLOv5, YOLOv7 and decoded YOLOv3/v4.

    Such a file may repeat the same as raw grids. Segmentation models add mask coefficients. Raises Unclear if
    what stands for scores is none: YOLOv5-face and YOLOv7-pose add key points.
    """
    masks = _n_mask_columns(probe)
    for name, rows, columns in row_outputs(probe):
        n_classes = columns - 5 - masks
        if n_classes < 1 or not strides_of(probe, rows, 3):
            continue
        _refuse_twins(probe, name)
        if np.any(probe.outputs[name][0, :, 5 : 5 + n_classes] > 1 + ROUNDING):
            raise Unclear(
                f"answers values above 1 where a YOLOv5 of {n_classes} classes has scores, as models with "
                "key points (YOLOv5-face, YOLOv7-pose) do; use one that finds boxes only"
            )
        return OutputLayout("YOLOv5", n_classes, partial(_decode_objectness, name, n_classes))
    return None


def _n_mask_columns(probe: Probe) -> int:
    """32 coefficients, for models with an output of 32 prototypes (1, 32, h, w)."""
    return 32 if any(v.ndim == 4 and v.shape[1] == 32 for v in probe.outputs.values()) else 0


def _refuse_twins(probe: Probe, name: str) -> None:
    """Raises Unclear if another output has the shape of this one, as of models with two heads."""
    shape = probe.outputs[name].shape
    twins = [other for other, values in probe.outputs.items() if values.shape == shape]
    if len(twins) > 1:
        raise Unclear(
            f"answers {' and '.join(twins)} of one shape {shape}, which does not say whose boxes count; "
            "export it with one of them"
        )


def _decode_objectness(name: str, n_classes: int, outputs: Outputs, _: Size) -> Boxes:
    return objectness_rows(outputs[name][0, :, : 5 + n_classes])


def objectness_rows(rows: F32) -> Boxes:
    """Rows (N, 5 + C): centre, size, objectness, class scores."""
    return best_class(xyxy_from_cxcywh(rows), rows[:, 4:5] * rows[:, 5:])


def cell_columns(probe: Probe) -> OutputLayout | None:
    """(1, 4 + C, N) with one column a cell and no objectness: YOLOv8, v9, v11, v12; also transposed.

    Segmentation models add 32 mask coefficients, which a second output (1, 32, h, w) shows; models of poses
    and of oriented boxes say so in their metadata, and add key points or an angle.
    """
    masks = _n_mask_columns(probe)
    for name, rows, columns in row_outputs(probe):
        for transposed, cells, values in ((False, columns, rows), (True, rows, columns)):
            if strides_of(probe, cells, 1) is None:
                continue
            n_classes = values - 4 - masks - (probe.task == "obb")
            if probe.task == "pose" and probe.n_names and values > 4 + probe.n_names:
                n_classes = probe.n_names
            if n_classes <= 0 or (transposed and n_classes != (probe.n_names or 80)):
                continue
            _refuse_twins(probe, name)
            oriented = probe.task == "obb"
            decode = partial(_decode_columns, name, n_classes, transposed, oriented)
            return OutputLayout("YOLOv8", n_classes, decode)
    return None


def _decode_columns(
    name: str, n_classes: int, transposed: bool, oriented: bool, outputs: Outputs, _: Size
) -> Boxes:
    p = outputs[name][0] if transposed else outputs[name][0].T
    upright = _enclosing(p) if oriented else p
    return best_class(xyxy_from_cxcywh(upright), p[:, 4 : 4 + n_classes])


def _enclosing(p: F32) -> F32:
    """Centre and size (N, 4) of the upright boxes around rows of centre, size, ..., angle in radians."""
    cos, sin = np.abs(np.cos(p[:, -1:])), np.abs(np.sin(p[:, -1:]))
    w, h = p[:, 2:3], p[:, 3:4]
    return np.concatenate([p[:, :2], w * cos + h * sin, w * sin + h * cos], axis=1)


def nanodet_rows(probe: Probe) -> OutputLayout | None:
    """(1, N, C + 4 B): class scores and the distances to four sides in B bins each: NanoDet and its Plus."""
    for name, rows, columns in row_outputs(probe):
        strides, n_classes = strides_of(probe, rows, 1), probe.n_names or 80
        bins = next((b for b in _NANODET_BINS if columns == n_classes + 4 * b), None)
        if strides and bins:
            _refuse_twins(probe, name)
            decode = partial(_decode_nanodet, name, strides, bins)
            return OutputLayout("NanoDet", n_classes, decode, NANODET_BGR, None)
    return None


def _decode_nanodet(
    name: str, strides: tuple[int, ...], n_bins: int, outputs: Outputs, input_hw: Size
) -> Boxes:
    p = outputs[name][0]
    cells, steps = cell_centres(input_hw, strides)
    centre = (cells + (0.0 if len(strides) == 4 else 0.5)) * steps  # Plus has four strides
    bins = softmax(p[:, -4 * n_bins :].reshape(-1, 4, n_bins))
    sides = bins @ np.arange(n_bins, dtype=np.float32) * steps
    corners = np.concatenate([centre - sides[:, :2], centre + sides[:, 2:]], axis=1)
    return best_class(corners, p[:, : -4 * n_bins])


def cell_rows(probe: Probe) -> OutputLayout | None:
    """(1, N, 5 + C) with one row a cell: YOLOv6, whose objectness is always 1, or YOLOX, decoded or raw."""
    for name, rows, columns in row_outputs(probe):
        strides = strides_of(probe, rows, 1)
        if strides is None or columns < 6:
            continue
        _refuse_twins(probe, name)
        if not probe.names and columns != 5 + len(COCO_80):
            raise Unclear(
                f"answers rows of {columns} numbers, which may be those of {columns - 5} classes (YOLOX, "
                f"YOLOv6) or of {columns - 4} (YOLOv8, transposed), and names none; write their names one a "
                "line into a file of its name ending in .names"
            )
        p = probe.outputs[name][0]
        decode = partial(_decode_objectness, name, columns - 5)
        if np.all(p[:, 4] == 1.0):
            return OutputLayout("YOLOv6", columns - 5, decode)
        # A raw centre is a small offset from its own cell; a decoded one grows with the cell's place.
        cells, steps = cell_centres(probe.input_hw, strides)
        normalised_px = p[:, :2] * size_px(probe.input_hw)[:2]
        raw, decoded, normalised = (
            np.median(np.abs(offset - 0.5))
            for offset in (p[:, :2], p[:, :2] / steps - cells, normalised_px / steps - cells)
        )
        if raw < min(decoded, normalised):
            decode = partial(_decode_yolox, name, strides)
            return OutputLayout("YOLOX raw", columns - 5, decode, BYTE_BGR, None)
        return OutputLayout("YOLOX", columns - 5, decode, BYTE_BGR)
    return None


def _decode_yolox(name: str, strides: tuple[int, ...], outputs: Outputs, input_hw: Size) -> Boxes:
    p = outputs[name][0]
    cells, steps = cell_centres(input_hw, strides)
    parts = (p[:, :2] + cells) * steps, np.exp(p[:, 2:4]) * steps, p[:, 4:]
    return objectness_rows(np.concatenate(parts, axis=1))
