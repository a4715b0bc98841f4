"""Waypoints that are flown through, and those that turn the nose."""

import math

import numpy as np
import pytest

from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import Flight
from skysweep.scenarios.model import Scenario
from skysweep.strategies.spec import StrategySpec
from skysweep.types import Command, Mode, Waypoint

CORNERS = [(0.0, 0.0), (60.0, 0.0), (60.0, 40.0)]
SMALL = {
    "name": "small",
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
    "home": {"position_enu_m": [-5, -5]},
    "targets": [{"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9}],
    "wind": {"mean_speed_mps": 0.0, "gust_std_mps": 0.0},
}


class Corners:
    """Flies round the corners, through them or with a stop."""

    def __init__(self, through, yaw_rad=None, reached_m=4.0):
        self.through, self.yaw_rad, self.reached_m, self.left = through, yaw_rad, reached_m, list(CORNERS)

    def step(self, seen):
        x, y, _ = seen.vehicle.position_enu_m.tolist()
        if math.dist((x, y), self.left[0]) <= self.reached_m:
            self.left.pop(0)
        if not self.left:
            return Command(Mode.SCAN, None)
        then = self.left[1] if self.through and len(self.left) > 1 else None
        return Command(Mode.SCAN, Waypoint(self.left[0], 20.0, 5.0, False, then, self.yaw_rad))

    def snapshot(self):
        return {}

    def restore(self, snapshot):
        pass


def flown(**how):
    """States of the search."""
    changes = how.pop("changes", {})
    spec = StrategySpec(lambda _context: Corners(**how), lambda _search: 20.0)
    mission = build_mission(Scenario.model_validate(SMALL | changes), 0, Rig("statistical", strategy=spec))
    with Flight(mission, MemoryJournal()) as flight:
        return [tick.state for tick in flight if tick.mode == Mode.SCAN]


def slowest_mps(states):
    """Near the second corner."""
    near = [s for s in states if math.dist(s.position_enu_m[:2].tolist(), CORNERS[1]) < 6.0]
    return min(float(np.hypot(*s.velocity_enu_mps[:2])) for s in near)


def test_a_waypoint_that_is_flown_through_costs_no_stop():
    stops, through = flown(through=False, reached_m=1.0), flown(through=True)
    assert slowest_mps(through) > slowest_mps(stops) + 0.7
    assert through[-1].time_s < stops[-1].time_s - 1.5


def test_it_is_not_cut_where_the_cut_is_barred():
    """The corner is a no-fly area's: nearer than it asks for nobody comes."""
    barred = [[50.0, 4.0], [57.0, 4.0], [57.0, 12.0], [50.0, 12.0]]
    changes = {"safety": {"no_fly_enu_m": [barred]}}
    for state in flown(through=True, changes=changes):
        x, y, _ = state.position_enu_m.tolist()
        assert not (50.0 < x < 57.0 and 4.0 < y < 12.0)


def test_the_nose_turns_where_a_waypoint_asks_for_it():
    last = flown(through=True, yaw_rad=math.pi / 2)[-1]
    nose = last.R_body_to_enu[:, 0]
    assert nose[1] == pytest.approx(1.0, abs=0.1)
