"""The estimate of the time left."""

from contextlib import closing

import numpy as np
import pytest

from skysweep.flights import outlook as outlooks
from skysweep.flights.build import build_mission
from skysweep.flights.outlook import Outlook
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import CameraPose
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.types import Mode


class Clock:
    """A wall clock on which a mission flies ten times as fast as real time."""

    def __init__(self):
        self.now_s = 0.0

    def monotonic(self):
        return self.now_s


@pytest.fixture
def clock(monkeypatch):
    made = Clock()
    monkeypatch.setattr(outlooks, "time", made)
    return made


def estimates(clock, scenario, speed=10.0):
    """Wall time, mode and estimate at each tick."""
    outlook, told = Outlook(), []

    def watch(state, mode, _new):
        clock.now_s = state.time_s / speed
        outlook.look(state, mode)
        told.append((clock.now_s, str(mode), outlook.left_s))

    mission = build_mission(scenario, 0, Rig("statistical"))
    outlook.prepare(mission)
    with closing(mission.sensor):
        fly(mission, MemoryJournal(), watch)
    return told


def test_a_scan_ends_when_it_was_estimated_to(clock):
    told = estimates(clock, change_scenario(load_scenario("clusters"), {"search.strategy": "scan-only"}))
    end_s = told[-1][0]
    known = [(now_s, left_s) for now_s, _, left_s in told if left_s is not None]
    assert known[0][0] < 1.0
    for now_s, left_s in known[:: len(known) // 20]:
        assert left_s == pytest.approx(end_s - now_s, abs=0.15 * end_s)


def test_a_check_moves_the_end(clock):
    told = estimates(clock, load_scenario("clusters"))
    checks = [(now_s, left_s) for now_s, mode, left_s in told if mode == "CHECK"]
    (begin_s, at_begin_s), (end_s, at_end_s) = checks[0], checks[-1]
    assert end_s - begin_s > 2.0
    assert end_s + at_end_s > begin_s + at_begin_s + 2.0


def test_a_vehicle_without_a_position_has_no_estimate(clock):
    mission = build_mission(load_scenario("clusters"), 0, Rig("statistical"))
    outlook = Outlook()
    outlook.prepare(mission)
    state = mission.vehicle.state()
    for mode in (Mode.TAKEOFF, Mode.RETURN):
        for _ in range(3):
            clock.now_s += 1.0
            place = np.full(3, np.nan if mode == Mode.RETURN else 0.0)
            camera = CameraPose(place, state.camera.R_camera_to_enu)
            outlook.look(state._replace(time_s=clock.now_s, position_enu_m=place, camera=camera), mode)
        assert (outlook.left_s is None) == (mode == Mode.RETURN)


def test_the_time_left_counts_the_sorties_that_are_still_to_be_flown(clock):
    field = {
        "vehicle.battery_wh": 9.0,
        "vehicle.batteries": 6,
        "vehicle.swap_s": 60.0,
        "search.strategy": "scan-only",
    }
    told = estimates(clock, change_scenario(load_scenario("clusters"), field))
    end_s = told[-1][0]
    assert "SWAP" in {mode for _, mode, _ in told}
    known = [(now_s, left_s) for now_s, _, left_s in told if left_s is not None]
    for now_s, left_s in known[:: len(known) // 20]:
        assert left_s == pytest.approx(end_s - now_s, abs=0.2 * end_s)
