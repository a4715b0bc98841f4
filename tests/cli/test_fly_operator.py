"""The person at the keyboard of 'skysweep fly', and the one at its page."""

import pytest

from skysweep.cli import fly
from skysweep.cli.live import PageOrders
from skysweep.errors import UserError
from skysweep.mission.orders import CONTINUE, HOLD, RETURN, TAKE_BACK, Order
from skysweep.mission.safety import OVER, Action
from skysweep.types import Mode


class State:
    def __init__(self, taken_over="", waits="", airborne=False):
        self.taken_over, self.waits, self.airborne = taken_over, waits, airborne


class Page:
    """A live page."""

    is_there = True

    def __init__(self):
        self.orders = []

    def order(self):
        return self.orders.pop(0) if self.orders else None


class Keyboard:
    """An operator at a keyboard, one at the page, and the time on the wall."""

    def __init__(self, monkeypatch, folder):
        self.now_s, self._is_pressed, self.page = 100.0, False, Page()
        monkeypatch.setattr(fly, "enter_pressed", lambda: self._is_pressed)
        monkeypatch.setattr(fly, "has_keyboard", lambda: True)
        monkeypatch.setattr(fly.time, "monotonic", lambda: self.now_s)
        self.operator = fly._Operator(folder, PageOrders(self.page))

    def sees(self, taken_over="", mode=Mode.SWAP, waits=""):
        self.operator.look(State(taken_over, waits), mode)

    def says_on_the_page(self, word):
        self.page.orders.append(Order(word))
        return self.operator()

    def ctrl_c(self):
        self.operator._interrupt(0, None)
        return self.operator()

    def hears(self, cause, action, sentence="It is so."):
        line = {"kind": "safety", "cause": cause, "action": action.name, "sentence": sentence}
        self.operator.hear(line)

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
    assert keyboard.enter(2.0) == Order(TAKE_BACK, holder="it is in Position")
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


def test_enter_for_one_holder_does_not_take_it_from_a_later_one(keyboard):
    keyboard.sees("it is in Hold", Mode.HOLD)
    keyboard.now_s += 5.0
    keyboard.sees("it is in Position", Mode.HOLD)
    assert keyboard.enter(0.3) is None
    assert keyboard.enter(1.5) == Order(TAKE_BACK, holder="it is in Position")


def test_enter_ends_a_hold_of_the_page(keyboard):
    keyboard.sees(mode=Mode.SCAN)
    assert keyboard.says_on_the_page(HOLD) == Order(HOLD)
    keyboard.hears("operator", Action.HOLD)
    assert keyboard.operator.hint == "Enter: go on, Ctrl-C: return"
    assert keyboard.enter(0.1) == Order(CONTINUE)


def test_after_a_continue_on_the_page_ctrl_c_holds_again(keyboard):
    keyboard.sees(mode=Mode.SCAN)
    assert keyboard.ctrl_c() == Order(HOLD)
    keyboard.hears("operator", Action.HOLD)
    assert keyboard.says_on_the_page(CONTINUE) == Order(CONTINUE)
    keyboard.hears("operator", Action.CONTINUE, OVER["operator"])
    assert keyboard.ctrl_c() == Order(HOLD)
    assert keyboard.ctrl_c() == Order(RETURN)


def test_after_a_hold_that_the_mission_ended_ctrl_c_holds_again(keyboard):
    keyboard.sees(mode=Mode.RETURN)
    keyboard.ctrl_c()
    keyboard.hears("operator", Action.HOLD)
    keyboard.hears("operator", Action.CONTINUE, "The place 3 m east, 4 m north is not looked at.")
    assert keyboard.operator.hint == "Enter: go on, Ctrl-C: return"
    keyboard.hears("operator", Action.CONTINUE, OVER["operator"])
    assert keyboard.ctrl_c() == Order(HOLD)


def test_what_is_ours_again_is_held_by_the_operator_then(keyboard):
    keyboard.sees(mode=Mode.SCAN, waits="It is in Offboard again.")
    keyboard.hears("taken over", Action.HOLD)
    keyboard.says_on_the_page(HOLD)
    keyboard.hears("operator", Action.HOLD)
    keyboard.hears("taken over", Action.CONTINUE, OVER["taken over"])
    assert keyboard.operator.hint == "Enter: go on, Ctrl-C: return"


def test_after_return_on_the_page_enter_ends_a_hold_on_the_way_home(keyboard):
    keyboard.sees(mode=Mode.RETURN)
    keyboard.says_on_the_page(RETURN)
    assert keyboard.operator.hint.startswith("returning")
    assert keyboard.enter(0.1) is None
    keyboard.says_on_the_page(HOLD)
    keyboard.hears("operator", Action.HOLD)
    assert keyboard.enter(0.1) == Order(CONTINUE)


def test_without_keyboard_and_page_nobody_can_take_it_back(keyboard, monkeypatch, capsys):
    monkeypatch.setattr(fly, "has_keyboard", lambda: False)
    state = State("it is in Hold", airborne=True)
    keyboard.operator()
    keyboard.operator.look(state, Mode.HOLD)
    keyboard.page.is_there = False
    keyboard.operator()
    keyboard.operator()
    assert capsys.readouterr().err.count("the live page has ended") == 1
    with pytest.raises(UserError, match="no keyboard to take it back; when it is free:  skysweep fly "):
        keyboard.operator.look(state, Mode.HOLD)
