"""The look-alike, our program and somebody else, in virtual time."""

from __future__ import annotations

import atexit

import numpy as np
from face_link import FaceLink
from mavlink_clients import Program, Sky
from takeovers import ORDERS, PARAMETERS

from skysweep.scenarios.model import Scenario
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.px4.vehicle import Px4Vehicle

_STICKS_EVERY_S = 0.05
_HEARTBEAT_EVERY_S = 1.0


class LookAlike:
    """The look-alike, our program and a ground station in virtual time. Implements ``takeovers.Range``."""

    def __init__(self, on_loss: int, of: Scenario | None = None, booted_s: float = 0.0) -> None:
        self.sky = Sky(of)
        self.sky.fly(booted_s)
        self.station = Program(self.sky, port=2, system=250)
        self._link = FaceLink(self.sky)
        self._link.others.append(self._speak)
        self._moving: bool | None = None
        self._next_stick_s = self._next_beat_s = self._open_again_s = 0.0
        for name, value in (PARAMETERS | {"COM_OBL_RC_ACT": on_loss}).items():
            assert self.sky.face.parameters.set(name, value), name
        self.vehicle: Px4Vehicle | None = None
        self.connect()

    def connect(self) -> None:
        """Our program begins, again perhaps: the one before it is as if killed."""
        if self.vehicle is not None:
            atexit.unregister(self.vehicle.close)
        self._link.drop()
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
