"""The detector around its layouts: geometry of letterbox and tiles, pixels, filters, suppression, errors."""

import math

import numpy as np
import onnx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

from skysweep.detection.model_files import sha256_of
from skysweep.detection.network import letterbox
from skysweep.detection.tiling import cut_copies, fitting_scale, tiles_px
from skysweep.detection.yolo import YoloDetector
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.scenarios.model import DetectorModel
from skysweep.sensing.statistical.view import _input_scale
from skysweep.types import Frame


def frame(image):
    pose = CameraPose(np.array([1.0, 2.0, 30.0]), np.eye(3))
    height, width = image.shape[:2]
    return Frame(12.5, image, pose, Lens(width, height, 1.0))


def grey(height, width):
    return np.full((height, width, 3), 90, np.uint8)


def model_of(path, nodes, constants, *, input_shape, output, metadata=None, input_type=TensorProto.FLOAT):
    """An ONNX file from nodes that turn ``images`` into ``output``."""
    graph = helper.make_graph(
        nodes,
        "model",
        [helper.make_tensor_value_info("images", input_type, input_shape)],
        [helper.make_tensor_value_info(output, TensorProto.FLOAT, None)],
        [numpy_helper.from_array(np.asarray(v), k) for k, v in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if metadata:
        helper.set_model_props(model, metadata)
    onnx.save(model, path)
    return path


def final_rows(path, rows, input_hw, names=None):
    """A model that answers rows (K, 6) of x0, y0, x1, y1, score, class to any picture."""
    rows = np.asarray(rows, np.float32).reshape(1, -1, 6)
    metadata = {"names": str(names)} if names else None
    node = helper.make_node("Identity", ["rows"], ["out"])
    return model_of(
        path, [node], {"rows": rows}, input_shape=[1, 3, *input_hw], output="out", metadata=metadata
    )


def test_boxes_come_back_in_frame_pixels_with_pose_and_lens(tmp_path):
    path = final_rows(tmp_path / "m.onnx", [[160, 160, 320, 240, 0.9, 0]], (640, 640))
    picture = frame(grey(360, 1280))  # scale 1/2, 230 px of padding above
    found = YoloDetector(path).detect(picture)
    np.testing.assert_allclose(found.boxes_xyxy_px, [[320, 0, 640, 20]])
    assert found.class_names == ("person",)
    assert (found.time_s, found.camera, found.lens) == (12.5, picture.camera, picture.lens)


@settings(max_examples=60)
@given(st.integers(20, 900), st.integers(20, 900), st.integers(1, 12), st.integers(1, 12), st.booleans())
def test_letterbox_keeps_the_whole_picture_and_its_shape(height, width, rows, columns, centred):
    target = (32 * rows, 32 * columns)
    canvas, scale, left, top = letterbox(np.full((height, width, 3), 200, np.uint8), target, centred=centred)
    assert canvas.shape == (*target, 3)
    ys, xs = np.nonzero(canvas[..., 0] == 200)
    assert (xs.min(), ys.min()) == (left, top)
    assert xs.max() + 1 - left == pytest.approx(width * scale, abs=1)
    assert ys.max() + 1 - top == pytest.approx(height * scale, abs=1)
    assert max(width * scale / target[1], height * scale / target[0]) == pytest.approx(1)


def brightest(path, *, bgr_row=False, unit=True):
    """A v5-like or YOLOX-like model whose one box has the picture's mean first channel as its confidence."""
    n = 3 * 84 if not bgr_row else 84  # cells of 64 x 64 at strides 8, 16, 32
    base = np.zeros((1, n, 6), np.float32)
    base[..., :4] = 0.5 if bgr_row else 20.0
    pick = np.zeros((1, n, 6), np.float32)
    pick[0, 0, 4] = 1.0 if unit else 1 / 255
    base[0, 0, 5] = 1.0
    nodes = [
        helper.make_node("Slice", ["images", "starts", "ends", "axes"], ["first"]),
        helper.make_node("ReduceMean", ["first"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "pick"], ["scaled"]),
        helper.make_node("Add", ["scaled", "base"], ["out"]),
    ]
    constants = {
        "starts": np.array([0]),
        "ends": np.array([1]),
        "axes": np.array([1]),
        "pick": pick,
        "base": base,
    }
    return model_of(
        path, nodes, constants, input_shape=[1, 3, 64, 64], output="out", metadata={"names": "{0: 'thing'}"}
    )


def test_pixels_are_rgb_shares_of_one(tmp_path):
    image = grey(64, 64)
    image[..., 0], image[..., 2] = 200, 50
    found = YoloDetector(brightest(tmp_path / "m.onnx"), confidence_min=0.01).detect(frame(image))
    assert found.confidences == pytest.approx([200 / 255], abs=1e-4)


def test_yolox_wants_bgr_bytes(tmp_path):
    image = grey(64, 64)
    image[..., 0], image[..., 2] = 200, 50
    path = brightest(tmp_path / "m.onnx", bgr_row=True, unit=False)
    detector = YoloDetector(path, confidence_min=0.01)
    assert detector.layout.name == "YOLOX raw"
    assert detector.detect(frame(image)).confidences == pytest.approx([50 / 255], abs=1e-4)


def test_the_order_of_channels_may_be_told(tmp_path):
    """The first channel is blue then, and ImageNet's mean is that of blue."""
    image = grey(64, 64)
    image[..., 0], image[..., 2] = 50, 140
    path = brightest(tmp_path / "m.onnx")
    told = {"confidence_min": 0.01, "channels": "bgr"}
    found = YoloDetector(path, **told).detect(frame(image))
    assert found.confidences == pytest.approx([140 / 255], abs=1e-4)
    found = YoloDetector(path, **told, pixels="imagenet").detect(frame(image))
    assert found.confidences == pytest.approx([(140 / 255 - 0.406) / 0.225], abs=1e-4)


def test_byte_pictures_with_channels_last(tmp_path):
    nodes = [
        helper.make_node("Cast", ["images"], ["float"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMax", ["float"], ["max"], keepdims=0),
        helper.make_node("Mul", ["max", "pick"], ["scaled"]),
        helper.make_node("Add", ["scaled", "base"], ["out"]),
    ]
    pick, base = np.zeros((1, 1, 6), np.float32), np.array([[[10, 10, 30, 30, 0, 0]]], np.float32)
    pick[0, 0, 4] = 1 / 255
    path = model_of(
        tmp_path / "m.onnx",
        nodes,
        {"pick": pick, "base": base},
        input_shape=[1, 64, 64, 3],
        output="out",
        input_type=TensorProto.UINT8,
    )
    image = grey(64, 64)
    image[3, 3] = 204
    assert YoloDetector(path).detect(frame(image)).confidences == pytest.approx([0.8])


def sized(path):
    """A model of any size. Its answer is a box as wide as its input is high, and as high as that is wide."""
    nodes = [
        helper.make_node("Shape", ["images"], ["shape"]),
        helper.make_node("Cast", ["shape"], ["shape_float"], to=TensorProto.FLOAT),
        helper.make_node("Slice", ["shape_float", "two", "four"], ["height_width"]),
        helper.make_node("Concat", ["zeros", "height_width", "score_class"], ["row"], axis=0),
        helper.make_node("Reshape", ["row", "row_shape"], ["out"]),
    ]
    constants = {
        "two": np.array([2]),
        "four": np.array([4]),
        "zeros": np.zeros(2, np.float32),
        "score_class": np.array([0.9, 0], np.float32),
        "row_shape": np.array([1, 1, 6]),
    }
    return model_of(path, nodes, constants, input_shape=[1, 3, "h", "w"], output="out")


def test_dynamic_models_look_at_native_resolution(tmp_path):
    """A 640 x 360 picture goes in as 640 x 384: width and height arrive as the box."""
    found = YoloDetector(sized(tmp_path / "m.onnx")).detect(frame(grey(360, 640)))
    np.testing.assert_allclose(
        found.boxes_xyxy_px, [[0, 0, 384, 360]]
    )  # 640 clips to 360, less 12 px padding


def test_dynamic_models_get_each_tile_as_large_as_a_whole_picture(tmp_path):
    """Tiles of 356 x 200 px go in as 640 x 384, enlarged 1.798 times, with 12 px of padding above."""
    found = YoloDetector(sized(tmp_path / "m.onnx"), tiles=2).detect(frame(grey(360, 640)))
    right = 384 / (640 / 356)
    corners = sorted(map(tuple, found.boxes_xyxy_px.round(2)))
    expected = sorted(
        (left, top, round(left + right, 2), top + 200.0) for left in (0.0, 284.0) for top in (0.0, 160.0)
    )
    np.testing.assert_allclose(corners, expected)


def test_the_weaker_of_two_overlapping_boxes_of_a_class_goes(tmp_path):
    rows = [
        [10, 10, 50, 50, 0.6, 0],
        [12, 10, 52, 50, 0.8, 0],
        [10, 10, 50, 50, 0.5, 8],
        [200, 200, 220, 240, 0.7, 0],
    ]
    found = YoloDetector(final_rows(tmp_path / "m.onnx", rows, (320, 320))).detect(frame(grey(320, 320)))
    assert found.class_names == ("person", "person", "boat")
    assert found.confidences == pytest.approx([0.8, 0.7, 0.5])


def test_threshold_and_class_filter(tmp_path):
    rows = [
        [10, 10, 50, 50, 0.2, 0],
        [100, 10, 150, 50, 0.8, 8],
        [200, 10, 250, 50, 0.8, 2],
    ]
    path = final_rows(tmp_path / "m.onnx", rows, (320, 320))
    detector = YoloDetector(path, ["boat", "person"], confidence_min=0.25)
    assert detector.class_names == ("boat", "person")
    assert detector.detect(frame(grey(320, 320))).class_names == ("boat",)


@pytest.mark.parametrize(
    ("row", "why"),
    [
        ([9, 9, 60, 60, 0.9, 99], "class number 99, and it has 80 classes"),
        ([9, 9, 60, 60, math.nan, 0], "boxes or confidences are not finite"),
        ([9, math.nan, 60, 60, 0.9, 0], "boxes or confidences are not finite"),
        ([9, 9, 60, 60, 1.5, 0], "the confidence 1.5 is not between 0 and 1"),
        ([9, 9, 9, 60, 0.9, 0], "a box has no extent"),
    ],
)
def test_what_cannot_be_is_no_answer(row, why, tmp_path):
    detector = YoloDetector(final_rows(tmp_path / "m.onnx", [[10, 10, 50, 50, 0.8, 0], row], (320, 320)))
    with pytest.raises(UserError, match=rf"m\.onnx: the model answers nonsense \({why}\)"):
        detector.detect(frame(grey(320, 320)))


def test_nothing_found_is_empty(tmp_path):
    path = final_rows(tmp_path / "m.onnx", [[0] * 6], (320, 320))
    found = YoloDetector(path, pixels="0..1").detect(frame(grey(320, 320)))
    assert len(found) == 0
    assert found.boxes_xyxy_px.shape == (0, 4)


def test_tiles_are_enlarged_and_put_back(tmp_path):
    """Two by two tiles of a 320 px picture are 178 px wide each, the last ones ending at the edge."""
    path = final_rows(tmp_path / "m.onnx", [[0, 0, 32, 32, 0.9, 0]], (320, 320))
    found = YoloDetector(path, tiles=2).detect(frame(grey(320, 320)))
    side = 32 * 178 / 320
    corners = sorted(map(tuple, found.boxes_xyxy_px.round(3)))
    expected = sorted((x, y, round(x + side, 3), round(y + side, 3)) for x in (0, 142) for y in (0, 142))
    np.testing.assert_allclose(corners, expected)


def test_what_a_tile_cuts_and_another_shows_whole_is_one_thing():
    tiles = tiles_px(320, 320, 2)  # the first ends at 178, the second begins at 142
    boxes = np.array([[150, 10, 178, 40], [150, 10, 210, 40], [150, 60, 178, 90], [10, 10, 20, 40]], float)
    classes, of_tile = np.array([0, 0, 0, 0]), np.array([0, 1, 0, 0])
    assert cut_copies(boxes, classes, of_tile, tiles, (320, 320)).tolist() == [True, False, False, False]
    assert not cut_copies(boxes, np.array([0, 1, 0, 0]), of_tile, tiles, (320, 320)).any(), "another class"


def test_names_from_a_file_beside_the_model(tmp_path):
    path = final_rows(tmp_path / "m.onnx", [[10, 10, 60, 60, 0.9, 1]], (320, 320))
    (tmp_path / "m.names").write_text("sheep\ngoat\n\n")
    detector = YoloDetector(path)
    assert detector.detect(frame(grey(320, 320))).class_names == ("goat",)


@pytest.mark.parametrize(("text", "line"), [("\nsheep\ngoat\n", 1), ("sheep\n \ngoat\n", 2)])
def test_a_line_without_a_name_does_not_shift_the_others(text, line, tmp_path):
    path = final_rows(tmp_path / "m.onnx", [[10, 10, 60, 60, 0.9, 1]], (320, 320))
    (tmp_path / "m.names").write_text(text)
    with pytest.raises(UserError, match=rf"m\.names: line {line} is empty"):
        YoloDetector(path)


def coarse(path, channels=3):
    """A model of any size whose pyramid joins strides 32 and 64: sides are multiples of 64, or it fails."""
    nodes = [
        helper.make_node("AveragePool", ["images"], ["fine"], kernel_shape=[32, 32], strides=[32, 32]),
        helper.make_node("AveragePool", ["images"], ["coarse"], kernel_shape=[64, 64], strides=[64, 64]),
        helper.make_node("Resize", ["coarse", "", "twice"], ["up"], mode="nearest"),
        helper.make_node("Sub", ["fine", "up"], ["rest"]),
        helper.make_node("ReduceMax", ["rest"], ["most"], keepdims=0),
        helper.make_node("Mul", ["most", "zero"], ["nothing"]),
        helper.make_node("Add", ["rows", "nothing"], ["out"]),
    ]
    constants = {
        "twice": np.array([1, 1, 2, 2], np.float32),
        "zero": np.float32(0),
        "rows": np.array([[[160, 160, 320, 240, 0.9, 1]]], np.float32),
    }
    return model_of(path, nodes, constants, input_shape=[1, channels, "h", "w"], output="out")


def test_sides_are_multiples_of_64_where_a_model_needs_that(tmp_path):
    detector = YoloDetector(coarse(tmp_path / "p6.onnx"))
    assert detector.network.input_hw_for((720, 1280)) == (768, 1280)
    assert len(detector.detect(frame(grey(720, 1280))).class_names) == 1
    seen = _input_scale(DetectorModel(model=str(tmp_path / "p6.onnx")), (800, 600), 1)
    assert seen == fitting_scale((600, 800), (640, 832)), "the statistical sensor knows it, too"


def test_pictures_of_one_channel_are_refused(tmp_path):
    with pytest.raises(
        UserError, match="takes pictures of 1 channels; export the model for pictures of three"
    ):
        YoloDetector(coarse(tmp_path / "grey.onnx", channels=1))


def test_what_cannot_be_opened_says_why(tmp_path):
    """An operator of another runtime, in a node whose name is no text."""
    node = helper.make_node("EfficientNMS_TRT", ["images"], ["out"], name="n\xff")
    path = model_of(tmp_path / "trt.onnx", [node], {}, input_shape=[1, 3, 64, 64], output="out")
    with pytest.raises(UserError, match=r"can be opened here \(.*EfficientNMS_TRT.*\); export") as refused:
        YoloDetector(path)
    assert "\n" not in str(refused.value)


def test_missing_file(tmp_path):
    with pytest.raises(UserError, match=r"gone\.onnx: there is no such model file"):
        YoloDetector(tmp_path / "gone.onnx")


@pytest.mark.parametrize("content", [b"", b"not onnx at all", b"\x08\x07\x12\x00truncated"])
def test_broken_file(content, tmp_path):
    path = tmp_path / "broken.onnx"
    path.write_bytes(content)
    with pytest.raises(
        UserError, match=r"broken\.onnx: .*(not an ONNX model that can be opened here|no model)"
    ):
        YoloDetector(path)


def test_unknown_class_names_those_there_are(tmp_path):
    path = final_rows(tmp_path / "m.onnx", [[0] * 6], (320, 320), names={0: "sheep", 1: "goat"})
    with pytest.raises(UserError, match=r"no class 'wolf'; it has sheep, goat"):
        YoloDetector(path, ["wolf"], pixels="0..1")


def test_unnamed_classes_are_an_error_with_the_remedy(tmp_path):
    node = helper.make_node("Identity", ["rows"], ["out"])
    rows = np.zeros((1, 3 * 2100, 5 + 7), np.float32)
    path = model_of(tmp_path / "m.onnx", [node], {"rows": rows}, input_shape=[1, 3, 320, 320], output="out")
    with pytest.raises(
        UserError, match=r"7 classes but names none; if so, write their names one a line into m\.names"
    ):
        YoloDetector(path)


def one_node(path, node, output, picture_type=TensorProto.FLOAT):
    picture = helper.make_tensor_value_info("images", picture_type, [1, 3, 64, 64])
    graph = helper.make_graph([node], "model", [picture], [output])
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


@pytest.mark.parametrize(
    ("node", "output"),
    [
        (
            helper.make_node("Constant", [], ["out"], value_strings=["sheep"]),
            helper.make_tensor_value_info("out", TensorProto.STRING, [1]),
        ),
        (
            helper.make_node("SequenceConstruct", ["images", "images"], ["out"]),
            helper.make_tensor_sequence_value_info("out", TensorProto.FLOAT, None),
        ),
    ],
)
def test_outputs_that_are_no_numbers(node, output, tmp_path):
    path = one_node(tmp_path / "m.onnx", node, output)
    with pytest.raises(UserError, match=r"m\.onnx: the output out is (tensor\(string\)|seq.*), no array"):
        YoloDetector(path)


@pytest.mark.parametrize("kind", [TensorProto.DOUBLE, TensorProto.INT8])
def test_an_input_of_other_numbers_is_told_so(kind, tmp_path):
    output = helper.make_tensor_value_info("out", kind, [1, 3, 64, 64])
    path = one_node(tmp_path / "m.onnx", helper.make_node("Identity", ["images"], ["out"]), output, kind)
    with pytest.raises(UserError, match=r"the input images is tensor\(.*one of tensor\(float\), tensor"):
        YoloDetector(path)


@pytest.mark.parametrize("shape", [[1, 10], [4, 3, 64, 64]])
def test_inputs_that_are_not_one_picture(shape, tmp_path):
    node = helper.make_node("Identity", ["rows"], ["out"])
    rows = np.zeros((1, 300, 6), np.float32)
    path = model_of(tmp_path / "m.onnx", [node], {"rows": rows}, input_shape=shape, output="out")
    with pytest.raises(UserError, match=r"one picture"):
        YoloDetector(path)


def test_weights_beside_a_model_are_part_of_it(tmp_path):
    model = tmp_path / "best.onnx"
    model.write_bytes(b"graph")
    alone = sha256_of(model)
    (tmp_path / "best.onnx.data").write_bytes(b"weights")
    first = sha256_of(model)
    (tmp_path / "best.onnx.data").write_bytes(b"weights of another day")
    assert len({alone, first, sha256_of(model)}) == 3


def test_a_very_thin_picture_keeps_a_row():
    canvas, *_ = letterbox(np.zeros((2, 3000, 3), np.uint8), (640, 640), centred=True)
    assert (canvas == 0).all(axis=(1, 2)).sum() == 1
