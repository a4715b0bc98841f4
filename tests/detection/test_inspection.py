"""What ``skysweep detect inspect`` says of a model, and the boxes that it draws."""

import json

import cv2
import numpy as np
import pytest
from test_yolo_outputs import _YOLO3, constant_model, detr, raw_grids, v8, v10, yolo_nas
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.detection.coco import COCO_80


def inspected(*arguments):
    done = CliRunner().invoke(app, ["detect", "inspect", *map(str, arguments)])
    lines = [line.partition(": ") for line in done.output.splitlines()]
    return done.exit_code, {name: words for name, _, words in lines}, done.output


def test_the_shipped_model():
    code, said, _ = inspected("skysweep")
    assert code == 0
    assert said["outputs"] == "YOLOX"
    assert (said["pixels"], said["channels"]) == ("0..255", "BGR, first")
    assert (said["boxes"], said["anchors"], said["NMS inside"]) == ("pixels", "none", "no")
    assert said["classes"].startswith("3: ")


@pytest.mark.parametrize(
    ("outputs", "name", "expected"),
    [
        (v10(), "model", {"outputs": "YOLOv10", "NMS inside": "yes", "pixels": "0..1"}),
        (
            raw_grids(_YOLO3, "chw"),
            "yolov3",
            {"anchors": "those of YOLOv3 for COCO", "size": "320 high, 320 wide (any: a multiple of 32)"},
        ),
        (detr(81, 11, softmax=True), "model", {"boxes": "normalised"}),
    ],
)
def test_says_what_it_understood(outputs, name, expected, tmp_path):
    names = {"names": str(dict(enumerate(COCO_80)))}
    code, said, _ = inspected(constant_model(tmp_path / "m.onnx", outputs, name=name, metadata=names))
    assert code == 0
    assert {key: said[key] for key in expected} == expected


def test_what_a_file_leaves_open_is_asked_for_by_the_commands_options(tmp_path):
    code, _, text = inspected(constant_model(tmp_path / "m.onnx", yolo_nas()))
    assert code == 2
    assert "write --pixels 0..255, 0..1 or imagenet" in " ".join(text.split())
    assert "detector.pixels" not in text


def test_the_picture_itself_is_not_drawn_into(tmp_path):
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((320, 320, 3), 90, np.uint8))
    before = (tmp_path / "grey.png").read_bytes()
    code, _, text = inspected("skysweep", tmp_path / "grey.png", "--out", tmp_path / "grey.png")
    assert code == 2
    assert "was given, and would be replaced" in " ".join(text.split())
    assert (tmp_path / "grey.png").read_bytes() == before


def test_draws_the_boxes(tmp_path):
    picture = np.full((320, 320, 3), 90, np.uint8)
    cv2.imwrite(str(tmp_path / "grey.png"), picture)
    model, out = constant_model(tmp_path / "m.onnx", {"out": v8()["output0"]}), tmp_path / "boxes.png"
    code, said, text = inspected(model, tmp_path / "grey.png", "--out", out)
    assert code == 0, text
    assert said["found"] == "stop sign 0.81 at 100, 60, 140, 130"
    (found,) = json.loads(inspected(model, tmp_path / "grey.png", "--out", out, "--json")[2])["found"]
    assert found["class"] == "stop sign"
    assert found["confidence"] == pytest.approx(0.81, abs=0.005)
    assert found["box_xyxy_px"] == pytest.approx([100, 60, 140, 130], abs=0.5)
    changed = np.argwhere((cv2.imread(str(out)) != picture).any(axis=2))
    assert (changed[:, 0].max(), changed[:, 1].min()) == (131, 99)  # a line two pixels wide


def test_what_is_no_picture_or_model_is_one_sentence(tmp_path):
    (tmp_path / "none.png").write_text("no picture")
    code, _, text = inspected("skysweep", tmp_path / "none.png")
    assert code == 2
    assert "none.png: not a readable picture" in text
    assert inspected(tmp_path / "none.onnx")[0] == 2


def test_a_picture_that_is_not_there_is_one_sentence(tmp_path, capfd):
    code, _, output = inspected("skysweep", tmp_path / "gone.jpg")
    assert code == 2
    assert "gone.jpg: there is no such picture; check the path" in " ".join(output.split())
    assert "WARN" not in capfd.readouterr().err
