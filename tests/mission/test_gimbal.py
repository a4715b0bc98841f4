"""Waypoints that point the camera: the vehicle's gimbal, what the sensors see, a vehicle that cannot."""

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
from skysweep.vehicles.embedded.multirotor import Multirotor

DOWN, FORWARD = -math.pi / 2, math.radians(-50.0)
HEIGHT_M = 20.0
SMALL = {
    "name": "small",
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
    "home": {"position_enu_m": [-5, -5]},
    "targets": [{"class": "stop sign", "position_enu_m": [55, 5], "size_m": 0.9}],
    "camera": {"hfov_rad": 1.2},
}
EAST = 0.0


class Course:
    """Flies from place to place; each has the camera's pitch."""

    def __init__(self, *places):
        self.left = list(places)

    def step(self, seen):
        here = seen.vehicle.position_enu_m[:2].tolist()
        if self.left and math.dist(here, self.left[0][0]) < 2.0:
            self.left.pop(0)
        if not self.left or seen.refused:
            return Command(Mode.SCAN, None)
        xy, pitch_rad = self.left[0]
        return Command(Mode.SCAN, Waypoint(xy, HEIGHT_M, 5.0, yaw_rad=EAST, gimbal_pitch_rad=pitch_rad))

    def snapshot(self):
        return {}

    def restore(self, snapshot):
        pass


def flown(*places, sensor="statistical", changes=None, **rig):
    """The ticks of the search with the true camera poses, and the journal's lines."""
    spec = StrategySpec(lambda _context: Course(*places), lambda _search: HEIGHT_M)
    scenario = Scenario.model_validate(SMALL | (changes or {}))
    mission = build_mission(scenario, 0, Rig(sensor, strategy=spec, **rig))
    journal, truth = MemoryJournal(), mission.vehicle.truth
    with Flight(mission, journal) as flight:
        ticks = [(t, truth and truth.true_camera_pose()) for t in flight if t.mode == Mode.SCAN]
    mission.sensor.close()
    return ticks, journal.lines


def test_the_gimbal_turns_at_its_rate_and_the_belief_follows_it():
    slow = SMALL["camera"] | {"gimbal": {"max_rate_dps": 60.0}}
    ticks, _ = flown(((10.0, 5.0), None), ((50.0, 5.0), FORWARD), changes={"camera": slow})
    pitches = np.array([tick.state.camera.pitch_rad for tick, _ in ticks])
    assert pitches[0] == pytest.approx(DOWN)
    assert pitches[-1] == pytest.approx(FORWARD)
    steps = np.diff(pitches)
    assert 0.0 < steps.max() <= math.radians(0.5 * 60.0) * 0.1 + 1e-9
    assert len(steps[steps > 1e-6]) >= 13  # 40 degrees at 30 degrees a second
    assert ticks[-1][1].pitch_rad == pytest.approx(FORWARD, abs=0.05)


def test_a_waypoint_without_a_pitch_has_that_of_the_scenario_again():
    ticks, _ = flown(((10.0, 5.0), FORWARD), ((50.0, 5.0), None))
    assert ticks[len(ticks) // 4][0].state.camera.pitch_rad == pytest.approx(FORWARD)
    assert ticks[-1][0].state.camera.pitch_rad == pytest.approx(DOWN)


class FixedCamera(Multirotor):
    """A vehicle whose camera looks straight down, whatever it is told."""

    def look(self, pitch_rad):
        pass


def first_seen_from_m(lines):
    """How far before the target the vehicle was when it first saw it."""
    seen = next(line for line in lines if line["kind"] == "sighting")
    here = next(line for line in lines if line["kind"] == "state" and line["t"] >= seen["t"])
    assert seen["p"][:2] == pytest.approx([55.0, 5.0], abs=3.0)
    return 55.0 - here["p"][0]


@pytest.mark.parametrize("sensor", ["statistical", pytest.param("imaging", marks=pytest.mark.slow)])
def test_a_camera_that_looks_ahead_sees_a_target_earlier_and_where_it_is(sensor):
    course = (5.0, 5.0), (58.0, 5.0)
    down = flown(*((xy, None) for xy in course), sensor=sensor)[1]
    ahead = flown(*((xy, math.radians(-60.0)) for xy in course), sensor=sensor)[1]
    assert first_seen_from_m(ahead) > first_seen_from_m(down) + 4.0


@pytest.mark.slow
@pytest.mark.parametrize("max_rate_dps", [180.0, 90.0])
def test_no_picture_is_doubted_because_the_gimbal_was_turned(max_rate_dps):
    places = (5.0, 5.0), (40.0, 5.0), (40.0, 15.0), (5.0, 15.0), (5.0, 25.0), (40.0, 25.0), (40.0, 35.0)
    pitches = np.radians([-90.0, -60.0, -75.0, -30.0, 10.0, -45.0, -90.0])
    camera = SMALL["camera"] | {"gimbal": {"max_rate_dps": max_rate_dps}}
    ticks, lines = flown(*zip(places, pitches, strict=True), sensor="imaging", changes={"camera": camera})
    looks = [tick.detections for tick, _ in ticks if tick.detections is not None]
    assert not [line for line in lines if line["kind"] == "safety"]
    assert {round(math.degrees(look.camera.pitch_rad)) for look in looks} >= {-90, -60, -75, -30, -45}


def test_no_picture_is_taken_that_would_be_put_elsewhere():
    """A picture's pose is 0.1 s old, in which a fast gimbal turns by 9 degrees."""
    ticks, _ = flown(((10.0, 5.0), None), ((30.0, 5.0), FORWARD), ((50.0, 5.0), None))
    true = {round(tick.state.time_s, 3): pose.pitch_rad for tick, pose in ticks}
    looks = [tick.detections for tick, _ in ticks if tick.detections is not None]
    wrong = [abs(look.camera.pitch_rad - true.get(round(look.time_s, 3), DOWN)) for look in looks]
    assert max(wrong) < math.radians(6.0)


@pytest.mark.parametrize("pitch_deg", [-91.0, 50.0])
def test_a_pitch_that_no_gimbal_takes_is_refused(pitch_deg):
    _, lines = flown(((10.0, 5.0), math.radians(pitch_deg)))
    (refused,) = [line for line in lines if line["kind"] == "safety"]
    assert refused["action"] == "REFUSE_CHECK"
    assert "is not -90 to 45 degrees" in refused["sentence"]


def test_a_vehicle_that_cannot_point_its_camera_is_said_once():
    s = Scenario.model_validate(SMALL)
    vehicle = FixedCamera(s.vehicle, s.wind, s.camera, [-5.0, -5.0, 0.0], lambda _x, _y: 0.0, 0)
    places = [((x, y), pitch) for y in (5.0, 20.0, 35.0) for x, pitch in ((0.0, None), (60.0, FORWARD))]
    _, lines = flown(*places, vehicle=vehicle)
    (said,) = [line for line in lines if line["kind"] == "safety"]
    assert said["cause"] == "gimbal"
    assert said["action"] == "CONTINUE"
    assert said["sentence"] == "The camera's pitch is -90 degrees, not -50: the vehicle does not point it."
    assert lines[-1] == {"t": lines[-1]["t"], "kind": "end", "reason": "completed"}


class Yanked(Multirotor):
    """Somebody else turns its camera up for a while."""

    from_s, to_s = 20.0, 40.0

    def command(self, setpoint):
        up = self.from_s <= self.state().time_s < self.to_s
        super().command(setpoint._replace(gimbal_pitch_rad=math.radians(20.0)) if up else setpoint)


def test_what_a_camera_shows_that_somebody_turned_away_does_not_count():
    s = Scenario.model_validate(SMALL)
    vehicle = Yanked(s.vehicle, s.wind, s.camera, [-5.0, -5.0, 0.0], lambda _x, _y: 0.0, 0)
    places = [((x, y), None) for y in (5.0, 20.0, 35.0) for x in (0.0, 60.0)]
    ticks, lines = flown(*places, vehicle=vehicle)
    said = [line for line in lines if line["kind"] == "safety" and line["cause"] == "gimbal"]
    assert [line["sentence"] for line in said] == [
        "The camera's pitch is 20 degrees, not -90: the vehicle does not point it, "
        "and what it shows does not count.",
        "The camera points where it is told again.",
    ]
    assert said[0]["t"] < 24.0
    looks = [tick.detections for tick, _ in ticks if tick.detections is not None]
    assert not [look for look in looks if Yanked.from_s + 1.5 < look.time_s < Yanked.to_s]
    assert [look for look in looks if look.time_s > Yanked.to_s + 2.0]
    blind = [line for line in lines if line["kind"] == "unsearched"]
    assert sum(line["length_m"] for line in blind) > 30.0
