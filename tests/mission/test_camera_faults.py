"""Cameras that go wrong while the vehicle scans or checks, in rendered worlds.

Nothing counts as searched that was not: a target is confirmed where it is, reported as unchecked, or lies
outside of what the results call seen. All ends safely, and what is wrong is said within 5 s.
"""

import math
import re

import cv2
import numpy as np
import pytest
import shapely

from skysweep.detection.template import RedBlobDetector
from skysweep.flights.build import build_mission
from skysweep.flights.replay import RecordedSensor
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import CameraMotion, CameraPose
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.results.metrics import seen_area
from skysweep.results.run_folder import Run
from skysweep.scenarios.model import Scenario
from skysweep.sensing.cameras.rendered import RenderedCamera
from skysweep.worlds.rendering.renderer import make_renderer
from skysweep.worlds.world import build_world

SCENARIO = Scenario.model_validate(
    {
        "name": "blind",
        "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 45], [0, 45]]},
        "home": {"position_enu_m": [-5, -5]},
        "targets": [
            {"class": "stop sign", "position_enu_m": [14, 34], "size_m": 1.2},
            {"class": "stop sign", "position_enu_m": [44, 14], "size_m": 1.2},
        ],
        "camera": {"width_px": 320, "height_px": 180, "hfov_rad": 1.2},
        "search": {"n_c": 1, "c_t": 0.4, "scan_altitude_agl_m": 16, "check_speed_mps": 2},
        "safety": {"detector_dead_s": 20},
    }
)
HOME = np.array(SCENARIO.home.position_enu_m)
LATE_LOOKS = 5  # 2 s
SAID_S = 5.0


class FaultyCamera:
    """A rendered camera that from ``begin`` on goes wrong in one way."""

    def __init__(self, inner, fault, other):
        self.inner, self.fault, self.other = inner, fault, other
        self.begun_s = math.inf
        self.images = []
        self.rng = np.random.default_rng(7)

    def capture(self, state):
        frame = self.inner.capture(state)
        self.images.append(frame.image)
        if state.time_s < self.begun_s:
            return frame
        return type(frame)(frame.time_s, self.fault(self, frame.image, state), frame.camera, frame.lens)

    def noisy(self, image):
        return np.clip(image + self.rng.normal(0.0, 2.0, image.shape), 0, 255).astype(np.uint8)

    def close(self):
        pass


def frozen(camera, image, state):
    camera.held = getattr(camera, "held", image)
    return camera.held


def black(camera, image, state):
    return np.zeros_like(image)


def white(camera, image, state):
    return np.full_like(image, 255)


def defocused(camera, image, state):
    return camera.noisy(cv2.GaussianBlur(image, (0, 0), image.shape[1] / 100))


def dirty(camera, image, state):
    height, width = image.shape[:2]
    ys, xs = np.mgrid[:height, :width]
    clear = np.clip((np.hypot(xs - 0.35 * width, ys - 0.4 * height) / width - 0.14) / 0.05, 0, 1)[..., None]
    return camera.noisy(clear * image + (1 - clear) * 50.0)


def upside_down(camera, image, state):
    return np.ascontiguousarray(image[::-1, ::-1])


def half_rate(camera, image, state):
    return camera.images[-1 - len(camera.images) % 2]


def late(camera, image, state):
    return camera.images[-1 - LATE_LOOKS]


def swapped(camera, image, state):
    return camera.other.capture(state).image


FAULTS = {
    frozen: "shows the same picture again",
    black: "shows black",
    white: "shows white",
    defocused: "is out of focus",
    dirty: "has something on its lens",
    upside_down: "something else|sees the ground pass",
    half_rate: "shows the same picture again .[23] of the last [345] pictures",
    late: "something else|sees the ground pass",
    swapped: "something else|sees the ground pass",
}


@pytest.fixture(scope="module")
def renderers():
    """One for each seed's world."""
    made = {}
    yield lambda seed: made.setdefault(seed, make_renderer(build_world(SCENARIO, seed), "auto"))
    for renderer in made.values():
        renderer.close()


class Elsewhere:
    """Another vehicle, on its own way over the same field. Implements ``types.Truth``."""

    def __init__(self, vehicle):
        self._vehicle = vehicle

    def true_camera_pose(self):
        t = self._vehicle.state().time_s
        place = np.array([30.0 + 20.0 * math.cos(t / 6.0), 22.0 + 15.0 * math.sin(t / 6.0), 16.0])
        return CameraPose(place, np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))

    def true_camera_motion(self):
        return CameraMotion(np.zeros(3), np.zeros(3))


class Flown:
    def __init__(self, fault, phase, seed, renderer):
        mission = build_mission(SCENARIO, seed, Rig(renderer=renderer, detector=RedBlobDetector()))
        vehicle = mission.vehicle

        world = build_world(SCENARIO, seed)
        other = RenderedCamera(world, SCENARIO.camera, Elsewhere(vehicle), seed + 100, renderer)
        self.camera = camera = FaultyCamera(mission.sensor.camera, fault, other)
        mission.sensor.camera = camera
        begun = {}

        def watch(state, mode, _):
            begun.setdefault(mode, state.time_s)
            if phase in begun and math.isinf(camera.begun_s):
                camera.begun_s = begun[phase] + (8.0 if phase == "SCAN" else 1.0)

        journal = MemoryJournal()
        object.__setattr__(mission, "sensor", RecordedSensor(mission.sensor, journal))
        self.reason = fly(mission, journal, watch)
        self.lines = journal.lines
        self.ended_at = vehicle.true_position_enu_m
        self.airborne = vehicle.state().airborne

    def of_kind(self, *kinds):
        return [line for line in self.lines if line["kind"] in kinds]

    def places(self, *kinds):
        return np.array([line["p"][:2] for line in self.of_kind(*kinds)]).reshape(-1, 2)

    def assert_nothing_is_called_searched_that_was_not(self):
        targets = np.array([t.position_enu_m for t in SCENARIO.targets])
        confirmed, unchecked = self.places("confirmed"), self.places("unchecked")
        for place in confirmed:
            assert np.hypot(*(targets - place).T).min() < 1.5, "confirmed where nothing is"
        seen = seen_area(Run(SCENARIO, tuple(self.lines)))
        for target in targets:
            if np.hypot(*(confirmed - target).T).min(initial=np.inf) < 1.5:
                continue
            assert self.reason != "completed"
            told = np.hypot(*(unchecked - target).T).min(initial=np.inf) < 3.0
            assert told or not seen.contains(shapely.Point(target)), f"{target} counts as searched"
            assert np.hypot(*(self.places("rejected") - target).T).min(initial=np.inf) > 3.0

    def assert_ends_safely(self):
        assert not self.airborne
        assert len(self.of_kind("landed")) == 1
        assert np.hypot(*(self.ended_at[:2] - HOME)) < 3.0

    def alarm(self):
        """The first words about the camera."""
        return next(line for line in self.of_kind("safety") if line["cause"] == "camera")


def fly_with(fault, phase, seed, renderers):
    flown = Flown(fault, phase, seed, renderers(seed))
    flown.assert_nothing_is_called_searched_that_was_not()
    flown.assert_ends_safely()
    alarm = flown.alarm()
    assert 0.0 < alarm["t"] - flown.camera.begun_s <= SAID_S
    assert re.search(FAULTS[fault], alarm["sentence"]), alarm["sentence"]
    return flown


@pytest.mark.parametrize("phase", ["SCAN", "CHECK"])
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_camera_that_goes_wrong(fault, phase, renderers):
    fly_with(fault, phase, 0, renderers)


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", [1, 2, 4, 5])  # in 3 a sound camera finds one of two
@pytest.mark.parametrize("phase", ["SCAN", "CHECK"])
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_camera_that_goes_wrong_in_other_worlds(fault, phase, seed, renderers):
    fly_with(fault, phase, seed, renderers)


@pytest.mark.parametrize("phase", ["SCAN", "CHECK"])
def test_a_sound_camera_is_never_doubted(phase, renderers):
    flown = Flown(lambda _camera, image, _state: image, phase, 0, renderers(0))
    assert flown.reason == "completed"
    assert [line for line in flown.of_kind("look") if "doubt" in line] == []
    assert len(flown.of_kind("confirmed")) == 2
