"""What the vehicle does on its own account: offboard control lost, fence crossed, battery low.

Actions and parameters are PX4's. A failsafe acts once when its condition begins, and never replaces a more
careful action that is under way; after it, whoever is in charge may choose another mode.
"""

from __future__ import annotations

from skysweep.vehicles.mavlink.autopilot import Autopilot
from skysweep.vehicles.mavlink.link import CRITICAL, WARNING
from skysweep.vehicles.mavlink.px4 import Mode

_CARE = {Mode.HOLD: 1, Mode.RETURN: 2, Mode.LAND: 3}
_OFFBOARD_LOST = {3: Mode.RETURN, 4: Mode.LAND}  # COM_OBL_RC_ACT; the others want a pilot and come to Hold
_FENCE_CROSSED = {2: Mode.HOLD, 3: Mode.RETURN, 4: Mode.LAND, 5: Mode.LAND}  # GF_ACTION
_BATTERY_CRITICAL = {2: Mode.LAND, 3: Mode.RETURN}  # COM_LOW_BAT_ACT
_FENCE_EVERY_S = 0.2


class Failsafes:
    """Looks after an autopilot."""

    def __init__(self) -> None:
        self._outside = False
        self._fence_next_s = 0.0
        self._battery_level = 0

    def check(self, pilot: Autopilot) -> None:
        """Once a tick."""
        if pilot.mode is Mode.OFFBOARD and not pilot.offboard.is_fresh(pilot):
            action = _OFFBOARD_LOST.get(int(pilot.parameters["COM_OBL_RC_ACT"]), Mode.HOLD)
            if pilot.flying:
                pilot.take_failsafe(action, "Offboard control lost")
            else:
                pilot.change_mode(Mode.HOLD)
        if pilot.time_s >= self._fence_next_s:
            self._fence_next_s = pilot.time_s + _FENCE_EVERY_S
            self._check_fence(pilot)
        self._check_battery(pilot)

    def _check_fence(self, pilot: Autopilot) -> None:
        action = int(pilot.parameters["GF_ACTION"])
        outside = pilot.flying and action > 0 and pilot.outside_fence()
        if outside and not self._outside:
            self._act(pilot, _FENCE_CROSSED.get(action), "Geofence crossed")
        self._outside = outside

    def _check_battery(self, pilot: Autopilot) -> None:
        limits = [pilot.parameters[name] for name in ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")]
        level = sum(pilot.state.battery_remaining < limit for limit in limits)
        action = int(pilot.parameters["COM_LOW_BAT_ACT"])
        if level > self._battery_level and pilot.flying:
            self._battery_level = level
            if level == 1:
                pilot.say("Battery low", WARNING)
            elif level == 2:
                self._act(pilot, _BATTERY_CRITICAL.get(action), "Battery critical")
            else:
                self._act(pilot, Mode.LAND if action >= 2 else None, "Battery nearly empty")

    def _act(self, pilot: Autopilot, mode: Mode | None, why: str) -> None:
        if mode is None or _CARE.get(pilot.mode, 0) >= _CARE[mode]:
            pilot.say(why, CRITICAL)
        else:
            pilot.take_failsafe(mode, why)
