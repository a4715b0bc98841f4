"""The person at the keyboard of 'skysweep fly'."""

import pytest

from skysweep.cli import fly
from skysweep.mission.orders import CONTINUE, TAKE_BACK, Order
from skysweep.types import Mode


class State:
    airborne = False

    def __init__(self, taken_over="", waits=""):
        self.taken_over, self.waits = taken_over, waits


class Keyboard:
    """An operator at a keyboard, and the time on the wall."""

    def __init__(self, monkeypatch, folder):
        self.now_s, self._is_pressed = 100.0, False
        monkeypatch.setattr(fly, "enter_pressed", lambda: self._is_pressed)
        monkeypatch.setattr(fly, "has_keyboard", lambda: True)
        monkeypatch.setattr(fly.time, "monotonic", lambda: self.now_s)
        self.operator = fly._Operator(folder)

    def sees(self, taken_over="", mode=Mode.SWAP, waits=""):
        self.operator.look(State(taken_over, waits), mode)

    def enter(self, after_s):
        self.now_s += after_s
        self._is_pressed = True
        order = self.operator()
        self._is_pressed = False
        return order


@pytest.fixture
def keyboard(monkeypatch, tmp_path):
    return Keyboard(monkeypatch, tmp_path)


def test_a_second_tap_on_take_back_does_not_take_off(keyboard):
    keyboard.sees("it is in Position")
    assert keyboard.enter(2.0) == Order(TAKE_BACK)
    keyboard.sees()
    assert keyboard.enter(0.3) is None
    assert keyboard.enter(1.5) == Order(CONTINUE)


def test_after_a_hold_on_the_way_down_enter_on_the_ground_needs_to_be_read(keyboard):
    keyboard.sees(mode=Mode.LAND)
    keyboard.operator._interrupt(0, None)
    keyboard.operator()
    keyboard.sees()
    assert keyboard.enter(0.3) is None
    assert keyboard.enter(1.5) == Order(CONTINUE)


def test_in_the_air_enter_ends_a_hold_at_once(keyboard):
    keyboard.sees(mode=Mode.SCAN)
    keyboard.operator._interrupt(0, None)
    assert keyboard.enter(0.1) == Order(CONTINUE)


def test_a_vehicle_that_is_ours_again_without_a_word_goes_on_after_enter_that_was_meant(keyboard):
    keyboard.sees("it is in Hold", Mode.SCAN)
    keyboard.sees(mode=Mode.SCAN, waits="It is in Offboard again.")
    assert keyboard.operator.hint == "Enter: go on, Ctrl-C: return"
    assert keyboard.enter(0.3) is None
    assert keyboard.enter(1.5) == Order(CONTINUE)
