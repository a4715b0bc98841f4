"""Whatever a model file holds: one sentence or an answer, within a time limit, in a process that goes on."""

import time

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper
from test_model_trial import looping_model
from test_yolo import final_rows
from test_yolo_outputs import LAYOUTS, constant_model, frame, v10

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


@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.floats(0, 1), st.integers(1, 255)), min_size=1, max_size=4))
@example([(0.1875, 128)])  # a name that is no UTF-8, of which ONNX Runtime prints a report
def test_flipped_bytes(tmp_path, flips):
    content = bytearray(final_rows(tmp_path / "m.onnx", [[9, 9, 60, 60, 0.9, 0]], (64, 64)).read_bytes())
    for place, change in flips:
        content[int(place * (len(content) - 1))] ^= change
    path = tmp_path / "mutated.onnx"
    path.write_bytes(content)
    answers_or_says_why(path, picture(64, 64))


LONGEST_S = 120.0  # a trial may take 60 s of wall clock, and a picture as long


def truncated(model, share):
    return model.SerializeToString()[: int(share * len(model.SerializeToString()))]


def spliced(model, share):
    """A part of the file is there twice."""
    content = model.SerializeToString()
    start = int(share * (len(content) - 1))
    return content[:start] + content[start // 2 : start] + content[start:]


def another_operator(model, share):
    operators = ("Softmax", "Transpose", "NonZero", "Loop", "Shape", "ArgMax", "NoSuchThing", "")
    for node in model.graph.node:
        node.op_type = operators[int(share * (len(operators) - 1))]
    return model.SerializeToString()


def other_extents(model, share):
    """The answers claim another shape than they have values for."""
    for constant in model.graph.initializer:
        constant.dims[-1] = int(10 ** (18 * share)) - 1
    return model.SerializeToString()


def another_input(model, share):
    extents = (0, 1, -1, 7, 4096, 2**31, 2**62)
    for extent in model.graph.input[0].type.tensor_type.shape.dim[1:]:
        extent.dim_value = extents[int(share * (len(extents) - 1))]
    return model.SerializeToString()


def another_type(model, share):
    kinds = (0, TensorProto.STRING, TensorProto.BOOL, TensorProto.INT64, TensorProto.COMPLEX64, 99)
    model.graph.input[0].type.tensor_type.elem_type = kinds[int(share * (len(kinds) - 1))]
    return model.SerializeToString()


def other_values(model, share):
    """Answers that are no numbers, without an end, or enormous."""
    value = (np.nan, np.inf, -np.inf, 3e38, -1.0)[int(share * 4)]
    for constant in model.graph.initializer:
        a = numpy_helper.to_array(constant)
        if a.dtype == np.float32:
            constant.CopyFrom(numpy_helper.from_array(np.full_like(a, value), constant.name))
    return model.SerializeToString()


def without_outputs(model, share):
    del model.graph.output[int(share * len(model.graph.output)) :]
    return model.SerializeToString()


def in_circles(model, share):
    for node in model.graph.node:
        node.input[0] = node.output[0]
    return model.SerializeToString()


def values_elsewhere(model, share):
    """The answers are said to be in another file, and one that never ends."""
    places = ("/dev/zero", "/dev/stdin", "../../../etc/passwd", "gone.bin", "")
    for constant in model.graph.initializer:
        constant.ClearField("raw_data")
        constant.data_location = TensorProto.EXTERNAL
        constant.external_data.add(key="location", value=places[int(share * 4)])
    return model.SerializeToString()


MUTATIONS = (
    truncated, spliced, another_operator, other_extents, another_input, another_type, other_values,
    without_outputs, in_circles, values_elsewhere,
)  # fmt: skip


@pytest.mark.parametrize("mutate", MUTATIONS)
@settings(max_examples=2, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(layout=st.sampled_from(sorted(LAYOUTS)), share=st.floats(0, 1))
def test_mutated_layouts(mutate, tmp_path, layout, share):
    """Every kind of damage to models of every layout; a dead or hanging process fails the test."""
    outputs, _, name = LAYOUTS[layout]
    model = onnx.load(constant_model(tmp_path / "whole.onnx", outputs, name=name))
    path = tmp_path / "mutated.onnx"
    path.write_bytes(mutate(model, share))
    start = time.monotonic()
    answers_or_says_why(path, frame())
    assert time.monotonic() - start < LONGEST_S


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
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
        YoloDetector(path, pixels="0..1").detect(picture(720, 1280))
