"""What a mode's manoeuvre sees of the autopilot that flies it."""

from __future__ import annotations

from typing import Protocol

from skysweep.types import Setpoint, VehicleState
from skysweep.vehicles.mavlink.modes import F64, PX4Mode, Site
from skysweep.vehicles.served.parameters import Parameters


class Pilot(Protocol):
    """Where the vehicle is and what is asked of it, and the orders that a manoeuvre is made of."""

    site: Site
    parameters: Parameters
    state: VehicleState
    setpoint: Setpoint | None
    home_enu_m: F64
    rally_enu_m: tuple[F64, ...]
    speed_mps: float | None  # of automatic modes, where it was changed
    flying: bool  # from the order to take off until touchdown
    landing: bool

    @property
    def time_s(self) -> float:
        """The vehicle's."""

    @property
    def yaw_rad(self) -> float:
        """ENU."""

    @property
    def cruise_mps(self) -> float:
        """Horizontal speed of automatic modes."""

    @property
    def may_lift_off(self) -> bool:
        """Whether it stands ready: armed, and not landed again since."""

    @property
    def taking_off(self) -> bool:
        """Whether the gentle beginning of a take-off is still under way."""

    def say(self, text: str, severity: int, /) -> None:
        """Tells every listener."""

    def enter(self, mode: PX4Mode, doing: Manoeuvre | None = None) -> None:
        """``mode`` is wanted from now on, and flown by ``doing`` unless a failsafe flies."""

    def lift_off(self, altitude_enu_m: float) -> None:
        """Leaves the ground straight up to a height in ENU."""

    def fly_to(
        self, position_enu_m: F64, yaw_rad: float, speed_mps: float, velocity_enu_mps: F64 | None = None
    ) -> None:
        """Flies towards a setpoint."""

    def touch_down(self) -> None:
        """Descends here until it stands."""

    def is_high_as(self, altitude_enu_m: float) -> bool:
        """Whether it is at that height, as PX4 counts it."""

    def outside_fence(self, position_enu_m: F64 | None = None) -> bool:
        """Whether a position (default: the vehicle's) is beyond the fence or farther than GF_MAX_*."""


class Manoeuvre(Protocol):
    """What a mode does."""

    def step(self, pilot: Pilot) -> None:
        """Goes on with it, once a tick."""
