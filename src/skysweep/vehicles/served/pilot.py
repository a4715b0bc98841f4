"""The part of the autopilot that a mode's manoeuvre uses."""

from __future__ import annotations

from typing import Protocol

from skysweep.types import Setpoint, VehicleState
from skysweep.vehicles.mavlink.modes import F64, PX4Mode, Site
from skysweep.vehicles.served.parameters import Parameters


class Pilot(Protocol):
    """The state and settings of the vehicle, and the orders of which a manoeuvre consists."""

    site: Site
    parameters: Parameters
    state: VehicleState
    setpoint: Setpoint | None
    home_enu_m: F64
    rally_enu_m: tuple[F64, ...]
    speed_mps: float | None  # of automatic modes, if it was changed
    flying: bool  # from the order to take off until touchdown
    landing: bool

    @property
    def time_s(self) -> float:
        """The vehicle's time."""

    @property
    def yaw_rad(self) -> float:
        """The vehicle's yaw, ENU."""

    @property
    def cruise_mps(self) -> float:
        """Horizontal speed of automatic modes."""

    @property
    def may_lift_off(self) -> bool:
        """Whether it is armed on the ground and has not flown since."""

    @property
    def taking_off(self) -> bool:
        """Whether the gentle start of a take-off is still under way."""

    def say(self, text: str, severity: int, /) -> None:
        """Tells every listener."""

    def enter(self, mode: PX4Mode, doing: Manoeuvre | None = None) -> None:
        """Makes ``mode`` the intended one, flown by ``doing`` unless a failsafe flies."""

    def lift_off(self, altitude_enu_m: float) -> None:
        """Climbs straight up from the ground to a height in ENU."""

    def fly_to(
        self, position_enu_m: F64, yaw_rad: float, speed_mps: float, velocity_enu_mps: F64 | None = None
    ) -> None:
        """Flies towards a setpoint."""

    def touch_down(self) -> None:
        """Lands here."""

    def is_high_as(self, altitude_enu_m: float) -> bool:
        """Whether it is within NAV_MC_ALT_RAD of that height."""

    def outside_fence(self, position_enu_m: F64 | None = None) -> bool:
        """Whether a position (default: the vehicle's) is beyond the fence or farther than GF_MAX_*."""


class Manoeuvre(Protocol):
    """The behaviour of a mode."""

    def step(self, pilot: Pilot) -> None:
        """Continues; called once a tick."""
