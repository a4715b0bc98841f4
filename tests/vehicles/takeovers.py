"""The cells of the takeover matrix: who takes the vehicle over, and when. Played on any PX4 by a ``Range``.

After somebody took it, no order of ours may reach the vehicle, it must stay with whoever took it, and the
vehicle must say that it was taken. Without anybody, it must come back or say why not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from pymavlink.dialects.v20 import common as m

from skysweep.types import Setpoint
from skysweep.vehicles.px4.telemetry import PxMode, mode_name
from skysweep.vehicles.px4.vehicle import Px4Vehicle

OFFBOARD, TAKE_OFF, HOLD, RETURN, LAND = (6, 0), (4, 2), (4, 3), (4, 5), (4, 6)
POSITION, ALTITUDE = (3, 0), (2, 0)
GROUND_STATION = {"LOITER": HOLD, "RTL": RETURN, "LAND": LAND, "POSCTL": POSITION}
TAKEN_IN = {who: (mode,) for who, mode in GROUND_STATION.items()} | {"sticks": (POSITION, ALTITUDE)}
FAILSAFES = ("geofence", "low battery", "GNSS loss")
PILOT = ("sticks", "POSCTL")  # whose transmitter is on from the beginning
WHO = ("sticks", *GROUND_STATION, *FAILSAFES, "kill")
PHASES = ("take-off", "scan", "check", "hold", "return")
GAPS_S = (0.3, 0.75, 2.0, 30.0)
AFTER_S = (-1.0, 0.2, 0.75, 2.0, 10.0, 30.0)  # -1: in the middle of the gap
ON_LOSS = (0, 1, 3, 5, 7)
PARAMETERS = {"COM_RC_IN_MODE": 1, "COM_RC_OVERRIDE": 3, "COM_LOW_BAT_ACT": 3}  # a joystick, which takes over
NOBODY = "nobody"
PEOPLE = ("sticks", *GROUND_STATION, "kill")
_EVERY = 9
SAID_WITHIN_S = 6.0  # PX4 takes seconds to notice a lost GNSS; see LATE_S
LATE_S = {"GNSS loss": 25.0, "low battery": 12.0}
LISTENS_S = 4.0
ORDERS = (
    m.MAV_CMD_DO_SET_MODE,
    m.MAV_CMD_NAV_TAKEOFF,
    m.MAV_CMD_NAV_LAND,
    m.MAV_CMD_NAV_RETURN_TO_LAUNCH,
    m.MAV_CMD_COMPONENT_ARM_DISARM,
)


@dataclass(frozen=True)
class Cell:
    """``after_s`` counts from the end of a gap of ``gap_s``; without a gap the phase decides."""

    who: str
    phase: str
    on_loss: int
    gap_s: float = 0.0
    after_s: float = 0.0

    def __str__(self) -> str:
        gap = f" {self.after_s:g} s after a gap of {self.gap_s:g} s" if self.gap_s else ""
        return f"{self.who}, {self.phase}{gap}, COM_OBL_RC_ACT {self.on_loss}"


@dataclass
class Outcome:
    """What happened after somebody took it."""

    orders: list[int]  # of ours, afterwards
    modes: list[PxMode]  # that the vehicle flew afterwards, each change once
    said: str
    said_after_s: float | None
    armed: bool

    def faults(self, cell: Cell) -> list[str]:
        """What was wrong; empty: nothing."""
        found = []
        names = " > ".join(map(mode_name, self.modes))
        if cell.who == NOBODY:
            sinks = cell.on_loss in (0, 1)  # in Position without a pilot, and lands in time
            comes_back = cell.gap_s < 1.0 or cell.on_loss in (3, 5) or (sinks and cell.gap_s < 10.0)
            came_back = self.armed and self.modes[-1] == OFFBOARD
            if came_back != comes_back or came_back == bool(self.said):
                found.append(f"flew {names}, {'armed' if self.armed else 'disarmed'}, said '{self.said}'")
            return found
        if self.orders:
            found.append(f"ordered {self.orders} afterwards")
        if OFFBOARD in self.modes[1:]:
            found.append(f"was in Offboard again: {names}")
        if not set(TAKEN_IN.get(cell.who, self.modes)) & set(self.modes):
            found.append(f"nobody took it ({names})")
        if not self.said:
            found.append(f"was not said ({names})")
        elif self.said_after_s is not None and self.said_after_s > LATE_S.get(cell.who, SAID_WITHIN_S):
            found.append(f"was said after {self.said_after_s:.1f} s only")
        return found


class Range(Protocol):
    """A PX4, our program connected to it through a link that can be cut, and somebody else."""

    vehicle: Px4Vehicle

    def cut(self, seconds: float) -> None:
        """Nothing goes through the link for so long, either way."""

    def now_s(self) -> float:
        """The vehicle's time."""

    def wait(self, seconds: float) -> None:
        """Lets time pass, and our vehicle listen."""

    def command(self, number: int, *params: float) -> None:
        """Of the ground station."""

    def sticks(self, moving: bool | None) -> None:
        """A pilot's sticks at 20 Hz from now on; None: no longer."""

    def fail(self, what: str) -> None:
        """Brings a failsafe about."""

    def flown(self) -> tuple[PxMode, bool]:
        """The mode that the vehicle is in, and whether it is armed, as the ground station sees it."""

    def orders(self) -> list[int]:
        """Commands of ours that reached the vehicle since the last call, of ``ORDERS``."""


def cells() -> list[Cell]:
    """All of them."""
    found = [Cell(who, phase, loss) for who in WHO for phase in PHASES for loss in ON_LOSS]
    for gap in GAPS_S:
        for loss in ON_LOSS:
            found.append(Cell(NOBODY, "scan", loss, gap, LISTENS_S))
            if loss == 7 and gap > 1.0:
                continue  # it fell: nobody can take it
            for after in AFTER_S:
                if gap < 0.5 and after < 0.0:
                    continue
                people = PEOPLE if gap < 10.0 and after < 10.0 else ("LOITER", "POSCTL")
                found += [Cell(who, "scan", loss, gap, after) for who in people]
            if gap == 2.0:
                found += [Cell("geofence", "scan", loss, gap, after) for after in (-1.0, 0.2, 2.0)]
    return found


def cells_for_px4() -> list[Cell]:
    """Every tenth, and all without anybody: the real PX4 flies in real time."""
    everything = cells()
    alone = [c for c in everything if c.who == NOBODY and c.on_loss != 1]
    return alone + [c for c in everything if c.who != NOBODY][::_EVERY]


def play(cell: Cell, there: Range) -> Outcome:
    """Flies to where the cell begins, and lets it happen."""
    vehicle = there.vehicle
    flight = _Flight(there)
    if cell.who in PILOT:
        there.sticks(moving=False)
    vehicle.takeoff(12.0)
    if cell.phase != "take-off":
        flight.run(60.0, lambda: vehicle.state().position_enu_m[2] > 10.5)
        flight.goal = np.array([80.0, 0.0, 12.0])
        flight.run(5.0)
    else:
        flight.run(3.0)
    if cell.phase == "check":
        flight.goal = np.array([30.0, 0.0, 4.0])
        flight.run(5.0)
    elif cell.phase == "hold":
        flight.holds = True
        flight.run(3.0)
    elif cell.phase == "return":
        flight.goal = np.array([0.0, 0.0, 12.0])
        flight.run(2.0)
    assert not vehicle.state().taken_over, vehicle.state().taken_over
    if cell.gap_s:
        there.cut(cell.gap_s)
        flight.run(cell.gap_s / 2.0 if cell.after_s < 0.0 else cell.gap_s + cell.after_s)
    there.orders()
    watch = _Watch(there)
    _happens(cell.who, there)
    if cell.who in FAILSAFES:
        flight.run(LATE_S.get(cell.who, LISTENS_S), lambda: there.flown()[0] not in (OFFBOARD, TAKE_OFF))
    else:
        flight.run(0.3)  # what was on its way already
    there.orders()
    watch.begin()
    if cell.gap_s and cell.after_s < 0.0:
        flight.run(cell.gap_s / 2.0, watch=watch)
        watch.begin()
    flight.run(LATE_S.get(cell.who, SAID_WITHIN_S), lambda: bool(vehicle.state().taken_over), watch)
    flight.run(LISTENS_S, watch=watch)
    there.sticks(None)
    return Outcome(there.orders(), watch.modes, vehicle.state().taken_over, watch.said_after_s, watch.armed)


def _happens(who: str, there: Range) -> None:
    if who in GROUND_STATION:
        there.command(m.MAV_CMD_DO_SET_MODE, 1, *GROUND_STATION[who])
    elif who == "sticks":
        there.sticks(moving=True)
    elif who == "kill":
        there.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196)
    elif who != NOBODY:
        there.fail(who)


class _Flight:
    """Does what a mission does: flies to a goal, holds where the link is silent, keeps out when taken."""

    def __init__(self, there: Range) -> None:
        self._there, self.goal, self.holds = there, None, False

    def run(self, seconds, until=lambda: False, watch=None) -> None:
        vehicle, end_s = self._there.vehicle, self._there.now_s() + seconds
        while self._there.now_s() < end_s and not until():
            state = vehicle.state()
            if not state.taken_over and state.silent_s < 1.0:
                if self.holds:
                    vehicle.hold()
                elif self.goal is not None:
                    vehicle.command(Setpoint(self.goal, 5.0, 0.0))
            elif not state.taken_over:
                vehicle.hold()
            self._there.wait(0.1)
            if watch is not None:
                watch.look()


class _Watch:
    def __init__(self, there: Range) -> None:
        self._there = there
        self.begin()

    def begin(self) -> None:
        self._since_s = self._there.now_s()
        self.modes, self.said_after_s, self.armed = [], None, True
        self.look()

    def look(self) -> None:
        mode, self.armed = self._there.flown()
        if self.modes[-1:] != [mode] and (self.armed or not self.modes):
            self.modes.append(mode)
        if self._there.vehicle.state().taken_over and self.said_after_s is None:
            self.said_after_s = self._there.now_s() - self._since_s
