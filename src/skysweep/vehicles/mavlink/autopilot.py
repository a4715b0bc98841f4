"""The autopilot: arming, modes, and what each mode makes the vehicle do. It knows nothing of messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from skysweep.types import Setpoint, Vehicle
from skysweep.vehicles.mavlink.items import NO_FENCE, Fence
from skysweep.vehicles.mavlink.link import NOTICE, WARNING
from skysweep.vehicles.mavlink.manoeuvres import Hold, Land, Return, TakeOff
from skysweep.vehicles.mavlink.mission_run import MissionRun
from skysweep.vehicles.mavlink.offboard import Offboard
from skysweep.vehicles.mavlink.parameters import Parameters
from skysweep.vehicles.mavlink.px4 import F64, Mode, Refused, Site

_TAKE_OFF_RAMP_S = 4.0  # COM_SPOOLUP_TIME and MPC_TKO_RAMP_T
_FORGOTTEN_ON_DISARM = (Mode.TAKEOFF, Mode.MISSION, Mode.RETURN, Mode.LAND)


class Manoeuvre(Protocol):
    """What a mode does, a step each tick."""

    def step(self, pilot: Autopilot) -> None: ...


class Autopilot:
    """Flies ``vehicle`` by PX4's modes. ``say(text, severity)`` tells every listener."""

    def __init__(
        self, vehicle: Vehicle, site: Site, parameters: Parameters, say: Callable[[str, int], None]
    ) -> None:
        self.site, self.parameters, self.say = site, parameters, say
        self.state = vehicle.state()
        self.mode, self.armed, self.failsafe = Mode.HOLD, False, False
        self.flying = False  # from the order to take off until touchdown
        self.landing = False
        self.setpoint: Setpoint | None = None
        self.home_enu_m: F64 = self.state.position_enu_m
        self.speed_mps: float | None = None  # of automatic modes, where it was changed
        self.fence: Fence = NO_FENCE
        self.rally_enu_m: tuple[F64, ...] = ()
        self.mission = MissionRun()
        self.offboard = Offboard()
        self._vehicle = vehicle
        self._doing: Manoeuvre = Hold()
        self._armed_s = self._lifted_s = self._landed_s = -np.inf

    # ---- time ----------------------------------------------------------------------------------------

    def advance(self, duration_s: float) -> None:
        """Lets the vehicle fly for that long, then decides what it does next."""
        self._vehicle.advance(duration_s)
        self.state = self._vehicle.state()
        if self.landing and not self.state.airborne:
            self.flying = self.landing = False
            self._landed_s = self.time_s
            self.setpoint = None
            self.say("landed", NOTICE)
        if self.armed:
            self._doing.step(self)
            self._disarm_when_idle()

    @property
    def time_s(self) -> float:
        """The vehicle's."""
        return self.state.time_s

    @property
    def yaw_rad(self) -> float:
        """ENU."""
        R = self.state.R_body_to_enu
        return float(np.arctan2(R[1, 0], R[0, 0]))

    @property
    def cruise_mps(self) -> float:
        """Horizontal speed of automatic modes."""
        speed = self.parameters["MPC_XY_CRUISE"] if self.speed_mps is None else self.speed_mps
        return min(speed, self.parameters["MPC_XY_VEL_MAX"])

    @property
    def may_lift_off(self) -> bool:
        """Whether it stands ready: armed, and not landed again since."""
        return self.armed and not self.flying and self._landed_s < self._armed_s

    @property
    def taking_off(self) -> bool:
        """Whether the gentle beginning of a take-off is still under way."""
        return self.flying and not (self.state.airborne and self.time_s - self._lifted_s >= _TAKE_OFF_RAMP_S)

    # ---- orders --------------------------------------------------------------------------------------

    def arm(self) -> None:
        """Raises Refused with the reason that speaks against it."""
        if self.armed:
            return
        if self.mode in (Mode.RETURN, Mode.LAND):
            raise Refused("Arming denied: not in this mode, choose Hold")
        if self.parameters["GF_ACTION"] > 0 and self.outside_fence():
            raise Refused("Arming denied: outside the geofence")
        if self.state.battery_remaining < self.parameters["BAT_CRIT_THR"]:
            raise Refused("Arming denied: battery")
        self.armed, self._armed_s = True, self.time_s
        self.home_enu_m = self.state.position_enu_m
        self.say("armed", NOTICE)

    def disarm(self) -> None:
        """Raises Refused in the air: this vehicle does not let itself fall."""
        if self.flying:
            raise Refused("Disarming denied: not landed")
        if not self.armed:
            return
        self.armed = self.failsafe = False
        self.speed_mps = None
        if self.mode in _FORGOTTEN_ON_DISARM:
            self.enter(Mode.HOLD, Hold())
        self.say("disarmed", NOTICE)

    def change_mode(self, mode: Mode) -> None:
        """Raises Refused where the mode cannot be had now."""
        if mode is self.mode and mode is not Mode.HOLD:
            return
        doing: Manoeuvre
        if mode is Mode.OFFBOARD:
            if not self.offboard.is_fresh(self):
                raise Refused("Offboard needs a stream of setpoints first")
            doing = self.offboard
        elif mode is Mode.MISSION:
            self.mission.begin(self)
            doing = self.mission
        else:
            doing = {Mode.HOLD: Hold, Mode.TAKEOFF: TakeOff, Mode.RETURN: Return, Mode.LAND: Land}[mode]()
        self.failsafe = False
        self.enter(mode, doing)

    def enter(self, mode: Mode, doing: Manoeuvre) -> None:
        """Goes into a mode whose conditions are met."""
        self.mode, self._doing = mode, doing

    def take_failsafe(self, mode: Mode, why: str) -> None:
        """Goes into a mode that nobody asked for."""
        self.failsafe = True
        self.enter(mode, {Mode.HOLD: Hold, Mode.RETURN: Return, Mode.LAND: Land}[mode]())
        self.say(f"{why}: {mode.name.lower()}", WARNING)

    def outside_fence(self, position_enu_m: F64 | None = None) -> bool:
        """Whether a position (default: the vehicle's) is beyond the fence or farther than GF_MAX_*."""
        position = self.state.position_enu_m if position_enu_m is None else position_enu_m
        away = position - self.home_enu_m
        far, high = self.parameters["GF_MAX_HOR_DIST"], self.parameters["GF_MAX_VER_DIST"]
        return (
            not self.fence.allows(position)
            or bool(0.0 < far < np.hypot(away[0], away[1]))
            or bool(0.0 < high < away[2])
        )

    # ---- what manoeuvres are made of -----------------------------------------------------------------

    def lift_off(self, altitude_enu_m: float) -> None:
        """Leaves the ground straight up to a height in ENU."""
        here = self.state.position_enu_m
        self._vehicle.takeoff(max(altitude_enu_m - here[2], 0.5))
        self.setpoint = Setpoint(np.array([here[0], here[1], altitude_enu_m]), 0.0, self.yaw_rad)
        self.flying, self.landing, self._lifted_s = True, False, self.time_s

    def fly_to(
        self, position_enu_m: F64, yaw_rad: float, speed_mps: float, velocity_enu_mps: F64 | None = None
    ) -> None:
        """Flies towards a setpoint."""
        limited = min(speed_mps, self.parameters["MPC_XY_VEL_MAX"])
        self.setpoint = Setpoint(position_enu_m, limited, yaw_rad, velocity_enu_mps)
        self.landing = False
        self._vehicle.command(self.setpoint)

    def touch_down(self) -> None:
        """Descends here until it stands."""
        self.landing = True
        self._vehicle.land()

    def is_high_as(self, altitude_enu_m: float) -> bool:
        """Whether it is at that height, as PX4 counts it."""
        return bool(abs(self.state.position_enu_m[2] - altitude_enu_m) <= self.parameters["NAV_MC_ALT_RAD"])

    def _disarm_when_idle(self) -> None:
        if self.flying:
            return
        landed = self._landed_s >= self._armed_s
        limit_s = self.parameters["COM_DISARM_LAND" if landed else "COM_DISARM_PRFLT"]
        since = self._landed_s if landed else self._armed_s
        if 0.0 <= limit_s < self.time_s - since:
            self.disarm()
