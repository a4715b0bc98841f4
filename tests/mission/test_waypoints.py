"""Waypoints that are flown through, those that turn the nose, and those that are refused in any mode."""

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


class Places:
    """Asks for one place after the other, each once it is reached or refused, in one mode."""

    def __init__(self, mode, *places):
        self.mode, self.left, self.refused = mode, [Waypoint(*place) for place in places], []

    def step(self, seen):
        x, y, _ = seen.vehicle.position_enu_m.tolist()
        place = self.left[0]
        there = (
            math.dist((x, y), place.xy_enu_m) < 1.0 and abs(seen.altitude_agl_m - place.altitude_agl_m) < 0.5
        )
        if seen.refused:
            self.refused.append((place.xy_enu_m, seen.refused))
        if seen.refused or there:
            self.left.pop(0)
        return Command(self.mode, self.left[0] if self.left else None)

    snapshot, restore = Corners.snapshot, Corners.restore


def asked(mode, *places, **changes):
    """What was refused, and the states of the search."""
    strategy = Places(mode, *places)
    spec = StrategySpec(lambda _context: strategy, lambda _search: 20.0)
    mission = build_mission(Scenario.model_validate(SMALL | changes), 0, Rig("statistical", strategy=spec))
    with Flight(mission, MemoryJournal()) as flight:
        states = [tick.state for tick in flight if tick.mode == mode]
    return strategy.refused, states


@pytest.mark.parametrize("mode", [Mode.SCAN, Mode.CHECK])
def test_a_place_that_was_allowed_is_refused_where_it_is_asked_for_too_low(mode):
    refused, states = asked(
        mode, ((30.0, 20.0), 5.0, 3.0), ((30.0, 20.0), 0.4, 3.0), ((30.0, 20.0), 9.0, 3.0)
    )
    assert refused == [((30.0, 20.0), "altitude")]
    heights = [state.position_enu_m[2] for state in states]
    assert min(heights) > 4.0
    assert heights[-1] > 8.0


@pytest.mark.parametrize("mode", [Mode.SCAN, Mode.CHECK])
def test_a_place_too_far_for_the_battery_is_refused(mode):
    weak = {"vehicle": {"battery_wh": 12.0}, "safety": {"battery_low": 0.01, "battery_critical": 0.005}}
    far = (400.0, 20.0)
    far_fence = {"geofence_enu_m": [[-50, -50], [500, -50], [500, 90], [-50, 90]]}
    refused, states = asked(mode, (far, 20.0, 5.0), ((30.0, 20.0), 20.0, 5.0), **weak, **far_fence)
    assert refused == [(far, "return energy")]
    assert max(state.position_enu_m[0] for state in states) < 35.0
    assert states[-1].position_enu_m[0] == pytest.approx(30.0, abs=1.5)


class Lost:
    """Asks for one and the same place that is not finite, calculated anew at every step."""

    def __init__(self, **wrong):
        self.wrong = wrong

    def step(self, seen):
        wrong = {field: value(float("nan")) for field, value in self.wrong.items()}
        return Command(Mode.SCAN, Waypoint((30.0, 20.0), 20.0, 5.0, to_look=True)._replace(**wrong))

    snapshot, restore = Corners.snapshot, Corners.restore


@pytest.mark.parametrize(
    "wrong",
    [
        {"xy_enu_m": lambda nan: (nan, 20.0)},
        {"altitude_agl_m": lambda nan: nan},
        {"speed_mps": lambda nan: nan},
        {"then_xy_enu_m": lambda nan: (20.0, nan)},
        {"yaw_rad": lambda nan: nan},
        {"yaw_rad": lambda _nan: math.inf},
        {"gimbal_pitch_rad": lambda nan: nan},
    ],
)
def test_a_waypoint_that_is_not_finite_is_refused_by_the_name_of_its_field(wrong):
    """Once; insisted on, it ends the search. Trees, so that the place to look from would be searched for."""
    trees = [{"position_enu_m": [40, 30], "height_m": 8}]
    spec = StrategySpec(lambda _context: Lost(**wrong), lambda _search: 20.0)
    scenario = Scenario.model_validate(SMALL | {"trees": trees})
    journal = MemoryJournal()
    with Flight(build_mission(scenario, 0, Rig("statistical", strategy=spec)), journal) as flight:
        assert all(np.isfinite(tick.state.position_enu_m).all() for tick in flight)
    said = [line for line in journal.lines if line["kind"] == "safety"]
    (field,) = wrong
    assert [line["action"] for line in said] == ["REFUSE_CHECK", "RETURN"]
    assert {line["sentence"] for line in said} == {f"A waypoint is not flown to: its {field} is not finite."}
    assert any(line["kind"] == "landed" for line in journal.lines)


def test_a_heading_that_is_not_finite_is_refused_at_a_place_that_was_allowed():
    place = (30.0, 20.0)
    refused, states = asked(
        Mode.SCAN,
        (place, 20.0, 5.0),
        (place, 20.0, 5.0, False, None, math.nan),
        ((10.0, 20.0), 20.0, 5.0),
    )
    assert refused == [(place, "waypoint")]
    assert np.isfinite(states[-1].position_enu_m).all()
