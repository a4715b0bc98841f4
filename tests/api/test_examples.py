"""A strategy, a detector, a camera and a vehicle from outside: short, and they fly."""

import ast
import importlib.util
from pathlib import Path

import numpy as np
import pytest

import skysweep as ss

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = ss.make_scenario(
    name="small",
    area={"polygon_enu_m": [[0, 0], [24, 0], [24, 12], [0, 12]]},
    home={"position_enu_m": [-5, -5]},
    targets=[ss.Target(kind="stop sign", position_enu_m=(12, 6), size_m=0.9)],
    detector={"rate_hz": 2},
    search={"scan_altitude_agl_m": 15, "check_altitude_agl_m": 6},
)


def load(name):
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["strategy", "detector", "camera", "vehicle"])
def test_it_is_at_most_25_lines_long(name):
    text = (EXAMPLES / f"{name}.py").read_text()
    docstring = ast.parse(text).body[0]
    lines = [line for line in text.splitlines()[docstring.end_lineno :] if line.strip()]
    assert len(lines) <= 25


def test_the_strategy_covers_from_half_way_down_and_confirms():
    halfway = load("strategy").Halfway
    run = ss.run("clusters", halfway, "statistical")
    assert run.summary["end_reason"] == "completed"
    assert run.summary["recall"] >= 0.75
    scan = run.track.filter(run.track["mode"] == "SCAN")
    assert scan["altitude_agl_m"].median() == pytest.approx(
        halfway.cover_altitude_agl_m(run.scenario.search), abs=0.5
    )


def test_the_detector_finds_red_and_flies():
    detector = load("detector").RedBlobs(min_px=20)
    image = np.full((60, 80, 3), 90, np.uint8)
    image[10:20, 30:50] = image[40:50, 5:15] = (220, 20, 30)
    frame = ss.Frame(1.0, image, ss.camera_pose((0, 0, 10)), ss.Lens(80, 60, 1.0))
    np.testing.assert_array_equal(detector.detect(frame).boxes_xyxy_px, [[30, 10, 50, 20], [5, 40, 15, 50]])
    run = ss.run(SMALL, detector=load("detector").RedBlobs, renderer="gl")
    assert run.summary["end_reason"] == "completed"
    assert run.candidates.height >= 1
    assert all(frame.image.dtype == np.uint8 for frame in run.frames)


def test_the_camera_shows_a_grey_world_and_flies():
    looks = []
    seen = []
    camera = load("camera").FoggyCamera

    class Watched(camera):
        def capture(self, state):
            frame = super().capture(state)
            seen.append(frame.image)
            return frame

    run = ss.run(SMALL, camera=Watched, watch=lambda _s, _m, new: looks.append(new))
    assert run.summary["end_reason"] == "completed"
    assert any(new is not None for new in looks)
    assert all(np.ptp(image.astype(int), axis=2).max() == 0 for image in seen)


def test_the_vehicle_believes_to_be_elsewhere_than_it_is():
    steady = ss.run(SMALL, sensor="statistical")
    drifting = ss.run(SMALL, sensor="statistical", vehicle=load("vehicle").Drifting)
    assert drifting.summary["end_reason"] == "completed"
    east_m = [
        run.candidates.filter(run.candidates["verdict"] == "confirmed")["east_m"][0]
        for run in (steady, drifting)
    ]
    assert east_m[1] - east_m[0] > 0.1
