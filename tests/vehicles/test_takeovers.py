"""Somebody takes the vehicle over, at every moment: never overruled, always said. On the look-alike."""

from __future__ import annotations

import numpy as np
import pytest
from face_link import FaceLink
from mavlink_clients import Program, Sky
from takeovers import FAILSAFES, NOBODY, ON_LOSS, ORDERS, PARAMETERS, PHASES, WHO, Cell, cells, play

from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.px4 import Px4Vehicle

_STICKS_EVERY_S = 0.05
_HEARTBEAT_EVERY_S = 1.0


class LookAlike:
    """The look-alike, our program and a ground station in virtual time. Implements ``takeovers.Range``."""

    def __init__(self, on_loss: int) -> None:
        self.sky = Sky()
        self.station = Program(self.sky, port=2, system=250)
        self._link = FaceLink(self.sky)
        self._link.others.append(self._speak)
        self._moving: bool | None = None
        self._next_stick_s = self._next_beat_s = self._open_again_s = 0.0
        for name, value in (PARAMETERS | {"COM_OBL_RC_ACT": on_loss}).items():
            assert self.sky.face.parameters.set(name, value), name
        self.vehicle = Px4Vehicle(
            "virtual", self.sky.scenario, lambda xy: np.zeros(len(xy)), open_link=lambda *_: self._link
        )

    def cut(self, seconds: float) -> None:
        self._link.open, self._open_again_s = False, self.now_s() + seconds

    def now_s(self) -> float:
        return self.sky.pilot.time_s

    def wait(self, seconds: float) -> None:
        end_s = self.now_s() + seconds
        self.vehicle.advance(seconds)
        while self.now_s() < end_s - 1e-6:
            self._link.tick()

    def command(self, number: int, *params: float) -> None:
        assert self.station.command(number, *params) == m.MAV_RESULT_ACCEPTED

    def sticks(self, moving: bool | None) -> None:
        self._moving = moving

    def fail(self, what: str) -> None:
        pilot = self.sky.pilot
        if what == "geofence":
            pilot.parameters.set("GF_ACTION", 2)
            pilot.parameters.set("GF_MAX_HOR_DIST", 2.0)
            pilot.parameters.set("GF_MAX_VER_DIST", 2.0)
        elif what == "low battery":
            pilot.battery_share = 0.06
        else:
            pilot.gnss_lost = True

    def flown(self):
        return self.sky.pilot.mode.value, self.sky.pilot.armed

    def orders(self) -> list[int]:
        said = [number for number in self._link.orders if number in ORDERS]
        self._link.orders.clear()
        return said

    def _speak(self) -> None:
        now_s = self.now_s()
        if now_s >= self._open_again_s:
            self._link.open = True
        if now_s >= self._next_beat_s:
            self._next_beat_s = now_s + _HEARTBEAT_EVERY_S
            self.station.say(m.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
        if self._moving is not None and now_s >= self._next_stick_s:
            self._next_stick_s = now_s + _STICKS_EVERY_S
            forward = 400 if self._moving else 0
            self.station.say(m.MAVLink_manual_control_message(1, forward, 0, 500, 0, 0))
        self.station.forget()


def faults(cell: Cell) -> list[str]:
    there = LookAlike(cell.on_loss)
    return play(cell, there).faults(cell)


@pytest.mark.parametrize("on_loss", ON_LOSS)
@pytest.mark.parametrize("phase", PHASES)
def test_whoever_takes_it_in_a_phase_keeps_it(phase, on_loss):
    chosen = [c for c in cells() if not c.gap_s and (c.phase, c.on_loss) == (phase, on_loss)]
    assert {c.who for c in chosen} == set(WHO)
    wrong = {str(cell): found for cell in chosen if (found := faults(cell))}
    assert not wrong


GAPS = sorted({(c.on_loss, c.gap_s, c.after_s) for c in cells() if c.gap_s})


@pytest.mark.parametrize(("on_loss", "gap_s", "after_s"), GAPS)
def test_whoever_takes_it_around_a_gap_of_the_link_keeps_it(on_loss, gap_s, after_s):
    chosen = [c for c in cells() if (c.on_loss, c.gap_s, c.after_s) == (on_loss, gap_s, after_s)]
    wrong = {str(cell): found for cell in chosen if (found := faults(cell))}
    assert not wrong


def test_there_are_enough_cells():
    everything = cells()
    assert len(set(everything)) == len(everything) >= 300
    assert {c.who for c in everything} == {*WHO, NOBODY}
    assert set(FAILSAFES) < {c.who for c in everything if c.gap_s == 0.0}
