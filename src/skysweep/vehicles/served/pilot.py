"""The part of the autopilot that a mode's manoeuvre uses."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Protocol

import numpy as np

from skysweep.types import F64, Setpoint, Vehicle
from skysweep.vehicles.mavlink.modes import PX4Mode, Site
from skysweep.vehicles.served.items import NO_FENCE, UploadedFence
from skysweep.vehicles.served.parameters import Parameters

_TAKE_OFF_RAMP_S = 4.0  # COM_SPOOLUP_TIME and MPC_TKO_RAMP_T


class Pilot(ABC):
    """The state and settings of ``vehicle``, and the orders of which a manoeuvre consists.

    ``say(text, severity)`` tells every listener.
    """

    def __init__(
        self, vehicle: Vehicle, site: Site, parameters: Parameters, say: Callable[[str, int], None]
    ) -> None:
        self._vehicle = vehicle
        self.site, self.parameters, self.say = site, parameters, say
        self.state = vehicle.state()
        self.armed = False
        self.flying = False  # from the order to take off until touchdown
        self.landing = False
        self.setpoint: Setpoint | None = None
        self.home_enu_m: F64 = self.state.position_enu_m
        self.speed_mps: float | None = None  # of the automatic mode, if it was changed since it began
        self.fence: UploadedFence = NO_FENCE
        self.rally_enu_m: tuple[F64, ...] = ()
        self._armed_s = self._lifted_s = self._landed_s = -np.inf

    @property
    def time_s(self) -> float:
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
        """Whether it is armed on the ground and has not flown since."""
        return self.armed and not self.flying and self._landed_s < self._armed_s

    @property
    def taking_off(self) -> bool:
        """Whether the gentle start of a take-off is still under way."""
        return self.flying and not (self.state.airborne and self.time_s - self._lifted_s >= _TAKE_OFF_RAMP_S)

    def is_high_as(self, altitude_enu_m: float) -> bool:
        """Whether it is within NAV_MC_ALT_RAD of that height."""
        return bool(abs(self.state.position_enu_m[2] - altitude_enu_m) <= self.parameters["NAV_MC_ALT_RAD"])

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

    @abstractmethod
    def enter(self, mode: PX4Mode, doing: Manoeuvre | None = None) -> None:
        """Makes ``mode`` the intended one, flown by ``doing`` unless a failsafe flies."""

    def lift_off(self, altitude_enu_m: float) -> None:
        """Climbs straight up from the ground to a height in ENU."""
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
        """Lands here."""
        self.landing = True
        self._vehicle.land()


class Manoeuvre(Protocol):
    """The behaviour of a mode."""

    def step(self, pilot: Pilot) -> None:
        """Continues; called once a tick."""
