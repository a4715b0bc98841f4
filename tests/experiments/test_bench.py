"""The benchmark measures what it says; how fast a machine is, is no test."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from skysweep.detection.model_files import own_model_path
from skysweep.errors import UserError
from skysweep.experiments import bench as benches
from skysweep.experiments.bench import MEASUREMENTS, bench
from skysweep.scenarios.model import Scenario

sys.path.insert(0, str(Path(__file__).parents[1] / "detection"))
from test_yolo_outputs import constant_model, yolo_nas

SMALL = Scenario.model_validate(
    {
        "name": "small",
        "area": {"polygon_enu_m": [[0, 0], [30, 0], [30, 12], [0, 12]]},
        "home": {"position_enu_m": [-5, -5]},
        "camera": {"width_px": 320, "height_px": 180},
        "search": {"scan_altitude_agl_m": 15.0},
        "targets": [{"class": "stop sign", "position_enu_m": [20, 10]}],
    }
)


@pytest.mark.slow
def test_bench_gives_one_flat_json_object_of_plausible_numbers(monkeypatch):
    monkeypatch.setattr(benches, "load_scenario", lambda _name: SMALL)
    for of, less in (("_WARM_UP", 2), ("_MEASURED", 4), ("_VEHICLE_S", 60.0), ("_FILMED_S", 10.0)):
        monkeypatch.setattr(benches, of, less)
    told = []
    result = bench(told.append)
    assert json.loads(json.dumps(result)) == result
    rates = {k: v for k, v in result.items() if isinstance(v, float)}
    assert set(rates) == {
        "vehicle_rtf",
        "rendered_mission_rtf",
        "rendered_mission_rtf_every_frame",
        "statistical_mission_rtf",
        "statistical_mission_s",
        "belief_mission_rtf",
        "belief_step_ms",
        "belief_step_worst_ms",
        "missions_per_minute_2_workers",
        "local_parallel_efficiency",
        "worker_memory_mb",
        "render_fps_640x360",
        "detector_ms_640x360",
        "video_rtf",
    }
    assert min(rates.values()) > 0
    assert rates["vehicle_rtf"] > rates["statistical_mission_rtf"] > rates["rendered_mission_rtf"]
    assert result["statistical_mission_s"] == pytest.approx(400 / result["statistical_mission_rtf"], rel=1e-3)
    assert len(told) == MEASUREMENTS


def test_the_time_over_that_of_yolox_nano(tmp_path):
    rows = np.zeros((1, 52**2 + 26**2 + 13**2, 85), np.float32)  # raw, as the public file's
    shape = (1, 3, 416, 416)
    nano = constant_model(tmp_path / "yolox_nano.onnx", {"output": rows}, input_shape=shape)
    measured = benches._pictures(SMALL, benches._yolox_nano(nano))
    assert measured["detector_vs_yolox_nano"] > 1  # it computes nothing
    assert "detector_vs_yolox_nano" not in benches._pictures(SMALL, None)


def test_a_model_that_asks_for_its_pixels_is_not_yolox_nano(tmp_path):
    with pytest.raises(UserError, match=r"--yolox-nano .*: is not the public yolox_nano.onnx"):
        benches._yolox_nano(constant_model(tmp_path / "m.onnx", yolo_nas()))


def test_another_model_is_not_yolox_nano():
    """That is said before minutes of measuring."""
    told = []
    with pytest.raises(UserError, match=r"--yolox-nano .*: is not the public yolox_nano.onnx"):
        bench(told.append, own_model_path())
    assert not told
