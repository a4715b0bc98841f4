"""Layouts that their outputs do not settle: read right, or refused in one true sentence, never silently."""

from dataclasses import replace

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from test_yolo_outputs import (
    BOX,
    CENTRE_SIZE,
    CLASS,
    CONFIDENCE,
    N_CELLS,
    SIDE,
    STRIDES,
    constant_model,
    detr,
    frame,
    objectness_rows,
    raw_grids,
    rf_detr,
    rt_detr,
    scores,
    v7_end_to_end,
    v8,
    v8_segment,
    v10,
    yolo_nas,
    yolox,
)

from skysweep.detection.coco import COCO_80, COCO_91
from skysweep.detection.grid_layouts import _YOLO3, _YOLO3_TINY, _YOLO4, _YOLO4_SCALE_XY, _YOLO4_TINY
from skysweep.detection.layouts import Unclear, cell_centres
from skysweep.detection.listed_layouts import _RowDecoder
from skysweep.detection.model_trial import vouch_for
from skysweep.detection.yolo import YoloDetector
from skysweep.errors import UserError

CORNERS = np.array(BOX)
CELLS, STEPS = cell_centres((SIDE, SIDE), STRIDES)
CENTRES = (CELLS + 0.5) * STEPS
EVERYWHERE = np.concatenate([CENTRES, 2 * STEPS, 2 * STEPS], axis=1).astype(np.float32)  # centre and size
OWN_ANCHORS = {8: ((5, 6), (9, 8), (11, 17)), 16: ((20, 21), (33, 50), (48, 31)), 32: ((60, 61),) * 3}
COCO_FROM_1 = ("background", *COCO_80)


def names_of(names):
    return {"names": str(dict(enumerate(names)))}


def array(*rows):
    return np.array(rows, np.float32)


def v8_normalised():
    a = v8()["output0"].copy()
    a[0, :4, 1:] = EVERYWHERE.T[:, 1:]
    a[0, :4] /= SIDE
    return {"output0": a}


def rows_normalised(outputs, per_cell):
    """Decoded rows of centre and size in 0..1, with a plausible box in each cell."""
    (name, a), *_ = outputs.items()
    a = a.copy()
    a[0, :, :4] = np.where(a[..., 5 + CLASS, None][0] > 0, a[0, :, :4], np.tile(EVERYWHERE, (per_cell, 1)))
    a[0, :, :4] /= SIDE
    return {name: a}


def nas_normalised(order=("a", "b")):
    boxes = np.concatenate([CENTRES - STEPS, CENTRES + STEPS], axis=1)
    boxes[0] = BOX
    a = {"a": (boxes / SIDE).astype(np.float32)[None], "b": scores(N_CELLS)[None]}
    return {k: a[k] for k in order}


def scores_first():
    return dict(reversed(yolo_nas().items()))


def v10_normalised():
    a = np.zeros((1, 300, 6), np.float32)
    a[0, :, :4] = np.linspace(0.1, 0.8, 300)[:, None] + array(0, 0, 0.1, 0.1)
    a[0, :, 4] = 0.01
    a[0, 0] = [*(CORNERS / SIDE), CONFIDENCE, CLASS]
    return {"output0": a}


def final(*row):
    a = np.zeros((1, 100, 6), np.float32)
    a[0, 0] = row
    return {"output0": a}


def tensorflow(n=100, class_id=13, names=("detection_boxes", "detection_classes", "detection_scores")):
    boxes, labels, confidence = np.zeros((1, n, 4)), np.ones((1, n)), np.zeros((1, n))
    boxes[0, 0], labels[0, 0], confidence[0, 0] = CORNERS[[1, 0, 3, 2]] / SIDE, class_id, CONFIDENCE
    parts = (np.asarray(x, np.float32) for x in (boxes, labels, confidence))
    return dict(zip(names, parts, strict=True)) | {"num_detections": array(n)}


def zoo_ssd():
    others = [[k / 40, k / 40, 0.3, 0.4] for k in range(9)]
    return {
        "bboxes": array(CORNERS / SIDE, *others)[None],
        "labels": np.array([[CLASS + 1, *[1] * 9]]),
        "scores": array([CONFIDENCE, *[0] * 9]),
    }


def torchvision():
    return {
        "boxes": array(BOX, (1, 2, 30, 40)),
        "labels": np.array([13, 1]),
        "scores": array(CONFIDENCE, 0.1).ravel(),
    }


def unbatched(outputs):
    return {name: a[0] for name, a in outputs.items()}


def mmdeploy():
    dets = np.zeros((1, 50, 5), np.float32)
    dets[0, 0] = [*BOX, CONFIDENCE]
    return {"dets": dets, "labels": np.full((1, 50), CLASS)}


def pp_yoloe():
    return {"boxes": yolo_nas()["a"], "scores": scores(N_CELLS).T[None].copy()}


def paddle_nms():
    return {
        "rows": array([CLASS, CONFIDENCE, *BOX], [0, 0.1, 3, 4, 50, 60]),
        "count": np.array([2], np.int32),
    }


def far_out(outputs, where):
    """One box of no score that reaches beyond any picture."""
    ((name, a),) = outputs.items()
    a = a.copy()
    a[where] = [0.95, 0.5, 2.3, 0.2]
    return {name: a}


def counted(*names):
    """Count, boxes, scores and labels under these names."""
    return dict(zip(names, v7_end_to_end().values(), strict=True))


def nanodet(strides, n_bins=8):
    """A box that reaches 3 strides to every side of a cell's centre, which is that of the known box."""
    cells, steps = cell_centres((SIDE, SIDE), strides)
    centre = (cells + (0 if len(strides) == 4 else 0.5)) * steps
    a = np.zeros((1, len(cells), 80 + 4 * n_bins), np.float32)
    row = int(np.flatnonzero((steps[:, 0] == 16) & (np.abs(centre - CENTRE_SIZE[:2]) < 16).all(1))[0])
    sides = np.concatenate([centre[row] - CORNERS[:2], CORNERS[2:] - centre[row]]) / 16
    bins = np.full((4, n_bins), -40.0)
    for side, at in zip(bins, sides, strict=True):
        low = int(at)
        side[low], side[low + 1] = np.log(1 - at % 1), np.log(at % 1 + 1e-20)
    a[0, row, CLASS], a[0, row, 80:] = CONFIDENCE, bins.ravel()
    return {"output": a}


def pose():
    a = np.zeros((1, 56, N_CELLS), np.float32)
    a[0, :5, 0], a[0, 5:, 0] = [*CENTRE_SIZE, CONFIDENCE], 99.0
    return {"output0": a}


def oriented():
    a = np.zeros((1, 4 + 2 + 1, N_CELLS), np.float32)
    a[0, :4, 0] = *CENTRE_SIZE[:2], 70, 40  # turned by 90 degrees
    a[0, 5, 0], a[0, 6, 0] = CONFIDENCE, np.pi / 2
    return {"output0": a}


def flat(*row):
    return {"rows": array(row, (0, 3, 4, 60, 70, *((0.1, 2) if row[6] == CLASS else (2, 0.1))))}


def openvino():
    """Picture, label from 1, score, box in 0..1."""
    return {"rows": array((0, CLASS + 1, CONFIDENCE, *(CORNERS / SIDE)), (0, 3, 0.1, 0.2, 0.2, 0.3, 0.4))}


def v5_segment():
    rows = objectness_rows(3 * N_CELLS, 0.9, 0.9)
    masks = np.full((1, 3 * N_CELLS, 32), 3.0, np.float32)  # larger than any class score
    prototypes = np.zeros((1, 32, SIDE // 4, SIDE // 4), np.float32)
    return {"output0": np.concatenate([rows, masks], axis=2), "output1": prototypes}


def v5_face():
    """Centre, size, objectness, five points, one class."""
    a = np.zeros((1, 3 * N_CELLS, 16), np.float32)
    a[0, :, 5:15] = 100.0
    return {"output": a}


def two_heads(name, values):
    return {"aux": np.zeros_like(values), name: values}


def oriented_rows(class_id=1, angle=0.5):
    """YOLO26 with oriented boxes: centre, size, score, class, angle."""
    a = np.zeros((1, 300, 7), np.float32)
    a[0, 0] = [*CENTRE_SIZE, CONFIDENCE, class_id, angle]
    return {"output0": a}


THREE = names_of(["person", "boat", "stop sign"])
NOTHING_YET = {"rows": np.zeros((1, 300, 6), np.float32)}
NOTHING_YET_OF_7 = {"rows": np.zeros((0, 7), np.float32)}
ULTRALYTICS = names_of(COCO_80)
RIGHT = {
    "v8, normalised": (v8_normalised(), {}),
    "v5, normalised": (rows_normalised({"output": objectness_rows(3 * N_CELLS, 0.9, 0.9)}, 3), {}),
    "yolox, normalised": (rows_normalised(yolox(), 1), {}),
    "v6, normalised": (
        rows_normalised({"output": objectness_rows(N_CELLS, 1.0, CONFIDENCE, background_objectness=1.0)}, 1),
        {},
    ),
    "nas, normalised": (nas_normalised(), {"name": "yolo_nas_s"}),
    "boxes and scores, told": (yolo_nas(), {"pixels": "0..255"}),
    "v10, normalised": (v10_normalised(), {}),
    "one normalised row, told": (final(*(CORNERS / SIDE), CONFIDENCE, CLASS), {"boxes": "normalised"}),
    "class, then score": (final(*BOX, CLASS, CONFIDENCE), {}),
    "class first": (final(CLASS, CONFIDENCE, *BOX), {"pixels": "imagenet"}),
    "nas flat nms": (flat(0, *BOX, CONFIDENCE, CLASS), {"name": "yolo_nas_s"}),
    "v7 flat nms": (flat(0, *BOX, CLASS, CONFIDENCE), {}),
    "paddle nms": (paddle_nms(), {"pixels": "imagenet"}),
    "openvino, told": (
        openvino(),
        {"pixels": "0..255", "channels": "bgr", "boxes": "normalised", "metadata": names_of(COCO_FROM_1)},
    ),
    "pp-yoloe without nms": (pp_yoloe(), {"pixels": "0..1"}),
    "damo-yolo, told": (scores_first(), {"pixels": "0..255"}),
    "tensorflow ssd": (tensorflow(), {"pixels": "0..255"}),
    "tensorflow ssd, own names": (
        tensorflow(class_id=2) | {"num_detections": array(1)},
        {"pixels": "0..1", "metadata": names_of(["boat", "stop sign"])},
    ),
    "tensorflow with ports": (
        tensorflow(names=("detection_boxes:0", "detection_classes:0", "detection_scores:0")),
        {"pixels": "0..255"},
    ),
    "zoo ssd, told": (
        zoo_ssd(),
        {
            "pixels": "imagenet",
            "channels": "rgb",
            "boxes": "normalised",
            "metadata": names_of(COCO_FROM_1),
        },
    ),
    "torchvision": (
        torchvision(),
        {"pixels": "0..1", "channels": "rgb", "metadata": names_of(COCO_91)},
    ),
    "a count, of no known family": (
        counted("num_dets", "boxes", "scores", "labels"),
        {"pixels": "0..255", "channels": "bgr", "metadata": ULTRALYTICS},
    ),
    "v8, normalised, one box without a score far out": (far_out(v8_normalised(), (0, slice(4), 50)), {}),
    "v5, normalised, one box without a score far out": (
        far_out(rows_normalised({"output": objectness_rows(3 * N_CELLS, 0.9, 0.9)}, 3), (0, 77, slice(4))),
        {},
    ),
    "nanodet of eleven bins": (nanodet(STRIDES, n_bins=11), {}),
    "mmdeploy": (mmdeploy(), {"pixels": "imagenet", "channels": "bgr"}),
    "mmdeploy, unbatched": (unbatched(mmdeploy()), {"pixels": "imagenet", "channels": "rgb"}),
    "nanodet-plus": (nanodet((8, 16, 32, 64)), {}),
    "nanodet": (nanodet(STRIDES), {}),
    "v8 pose": (pose(), {"metadata": names_of(["stop sign"]) | {"task": "pose"}}),
    "v8 obb": (oriented(), {"metadata": names_of(["boat", "stop sign"]) | {"task": "obb"}}),
    "v5 segmentation": (v5_segment(), {"metadata": ULTRALYTICS}),
    "v8 segmentation, named": (v8_segment(), {"metadata": ULTRALYTICS}),
    "detr, named": (detr(81, CLASS, softmax=True), {"metadata": ULTRALYTICS}),
    "rt-detr of hugging face": (detr(80, CLASS, softmax=False), {"pixels": "0..1"}),
    "rf-detr, a name for each column": (
        rf_detr(3, 2),
        {"metadata": names_of(["none", "boat", "stop sign"])},
    ),
    "v5 grids (1, 255, h, w)": (raw_grids(_YOLO3, "chw", squared=True), {"name": "yolov5s"}),
    "v4 tiny": (raw_grids(_YOLO4_TINY, "chw", strides=(16, 32)), {"name": "yolov4-tiny"}),
    "v7 tiny, which has the anchors of v5": (
        raw_grids(_YOLO3, "ahwk", squared=True),
        {"name": "yolov7-tiny"},
    ),
    "v4 of its backbone's name": (
        raw_grids(_YOLO4, "chw", scale=_YOLO4_SCALE_XY),
        {"name": "yolov4-cspdarknet53"},
    ),
    "v3, own anchors": (raw_grids(OWN_ANCHORS, "chw"), {"name": "yolov3", "anchors": OWN_ANCHORS}),
    "v5, own anchors": (raw_grids(OWN_ANCHORS, "ahwk", squared=True), {"anchors": OWN_ANCHORS}),
}


def model(tmp_path, outputs, *, metadata=None, name="model", anchors=None):
    path = constant_model(tmp_path / "m.onnx", outputs, metadata=metadata, name=name)
    if anchors is not None:
        numbers = [str(n) for stride in sorted(anchors) for pair in anchors[stride] for n in pair]
        path.with_suffix(".anchors").write_text(", ".join(numbers))
    return path


def split(told):
    """What is of the file, and what of the detector's settings."""
    settings = {k: told[k] for k in ("boxes", "pixels", "channels") if k in told}
    return {k: v for k, v in told.items() if k not in settings}, settings


@pytest.mark.parametrize("case", RIGHT)
def test_read_right(case, tmp_path):
    outputs, told = RIGHT[case]
    about, settings = split(told)
    found = YoloDetector(model(tmp_path, outputs, **about), **settings).detect(frame())
    assert found.class_names == ("stop sign",)
    np.testing.assert_allclose(found.boxes_xyxy_px, [BOX], atol=0.05)
    np.testing.assert_allclose(found.confidences, [CONFIDENCE], atol=1e-3)


def logits():
    return {"output0": np.where(v8()["output0"] == 0, -9, 3).astype(np.float32)}


def through_sigmoid(grids):
    return {name: (1 / (1 + np.exp(-a))).astype(np.float32) for name, a in grids.items()}


def v8_heads(n_classes):
    return {f"head{s}": np.full((1, 64 + n_classes, SIDE // s, SIDE // s), -5, np.float32) for s in STRIDES}


IN_CELLS = {s: [(w / s, h / s) for w, h in pairs] for s, pairs in _YOLO3.items()}
LARGEST_FIRST = dict(zip(STRIDES, reversed(_YOLO3.values()), strict=True))


def probabilities(outputs, name):
    return outputs | {name: (1 / (1 + np.exp(-outputs[name]))).astype(np.float32)}


def corners_and_score():
    a = np.zeros((1, 100, 5), np.float32)
    a[0, :, :4] = EVERYWHERE[:100] / SIDE
    a[0, :, 2:4] += a[0, :, :2]
    a[0, 0] = [*(CORNERS / SIDE), CONFIDENCE]
    return {"rows": a}


def padded_rows(*row):
    a = np.zeros((1, 100, len(row)), np.float32)
    a[0, 0] = row
    return {"rows": a}


REFUSED = {
    "rows of seven, y or x first": (
        flat(0, *BOX, CONFIDENCE, CLASS),
        {},
        "as YOLO-NAS does with x first and EfficientDet with y",
    ),
    "a count, of no known family": (
        counted("num_dets", "boxes", "scores", "labels"),
        {"metadata": ULTRALYTICS},
        "detector.pixels: .* and detector.channels: rgb or bgr$",
    ),
    "boxes of either order": (
        counted("valid", "nmsed_boxes", "nmsed_scores", "nmsed_classes"),
        {"metadata": ULTRALYTICS},
        "some exports have x first and others y",
    ),
    "tensorflow's names for pixels": (
        tensorflow() | {"detection_boxes": array(BOX)[None].repeat(100, 1)},
        {"pixels": "0..1"},
        "detection_boxes in pixels, in which some exports have x first",
    ),
    "detr with softmax": (
        probabilities(detr(92, 13, softmax=True), "logits"),
        {},
        "answers probabilities .logits. where DETR has logits",
    ),
    "rf-detr with sigmoid": (probabilities(rf_detr(91, 13), "labels"), {}, "export it without its last"),
    "corners and one score": (
        corners_and_score(),
        {"metadata": names_of(["person"])},
        "may hold corners or centre and size",
    ),
    "one row of corners and score": (
        padded_rows(*BOX, CONFIDENCE),
        {"metadata": names_of(["person"])},
        "none of the layouts known",
    ),
    "oriented rows of class 0 or 1": (oriented_rows(), {"metadata": THREE}, "none of the layouts known"),
    "rows of five or six numbers": (
        {"output": np.full((1, N_CELLS, 6), 0.3, np.float32)},
        {},
        r"1 classes \(YOLOX, YOLOv6\) or of 2 \(YOLOv8, transposed\), and names none",
    ),
    "eighty classes of one's own, anchors of COCO": (
        raw_grids(_YOLO3, "ahwk", squared=True),
        {"name": "yolov5", "metadata": names_of([f"kind {k}" for k in range(80)])},
        "does not hold their anchors",
    ),
    "pixels, told that they are shares": (
        {"output0": v8_normalised()["output0"] * array(*[SIDE] * 4, *[1] * 80)[:, None]},
        {"boxes": "normalised"},
        "answers boxes that are pixels; leave out detector.boxes",
    ),
    "grids through a sigmoid, 5 axes": (
        through_sigmoid(raw_grids(_YOLO3, "ahwk", squared=True)),
        {"name": "yolov5s"},
        "have been through a sigmoid",
    ),
    "grids through a sigmoid, 4 axes": (
        through_sigmoid(raw_grids(_YOLO3, "chw", squared=True)),
        {"name": "yolov5s"},
        "have been through a sigmoid",
    ),
    **{
        f"scaled v4, {name}": (raw_grids(_YOLO4, axes, squared=True), {"name": name}, "scaled YOLOv4")
        for name, axes in {"yolov4-csp": "chw", "yolov4-p5": "ahwk", "yolov4x-mish": "chw"}.items()
    },
    "v4 tiny of three grids": (
        raw_grids(_YOLO4, "chw"),
        {"name": "yolov4-tiny-3l"},
        "3 raw grids of YOLOv4 tiny, whose anchors are not known",
    ),
    "a version of one's own": (
        raw_grids(_YOLO3, "chw"),
        {"name": "stop-signs-v3"},
        "may be those of YOLOv3, v4",
    ),
    "a number of classes": (
        raw_grids(_YOLO3, "chw"),
        {"name": "yolo_4classes"},
        "may be those of YOLOv3, v4",
    ),
    "anchors in cells": (
        raw_grids(_YOLO3, "ahwk", squared=True),
        {"name": "yolov5", "anchors": IN_CELLS},
        r"at least a cell of the coarsest \(32 pixels\); .* in pixels, not in cells",
    ),
    "anchors, largest first": (
        raw_grids(_YOLO3, "ahwk", squared=True),
        {"name": "yolov5", "anchors": LARGEST_FIRST},
        "do not grow from grid to grid .* smallest first",
    ),
    "v8 heads": (v8_heads(80), {"name": "yolov8n"}, r"raw heads of 64 \+ 80 channels, as YOLOv8"),
    "v8 heads, named v5": (v8_heads(80), {"name": "yolov5nu"}, r"raw heads of 64 \+ 80 channels"),
    "v8 heads, own classes": (
        v8_heads(2),
        {"metadata": names_of(["boat", "stop sign"])},
        r"raw heads of 64 \+ 2 channels",
    ),
    "v8 heads, own classes without names": (v8_heads(2), {}, r"names no classes; .*\.names"),
    "grids of other classes than named": (
        raw_grids(_YOLO3, "ahwk"),
        {"metadata": names_of(["boat"])},
        "80 classes, and 1 are named",
    ),
    "one normalised row": (
        final(*(CORNERS / SIDE), CONFIDENCE, CLASS),
        {},
        "detector.boxes: normalised .*detector.boxes: pixels",
    ),
    "scores first": (scores_first(), {}, "detector.pixels: 0..255, 0..1 or imagenet"),
    "pp-yoloe": (pp_yoloe(), {}, "detector.pixels"),
    "paddle nms": (paddle_nms(), {}, "detector.pixels"),
    "mmdeploy": (
        mmdeploy(),
        {},
        "detector.pixels: .* and detector.channels: rgb or bgr$",
    ),
    "boxes first, of no name": (yolo_nas(), {}, r"detector.pixels: .* deviation\)$"),
    "boxes first, of another name": (yolo_nas(), {"name": "nasa-boats"}, "detector.pixels"),
    "tensorflow of floats": (tensorflow(), {}, "detector.pixels"),
    "torchvision": (torchvision(), {}, "does not say whether its labels count from 0"),
    "zoo ssd": (zoo_ssd(), {}, "does not say whether its labels count from 0"),
    "named zoo ssd": (zoo_ssd(), {"metadata": names_of(COCO_FROM_1)}, "detector.pixels"),
    "scores and classes of 0 and 1": (final(*BOX, 1, 0), {}, "read in several orders"),
    "logits": (logits(), {}, "answers scores below 0"),
    "a broken class number": (final(*BOX, 0.5, 0.25), {}, "no whole number"),
    "v3 or v5": (raw_grids(_YOLO3, "chw"), {}, "may be those of YOLOv3, v4, v5 or v7"),
    "v5 or v7": (raw_grids(_YOLO4, "ahwk", squared=True), {}, "may be those of YOLOv5 or v7"),
    "tiny v3 or v4": (raw_grids(_YOLO3_TINY, "chw", strides=(16, 32)), {}, "may be those of YOLOv3"),
    "own classes, anchors unknown": (
        {k: a[:, :, :, :, :8].copy() for k, a in raw_grids(_YOLO3, "ahwk", squared=True).items()},
        {"name": "yolov5"},
        r"does not hold their anchors.*\.anchors",
    ),
    "too few anchors": (
        raw_grids(_YOLO3, "chw"),
        {"name": "yolov3", "anchors": {8: OWN_ANCHORS[8]}},
        "holds 6 numbers; write 18",
    ),
    "rt-detr of hugging face": (detr(80, CLASS, softmax=False), {}, "detector.pixels"),
    "rt-detr of hugging face, own classes": (
        detr(2, 1, softmax=False),
        {"metadata": names_of(["boat", "stop sign"])},
        "detector.pixels",
    ),
    "rf-detr, a column left over": (
        rf_detr(3, 2),
        {"metadata": names_of(["boat", "stop sign"])},
        r"3 columns of scores for 2 named classes; write a name for each column.*\.names",
    ),
    "rf-detr of COCO, 90 names": (
        rf_detr(91, 13),
        {"metadata": names_of(COCO_91[1:])},
        "91 columns of scores for 90 named classes",
    ),
    "deformable detr, 90 names": (
        detr(91, 13, softmax=False),
        {"metadata": names_of(COCO_91[1:])},
        "91 columns of scores for 90 named classes",
    ),
    "rows that a blank picture leaves out": (NOTHING_YET, {}, "detector.pixels"),
    "seven columns that a blank picture leaves out": (
        NOTHING_YET_OF_7,
        {"metadata": ULTRALYTICS},
        "detector.pixels: .* and detector.channels",
    ),
    "seven columns that a blank picture leaves out, unnamed": (
        NOTHING_YET_OF_7,
        {},
        "does not say whether its labels count from 0",
    ),
    "openvino": (openvino(), {}, "does not say whether its labels count from 0"),
    "openvino, named": (openvino(), {"metadata": names_of(COCO_FROM_1)}, "detector.channels: rgb or bgr"),
    "rows of oriented boxes": (
        oriented_rows(),
        {"metadata": THREE | {"task": "obb"}},
        "none of the layouts known",
    ),
    "rows of oriented boxes without their task": (
        oriented_rows(class_id=2),
        {"metadata": THREE},
        "none of the layouts known",
    ),
    "v5 with faces' points": (v5_face(), {"metadata": names_of(["face"])}, "key points"),
    "two heads of v8": (two_heads("main", v8()["output0"]), {}, "answers aux and main of one shape"),
    "two heads of v5": (
        two_heads("main", objectness_rows(3 * N_CELLS, 0.9, 0.9)),
        {},
        "answers aux and main of one shape",
    ),
    "two heads of yolox": (two_heads("main", yolox()["output"]), {}, "answers aux and main of one shape"),
    "two heads of nanodet": (
        two_heads("main", nanodet(STRIDES)["output"]),
        {},
        "answers aux and main of one shape",
    ),
    "four classes and four sides": (
        {name: a[..., :4].copy() for name, a in yolo_nas().items()},
        {},
        "a and b of one shape .* which of them holds the boxes",
    ),
    "classes numbered from 1": (
        final(*BOX, CONFIDENCE, 1),
        {"metadata": {"names": str({1: "boat", 2: "stop sign"})}},
        r"not numbered 0, 1, 2 and so on; .* into m\.names",
    ),
    "classes with a gap": (
        final(*BOX, CONFIDENCE, 1),
        {"metadata": {"names": str({0: "boat", 2: "stop sign"})}},
        "not numbered 0, 1, 2",
    ),
    "pose without its task": (pose(), {}, "52 classes but names none.*export the model for detection"),
    "obb without its task": (
        oriented(),
        {"metadata": names_of(["boat", "stop sign"])},
        "3 classes but names 2.*export the model for detection",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_one_sentence(case, tmp_path):
    outputs, told, why = REFUSED[case]
    about, settings = split(told)
    path = model(tmp_path, outputs, **about)
    with pytest.raises(UserError, match=rf"m\.onnx: .*{why}") as refused:
        YoloDetector(path, **settings).detect(frame())
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("outputs", "numbers", "why"),
    [
        (v8(), "1 2 3 4 5 6", r"m\.anchors: YOLOv8 .*takes no anchors; delete or rename this file$"),
        (raw_grids(_YOLO3, "chw"), "10 13 -16 30", r"m\.anchors: write only the anchors' widths .* above 0$"),
        (raw_grids(_YOLO3, "chw"), "10 13 wide", r"m\.anchors: write only the anchors' widths .* above 0$"),
        (
            raw_grids(_YOLO3, "chw"),
            " ".join(str(n) for n in range(18, 0, -1)),
            r"m\.onnx: .* do not grow from grid to grid",
        ),
    ],
    ids=["none needed", "negative", "a word", "largest first"],
)
def test_wrong_anchors_are_one_sentence(outputs, numbers, why, tmp_path):
    path = model(tmp_path, outputs, name="yolov3", metadata=names_of(COCO_80))
    path.with_suffix(".anchors").write_text(numbers)
    with pytest.raises(UserError, match=why) as refused:
        YoloDetector(path)
    assert "\n" not in str(refused.value)


def rows_of(brightness, path, metadata=None):
    """A model that answers rows (K, 6) by the brightness of the picture, 0..255, and else none."""
    nodes, inits = [helper.make_node("ReduceMax", ["images"], ["lightest"], keepdims=0)], {}
    for value, rows in brightness.items():
        low, high = (np.float32((value + step) / 255) for step in (-0.5, 0.5))
        inits |= {f"low{value}": low, f"high{value}": high, f"rows{value}": array(*rows)}
        nodes += [
            helper.make_node("Greater", ["lightest", f"low{value}"], [f"above{value}"]),
            helper.make_node("Less", ["lightest", f"high{value}"], [f"below{value}"]),
            helper.make_node("And", [f"above{value}", f"below{value}"], [f"so{value}"]),
            helper.make_node("Expand", [f"so{value}", f"n{value}"], [f"all{value}"]),
            helper.make_node("Compress", [f"rows{value}", f"all{value}"], [f"some{value}"], axis=0),
        ]
        inits[f"n{value}"] = np.array([len(rows)])
    nodes.append(helper.make_node("Concat", [f"some{value}" for value in brightness], ["rows"], axis=0))
    graph = helper.make_graph(
        nodes,
        "model",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, SIDE, SIDE))],
        [helper.make_tensor_value_info("rows", TensorProto.FLOAT, ("k", 6))],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in inits.items()],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(made, metadata or {})
    onnx.save(made, path)
    vouch_for(path)
    return path


def shown(brightness):
    return replace(frame(), image=np.full((SIDE, SIDE, 3), brightness, np.uint8))


CERTAIN = [(*BOX, 1, 0)]  # of score 1 and class 0, or of class 1 and score 0


def test_the_order_of_columns_is_remembered(tmp_path):
    path = rows_of({90: [(*BOX, CONFIDENCE, CLASS)], 50: CERTAIN}, tmp_path / "m.onnx")
    detector = YoloDetector(path, pixels="0..1")
    with pytest.raises(UserError, match="read in several orders"):
        detector.detect(shown(50))
    assert detector.detect(shown(90)).class_names == ("stop sign",)
    found = detector.detect(shown(50))
    assert (found.class_names, list(found.confidences)) == (("person",), [1.0])


def test_rows_by_ultralytics_are_known_without_any(tmp_path):
    path = rows_of({50: CERTAIN}, tmp_path / "m.onnx", ULTRALYTICS | {"task": "detect"})
    assert YoloDetector(path).detect(shown(50)).class_names == ("person",)


def test_a_model_of_bytes_is_not_asked_for_its_pixels(tmp_path):
    path = constant_model(
        tmp_path / "m.onnx", tensorflow(), input_shape=(1, "h", "w", 3), input_type=TensorProto.UINT8
    )
    assert YoloDetector(path).detect(frame()).class_names == ("stop sign",)


def test_deim_answers_without_a_batch(tmp_path):
    size = helper.make_tensor_value_info("orig_target_sizes", TensorProto.INT64, (1, 2))
    path = constant_model(tmp_path / "m.onnx", unbatched(rt_detr()), extra_inputs=[size])
    np.testing.assert_allclose(YoloDetector(path).detect(frame()).boxes_xyxy_px, [BOX], atol=0.05)


def test_the_picture_need_not_be_the_first_input(tmp_path):
    shape, scale = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, (1, 2))
        for name in ("im_shape", "scale_factor")
    )
    path = constant_model(
        tmp_path / "m.onnx", paddle_nms(), first_inputs=[shape], extra_inputs=[scale], metadata=ULTRALYTICS
    )
    assert YoloDetector(path, pixels="imagenet").detect(frame()).class_names == ("stop sign",)


def test_pixel_boxes_may_be_insisted_on(tmp_path):
    path = model(tmp_path, final(0.2, 0.2, 1.9, 1.9, CONFIDENCE, CLASS))
    found = YoloDetector(path, boxes="pixels").detect(frame())
    np.testing.assert_allclose(found.boxes_xyxy_px, [[0.2, 0.2, 1.9, 1.9]], atol=1e-5)


def test_pixels_that_were_called_normalised_are_noticed_in_the_first_picture(tmp_path):
    """The blank picture shows none, and all of them fell outside of every picture: nothing was found."""
    path = rows_of({90: [(*BOX, CONFIDENCE, CLASS)]}, tmp_path / "m.onnx")
    detector = YoloDetector(path, pixels="0..1", boxes="normalised")
    with pytest.raises(UserError, match=r"answers boxes that are pixels; leave out detector\.boxes"):
        detector.detect(shown(90))


def test_padding_does_not_tell_the_unit(tmp_path):
    rows = np.full((1, 100, 6), -1.0, np.float32)
    rows[0, :25, :4] = np.arange(25)[:, None] + array(*BOX)
    rows[0, :25, 4:] = CONFIDENCE, CLASS
    found = YoloDetector(model(tmp_path, {"output0": rows})).detect(frame())
    np.testing.assert_allclose(found.boxes_xyxy_px[:1], [BOX], atol=25.0)


def test_seven_columns_that_fit_several_orders_are_not_taken_for_one():
    rows = {"rows": array((0, *BOX, 1, 1))}
    with pytest.raises(Unclear, match="seven columns"):
        _RowDecoder("rows", None, may_be_usual=False)(rows, (SIDE, SIDE))


def test_boxes_built_from_grids_have_no_unit_to_set(tmp_path):
    path = model(tmp_path, raw_grids(_YOLO3, "chw"), name="yolov3")
    with pytest.raises(UserError, match=r"YOLOv3 grids are computed in pixels; leave out detector\.boxes"):
        YoloDetector(path, boxes="normalised")


def test_v10_in_pixels_is_as_before(tmp_path):
    found = YoloDetector(model(tmp_path, v10())).detect(frame())
    np.testing.assert_allclose(found.boxes_xyxy_px, [BOX])
