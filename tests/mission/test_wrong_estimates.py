"""Height, place or heading that are wrong, or drift away, in whole missions with rendered pictures.

No such mission ends as completed without a word.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from test_faults import Around, Misplaced

from skysweep.detection.template import RedBlobDetector
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.scenarios.files import change_scenario
from skysweep.scenarios.model import Scenario
from skysweep.worlds.rendering.renderer import make_renderer
from skysweep.worlds.world import build_world

SCENARIO = Scenario.model_validate(
    {
        "name": "wrong",
        "area": {"polygon_enu_m": [[0, 0], [90, 0], [90, 60], [0, 60]]},
        "home": {"position_enu_m": [-5, -5]},
        "targets": [
            {"class": "stop sign", "position_enu_m": [20, 45], "size_m": 2.0},
            {"class": "stop sign", "position_enu_m": [64, 20], "size_m": 2.0},
        ],
        "camera": {"width_px": 320, "height_px": 180, "hfov_rad": 1.2},
        "search": {"n_c": math.inf, "c_t": 0.4, "check_speed_mps": 2},
        "safety": {"detector_dead_s": 20},
    }
)
BEGUN_S = 25.0  # a few seconds after the search
HOME = np.array(SCENARIO.home.position_enu_m)


class Higher(Misplaced):
    """A vehicle whose barometer says 20 m too much."""

    def __init__(self, inner):
        super().__init__(inner, 0.0, math.inf)
        self.offset = np.array([0.0, 0.0, 20.0])


class Drifting(Misplaced):
    """A vehicle whose position drifts by (3,) metres a second, from ``BEGUN_S`` on."""

    def __init__(self, inner, drift_mps):
        super().__init__(inner, BEGUN_S, math.inf)
        self.drift_mps = np.array(drift_mps)

    def state(self):
        self.offset = self.drift_mps * (self.inner.state().time_s - BEGUN_S)
        return super().state()


class Turned(Around):
    """A vehicle whose compass says ``by_deg`` too far to the left."""

    def __init__(self, inner, by_deg):
        super().__init__(inner)
        self.by_rad = math.radians(by_deg)

    def state(self):
        state, s, c = self.inner.state(), math.sin(self.by_rad), math.cos(self.by_rad)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        camera = state.camera._replace(R_camera_to_enu=turn @ state.camera.R_camera_to_enu)
        return state._replace(R_body_to_enu=turn @ state.R_body_to_enu, camera=camera)

    def command(self, setpoint):
        self.inner.command(setpoint._replace(yaw_rad=setpoint.yaw_rad - self.by_rad))


@pytest.fixture(scope="module")
def renderer():
    made = make_renderer(build_world(SCENARIO, 0), "auto")
    yield made
    made.close()


class Flown:
    def __init__(self, vehicle, renderer, scenario=SCENARIO):
        mission = build_mission(scenario, 0, Rig(renderer=renderer, detector=RedBlobDetector()))
        self.embedded, journal = mission.vehicle, MemoryJournal()
        self.reason = fly(replace(mission, vehicle=vehicle(mission.vehicle)), journal)
        self.lines = journal.lines

    def of_kind(self, kind):
        return [line for line in self.lines if line["kind"] == kind]

    def assert_says_so_and_ends(self, within_s):
        """The camera says first, this long after the fault or the search began, what it sees; then it is
        called home, and lands where it takes that to be."""
        assert self.reason == "camera"
        first, *_, last = self.of_kind("safety")
        searched_s = next(line["t"] for line in self.of_kind("state") if line["mode"] == "SCAN")
        assert first["cause"] == "camera"
        assert searched_s < first["t"] < max(searched_s, BEGUN_S) + within_s
        assert "sees the ground pass at" in first["sentence"]
        assert "height, position, heading or the pictures' dates are wrong" in first["sentence"]
        assert (last["cause"], last["action"]) == ("camera", "RETURN")
        assert self.of_kind("confirmed") + self.of_kind("rejected") == []
        assert len(self.of_kind("unsearched")) > 0
        assert len(self.of_kind("landed")) == 1
        assert not self.embedded.state().airborne
        landing = next(line for line in self.of_kind("state") if line["mode"] == "LAND")
        assert np.hypot(*(landing["p"][:2] - HOME)) < 2.5


def test_where_nothing_is_wrong_both_are_found(renderer):
    flown = Flown(lambda inner: inner, renderer)
    assert flown.reason == "completed"
    assert flown.of_kind("safety") == []
    assert len(flown.of_kind("confirmed")) == 2


def test_a_quick_turn_before_the_first_leg_is_not_doubted():
    """The believed heading is 9 degrees late in it."""
    corners = [[0, 0], [40, 0], [40, 30], [0, 30]]
    changes = {"area.polygon_enu_m": corners, "targets": [], "search.transect_heading_deg": 0.0}
    flown = Flown(lambda inner: inner, "auto", change_scenario(SCENARIO, changes))
    assert flown.reason == "completed"
    assert flown.of_kind("safety") == []


def test_twenty_metres_too_low(renderer):
    flown = Flown(Higher, renderer)
    flown.assert_says_so_and_ends(10.0)
    assert np.hypot(*(flown.embedded.true_position_enu_m[:2] - HOME)) < 2.5


@pytest.mark.parametrize(
    ("drift_mps", "within_s"),
    [
        ((0.5, 0.0, 0.0), 40.0),  # along the transects: it shows on the way to the next one
        ((0.0, 0.5, 0.0), 20.0),
        ((0.0, 0.0, 0.5), 40.0),
    ],
    ids=["east", "north", "up"],
)
def test_a_position_that_drifts_slowly(drift_mps, within_s, renderer):
    flown = Flown(lambda inner: Drifting(inner, drift_mps), renderer)
    flown.assert_says_so_and_ends(within_s)


@pytest.mark.parametrize("by_deg", [-10, -6, 6, 8])
def test_a_compass_that_is_off(by_deg, renderer):
    flown = Flown(lambda inner: Turned(inner, by_deg), renderer)
    flown.assert_says_so_and_ends(15.0)
    assert np.hypot(*(flown.embedded.true_position_enu_m[:2] - HOME)) < 2.5
