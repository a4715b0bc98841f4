"""Failsafes: the actions that replace the intended mode, and how a person ends them.

Semantics of PX4 v1.17 (commander, failsafe): each cause requests an action, the worst action wins, and some
actions outlast their cause. Return and Land of most causes begin with a Hold of COM_FAIL_ACT_T. A mode
command, or sticks if the cause allows it, ends an action until another cause comes up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from skysweep.vehicles.mavlink.modes import PX4Mode
from skysweep.vehicles.served.link import CRITICAL, NOTICE, WARNING
from skysweep.vehicles.served.parameters import Parameters

_NO_STICKS = 4  # COM_RC_IN_MODE
_WITHOUT_POSITION = (PX4Mode.ALTITUDE, PX4Mode.STABILIZED, PX4Mode.OFFBOARD, PX4Mode.TERMINATION)
# Bits of COM_RCL_EXCEPT.
_STICKS_OPTIONAL = {PX4Mode.MISSION: 1, PX4Mode.HOLD: 2, PX4Mode.TAKEOFF: 2, PX4Mode.OFFBOARD: 4}


class Reaction(IntEnum):
    """A failsafe's action; a higher number is worse."""

    NONE = 0
    WARN = 1
    POSITION = 2
    ALTITUDE = 3
    STABILIZED = 4
    HOLD = 5
    RETURN = 6
    LAND = 7
    DESCEND = 8
    DISARM = 9
    TERMINATE = 10


_MODES = {
    Reaction.POSITION: PX4Mode.POSITION,
    Reaction.ALTITUDE: PX4Mode.ALTITUDE,
    Reaction.STABILIZED: PX4Mode.STABILIZED,
    Reaction.HOLD: PX4Mode.HOLD,
    Reaction.RETURN: PX4Mode.RETURN,
    Reaction.LAND: PX4Mode.LAND,
    Reaction.DESCEND: PX4Mode.LAND,  # what PX4 shows for it
    Reaction.TERMINATE: PX4Mode.TERMINATION,
}


class Response(NamedTuple):
    """The action that a cause requests."""

    action: Reaction
    latched: bool = False  # outlasts the cause, until a mode change or disarming
    waits: bool = True  # begins with a Hold of COM_FAIL_ACT_T, if the action is worse than Hold
    mode_only: bool = False  # ended by a mode command, not by sticks


_PILOT_LOST = {  # NAV_RCL_ACT; 4 is nothing
    1: Response(Reaction.HOLD, latched=True),
    2: Response(Reaction.RETURN, latched=True),
    3: Response(Reaction.LAND, latched=True),
    5: Response(Reaction.TERMINATE),
    6: Response(Reaction.DISARM),
}
_FENCE_CROSSED = {  # GF_ACTION
    1: Response(Reaction.WARN),
    2: Response(Reaction.HOLD, latched=True, waits=False, mode_only=True),
    3: Response(Reaction.RETURN, latched=True),
    4: Response(Reaction.TERMINATE),
    5: Response(Reaction.LAND, latched=True),
}
CRITICAL_BATTERY = 2  # level
_BATTERY_TEXTS = ("", "battery low", "battery critical", "battery nearly empty")
_BATTERY = {  # COM_LOW_BAT_ACT, then by level
    0: (Reaction.NONE, Reaction.WARN, Reaction.WARN, Reaction.WARN),
    1: (Reaction.NONE, Reaction.WARN, Reaction.RETURN, Reaction.RETURN),
    2: (Reaction.NONE, Reaction.WARN, Reaction.LAND, Reaction.LAND),
    3: (Reaction.NONE, Reaction.WARN, Reaction.RETURN, Reaction.LAND),
}
_OFFBOARD_LOST = {  # COM_OBL_RC_ACT
    0: Reaction.POSITION,
    1: Reaction.ALTITUDE,
    2: Reaction.STABILIZED,
    3: Reaction.RETURN,
    4: Reaction.LAND,
    5: Reaction.HOLD,
    6: Reaction.TERMINATE,
    7: Reaction.DISARM,
}
_AT_ONCE = (Reaction.NONE, Reaction.HOLD, Reaction.DISARM, Reaction.TERMINATE)  # whatever waits
_SHORTEST_WAIT_S = 0.1
_STICKS_LOST, _OUTSIDE = "manual control lost", "geofence crossed"
_NO_OFFBOARD, _NO_POSITION = "offboard control lost", "no position"


class Health(NamedTuple):
    """The conditions that failsafes watch."""

    setpoints_lost: bool
    sticks_lost: bool
    position_lost: bool
    outside_fence: bool
    battery_level: int  # 0 full enough, 1 low, 2 critical, 3 nearly empty


def why_not(mode: PX4Mode, health: Health) -> str | None:
    """The reason that a mode cannot be flown; sticks are needed to choose a stick mode, not to stay in it."""
    if mode is PX4Mode.OFFBOARD and health.setpoints_lost:
        return _NO_OFFBOARD
    return _NO_POSITION if health.position_lost and mode not in _WITHOUT_POSITION else None


@dataclass(slots=True)
class _Active:
    response: Response
    mode_only: bool
    failing: bool = True


class Failsafes:
    """``action`` is the current one; ``say(text, severity)`` tells all listeners its cause."""

    def __init__(self, parameters: Parameters, say: Callable[[str, int], None]) -> None:
        self.action = Reaction.NONE
        self.taken_over = False
        self._parameters, self._say = parameters, say
        self._active: dict[str, _Active] = {}
        self._armed = False
        self._intended = PX4Mode.HOLD
        self._sticks_optional = True  # no sticks since before arming
        self._wait_s = 0.0  # until an action that waits in Hold begins
        self._waited_s = 0.0  # recently, so that an intermittent cause does not wait for ever

    def mode(self, intended: PX4Mode) -> PX4Mode:
        return _MODES.get(self.action, intended)

    def update(
        self, armed: bool, intended: PX4Mode, asked: bool, sticks: bool, health: Health, dt_s: float
    ) -> PX4Mode:
        """Updates the action ``dt_s`` later; returns the intended mode, which only sticks can change.

        ``asked``: a mode was chosen, perhaps the same one. ``sticks``: they moved during a failsafe.
        """
        asked |= intended is not self._intended
        if armed != self._armed:
            self.taken_over = False
            self._active.clear()
        if asked or self.taken_over:
            self._active = {cause: active for cause, active in self._active.items() if active.failing}
        if not (armed and self._armed):
            self._sticks_optional = health.sticks_lost
        elif not health.sticks_lost:
            self._sticks_optional = False
        self._armed = armed
        self._wait_s = max(self._wait_s - dt_s, 0.0)
        warned = self._look(self._causes(intended, health) if armed else {})
        if self.action > Reaction.HOLD or health.position_lost or self.taken_over:
            self._wait_s = 0.0
        before = self.action
        cause, delayed, self._intended = self._choose(intended, asked, sticks, health)
        self._waited_s = max(self._waited_s + (dt_s if delayed else -0.25 * dt_s), 0.0)
        if self.action > before or (self.action and warned):
            self._tell(cause, delayed)
        return self._intended

    def _causes(self, intended: PX4Mode, health: Health) -> dict[str, Response]:
        """The response that each present cause requests."""
        p = self._parameters
        found: dict[str, Response | None] = {}
        excepted = int(p["COM_RCL_EXCEPT"]) & _STICKS_OPTIONAL.get(intended, 0)
        optional = self._sticks_optional or excepted or p["COM_RC_IN_MODE"] == _NO_STICKS
        if health.sticks_lost and not optional:
            found[_STICKS_LOST] = _PILOT_LOST.get(int(p["NAV_RCL_ACT"]))
        if health.outside_fence:
            found[_OUTSIDE] = _FENCE_CROSSED.get(int(p["GF_ACTION"]))
        level = health.battery_level
        if level:
            found[_BATTERY_TEXTS[level]] = Response(_BATTERY[int(p["COM_LOW_BAT_ACT"])][level])
        why = why_not(intended, health)
        if why is not None:
            found[why] = Response(self._instead_of(intended, health), waits=False)
        return {cause: response for cause, response in found.items() if response is not None}

    def _instead_of(self, mode: PX4Mode, health: Health) -> Reaction:
        """The action instead of a mode that cannot be flown; NONE if it can."""
        why = why_not(mode, health)
        if why is None:
            return Reaction.NONE
        if why == _NO_OFFBOARD:
            return _OFFBOARD_LOST[int(self._parameters["COM_OBL_RC_ACT"])]
        return Reaction.ALTITUDE if mode is PX4Mode.POSITION else Reaction.RETURN

    def _look(self, causes: dict[str, Response]) -> bool:
        """Updates the active responses; True if a warning was added."""
        for cause in [cause for cause in self._active if cause not in causes]:
            self._active[cause].failing = False
            if not self._active[cause].response.latched:
                del self._active[cause]
        warned, hold_s = False, self._parameters["COM_FAIL_ACT_T"]
        for cause, response in causes.items():
            active = self._active.get(cause)
            if active is not None:
                active.failing, active.response = True, active.response._replace(action=response.action)
                continue
            waits = response.waits and hold_s > _SHORTEST_WAIT_S
            self._active[cause] = _Active(response, response.mode_only or (response.waits and not waits))
            warned |= response.action is Reaction.WARN
            if waits and response.action is not Reaction.WARN and self._wait_s == 0.0:
                self._wait_s = max(hold_s - self._waited_s, 0.0)
            if response.action >= Reaction.HOLD:
                self.taken_over = False
        return warned

    def _choose(
        self, intended: PX4Mode, asked: bool, sticks: bool, health: Health
    ) -> tuple[str, Reaction, PX4Mode]:
        """Sets the action; returns its cause, the action delayed by a Hold, and the intended mode."""
        before, delayed = self.action, Reaction.NONE
        if intended is PX4Mode.TERMINATION or before is Reaction.TERMINATE:
            self.action = Reaction.TERMINATE
            return "flight terminated", delayed, intended
        if not self._active:
            self.action, self.taken_over = Reaction.NONE, False
            return "", delayed, intended
        cause, worst = max(self._active.items(), key=lambda item: item[1].response.action)
        action, mode_only = worst.response.action, any(a.mode_only for a in self._active.values())
        if self._wait_s > 0.0 and not self.taken_over and action not in _AT_ONCE:
            delayed, action, mode_only = action, Reaction.HOLD, True
        over = self.taken_over or (asked and before > Reaction.WARN) or (sticks and not mode_only)
        over &= Reaction.HOLD <= action <= Reaction.DESCEND
        if over:
            if sticks and not self.taken_over:
                intended = PX4Mode.POSITION
                self._say("pilot took over with sticks", NOTICE)
            delayed, action = Reaction.NONE, max(Reaction.WARN, self._instead_of(intended, health))
        self.taken_over = over
        if Reaction.POSITION <= action < Reaction.DESCEND:
            worse = [a for a in _MODES if action <= a < Reaction.DESCEND]
            action = next((a for a in worse if why_not(_MODES[a], health) is None), Reaction.DESCEND)
        on_its_way = intended in (PX4Mode.LAND, PX4Mode.RETURN) and why_not(intended, health) is None
        if on_its_way and Reaction.RETURN in (action, delayed):
            delayed, action = Reaction.NONE, Reaction.WARN
        self.action = action
        return cause, delayed, intended

    def _tell(self, cause: str, delayed: Reaction) -> None:
        text, severity = cause.capitalize(), WARNING
        if self.action > Reaction.WARN:
            text, severity = f"{text}: {self.action.name.lower()}", CRITICAL
        if delayed:
            text += f", {delayed.name.lower()} in {self._wait_s:.0f} s"
        self._say(text, severity)
