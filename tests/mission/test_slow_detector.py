"""A computer too slow for its camera and detector, on a vehicle whose time does not wait."""

import math
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import project
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.scenarios.model import Scenario
from skysweep.types import Detections, Frame

SCENARIO = {
    "name": "slow",
    "area": {"polygon_enu_m": [[0, 0], [120, 0], [120, 40], [0, 40]]},
    "home": {"position_enu_m": [-5, -5]},
    "targets": [
        {"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9},
        {"class": "stop sign", "position_enu_m": [95, 25], "size_m": 0.9},
    ],
    "search": {"n_c": 1, "check_speed_mps": 2.0},
}
_HANDED_ON_S = 30.0  # at most, on the wall: between the sensor's threads


class BlankCamera:
    """Takes pictures that show nothing but noise, in no time."""

    def __init__(self, lens):
        self.lens, self.rng = lens, np.random.default_rng(0)

    def capture(self, state):
        grey = self.rng.integers(100, 103, (2, 2, 3), np.uint8)
        return Frame(state.time_s, grey, state.camera, self.lens)

    def close(self):
        pass


class SlowDetector:
    """Knows where the targets are; a look takes ``look_s(time_s)`` of the vehicle's time."""

    class_names = ("stop sign",)

    def __init__(self, look_s):
        self.look_s = look_s
        self.frame, self.free_s = None, -math.inf
        self.go = threading.Semaphore(0)
        self.exposed_s = []

    def detect(self, frame):
        self.exposed_s.append(frame.time_s)
        self.frame = frame
        self.go.acquire()
        places = np.array([[*target["position_enu_m"], 0.0] for target in SCENARIO["targets"]])
        pixels, depth = project(frame.lens, frame.camera, places)
        inside = (depth > 0) & (np.abs(pixels - (320, 180)) < (310, 170)).all(axis=1)
        seen, half = pixels[inside], frame.lens.pixels_on_target(0.45, depth[inside])[:, None]
        n = len(seen)
        boxes = np.column_stack([seen - half, seen + half])
        return Detections(frame.time_s, boxes, np.full(n, 0.99), ("stop sign",) * n, frame.camera, frame.lens)

    def pass_time(self, now_s, sensor):
        self._hand_on(sensor)
        frame = self.frame
        if frame is not None and now_s >= max(frame.time_s, self.free_s) + self.look_s(frame.time_s) - 1e-6:
            self.frame, self.free_s = None, now_s
            self.go.release()
            self._hand_on(sensor)

    def _hand_on(self, sensor):
        """Wait until the sensor's thread has nothing left to do, or waits for this detector."""
        end_s = time.monotonic() + _HANDED_ON_S
        while self.frame is None and not all(look.answer.done() for look in sensor._pending):
            assert time.monotonic() < end_s
            time.sleep(0.0002)


class Flown:
    """A mission whose vehicle does not wait for the detector."""

    def __init__(self, look_s, **changes):
        scenario = Scenario.model_validate(SCENARIO | changes)
        self.detector = SlowDetector(look_s)
        vehicle = build_mission(scenario, 0, Rig("statistical")).vehicle
        camera = BlankCamera(scenario.camera.lens)
        mission = build_mission(scenario, 0, Rig(vehicle=vehicle, camera=camera, detector=self.detector))
        mission = replace(mission, vehicle=_Ticking(vehicle, self.detector, mission.sensor))
        journal = MemoryJournal()
        self.speeds_mps = []

        def watch(state, mode, _new):
            self.speeds_mps.append((mode, state.time_s, np.hypot(*state.velocity_enu_mps[:2])))

        self.reason = fly(mission, journal, watch)
        self.lines = journal.lines
        self.detector.go.release()
        mission.sensor.close()

    def of_kind(self, kind):
        return [line for line in self.lines if line["kind"] == kind]

    @property
    def causes(self):
        return [line["cause"] for line in self.of_kind("safety")]

    def fastest_scan_mps(self, since_s=0.0):
        return max(v for mode, t, v in self.speeds_mps if mode == "SCAN" and t >= since_s)

    def assert_found(self):
        assert self.reason == "completed"
        assert len(self.of_kind("confirmed")) == 2


class _Ticking:
    def __init__(self, inner, detector, sensor):
        self.inner, self.detector, self.sensor = inner, detector, sensor

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def advance(self, duration_s):
        self.inner.advance(duration_s)
        self.detector.pass_time(self.inner.state().time_s, self.sensor)


def test_a_detector_that_keeps_up_is_asked_as_often_as_wanted():
    flown = Flown(lambda _t: 0.15)
    assert flown.causes == []
    np.testing.assert_allclose(np.diff(flown.detector.exposed_s), 0.4, atol=0.01)
    flown.assert_found()


@pytest.fixture(scope="module")
def slow():
    return Flown(lambda _t: 2.5)


def test_a_slow_one_is_asked_less_often_and_nothing_is_flown_again(slow):
    """Each look takes longer than what was once called blind: 0.4 s and 2 s."""
    assert slow.of_kind("unsearched") == []
    assert np.median(np.diff(slow.detector.exposed_s)[5:]) == pytest.approx(2.8, abs=0.15)
    slow.assert_found()


def test_it_is_said_once_and_not_taken_back_at_the_end(slow):
    said = slow.of_kind("safety")
    (first,) = (line for line in said if line["cause"] == "detector slow")
    assert first["sentence"] == "The detector manages 0.36 looks a second of 2.5."
    later = [line["sentence"] for line in said if line["t"] > first["t"]]
    assert later == [], "late is usual from then on"
    fastest_mps = slow.fastest_scan_mps()
    assert fastest_mps == pytest.approx(5.0, abs=1.0), "its pictures overlap: no reason to slow down"


def test_it_is_said_again_when_it_recovers():
    flown = Flown(lambda t: 1.0 if t < 22.0 else 0.15)
    assert flown.causes == ["detector slow", "detector slow"]
    assert flown.of_kind("safety")[1]["sentence"] == "The detector keeps its rate again."
    later_s = [t for t in flown.detector.exposed_s if t > 65.0]
    assert len(later_s) > 20
    np.testing.assert_allclose(np.diff(later_s), 0.4, atol=0.01)
    flown.assert_found()


def test_where_pictures_would_no_longer_overlap_the_scan_slows_down():
    narrow = {"hfov_rad": 0.7}  # 12 m along the track from 30 m: 2.5 s at 5 m/s
    flown = Flown(lambda _t: 2.5, camera=narrow)
    (slowed,) = (line for line in flown.of_kind("safety") if line["cause"] == "scan slowed")
    assert slowed["sentence"] == "The scan slows down to 2.2 m/s, to leave nothing unseen."
    assert flown.fastest_scan_mps(slowed["t"] + 5.0) < 3.0
    assert [line for line in flown.of_kind("unsearched") if line["t"] > slowed["t"] + 10.0] == []
    flown.assert_found()
