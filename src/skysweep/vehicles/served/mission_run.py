"""AUTO.MISSION: flies the items of a plan, one after the other."""

from __future__ import annotations

import numpy as np

from skysweep.geometry.frames import yaw_from_heading
from skysweep.types import F64
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import PX4Mode, finite, whole
from skysweep.vehicles.served.items import Item, heading_towards
from skysweep.vehicles.served.link import NOTICE
from skysweep.vehicles.served.manoeuvres import Hold
from skysweep.vehicles.served.pilot import Pilot

_ANYWHERE = {m.MAV_CMD_NAV_TAKEOFF, m.MAV_CMD_NAV_LAND}  # at 0, 0: where the vehicle is


class MissionRun:
    """The progress of a mission. An interrupted one resumes at ``current``; a finished one restarts."""

    def __init__(self) -> None:
        self.items: tuple[Item, ...] = ()
        self.current = 0
        self.finished = False
        self.reached: list[int] = []  # not yet reported
        self._jumps: dict[int, int] = {}
        self._resumes = False  # from the next step on
        self._target: F64 | None = None
        self._yaw_rad = 0.0
        self._since_s: float | None = None  # at the place, or of the delay

    def load(self, items: tuple[Item, ...]) -> None:
        self.items = items
        self.go_to(0)

    def go_to(self, index: int) -> None:
        if index == 0:
            self._jumps.clear()
        self.current, self.finished = index, False
        self._target = self._since_s = None

    def why_not(self, pilot: Pilot, items: tuple[Item, ...] | None = None) -> str | None:
        """The reason not to fly it, or ``items`` instead; None if there is none."""
        places = [i for i in (self.items if items is None else items) if i.is_place]
        for place in places:
            at_zero = place.x == place.y == 0 and place.command in _ANYWHERE
            if not at_zero and pilot.outside_fence(place.position_enu_m(pilot.site, pilot.home_enu_m)):
                return "the mission leaves the geofence"
        return None if places else "no mission to fly"

    def begin(self) -> None:
        """Called when the mode is entered."""
        self.go_to(0 if self.finished else self.current)
        self._resumes = True

    def step(self, pilot: Pilot) -> None:
        """Handles one item per step, so that circular jumps take time."""
        if not self.items:  # cleared in flight
            pilot.enter(PX4Mode.HOLD)
            return
        if self._resumes:  # as PX4, at the speed of the items before
            self._resumes = False
            for before in self.items[: self.current]:
                _change_speed(before, pilot)
        if self.finished or not (pilot.flying or pilot.may_lift_off):
            return
        item = self.items[self.current]
        if item.is_place:
            self._fly(item, pilot)
        elif item.command == m.MAV_CMD_NAV_DELAY:
            self._wait(item.params[0], pilot)
        elif item.command == m.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            self._done(pilot)
            self.finished = True
            pilot.enter(PX4Mode.RETURN)
        else:
            _change_speed(item, pilot)
            jump = self._jump(item) if item.command == m.MAV_CMD_DO_JUMP else None
            self._done(pilot, jump)

    def _fly(self, item: Item, pilot: Pilot) -> None:
        here = pilot.state.position_enu_m
        if self._target is None:
            self._target = self._place(item, pilot)
            self._yaw_rad = heading_towards(here, self._target, pilot.yaw_rad)
            if item.command == m.MAV_CMD_NAV_WAYPOINT and finite(item.params[3]):
                self._yaw_rad = yaw_from_heading(item.params[3])
            if not pilot.flying:
                low = pilot.home_enu_m[2] + pilot.parameters["MIS_TAKEOFF_ALT"]
                pilot.lift_off(float(max(self._target[2], low)))
                return
            if not pilot.taking_off:
                pilot.fly_to(self._target, self._yaw_rad, pilot.cruise_mps)
            return
        if pilot.setpoint is not None and pilot.setpoint.position_enu_m is not self._target:
            if not pilot.taking_off and pilot.is_high_as(pilot.setpoint.position_enu_m[2]):
                pilot.fly_to(self._target, self._yaw_rad, pilot.cruise_mps)
            return
        radius = item.params[1] if item.command == m.MAV_CMD_NAV_WAYPOINT else 0.0
        if not radius > 0.0:
            radius = pilot.parameters["NAV_ACC_RAD"]
        arrived = np.hypot(*(self._target - here)[:2]) <= radius and pilot.is_high_as(self._target[2])
        if self._since_s is None and not arrived:
            return
        if item.command == m.MAV_CMD_NAV_LAND:
            pilot.touch_down()
            self._reach()
            self.finished = True
        elif item.command == m.MAV_CMD_NAV_LOITER_UNLIM:
            if self._since_s is None:
                self._since_s = pilot.time_s
                self._reach()
        else:
            takes_time = item.command in (m.MAV_CMD_NAV_WAYPOINT, m.MAV_CMD_NAV_LOITER_TIME)
            self._wait(item.params[0] if takes_time else 0.0, pilot)

    def _place(self, item: Item, pilot: Pilot) -> F64:
        here = pilot.state.position_enu_m
        place = item.position_enu_m(pilot.site, pilot.home_enu_m)
        if item.x == item.y == 0 and item.command in _ANYWHERE:
            place = np.array([here[0], here[1], place[2]])
        if item.command == m.MAV_CMD_NAV_LAND:
            place[2] = max(here[2], pilot.home_enu_m[2] + pilot.parameters["MIS_TAKEOFF_ALT"])
        return place

    def _wait(self, seconds: float, pilot: Pilot) -> None:
        if self._since_s is None:
            self._since_s = pilot.time_s
        if not pilot.time_s - self._since_s < seconds:
            self._done(pilot)

    def _jump(self, item: Item) -> int | None:
        """The target of a DO_JUMP; None once it was taken as often as it says (-1: without limit)."""
        to, times = whole(item.params[0]), whole(item.params[1])
        taken = self._jumps.get(self.current, 0)
        if to is None or times is None or not 0 <= to < len(self.items) or 0 <= times <= taken:
            return None
        self._jumps[self.current] = taken + 1
        return to

    def _reach(self) -> None:
        self.reached.append(self.current)

    def _done(self, pilot: Pilot, jump: int | None = None) -> None:
        self._reach()
        place = self._target
        self._target = self._since_s = None
        if jump is not None:
            self.current = jump
        elif self.current + 1 < len(self.items):
            self.current += 1
        else:
            self.finished = True
            pilot.say("mission finished", NOTICE)
            pilot.enter(PX4Mode.HOLD, Hold(place))


def _change_speed(item: Item, pilot: Pilot) -> None:
    if item.command == m.MAV_CMD_DO_CHANGE_SPEED and finite(item.params[1]):
        pilot.speed_mps = item.params[1] if item.params[1] > 0.0 else None
