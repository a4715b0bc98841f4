"""States whose clock or numbers are wrong, one by one."""

import math

import numpy as np
import pytest

from skysweep.geometry.camera import CameraPose
from skysweep.mission.believable import Believable
from skysweep.types import VehicleState


class Script:
    """A vehicle that says one state after another: each is a time and an east."""

    truth = None

    def __init__(self, *said):
        self.said, self.now = said, 0

    def state(self):
        t, x = self.said[self.now]
        place = np.array([x, 0.0, 30.0])
        return VehicleState(
            t, place, np.zeros(3), np.eye(3), CameraPose(place, np.eye(3)), 0.9, 1.0, True, silent_s=0.0
        )

    def advance(self, _duration_s):
        self.now += 1

    def takeoff(self, _altitude_agl_m):
        self.now += 1


def heard(*said):
    vehicle = Believable(Script(*said))
    states = [vehicle.state()]
    for _ in said[1:]:
        vehicle.advance(0.1)
        states.append(vehicle.state())
    return vehicle, states


def test_sound_states_are_passed_on_as_they_are():
    vehicle, states = heard((1.0, 0.0), (1.1, 0.5), (1.3, 1.0))
    assert [(s.time_s, s.position_enu_m[0], s.silent_s) for s in states] == [
        (1.0, 0.0, 0.0),
        (1.1, 0.5, 0.0),
        (1.3, 1.0, 0.0),
    ]
    assert vehicle.state() is not None
    assert vehicle.went_back_s == 0.0


def test_time_that_does_not_pass_is_silence_until_it_passes_again():
    _, states = heard((1.0, 0.0), (1.0, 0.5), (1.0, 1.0), (1.1, 1.5))
    assert [s.silent_s for s in states] == pytest.approx([0.0, 0.1, 0.2, 0.0])
    assert [s.position_enu_m[0] for s in states] == [0.0, 0.5, 1.0, 1.5]


def test_a_late_state_is_left_out():
    _, states = heard((1.0, 0.0), (1.1, 0.5), (0.9, -0.5), (1.3, 1.0))
    assert [s.time_s for s in states] == [1.0, 1.1, 1.1, 1.3]
    assert states[2].position_enu_m[0] == 0.5


def test_a_clock_that_goes_back_goes_on_from_there():
    vehicle, states = heard((60.0, 0.0), (10.0, 0.5), (10.1, 1.0), (5.0, 1.5))
    assert [s.time_s for s in states] == pytest.approx([60.0, 60.0, 60.1, 60.1])
    assert vehicle.went_back_s == pytest.approx(55.1)


@pytest.mark.parametrize("t", [1.1, 1.0])
def test_a_place_that_is_none_is_the_last_that_was_one(t):
    _, states = heard((1.0, 3.0), (t, math.nan), (1.2, 4.0))
    assert states[1].position_enu_m[0] == 3.0
    assert [s.position_std_m for s in states] == [0.0, math.inf, 0.0]


def test_a_time_that_is_none_does_not_pass():
    _, states = heard((1.0, 0.0), (math.nan, 9.0), (1.2, 1.0))
    assert [s.time_s for s in states] == [1.0, 1.0, 1.2]
    assert states[1].position_enu_m[0] == 0.0


def test_time_may_begin_with_the_take_off():
    vehicle = Believable(Script((500.0, 0.0), (0.0, 0.0)))
    vehicle.takeoff(30.0)
    assert (vehicle.state().time_s, vehicle.went_back_s) == (0.0, 0.0)
