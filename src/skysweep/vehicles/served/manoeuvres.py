"""Hold, take-off, return and landing."""

from __future__ import annotations

import numpy as np

from skysweep.types import F64
from skysweep.vehicles.mavlink.modes import PX4Mode
from skysweep.vehicles.served.items import heading_towards
from skysweep.vehicles.served.pilot import Pilot

_ABOVE_LANDING_PLACE_M = 1.0


class Hold:
    """Holds a given place, or the one where the vehicle comes to rest."""

    def __init__(self, position_enu_m: F64 | None = None, yaw_rad: float | None = None) -> None:
        self._position_enu_m, self._yaw_rad = position_enu_m, yaw_rad
        self._told = False

    def step(self, pilot: Pilot) -> None:
        if self._told or not pilot.flying:
            return
        self._told = True
        state = pilot.state
        if not state.airborne:
            pilot.touch_down()
            return
        place, speed_mps = self._position_enu_m, pilot.cruise_mps
        if place is None:
            place = state.position_enu_m + state.velocity_enu_mps / pilot.parameters["MPC_XY_P"]
            speed_mps = np.inf
        pilot.fly_to(place, pilot.yaw_rad if self._yaw_rad is None else self._yaw_rad, speed_mps)


class TakeOff:
    """Climbs straight up to a height in ENU (default: MIS_TAKEOFF_ALT above here), then holds."""

    def __init__(self, altitude_enu_m: float | None = None) -> None:
        self._altitude_enu_m = altitude_enu_m
        self._place: F64 | None = None

    def step(self, pilot: Pilot) -> None:
        if self._place is None:
            here = pilot.state.position_enu_m
            up = self._altitude_enu_m
            if up is None or up <= here[2]:
                up = here[2] if pilot.flying else here[2] + pilot.parameters["MIS_TAKEOFF_ALT"]
            self._place = np.array([here[0], here[1], up])
            if pilot.flying and pilot.state.airborne:
                pilot.enter(PX4Mode.HOLD, Hold(self._place))
            elif pilot.flying or pilot.may_lift_off:
                pilot.lift_off(up)
        elif pilot.flying and pilot.is_high_as(self._place[2]):
            pilot.enter(PX4Mode.HOLD, Hold(self._place))


class Land:
    """Lands where it is."""

    def __init__(self) -> None:
        self._told = False

    def step(self, pilot: Pilot) -> None:
        if pilot.flying and not self._told:
            self._told = True
            pilot.touch_down()


class Return:
    """Climbs to RTL_RETURN_ALT above home or the nearest rally point, flies there and lands."""

    def __init__(self) -> None:
        self._over: F64 | None = None

    def step(self, pilot: Pilot) -> None:
        if not pilot.flying or (pilot.landing and self._over is not None):
            return
        here = pilot.state.position_enu_m
        if not pilot.state.airborne:
            pilot.touch_down()
            return
        if self._over is None:
            places = (pilot.home_enu_m, *pilot.rally_enu_m)
            to = min(places, key=lambda place: float(np.hypot(*(place - here)[:2])))
            near = np.hypot(*(to - here)[:2]) < pilot.parameters["RTL_MIN_DIST"]
            up = here[2] if near else max(here[2], to[2] + pilot.parameters["RTL_RETURN_ALT"])
            self._over = np.array([to[0], to[1], up])
            pilot.fly_to(np.array([here[0], here[1], up]), pilot.yaw_rad, pilot.cruise_mps)
        elif np.hypot(*(self._over - here)[:2]) <= _ABOVE_LANDING_PLACE_M:
            pilot.touch_down()
        elif pilot.is_high_as(self._over[2]):
            yaw = heading_towards(here, self._over, pilot.yaw_rad)
            pilot.fly_to(self._over, yaw, pilot.cruise_mps)
