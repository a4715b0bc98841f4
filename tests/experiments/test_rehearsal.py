"""Camera and detector tried before take-off, by a clock that runs fifty times as fast as the wall's."""

import threading
import time

import numpy as np
import pytest

from skysweep.experiments.rehearsal import rehearse
from skysweep.mission import build
from skysweep.scenarios.model import Scenario
from skysweep.types import Detections, Frame
from skysweep.vehicles.mavlink.embedded import embedded_vehicle

FASTER = 50.0


def scenario(**changes):
    area = {"polygon_enu_m": [[100, 100], [160, 100], [160, 140], [100, 140]]}
    return Scenario.model_validate({"name": "rehearsed", "area": area} | changes)


class Standing:
    """A vehicle on the ground whose time passes."""

    def __init__(self, of):
        self.inner = embedded_vehicle(of, 0)
        self.begun_s = time.monotonic()
        self.command = self.hold = self.takeoff = self.land = None

    def state(self):
        return self.inner.state()._replace(time_s=FASTER * (time.monotonic() - self.begun_s))

    def advance(self, duration_s):
        time.sleep(duration_s / FASTER)


class Camera:
    """Remembers from where it was asked to look."""

    def __init__(self, lens):
        self.lens, self.poses, self.closed = lens, [], False

    def capture(self, state):
        self.poses.append(state.camera)
        return Frame(state.time_s, np.zeros((2, 2, 3), np.uint8), state.camera, self.lens)

    def close(self):
        self.closed = True


class Detector:
    class_names = ("stop sign",)

    def __init__(self, look):
        self.look = look

    def detect(self, frame):
        self.look()
        none = np.zeros((0, 4))
        return Detections(frame.time_s, none, none[:, 0], (), frame.camera, frame.lens)


def rehearsed(monkeypatch, look, **changes):
    of = scenario(**changes)
    camera = Camera(of.camera.lens)
    monkeypatch.setattr(build, "make_detector", lambda *_: Detector(look))
    check = rehearse(of, Standing(of), camera, "auto", 1)
    assert camera.closed
    return check, camera


def takes(seconds):
    return lambda: time.sleep(seconds / FASTER)


def test_a_computer_that_is_fast_enough_passes(monkeypatch):
    check, camera = rehearsed(monkeypatch, lambda: None, detector={"rate_hz": 1.0})
    assert (check.name, check.passed, check.said) == ("detector", True, "1 looks a second")
    for pose in camera.poses:
        np.testing.assert_allclose(pose.position_enu_m, [130, 120, 30], atol=1.0)
        assert pose.R_camera_to_enu[2, 2] == pytest.approx(-1.0, abs=0.05), "straight down"


def test_one_that_is_too_slow_is_a_note_with_the_rate(monkeypatch):
    check, _ = rehearsed(monkeypatch, takes(1.0))
    assert check.passed is None
    assert check.said.startswith("this computer manages 0.")
    assert "looks a second of 2.5; enough to cover the area" in check.said


def test_one_that_is_too_slow_for_the_scan_says_how_fast_that_will_be(monkeypatch):
    check, _ = rehearsed(monkeypatch, takes(2.0), camera={"hfov_rad": 0.3})
    assert check.passed is None
    assert "; the scan slows down to " in check.said


def test_what_does_not_answer_or_fails_ends_it(monkeypatch):
    def out_of_memory():
        raise MemoryError("out of memory")

    check, _ = rehearsed(monkeypatch, out_of_memory)
    assert check.passed is False
    assert "out of memory" in check.said
    never = threading.Event()
    check, _ = rehearsed(monkeypatch, lambda: never.wait(3.0))
    assert check.passed is False
    assert "does not answer" in check.said
