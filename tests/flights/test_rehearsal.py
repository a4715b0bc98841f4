"""Camera and detector tried before take-off, by a clock that runs ten times as fast as the wall's."""

import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from skysweep.flights.rehearsal import rehearse
from skysweep.flights.rig import Rig
from skysweep.scenarios.model import Scenario
from skysweep.types import Detections, Frame
from skysweep.vehicles.embedded.at_home import embedded_vehicle

FASTER = 10.0


def scenario(**changes):
    area = {"polygon_enu_m": [[100, 100], [160, 100], [160, 140], [100, 140]]}
    return Scenario.model_validate({"name": "rehearsed", "area": area} | changes)


class Standing:
    """A vehicle on the ground whose time passes."""

    def __init__(self, of):
        self.inner = embedded_vehicle(of, 0)
        self.begun_s = time.monotonic()
        self.command = self.hold = self.takeoff = self.land = self.truth = None

    def state(self):
        return self.inner.state()._replace(time_s=FASTER * (time.monotonic() - self.begun_s))

    def advance(self, duration_s):
        time.sleep(duration_s / FASTER)


class Camera:
    """Remembers from where it was asked to look; shows noise, or the same again and again."""

    renderer = None

    def __init__(self, lens, level=100, spread=3):
        self.lens, self.poses, self.closed = lens, [], False
        self.levels, self.rng = (level, level + spread), np.random.default_rng(0)

    def capture(self, state):
        self.poses.append(state.camera)
        image = self.rng.integers(*self.levels, (36, 64, 3), np.uint8)
        return Frame(state.time_s, image, state.camera, self.lens)

    def close(self):
        self.closed = True


class Detector:
    class_names = ("stop sign",)

    def __init__(self, look, n_found=0):
        self.look, self.n_found = look, n_found

    def detect(self, frame):
        self.look()
        n = self.n_found
        boxes = np.full((n, 4), [10.0, 10.0, 20.0, 20.0])
        return Detections(
            frame.time_s, boxes, np.full(n, 0.9), self.class_names * n, frame.camera, frame.lens
        )


def rehearsed(look, shows=(100, 3), n_found=0, **changes):
    of = scenario(**changes)
    camera = Camera(of.camera.lens, *shows)
    check = rehearse(of, Rig(vehicle=Standing(of), camera=camera, detector=Detector(look, n_found)))
    assert camera.closed
    return check, camera


def takes(seconds):
    return lambda: time.sleep(seconds / FASTER)


def test_a_computer_that_is_fast_enough_passes():
    check, camera = rehearsed(lambda: None, detector={"rate_hz": 1.0})
    assert (check.name, check.passed) == ("detector", True)
    assert check.said == "1 looks a second; it sees nothing that is searched for"
    for pose in camera.poses:
        np.testing.assert_allclose(pose.position_enu_m, [130, 120, 30], atol=1.0)
        assert pose.R_camera_to_enu[2, 2] == pytest.approx(-1.0, abs=0.05), "straight down"


def test_a_target_that_is_laid_out_is_said_to_be_seen():
    check, _ = rehearsed(lambda: None, n_found=1, detector={"rate_hz": 1.0})
    assert check.said == "1 looks a second; it sees stop sign"


@pytest.mark.parametrize(
    ("shows", "passed", "why"),
    [
        ((0, 2), False, "the camera shows black"),
        ((250, 2), False, "the camera shows white"),
        ((100, 1), None, "the camera shows the same picture again"),
    ],
)
def test_pictures_that_show_nothing_end_it(shows, passed, why):
    """The same picture may be that of a simulator that stands still: a note."""
    check, _ = rehearsed(lambda: None, shows=shows, detector={"rate_hz": 1.0})
    assert check.passed is passed
    assert check.said.startswith(why)


def test_one_that_is_too_slow_is_a_note_with_the_rate():
    check, _ = rehearsed(takes(1.0))
    assert check.passed is None
    assert check.said.startswith("this computer manages 0.")
    assert "looks a second of 2.5; enough to cover the area" in check.said


def test_one_that_is_too_slow_for_the_scan_says_how_fast_that_will_be():
    check, _ = rehearsed(takes(2.0), camera={"hfov_rad": 0.3})
    assert check.passed is None
    assert "; the scan slows down to " in check.said


def test_what_does_not_answer_or_fails_ends_it():
    def out_of_memory():
        raise MemoryError("out of memory")

    check, _ = rehearsed(out_of_memory)
    assert check.passed is False
    assert "out of memory" in check.said
    never = threading.Event()
    check, _ = rehearsed(lambda: never.wait(3.0))
    assert check.passed is False
    assert "does not answer" in check.said


def test_one_answer_and_no_second_ends_it():
    first_is_over = threading.Event()

    def stops():
        if first_is_over.is_set():
            time.sleep(2 * 5.0 / FASTER)
        first_is_over.set()

    check, _ = rehearsed(stops)
    assert check.passed is False
    assert "does not answer" in check.said


NOTHING_MORE = """
import gc
from numba.core.dispatcher import Dispatcher
from skysweep.flights.fly import fly_in_memory
from skysweep.flights.rehearsal import compile_ahead
from skysweep.scenarios.files import change_scenario, load_scenario

def compiled():
    functions = [o for o in gc.get_objects() if isinstance(o, Dispatcher)]
    return {(f.py_func.__module__, f.py_func.__qualname__, s) for f in functions for s in f.signatures}

compile_ahead()
before = compiled()
assert len(before) > 20, before
for name, strategy, more in (
    ("buildings", "scan-check", {}),
    ("clusters", "low-only", {}),
    ("sparse", "belief", {"search.confirm_height_max_m": 8}),
    ("maritime", "belief", {"search.target_speed_mps": 0.3}),
):
    fly_in_memory(change_scenario(load_scenario(name), {"search.strategy": strategy} | more), 1)
print(sorted(compiled() - before))
"""


def test_after_compiling_ahead_a_flight_compiles_nothing():
    """In the air it took seconds in which nobody decided where the vehicle flies."""
    told = subprocess.run([sys.executable, "-c", NOTHING_MORE], capture_output=True, text=True, timeout=300)
    assert told.returncode == 0, told.stderr
    assert told.stdout.strip() == "[]"
