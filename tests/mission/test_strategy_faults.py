"""A strategy that fails: it ends a simulation, and every other vehicle comes home."""

import math
import re

import pytest

from skysweep.errors import UserError
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.scenarios.model import Scenario
from skysweep.strategies.given import spec_of
from skysweep.types import Command, Event, EventKind, Mode, Waypoint
from skysweep.vehicles.embedded.at_home import embedded_vehicle

SMALL = Scenario.model_validate(
    {
        "name": "small",
        "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
        "home": {"position_enu_m": [-5, -5]},
        "targets": [{"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9}],
        "camera": {"hfov_rad": 1.2},
    }
)
AFTER_S = 30.0


class Sound:
    """Flies the path, and tells its state."""

    def __init__(self, context):
        self.to_scan = list(context.waypoints_xy_enu_m)

    def step(self, seen):
        if self.to_scan and math.dist(seen.vehicle.position_enu_m[:2], self.to_scan[0]) < 2.0:
            self.to_scan.pop(0)
        if not self.to_scan:
            return Command(Mode.SCAN, None, (Event(EventKind.FINISHED),))
        events = (Event(EventKind.SCANNED, next(iter(seen.candidates))),) if seen.sightings else ()
        return Command(Mode.SCAN, self.goal(seen), events)

    def goal(self, _seen):
        return Waypoint(tuple(self.to_scan[0]), 30.0, 5.0)

    def snapshot(self):
        return {"to_scan": self.to_scan}

    def restore(self, snapshot):
        self.to_scan = snapshot["to_scan"]


class Raises(Sound):
    def step(self, seen):
        return super().step(seen) if seen.time_s < AFTER_S else [][0]


class Answers(Sound):
    def step(self, seen):
        return super().step(seen) if seen.time_s < AFTER_S else None


class CannotBeSaved(Sound):
    asked = 0

    def snapshot(self):
        self.asked += 1
        return super().snapshot() if self.asked < 3 else {"to_scan": object()}


class Elsewhere(Sound):
    """Asks for another place outside the fence at every step."""

    def goal(self, seen):
        return Waypoint((5000.0 + seen.time_s, 0.0), 30.0, 5.0)


class Real:
    """The embedded vehicle as one of which nobody knows the truth."""

    truth = None

    def __init__(self):
        inner = embedded_vehicle(SMALL, 0)
        self.state, self.command, self.advance = inner.state, inner.command, inner.advance
        self.takeoff, self.land, self.hold = inner.takeoff, inner.land, inner.hold


def flown(strategy, vehicle=None):
    """Why the mission ended, its journal's lines, and its vehicle."""
    mission = build_mission(SMALL, 0, Rig("statistical", strategy=spec_of(strategy), vehicle=vehicle))
    journal = MemoryJournal()
    return fly(mission, journal), journal.lines, mission.vehicle


def alarms(lines):
    return [line for line in lines if line["kind"] == "safety" and line["cause"] == "strategy"]


@pytest.mark.parametrize(
    ("strategy", "words"),
    [
        (Raises, r"step raises IndexError: list index out of range at test_strategy_faults\.py:\d+; mend it"),
        (Answers, r"step returned None; return a Command\(mode, waypoint, events\)"),
        (CannotBeSaved, r"snapshot returned what JSON cannot hold \(a object\); return numbers"),
    ],
)
def test_a_real_vehicle_comes_home_from_a_strategy_that_fails(strategy, words):
    reason, lines, vehicle = flown(strategy, Real())
    assert reason == "strategy"
    (alarm,) = alarms(lines)
    assert alarm["action"] == "RETURN"
    assert re.search(words, alarm["sentence"])
    state = vehicle.state()
    assert not state.airborne
    assert math.dist(state.position_enu_m[:2], (-5.0, -5.0)) < 2.0
    assert [line["kind"] for line in lines][-2:] == ["landed", "end"]


def test_a_simulation_ends_in_one_sentence():
    with pytest.raises(UserError, match="Raises: step raises IndexError"):
        flown(Raises)


def test_a_sound_one_is_flown_the_same_in_both():
    simulated, real = flown(Sound), flown(Sound, Real())
    assert simulated[0] == real[0] == "completed"
    assert simulated[1][-1] == real[1][-1]


def test_refused_waypoints_that_never_repeat_end_the_search():
    reason, lines, _ = flown(Elsewhere)
    assert reason == "geofence"
    told = [line for line in lines if line["kind"] == "safety"]
    assert [line["action"] for line in told] == ["REFUSE_CHECK"] * 5 + ["RETURN"]
    assert 9.0 < told[-1]["t"] - told[0]["t"] < 12.0
    assert "that were refused in a row" in told[-1]["sentence"]
