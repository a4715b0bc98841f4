"""Layouts that list finished objects: exports with NMS, DETR and its kin, TensorFlow, torchvision, mmdeploy.

Sources: YOLOv7 (arXiv:2207.02696), YOLOv10 (arXiv:2405.14458), DETR (arXiv:2005.12872), RT-DETR
(arXiv:2304.08069), the TensorFlow Object Detection API, torchvision, mmdeploy, PaddleDetection and
super-gradients.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from skysweep.arrays import F32
from skysweep.detection.layouts import (
    IMAGENET_RGB,
    NAMED_NAS,
    NORMALISED_MAX,
    ROUNDING,
    UNIT_RGB,
    Boxes,
    OutputLayout,
    Outputs,
    Probe,
    Size,
    Unclear,
    best_class,
    find_outputs,
    row_outputs,
    sigmoid,
    softmax,
    whole,
    xyxy_from_cxcywh,
)

_MAX_LISTED = 1000
_PLAUSIBLE = 0.9  # share of boxes whose corners are in order
_COCO_IDS = 91
_OF_EITHER_ORDER = ("nmsed_", "detection_")
_A_FEW = 20  # rows; queries answer on a blank picture, too

# Columns of box corners, score and class, as exports order them.
_ORDERS = {
    "box, score, class": (slice(0, 4), 4, 5),
    "box, class, score": (slice(0, 4), 5, 4),
    "class, score, box": (slice(2, 6), 1, 0),
}
_USUAL, _CLASS_FIRST = "box, score, class", "class, score, box"


def labelled_boxes(probe: Probe) -> OutputLayout | None:
    """Boxes ([1,] K, 4), scores and classes or labels ([1,] K), with or without a count of valid ones.

    With a count and names such as ``det_boxes``: YOLOv7 with TensorRT-style NMS. With the picture's size as a
    second input: RT-DETR, D-FINE and DEIM. Others, such as torchvision and the SSD of the ONNX zoo, may take
    other pixels and count labels from 1, after the background: they need a file of names, which has a line
    for label 0. Raises Unclear of names under which some exports have x first and others y.
    """
    wanted = ("boxes", "scores", "classes"), ("boxes", "scores", "labels")
    names = next(filter(None, (find_outputs(probe, *w) for w in wanted)), None)
    if names is None or not all(_is_list(probe.outputs[n]) for n in names[1:]):
        return None
    if probe.outputs[names[0]].shape[-1] != 4:
        return None
    if names[0].startswith(_OF_EITHER_ORDER):
        raise Unclear(
            f"answers {names[0]}, in which some exports have x first and others y; export it without NMS"
        )
    count = find_outputs(probe, "num")
    decode = partial(_decode_labelled, names, count[0] if count else None)
    if probe.told_size or (count and names == ("det_boxes", "det_scores", "det_classes")):
        name = "YOLOv7 end-to-end" if count else "RT-DETR"
        return OutputLayout(name, probe.n_names or 80, decode, suppressed=True)
    return OutputLayout("boxes, scores and labels", _named(probe), decode, None, suppressed=True, bgr=None)


def _is_list(values: F32) -> bool:
    return values.ndim > 0 and values.size in (0, max(values.shape))


def _named(probe: Probe) -> int:
    """The number of named classes. Raises Unclear if there are none."""
    if not probe.n_names:
        raise Unclear(
            "does not say whether its labels count from 0; write the classes' names one a line into a file "
            "of its name ending in .names, the first for label 0 ('background' if that is no class)"
        )
    return probe.n_names


def _decode_labelled(names: tuple[str, ...], count: str | None, outputs: Outputs, _: Size) -> Boxes:
    boxes, scores, classes = names
    n = int(outputs[count].ravel()[0]) if count else None
    labels = whole(outputs[classes].ravel()[:n])
    return Boxes(outputs[boxes].reshape(-1, 4)[:n], outputs[scores].ravel()[:n], labels)


def tensorflow_lists(probe: Probe) -> OutputLayout | None:
    """detection_boxes (1, K, 4) of y0, x0, y1, x1, normalised; detection_scores; detection_classes from 1."""
    plain = {name.split(":")[0]: name for name in probe.outputs}
    wanted = [f"detection_{part}" for part in ("boxes", "scores", "classes")]
    if not all(name in plain for name in wanted):
        return None
    names = tuple(plain[name] for name in wanted)
    n_classes = probe.n_names or _COCO_IDS
    first = 0 if n_classes == _COCO_IDS else 1
    decode = partial(_decode_tensorflow, names, plain.get("num_detections"), first)
    return OutputLayout("TensorFlow detection", n_classes, decode, None, "normalised", suppressed=True)


def _decode_tensorflow(
    names: tuple[str, ...], count: str | None, first: int, outputs: Outputs, input_hw: Size
) -> Boxes:
    found = _decode_labelled(names, count, outputs, input_hw)
    if np.any(found.xyxy_px > NORMALISED_MAX):
        raise Unclear(
            f"answers {names[0]} in pixels, in which some exports have x first and others y; export it "
            "without NMS"
        )
    return Boxes(found.xyxy_px[:, [1, 0, 3, 2]], found.scores, found.classes - first)


def scored_boxes(probe: Probe) -> OutputLayout | None:
    """Boxes with their score, dets ([1,] K, 5), and labels ([1,] K) from 0: mmdeploy.

    RTMDet takes BGR, others of mmdetection RGB.
    """
    names = find_outputs(probe, "dets", "labels")
    if names is None:
        return None
    dets, labels = (probe.outputs[n] for n in names)
    if dets.shape[-1] != 5 or dets.size != 5 * labels.size:
        return None
    decode = partial(_decode_scored, names)
    return OutputLayout("mmdeploy", probe.n_names or 80, decode, None, suppressed=True, bgr=None)


def _decode_scored(names: tuple[str, ...], outputs: Outputs, _: Size) -> Boxes:
    dets, labels = names
    rows = outputs[dets].reshape(-1, 5)
    return Boxes(rows[:, :4], rows[:, 4], whole(outputs[labels].ravel()))


def detr(probe: Probe) -> OutputLayout | None:
    """Logits (1, Q, C [+ 1 for nothing]) and boxes (1, Q, 4), centre and size, normalised.

    ``dets`` and ``labels`` are RF-DETR's, which has no column for nothing; nor have RT-DETR, D-FINE and
    Deformable DETR by Hugging Face, whose ``logits`` and ``pred_boxes`` are named as those of DETR. Where
    there is such a column, it wins on a blank picture. Raises Unclear if a column is left over.
    """
    rf_detr = find_outputs(probe, "dets", "labels")
    names = find_outputs(probe, "boxes", "logits") or rf_detr
    if names is None or any(probe.outputs[n].ndim != 3 for n in names):
        return None
    boxes, logits = names
    if np.all(np.abs(probe.outputs[logits] - 0.5) <= 0.5):
        raise Unclear(
            f"answers probabilities ({logits}) where DETR has logits; export it without its last activation"
        )
    columns = probe.outputs[logits].shape[2]
    one_more = columns == probe.n_names + 1 if probe.n_names else columns in (81, 92)
    last_wins = np.mean(probe.outputs[logits][0].argmax(axis=1) == columns - 1) > 0.5
    with_nothing = bool(one_more and last_wins and names != rf_detr)
    if probe.n_names and one_more and not with_nothing:
        raise Unclear(
            f"answers {columns} columns of scores for {probe.n_names} named classes; write a name for each "
            "column, one a line, into a file of its name ending in .names"
        )

    def decode(outputs: Outputs, _: Size) -> Boxes:
        z = outputs[logits][0]
        scores = softmax(z)[:, :-1] if with_nothing else sigmoid(z)
        return best_class(xyxy_from_cxcywh(outputs[boxes][0]), scores)

    known = with_nothing or names == rf_detr or columns == _COCO_IDS
    return OutputLayout(
        "RF-DETR" if names == rf_detr else "DETR" if known else "DETR, RT-DETR or D-FINE",
        columns - with_nothing,
        decode,
        IMAGENET_RGB if known else None,
        "normalised",
        suppressed=True,
    )


def final_rows(probe: Probe) -> OutputLayout | None:
    """A row for each object.

    Six columns: YOLOv10 and exports with NMS (box, score, class), PP-YOLOE (class, score, box). Seven, the
    first of them the picture's number: YOLOv7 and YOLO-NAS with NMS. Or (1, K, 4 + C) with centre and size,
    and class scores: RT-DETR by Ultralytics. The rows themselves tell the order of six columns; where there
    are none on a blank picture, only models by Ultralytics are known. Seven columns with the class first are
    of many families, and some of them count labels from 1, after the background.
    """
    name = next(iter(probe.outputs))
    shape = probe.outputs[name].shape
    rows_only = len(shape) == 2 or (len(shape) == 3 and shape[0] == 1)
    if not rows_only or any(v.size > 1 for n, v in probe.outputs.items() if n != name):
        return None
    if not (shape[-1] == 6 or (shape[-1] == 7 and len(shape) == 2)) or shape[-2] > _MAX_LISTED:
        return _score_rows(probe)
    rows = _objects(probe.outputs[name])
    fits_none = len(rows) > 0 and not _fitting(rows)
    if fits_none and (scored := _score_rows(probe)):
        return scored
    seven = shape[-1] == 7
    by_ultralytics = probe.task == "detect" and not seven
    order = _USUAL if fits_none or by_ultralytics else _order_of(rows)
    decode = _RowDecoder(name, order, may_be_usual=not seven or bool(NAMED_NAS.search(probe.hint)))
    if order in (None, _CLASS_FIRST):
        n_classes = _named(probe) if seven else probe.n_names or 80
        bgr = None if seven else False
        return OutputLayout("rows of objects", n_classes, decode, None, suppressed=True, bgr=bgr)
    known = "YOLOv7 with NMS" if seven else "YOLOv10"
    pixels = None if len(probe.outputs) > 1 else UNIT_RGB
    return OutputLayout(known, probe.n_names or 80, decode, pixels, suppressed=True)


class _RowDecoder:
    """Decodes rows (K, 6), whose order of columns it remembers once a picture has shown it."""

    def __init__(self, name: str, order: str | None, may_be_usual: bool) -> None:
        self._name, self._order, self._may_be_usual = name, order, may_be_usual

    def __call__(self, outputs: Outputs, _: Size) -> Boxes:
        rows = _objects(outputs[self._name])
        self._order = self._order or _order_of(rows)
        order = self._order or _USUAL
        if len(rows) and order == _USUAL and not self._may_be_usual:
            raise Unclear(
                "answers rows of seven columns that end with score and class, as YOLO-NAS does with x first "
                "and EfficientDet with y; name the file as in my-yolo-nas.onnx if it is the former, else "
                "export it without NMS"
            )
        box, score, label = _ORDERS[order]
        return Boxes(rows[:, box], rows[:, score], whole(rows[:, label]))


def _objects(array: F32) -> F32:
    """Rows (K, 6) without the picture's number and without padding, whose values are all the same."""
    rows = array.reshape(-1, array.shape[-1])[:, -6:]
    return rows[np.any(rows != rows[:, :1], axis=1)]


def _fitting(rows: F32) -> list[str]:
    return [order for order in _ORDERS if len(rows) and _fits(rows, order)]


def _fits(rows: F32, order: str) -> bool:
    box, score, label = _ORDERS[order]
    corners, scores, labels = rows[:, box], rows[:, score], rows[:, label]
    return bool(
        np.all(labels % 1 == 0)
        and np.all(labels >= 0)
        and np.all(np.abs(scores - 0.5) <= 0.5)
        and np.mean(np.all(corners[:, 2:] >= corners[:, :2], axis=1)) >= _PLAUSIBLE
    )


def _order_of(rows: F32) -> str | None:
    """The order of the columns; None if none fits, or two that are the same for these rows.

    Raises Unclear if several fit otherwise.
    """
    fitting = _fitting(rows)
    if len(fitting) == 1:
        return fitting[0]
    if fitting and (_CLASS_FIRST in fitting or np.any(rows[:, 4] != rows[:, 5])):
        raise Unclear("answers rows whose columns may be read in several orders; export it without NMS")
    return None


def _score_rows(probe: Probe) -> OutputLayout | None:
    if len(probe.outputs) != 1 or not row_outputs(probe):
        return None
    name, rows, columns = row_outputs(probe)[0]
    if rows > _MAX_LISTED or columns - 4 != (probe.n_names or 80) or probe.task in ("obb", "pose"):
        return None
    found = probe.outputs[name][0]
    real = found[np.any(found[:, :4] != 0.0, axis=1)]
    if len(real) < _A_FEW or np.any(np.abs(found[:, 4:] - 0.5) > 0.5 + ROUNDING):
        return None
    if np.median(np.abs(real[:, :4]).max(axis=1)) > NORMALISED_MAX:
        return None
    if np.mean(np.all(real[:, 2:4] >= real[:, :2], axis=1)) >= _PLAUSIBLE:
        raise Unclear("answers rows that may hold corners or centre and size; export it without NMS")
    return OutputLayout(
        "RT-DETR rows",
        columns - 4,
        partial(_decode_score_rows, name),
        boxes="normalised",
        suppressed=True,
    )


def _decode_score_rows(name: str, outputs: Outputs, _: Size) -> Boxes:
    p = outputs[name][0]
    return best_class(xyxy_from_cxcywh(p[:, :4]), p[:, 4:])
