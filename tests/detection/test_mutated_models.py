"""Whatever a model file holds: one sentence or an answer, within a time limit, in a process that goes on."""

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper
from test_model_trial import looping_model
from test_yolo import final_rows
from test_yolo_outputs import constant_model, frame, v10

from skysweep.detection import network
from skysweep.detection.model_trial import vouch_for
from skysweep.detection.yolo import YoloDetector
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.types import Frame


def picture(height, width):
    image = np.arange(height * width * 3, dtype=np.uint32).reshape(height, width, 3).astype(np.uint8)
    return Frame(0.0, image, CameraPose(np.zeros(3), np.eye(3)), Lens(width, height, 1.0))


def answers_or_says_why(path, shown):
    sentence = ""
    try:
        found = YoloDetector(path).detect(shown)
    except UserError as error:
        sentence = str(error)
    else:
        assert np.isfinite(found.boxes_xyxy_px).all()
    assert "\n" not in sentence


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.floats(0, 1), st.integers(1, 255)), min_size=1, max_size=4))
def test_flipped_bytes(tmp_path, flips):
    content = bytearray(final_rows(tmp_path / "m.onnx", [[9, 9, 60, 60, 0.9, 0]], (64, 64)).read_bytes())
    for place, change in flips:
        content[int(place * (len(content) - 1))] ^= change
    path = tmp_path / "mutated.onnx"
    path.write_bytes(content)
    answers_or_says_why(path, picture(64, 64))


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(
            st.lists(st.sampled_from([0, 1, 2, 4, 5, 6, 7, 80, 84, 85, 2100]), max_size=4),
            st.sampled_from(["boxes", "scores", "labels", "num", "dets", "out", "logits"]),
            st.sampled_from([0.0, 0.4, 1.0, 7.0, -1.0, 1e30, np.inf, np.nan]),
        ),
        min_size=1,
        max_size=4,
        unique_by=lambda output: output[1],
    )
)
def test_answers_of_any_shape(tmp_path, outputs):
    answers = {
        name: np.full(shape, value, np.float32)
        for shape, name, value in outputs
        if np.prod(shape, dtype=float) < 1e6
    }
    path = constant_model(tmp_path / "m.onnx", answers or v10())
    answers_or_says_why(path, frame())


def test_a_look_has_a_time_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(network, "PICTURE_S", 0.5)
    path = looping_model(tmp_path / "later.onnx", when="Greater")
    vouch_for(path)
    with pytest.raises(UserError, match=r"later\.onnx: the model was stopped before it answered"):
        YoloDetector(path).detect(picture(320, 320))


@pytest.mark.parametrize(("shape", "expected"), [((1, 3, "h", 640), 384), ((1, 3, 320, "w"), 320)])
def test_one_side_alone_is_fixed(shape, expected, tmp_path):
    """A 1280 x 720 picture keeps its shape; the model answers the height that it was given."""
    nodes = [
        helper.make_node("Shape", ["images"], ["all"], start=2, end=3),
        helper.make_node("Cast", ["all"], ["height"], to=TensorProto.FLOAT),
        helper.make_node("Concat", ["corner", "height", "rest"], ["row"], axis=0),
        helper.make_node("Reshape", ["row", "rows"], ["out"]),
    ]
    constants = {
        "corner": np.array([0, 0, 64], np.float32),
        "rest": np.array([0.9, 0], np.float32),
        "rows": np.array([1, 1, 6]),
    }
    graph = helper.make_graph(
        nodes,
        "model",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("out", TensorProto.FLOAT, None)],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    path = tmp_path / "m.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    vouch_for(path)
    detector = YoloDetector(path)
    assert detector.network.input_hw_for((720, 1280))[0] == expected
    found = detector.detect(picture(720, 1280))
    assert found.boxes_xyxy_px[0, 3] == 720  # the whole height, less the padding


def test_a_picture_that_a_model_cannot_take_is_one_sentence(tmp_path):
    """A model that is exported for any size, but reshapes to one."""
    nodes = [
        helper.make_node("Reshape", ["images", "fixed"], ["pixels"]),
        helper.make_node("ReduceMean", ["pixels"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "none"], ["out"]),
    ]
    constants = {"fixed": np.array([1, 3, 640, 640]), "none": np.zeros((1, 300, 6), np.float32)}
    graph = helper.make_graph(
        nodes,
        "model",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, "h", "w"))],
        [helper.make_tensor_value_info("out", TensorProto.FLOAT, None)],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    path = tmp_path / "m.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    vouch_for(path)
    with pytest.raises(UserError, match=r"m\.onnx: the model does not run \("):
        YoloDetector(path).detect(picture(720, 1280))
