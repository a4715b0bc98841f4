"""Layouts that their outputs do not settle: read right, or refused in one true sentence, never silently."""

import numpy as np
import pytest
from onnx import TensorProto, helper
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
    rt_detr,
    scores,
    v8,
    v8_segment,
    v10,
    yolo_nas,
    yolox,
)

from skysweep.detection.coco import COCO_80, COCO_91
from skysweep.detection.grid_layouts import _YOLO3, _YOLO3_TINY, _YOLO4, _YOLO4_TINY
from skysweep.detection.layouts import cell_centres
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


def nanodet(strides):
    """A box that reaches 3 strides to every side of a cell's centre, which is that of the known box."""
    cells, steps = cell_centres((SIDE, SIDE), strides)
    centre = (cells + (0 if len(strides) == 4 else 0.5)) * steps
    a = np.zeros((1, len(cells), 112), np.float32)
    row = int(np.flatnonzero((steps[:, 0] == 16) & (np.abs(centre - CENTRE_SIZE[:2]) < 16).all(1))[0])
    sides = np.concatenate([centre[row] - CORNERS[:2], CORNERS[2:] - centre[row]]) / 16
    bins = np.full((4, 8), -40.0)
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


ULTRALYTICS = names_of(COCO_80)
RIGHT = {
    "v8, normalised": (v8_normalised(), {}),
    "v5, normalised": (rows_normalised({"output": objectness_rows(3 * N_CELLS, 0.9, 0.9)}, 3), {}),
    "yolox, normalised": (rows_normalised(yolox(), 1), {}),
    "v6, normalised": (
        rows_normalised({"output": objectness_rows(N_CELLS, 1.0, CONFIDENCE, background_objectness=1.0)}, 1),
        {},
    ),
    "nas, normalised": (nas_normalised(), {}),
    "v10, normalised": (v10_normalised(), {}),
    "one normalised row, told": (final(*(CORNERS / SIDE), CONFIDENCE, CLASS), {"boxes": "normalised"}),
    "class, then score": (final(*BOX, CLASS, CONFIDENCE), {}),
    "class first": (final(CLASS, CONFIDENCE, *BOX), {"pixels": "imagenet"}),
    "nas flat nms": (flat(0, *BOX, CONFIDENCE, CLASS), {}),
    "v7 flat nms": (flat(0, *BOX, CLASS, CONFIDENCE), {}),
    "paddle nms": (paddle_nms(), {"pixels": "imagenet"}),
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
        {"pixels": "imagenet", "boxes": "normalised", "metadata": names_of(COCO_FROM_1)},
    ),
    "torchvision": (torchvision(), {"pixels": "0..1", "metadata": names_of(COCO_91)}),
    "mmdeploy": (mmdeploy(), {"pixels": "imagenet"}),
    "mmdeploy, unbatched": (unbatched(mmdeploy()), {"pixels": "imagenet"}),
    "nanodet-plus": (nanodet((8, 16, 32, 64)), {}),
    "nanodet": (nanodet(STRIDES), {}),
    "v8 pose": (pose(), {"metadata": names_of(["stop sign"]) | {"task": "pose"}}),
    "v8 obb": (oriented(), {"metadata": names_of(["boat", "stop sign"]) | {"task": "obb"}}),
    "v8 segmentation, named": (v8_segment(), {"metadata": ULTRALYTICS}),
    "detr, named": (detr(81, CLASS, softmax=True), {"metadata": ULTRALYTICS}),
    "v5 grids (1, 255, h, w)": (raw_grids(_YOLO3, "chw", squared=True), {"name": "yolov5s"}),
    "v4 tiny": (raw_grids(_YOLO4_TINY, "chw", strides=(16, 32)), {"name": "yolov4-tiny"}),
    "v3, own anchors": (raw_grids(OWN_ANCHORS, "chw"), {"name": "yolov3", "anchors": OWN_ANCHORS}),
    "v5, own anchors": (raw_grids(OWN_ANCHORS, "ahwk", squared=True), {"anchors": OWN_ANCHORS}),
}


def model(tmp_path, outputs, *, metadata=None, name="model", anchors=None):
    path = constant_model(tmp_path / "m.onnx", outputs, metadata=metadata, name=name)
    if anchors is not None:
        numbers = [str(n) for stride in sorted(anchors) for pair in anchors[stride] for n in pair]
        path.with_suffix(".anchors").write_text(", ".join(numbers))
    return path


@pytest.mark.parametrize("case", RIGHT)
def test_read_right(case, tmp_path):
    outputs, told = RIGHT[case]
    settings = {k: told[k] for k in ("boxes", "pixels") if k in told}
    about = {k: v for k, v in told.items() if k not in settings}
    found = YoloDetector(model(tmp_path, outputs, **about), **settings).detect(frame())
    assert found.class_names == ("stop sign",)
    np.testing.assert_allclose(found.boxes_xyxy_px, [BOX], atol=0.05)
    np.testing.assert_allclose(found.confidences, [CONFIDENCE], atol=1e-3)


def logits():
    return {"output0": np.where(v8()["output0"] == 0, -9, 3).astype(np.float32)}


REFUSED = {
    "one normalised row": (final(*(CORNERS / SIDE), CONFIDENCE, CLASS), {}, "detector.boxes: normalised"),
    "scores first": (scores_first(), {}, "detector.pixels: 0..255, 0..1 or imagenet"),
    "pp-yoloe": (pp_yoloe(), {}, "detector.pixels"),
    "paddle nms": (paddle_nms(), {}, "detector.pixels"),
    "mmdeploy": (mmdeploy(), {}, "detector.pixels"),
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
    "pose without its task": (pose(), {}, "52 classes but names none.*export the model for detection"),
    "obb without its task": (
        oriented(),
        {"metadata": names_of(["boat", "stop sign"])},
        "3 classes but names 2.*export the model for detection",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_one_sentence(case, tmp_path):
    outputs, about, why = REFUSED[case]
    path = model(tmp_path, outputs, **about)
    with pytest.raises(UserError, match=rf"m\.onnx: .*{why}") as refused:
        YoloDetector(path).detect(frame())
    assert "\n" not in str(refused.value)


def test_a_model_of_bytes_is_not_asked_for_its_pixels(tmp_path):
    path = constant_model(
        tmp_path / "m.onnx", tensorflow(), input_shape=(1, "h", "w", 3), input_type=TensorProto.UINT8
    )
    assert YoloDetector(path).detect(frame()).class_names == ("stop sign",)


def test_deim_answers_without_a_batch(tmp_path):
    size = helper.make_tensor_value_info("orig_target_sizes", TensorProto.INT64, (1, 2))
    path = constant_model(tmp_path / "m.onnx", unbatched(rt_detr()), extra_inputs=[size])
    np.testing.assert_allclose(YoloDetector(path).detect(frame()).boxes_xyxy_px, [BOX], atol=0.05)


def test_pixel_boxes_may_be_insisted_on(tmp_path):
    path = model(tmp_path, final(0.2, 0.2, 1.9, 1.9, CONFIDENCE, CLASS))
    found = YoloDetector(path, boxes="pixels").detect(frame())
    np.testing.assert_allclose(found.boxes_xyxy_px, [[0.2, 0.2, 1.9, 1.9]], atol=1e-5)


def test_boxes_built_from_grids_have_no_unit_to_set(tmp_path):
    path = model(tmp_path, raw_grids(_YOLO3, "chw"), name="yolov3")
    with pytest.raises(UserError, match=r"YOLOv3 grids are computed in pixels; delete detector\.boxes"):
        YoloDetector(path, boxes="normalised")


def test_v10_in_pixels_is_as_before(tmp_path):
    found = YoloDetector(model(tmp_path, v10())).detect(frame())
    np.testing.assert_allclose(found.boxes_xyxy_px, [BOX])
