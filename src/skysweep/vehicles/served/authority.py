"""The program in command: the one whose order the vehicle carried out last.

PX4 obeys every sender. Here, too, anyone may order Hold, Return, Land, the modes with sticks and switching
off, so that a person can always take over. Orders that would take the vehicle away unseen are accepted only
from the program in command while the vehicle is armed: parameters, home, speed, and plans except in Hold. No
other program's Offboard, Mission, take-off or reposition replaces the Mission or take-off that it flies, or a
pilot's flight by sticks.
"""

from __future__ import annotations

import math

from skysweep.vehicles.mavlink.modes import PX4Mode, Refused
from skysweep.vehicles.served.autopilot import Autopilot
from skysweep.vehicles.served.link import Key


class Denied(Refused):
    """Refused for good, not for now."""


class Authority:
    """A program that is silent for ``silent_s`` of vehicle time loses command."""

    def __init__(self, pilot: Autopilot, silent_s: float) -> None:
        self._pilot, self._silent_s = pilot, silent_s
        self._commander: Key | None = None
        self._heard_s = -math.inf

    def tick(self) -> None:
        """Gives command to a pilot who flies by sticks."""
        pilot = self._pilot.sticks.source
        if pilot is not None and self._pilot.by_stick:
            self.take(pilot)

    def hear(self, key: Key) -> None:
        if key == self._commander:
            self._heard_s = self._pilot.time_s

    def take(self, key: Key) -> None:
        """Gives command to a program whose order was carried out."""
        self._commander, self._heard_s = key, self._pilot.time_s

    def commands(self, key: Key) -> bool:
        """Whether this program is in command of an armed vehicle."""
        return self._is_held() and self._commander == key

    def must_command(self, key: Key) -> None:
        """Raises Denied in a flight that another program commands."""
        if self._is_held() and self._commander != key:
            raise Denied("denied: another program is in command")

    def may_plan(self, key: Key) -> None:
        """Raises Denied if another program flies; in Hold anyone may prepare the next flight."""
        if self._pilot.intended is not PX4Mode.HOLD:
            self.must_command(key)

    def must_be_free(self, key: Key, offboard_wanted: bool = False) -> None:
        """Raises Denied if another's Offboard, Mission, take-off or flight by sticks would be replaced."""
        pilot = self._pilot
        engaged = offboard_wanted or pilot.mode is PX4Mode.OFFBOARD
        if engaged and not pilot.offboard.may_control(key, pilot):
            raise Denied("denied: another program is in control")
        if pilot.mode in (PX4Mode.MISSION, PX4Mode.TAKEOFF) or pilot.by_stick:
            self.must_command(key)

    def _is_held(self) -> bool:
        return self._pilot.armed and self._pilot.time_s - self._heard_s <= self._silent_s
