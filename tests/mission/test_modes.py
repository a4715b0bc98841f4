"""What is flown, told and counted as seen does not depend on how a strategy calls its modes."""

from dataclasses import replace

import numpy as np
import pytest

from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.results.metrics import seen_area
from skysweep.results.run_folder import Run
from skysweep.scenarios.model import Scenario
from skysweep.strategies.baselines import SingleAltitude
from skysweep.strategies.spec import StrategySpec
from skysweep.types import Mode, Setpoint

SCENARIO = Scenario.model_validate(
    {
        "name": "small",
        "area": {"polygon_enu_m": [[0, 0], [90, 0], [90, 60], [0, 60]]},
        "home": {"position_enu_m": [-5, -5]},
        "targets": [{"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9}],
        "search": {"scan_altitude_agl_m": 20.0, "check_altitude_agl_m": 3.0},
    }
)


class Renamed:
    """A strategy that calls every mode the same."""

    def __init__(self, inner, mode):
        self.inner, self.mode = inner, mode
        self.snapshot, self.restore = inner.snapshot, inner.restore

    def step(self, seen):
        return self.inner.step(seen)._replace(mode=self.mode)


class Deaf:
    """A sensor without answers for ten seconds."""

    def __init__(self, inner):
        self.inner, self.close = inner, inner.close

    def sense(self, state):
        found = self.inner.sense(state)
        return None if 20.0 < state.time_s < 30.0 else found


class Borrowed:
    """A vehicle that somebody takes for twelve seconds and leads to the north."""

    def __init__(self, inner):
        self.inner, self.truth = inner, inner.truth
        self.takeoff, self.land, self.hold, self.command = (
            inner.takeoff,
            inner.land,
            inner.hold,
            inner.command,
        )

    @property
    def is_theirs(self):
        return 40.0 <= self.inner.state().time_s < 52.0

    def state(self):
        return self.inner.state()._replace(taken_over="it is in Position" if self.is_theirs else "")

    def advance(self, duration_s):
        if self.is_theirs:
            x, _, z = self.inner.state().position_enu_m
            self.inner.command(Setpoint(np.array([x, 75.0, z]), 5.0, 0.0))
        self.inner.advance(duration_s)


def flown(mode, altitude_agl_m, slow=False):
    """The journal's lines."""
    spec = StrategySpec(
        lambda context: Renamed(SingleAltitude(context, altitude_agl_m), mode), lambda _search: altitude_agl_m
    )
    mission = build_mission(SCENARIO, 0, Rig("statistical", strategy=spec))
    if slow:
        mission.look_period.period_s = 6.0
    else:
        mission = replace(mission, sensor=Deaf(mission.sensor), vehicle=Borrowed(mission.vehicle))
    journal = MemoryJournal()
    fly(mission, journal)
    return journal.lines


def called(lines, mode):
    return [line | {"mode": mode} if line.get("mode") in (Mode.SCAN, Mode.CHECK) else line for line in lines]


@pytest.mark.parametrize("altitude_agl_m", [20.0, 3.0])
def test_a_mission_that_is_flown_blind_and_taken_is_the_same_by_any_name(altitude_agl_m):
    scan, check = (flown(mode, altitude_agl_m) for mode in (Mode.SCAN, Mode.CHECK))
    assert called(scan, Mode.CHECK) == check
    (blind,) = (line for line in check if line["kind"] == "unsearched")
    assert blind["again"]
    assert blind["length_m"] > 20.0
    taken = [line["p"] for line in check if line["kind"] == "state" and line["mode"] == Mode.HOLD]
    assert max(p[1] for p in taken) > 60.0
    x, y, _ = next(line["p"] for line in check if line["kind"] == "state" and line["t"] >= 39.9)
    back = next(
        line["p"]
        for line in check
        if line["kind"] == "state" and line["t"] > 52.0 and line["mode"] == "CHECK"
    )
    assert back[:2] == pytest.approx([x, y], abs=4.0)
    areas = [seen_area(Run(SCENARIO, tuple(lines))).area for lines in (scan, check)]
    assert areas[0] == areas[1] > 0.9 * SCENARIO.area_enu_m.area


def test_ground_is_covered_no_faster_than_looks_allow_by_any_name():
    scan, check = (flown(mode, 3.0, slow=True) for mode in (Mode.SCAN, Mode.CHECK))
    assert called(scan, Mode.CHECK) == check
    assert [line["cause"] for line in check if line["kind"] == "safety"][:2] == [
        "detector slow",
        "scan slowed",
    ]
    searched = [line["v"] for line in check if line["kind"] == "state" and line["mode"] == Mode.CHECK]
    assert max(np.hypot(*v[:2]) for v in searched) < 2.0
