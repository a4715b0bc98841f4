"""Each layout of the YOLO family: a tiny ONNX file that answers with one known box must give that box."""

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from skysweep.detection.coco import COCO_80, COCO_91
from skysweep.detection.grid_layouts import (
    _YOLO3,
    _YOLO3_TINY,
    _YOLO4,
    _YOLO4_SCALE_XY,
)
from skysweep.detection.layouts import cell_centres
from skysweep.detection.model_trial import vouch_for
from skysweep.detection.yolo import YoloDetector
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.types import Frame

SIDE = 320
BOX = (100.0, 60.0, 140.0, 130.0)  # x0, y0, x1, y1
CENTRE_SIZE = np.array([120.0, 95.0, 40.0, 70.0])
CLASS, CONFIDENCE = 11, 0.81
STRIDES = (8, 16, 32)
N_CELLS = sum((SIDE // s) ** 2 for s in STRIDES)


def frame(side=SIDE):
    pose = CameraPose(np.array([1.0, 2.0, 30.0]), np.eye(3))
    return Frame(12.5, np.full((side, side, 3), 90, np.uint8), pose, Lens(side, side, 1.0))


def constant_model(
    path,
    outputs,
    *,
    metadata=None,
    input_shape=(1, 3, SIDE, SIDE),
    name="model",
    extra_inputs=(),
    first_inputs=(),
    input_type=TensorProto.FLOAT,
):
    """An ONNX file that answers ``outputs`` to any picture."""
    constants = [numpy_helper.from_array(np.asarray(a), f"{k}_value") for k, a in outputs.items()]
    nodes = [helper.make_node("Identity", [f"{k}_value"], [k]) for k in outputs]
    infos = [
        helper.make_tensor_value_info(k, helper.np_dtype_to_tensor_dtype(np.asarray(a).dtype), np.shape(a))
        for k, a in outputs.items()
    ]
    picture = helper.make_tensor_value_info("images", input_type, input_shape)
    inputs = [*first_inputs, picture, *extra_inputs]
    model = helper.make_model(
        helper.make_graph(nodes, name, inputs, infos, constants),
        opset_imports=[helper.make_opsetid("", 17)],
        ir_version=8,
    )
    if metadata:
        helper.set_model_props(model, metadata)
    onnx.save(model, path)
    vouch_for(path)
    return path


def scores(n, n_classes=80, fill=0.0):
    a = np.full((n, n_classes), fill, np.float32)
    a[0, CLASS] = CONFIDENCE
    return a


def objectness_rows(n, objectness, class_score, background_objectness=0.0):
    """(1, n, 85) with the known box in row 0."""
    a = np.zeros((1, n, 85), np.float32)
    a[0, :, :4] = 10.0
    a[0, :, 4] = background_objectness
    a[0, 0] = 0
    a[0, 0, :4], a[0, 0, 4], a[0, 0, 5 + CLASS] = CENTRE_SIZE, objectness, class_score
    return a


def logit(p):
    return np.log(p / (1 - p))


def v5():
    return {"output0": objectness_rows(3 * N_CELLS, 0.9, 0.9)}


def v5_with_grids():
    raw = {f"grid{s}": np.zeros((1, 3, SIDE // s, SIDE // s, 85), np.float32) for s in STRIDES}
    return {"output": objectness_rows(3 * N_CELLS, 0.9, 0.9), **raw}


def v3_tiny_decoded():
    return {"output": objectness_rows(3 * sum((SIDE // s) ** 2 for s in (16, 32)), 0.9, 0.9)}


def v6():
    return {"outputs": objectness_rows(N_CELLS, 1.0, CONFIDENCE, background_objectness=1.0)}


def v8():
    a = np.zeros((1, 84, N_CELLS), np.float32)
    a[0, :4, 0], a[0, 4:] = CENTRE_SIZE, scores(N_CELLS).T
    return {"output0": a}


def v8_transposed():
    return {"output0": v8()["output0"].transpose(0, 2, 1)}


def v8_segment():
    masks = np.full((1, 32, N_CELLS), 3.0, np.float32)  # larger than any class score
    prototypes = np.zeros((1, 32, SIDE // 4, SIDE // 4), np.float32)
    return {"output0": np.concatenate([v8()["output0"], masks], axis=1), "output1": prototypes}


def v10():
    a = np.zeros((1, 300, 6), np.float32)
    a[0, 0] = [*BOX, CONFIDENCE, CLASS]
    return {"output0": a}


def v7_nms():
    return {"output": np.array([[0, *BOX, CLASS, CONFIDENCE]], np.float32)}


def v7_end_to_end():
    boxes, confidence, classes = np.zeros((1, 100, 4)), np.full((1, 100), 0.9), np.zeros((1, 100), np.int32)
    boxes[0, 0], confidence[0, 0], classes[0, 0] = BOX, CONFIDENCE, CLASS
    return {
        "num_dets": np.array([[1]], np.int32),
        "det_boxes": boxes.astype(np.float32),
        "det_scores": confidence.astype(np.float32),
        "det_classes": classes,
    }


def yolox_cell():
    """The cell of stride 16 that holds the known box's centre, and its row."""
    cells, steps = cell_centres((SIDE, SIDE), STRIDES)
    row = int(np.flatnonzero((steps[:, 0] == 16) & (cells == CENTRE_SIZE[:2] // 16).all(1))[0])
    return cells, steps, row


def yolox_raw():
    cells, _, row = yolox_cell()
    a = np.zeros((1, N_CELLS, 85), np.float32)
    a[0, row, :2] = CENTRE_SIZE[:2] / 16 - cells[row]
    a[0, row, 2:4] = np.log(CENTRE_SIZE[2:] / 16)
    a[0, row, 4], a[0, row, 5 + CLASS] = 0.9, 0.9
    return {"output": a}


def yolox():
    cells, steps, row = yolox_cell()
    a = np.zeros((1, N_CELLS, 85), np.float32)
    a[0, :, :2], a[0, :, 2:4] = (cells + 0.4) * steps, steps
    a[0, row, :4], a[0, row, 4], a[0, row, 5 + CLASS] = CENTRE_SIZE, 0.9, 0.9
    return {"output": a}


def raw_grids(anchors, axes, *, scale=None, squared=False, strides=STRIDES):
    """Raw heads (3, h, w, 85) with the known box in the head of stride 16, anchor 1."""
    outputs = {}
    for s in strides:
        t = np.full((3, SIDE // s, SIDE // s, 85), -12.0, np.float32)
        t[..., :4] = 0
        if s == 16:
            col, row = (CENTRE_SIZE[:2] // s).astype(int)
            offset = CENTRE_SIZE[:2] / s - [col, row]
            ratio = CENTRE_SIZE[2:] / np.array(anchors[s][1])
            cell = t[1, row, col]
            if squared:
                cell[:2], cell[2:4] = logit((offset + 0.5) / 2), logit(np.sqrt(ratio) / 2)
            else:
                k = scale[s] if scale else 1.0
                cell[:2], cell[2:4] = logit((offset + (k - 1) / 2) / k), np.log(ratio)
            cell[4] = cell[5 + CLASS] = logit(0.9)
        h = SIDE // s
        a = {
            "chw": lambda t=t, h=h: t.transpose(0, 3, 1, 2).reshape(1, 255, h, h),
            "hwc": lambda t=t, h=h: t.transpose(1, 2, 0, 3).reshape(1, h, h, 255),
            "ahwk": lambda t=t: t[None],
            "hwak": lambda t=t: t.transpose(1, 2, 0, 3)[None],
        }[axes]()
        outputs[f"head{s}"] = np.ascontiguousarray(a)
    return outputs


def v4_decoded():
    boxes = np.zeros((1, 50, 1, 4), np.float32)
    boxes[0, 0, 0] = np.array(BOX) / SIDE
    return {"boxes": boxes, "confs": scores(50)[None]}


def yolo_nas():
    boxes = np.zeros((1, N_CELLS, 4), np.float32)
    boxes[0, 0] = BOX
    return {"a": boxes, "b": scores(N_CELLS)[None]}


def detr(n_logits, class_id, *, softmax):
    logits = np.full((1, 100, n_logits), -12.0, np.float32)
    boxes = np.full((1, 100, 4), 0.5, np.float32)
    if softmax:
        logits[0, 1:, -1] = 12
        logits[0, 0, [class_id, -1]] = [np.log(CONFIDENCE), np.log(1 - CONFIDENCE)]
    else:
        logits[0, 0, class_id] = logit(CONFIDENCE)
    boxes[0, 0] = CENTRE_SIZE / SIDE
    return {"logits": logits, "pred_boxes": boxes}


def rf_detr(n_columns, column):
    logits, boxes = detr(n_columns, column, softmax=False).values()
    return {"dets": boxes, "labels": logits}


def rt_detr():
    e2e = v7_end_to_end()
    e2e["det_scores"][0, 1:] = 0
    return {
        "labels": e2e["det_classes"].astype(np.int64),
        "boxes": e2e["det_boxes"],
        "scores": e2e["det_scores"],
    }


def rt_detr_rows():
    a = np.zeros((1, 300, 84), np.float32)
    a[0, :, :4] = np.linspace(0.1, 0.9, 300)[:, None] * (1, 1, 0.1, 0.1)
    a[0, 0, :4], a[0, :, 4:] = CENTRE_SIZE / SIDE, scores(300)
    return {"output0": a}


LAYOUTS = {
    "v5": (v5(), "YOLOv5", "model"),
    "v5 with raw grids beside": (v5_with_grids(), "YOLOv5", "model"),
    "v3 tiny decoded": (v3_tiny_decoded(), "YOLOv5", "model"),
    "v6": (v6(), "YOLOv6", "model"),
    "v7 with nms": (v7_nms(), "YOLOv7 with NMS", "model"),
    "v7 end to end": (v7_end_to_end(), "YOLOv7 end-to-end", "model"),
    "v7 raw": (raw_grids(_YOLO4, "ahwk", squared=True), "YOLOv7 grids", "yolov7"),
    "v5 raw": (raw_grids(_YOLO3, "ahwk", squared=True), "YOLOv5 grids", "yolov5s"),
    "v8": (v8(), "YOLOv8", "model"),
    "v8 transposed": (v8_transposed(), "YOLOv8", "model"),
    "v8 segmentation": (v8_segment(), "YOLOv8", "model"),
    "v10": (v10(), "YOLOv10", "model"),
    "yolox raw": (yolox_raw(), "YOLOX raw", "model"),
    "yolox decoded": (yolox(), "YOLOX", "model"),
    "v3": (raw_grids(_YOLO3, "chw"), "YOLOv3 grids", "yolov3"),
    "v3 channels last": (raw_grids(_YOLO3, "hwc"), "YOLOv3 grids", "yolov3"),
    "v3 tiny": (raw_grids(_YOLO3_TINY, "chw", strides=(16, 32)), "YOLOv3 grids", "yolov3"),
    "v4": (raw_grids(_YOLO4, "chw", scale=_YOLO4_SCALE_XY), "YOLOv4 grids", "yolov4"),
    "v4 of the ONNX zoo": (raw_grids(_YOLO4, "hwak", scale=_YOLO4_SCALE_XY), "YOLOv4 grids", "model"),
    "v4 decoded": (v4_decoded(), "YOLOv4 decoded", "model"),
    "yolo-nas": (yolo_nas(), "YOLO-NAS", "yolo_nas_s"),
    "detr": (detr(92, COCO_91.index("stop sign"), softmax=True), "DETR", "model"),
    "deformable detr": (detr(91, COCO_91.index("stop sign"), softmax=False), "DETR", "model"),
    "rf-detr": (rf_detr(91, COCO_91.index("stop sign")), "RF-DETR", "model"),
    "rt-detr rows": (rt_detr_rows(), "RT-DETR rows", "model"),
}


@pytest.mark.parametrize("case", LAYOUTS)
def test_recognised_and_decoded(case, tmp_path):
    outputs, layout, graph_name = LAYOUTS[case]
    detector = YoloDetector(constant_model(tmp_path / "m.onnx", outputs, name=graph_name))
    assert detector.layout.name == layout
    found = detector.detect(frame())
    assert found.class_names == ("stop sign",)
    np.testing.assert_allclose(found.boxes_xyxy_px, [BOX], atol=0.05)
    np.testing.assert_allclose(found.confidences, [CONFIDENCE], atol=1e-3)


def test_rt_detr_is_told_the_size_of_the_input(tmp_path):
    size = helper.make_tensor_value_info("orig_target_sizes", TensorProto.INT64, (1, 2))
    detector = YoloDetector(constant_model(tmp_path / "m.onnx", rt_detr(), extra_inputs=[size]))
    np.testing.assert_allclose(detector.detect(frame()).boxes_xyxy_px, [BOX], atol=0.05)


@pytest.mark.parametrize("n_classes", [1, 2, 3])
def test_few_classes_need_only_their_names(n_classes, tmp_path):
    """Six columns are v5 with one class in one place and v10 in another; the number of rows tells."""
    rows = objectness_rows(3 * N_CELLS, 0.9, 0.0)[..., : 5 + n_classes].copy()
    rows[0, 0, 5] = 0.9
    names = str({i: f"thing {i}" for i in range(n_classes)})
    detector = YoloDetector(constant_model(tmp_path / "m.onnx", {"output": rows}, metadata={"names": names}))
    assert detector.layout.name == "YOLOv5"
    assert detector.detect(frame()).class_names == ("thing 0",)


@pytest.mark.parametrize(
    "outputs",
    [
        {"probabilities": np.zeros((1, 1000), np.float32)},  # a classifier
        {"output0": np.zeros((1, 56, 77), np.float32)},  # neither cells nor final rows
        {"mask": np.zeros((1, 21, SIDE, SIDE), np.float32)},  # semantic segmentation
        {"grid": np.zeros((1, 425, 10, 10), np.float32)},  # YOLOv2: five anchors, one head
    ],
)
def test_other_outputs_are_refused_in_one_sentence(outputs, tmp_path):
    path = constant_model(tmp_path / "other.onnx", outputs)
    with pytest.raises(UserError, match=r"other\.onnx: outputs .* none of the layouts known"):
        YoloDetector(path)


def test_coco_names():
    assert len(COCO_80) == 80
    assert (COCO_80[0], COCO_80[8]) == ("person", "boat")
    assert COCO_80[11] == "stop sign" == COCO_91[13]
    assert COCO_91[90] == "toothbrush" == COCO_80[79]
