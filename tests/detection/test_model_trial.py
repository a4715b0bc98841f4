"""Models that loop for ever or eat all memory: refused before they run in our process, survived in flight."""

import re
import shutil
import subprocess
import sys

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from skysweep.detection.model_files import own_model_path
from skysweep.detection.yolo import YoloDetector
from skysweep.errors import UserError

ROWS = [1, 84, 2100]  # YOLOv8's answer to 320 x 320 pixels
PICTURE = [1, 3, 320, 320]

FLIGHT = """
import sys
import numpy as np
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.detection.yolo import YoloDetector
from skysweep.sensing.imaging import DetectorError, ImagingSensor
from skysweep.sensing.exposures import Exposures
from skysweep.types import Frame, VehicleState

class Noise:
    def capture(self, state):
        picture = np.random.default_rng(0).integers(0, 255, (320, 320, 3), dtype=np.uint8)
        return Frame(state.time_s, picture, state.camera, Lens(320, 320, 1.0))
    def close(self):
        pass

pose = CameraPose(np.zeros(3), np.eye(3))
state = VehicleState(0.0, np.zeros(3), np.zeros(3), 0.0, pose, 1.0, 0.0, True)
sensor = ImagingSensor(Noise(), YoloDetector(sys.argv[1]), Exposures(1.0, 0.0), 0.0, patience_s=0.5)
try:
    sensor.sense(state)
except DetectorError as error:
    print(error)
sensor.close()
"""


def saved(path, nodes, constants, picture=PICTURE, rows=ROWS):
    graph = helper.make_graph(
        nodes,
        "model",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, picture)],
        [helper.make_tensor_value_info("rows", TensorProto.FLOAT, rows)],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def empty_model(path, picture=PICTURE):
    nodes = [helper.make_node("Identity", ["none"], ["rows"])]
    return saved(path, nodes, {"none": np.zeros(ROWS, np.float32)}, picture)


def looping_model(path, *, when):
    """Loops for ever where ``when`` is true of a picture's darkest and brightest values."""
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["go_on"]), helper.make_node("Neg", ["x"], ["y"])],
        "body",
        [
            helper.make_tensor_value_info("turn", TensorProto.INT64, []),
            helper.make_tensor_value_info("go", TensorProto.BOOL, []),
            helper.make_tensor_value_info("x", TensorProto.FLOAT, [1]),
        ],
        [
            helper.make_tensor_value_info("go_on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("y", TensorProto.FLOAT, [1]),
        ],
    )
    nodes = [
        helper.make_node("ReduceMin", ["images"], ["darkest"], keepdims=0),
        helper.make_node("ReduceMax", ["images"], ["brightest"], keepdims=0),
        helper.make_node(when, ["brightest", "darkest"], ["begins"]),
        helper.make_node("Loop", ["turns", "begins", "zero"], ["end"], body=body),
        helper.make_node("Mul", ["none", "end"], ["rows"]),
    ]
    constants = {
        "turns": np.array(2**62),
        "zero": np.zeros(1, np.float32),
        "none": np.zeros(ROWS, np.float32),
    }
    return saved(path, nodes, constants)


@pytest.fixture(autouse=True)
def fresh_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def test_an_endless_loop_is_refused_and_the_wait_is_explained(tmp_path, capsys):
    path = looping_model(tmp_path / "endless.onnx", when="GreaterOrEqual")
    with pytest.raises(UserError, match=r"endless\.onnx: the model took more than 10 s for one picture"):
        YoloDetector(path)
    assert f"{path}: the model is tried out first" in capsys.readouterr().err


def tried_alone(path):
    """(what a process that opens this model says, the most memory in kB of any process that it started)."""
    program = (
        "import resource, sys\n"
        "from skysweep.errors import UserError\n"
        "from skysweep.detection.yolo import YoloDetector\n"
        "try: YoloDetector(sys.argv[1])\n"
        "except UserError as error: print(error)\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, path], capture_output=True, text=True, check=True)
    said, largest_kb = done.stdout.rsplit("\n", 2)[:2]
    return said, int(largest_kb)


def test_an_enormous_picture_is_refused(tmp_path):
    said, largest_kb = tried_alone(empty_model(tmp_path / "wide.onnx", [1, 3, 16384, 16384]))
    assert re.search(r"wide\.onnx: the model (needs too much memory|takes more than)", said)
    assert 10_000 < largest_kb < 2_000_000


def test_an_enormous_answer_is_refused(tmp_path):
    rows = [1, 84, 12_000_000]
    nodes = [helper.make_node("ConstantOfShape", ["shape"], ["rows"])]
    said, largest_kb = tried_alone(saved(tmp_path / "long.onnx", nodes, {"shape": np.array(rows)}, rows=rows))
    assert "long.onnx: the model needs too much memory" in said
    assert 10_000 < largest_kb < 2_000_000


def test_a_model_that_passed_is_not_tried_again(tmp_path, monkeypatch):
    path = empty_model(tmp_path / "good.onnx")
    assert YoloDetector(path).layout.name == "YOLOv8"
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    again = shutil.copy(path, tmp_path / "copy.onnx")
    assert YoloDetector(again).layout.name == "YOLOv8"
    other = empty_model(tmp_path / "other.onnx", [1, 3, 320, "width"])
    with pytest.raises(FileNotFoundError):
        YoloDetector(other)


def test_what_lies_beside_a_model_is_not_run(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = empty_model(tmp_path / "good.onnx")
    (tmp_path / "onnxruntime.py").write_text(f"open({str(tmp_path / 'was-run')!r}, 'w')")
    monkeypatch.chdir(tmp_path)
    YoloDetector(path.name)
    assert not (tmp_path / "was-run").exists()


def test_the_shipped_model_needs_no_trial(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    YoloDetector("skysweep")
    YoloDetector(shutil.copy(own_model_path(), tmp_path / "mine.onnx"))


def test_a_model_that_hangs_in_flight_is_no_answer_and_keeps_no_program_alive(tmp_path):
    path = looping_model(tmp_path / "later.onnx", when="Greater")
    done = subprocess.run(
        [sys.executable, "-c", FLIGHT, str(path)], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout) == (0, "no answer\n"), done.stderr
