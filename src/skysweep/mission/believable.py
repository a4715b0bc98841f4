"""A vehicle's states as a mission can use them, whatever is wrong with their clock or their numbers."""

from __future__ import annotations

import math

from skysweep.types import Setpoint, Vehicle, VehicleState

_LATE_S = 1.0  # a state that is older than the newest by more did not come late: the clock went back


class Believable:
    """A vehicle whose time never goes back and whose numbers are numbers. Implements ``types.Vehicle``.

    - Time that was asked for and did not pass is silence of the telemetry: a clock that stands still, or one
      state told again and again, is no news.
    - A state older than the newest came late, and the newest stays. A clock that goes back by more than a
      second is followed from there; ``went_back_s`` is by how much, all in all.
    - A state with a number that is none (NaN) has no position; its place is that of the last sound state.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self.truth = vehicle.truth
        self._newest = self._sound = vehicle.state()
        self._asked_s = self.went_back_s = 0.0

    def state(self) -> VehicleState:
        """What the vehicle says."""
        state = self._vehicle.state()
        finite = math.isfinite(sum(state.camera.position_enu_m.tolist()))
        if finite and state.time_s > self._newest.time_s and self.went_back_s == 0.0:
            self._newest = self._sound = state
            self._asked_s = 0.0
            return state
        return self._doubted(state)

    def advance(self, duration_s: float) -> None:
        """Lets time pass."""
        self._vehicle.advance(duration_s)
        self._asked_s += duration_s

    def takeoff(self, altitude_agl_m: float) -> None:
        """Takes off; the vehicle's time may begin with that."""
        self._vehicle.takeoff(altitude_agl_m)
        self._newest, self._asked_s = self._vehicle.state(), 0.0

    def command(self, setpoint: Setpoint) -> None:
        self._vehicle.command(setpoint)

    def land(self) -> None:
        self._vehicle.land()

    def hold(self) -> None:
        self._vehicle.hold()

    def _doubted(self, state: VehicleState) -> VehicleState:
        newest_s = self._newest.time_s
        if state.time_s > newest_s:
            self._newest, self._asked_s = state, 0.0
        elif state.time_s < newest_s - _LATE_S:
            self._newest, self.went_back_s = state, self.went_back_s + newest_s - state.time_s
        elif state.time_s != newest_s:
            state = self._newest
        if has_place(state):
            self._sound = state
        else:
            place, R = self._sound.position_enu_m, self._sound.R_body_to_enu
            state = state._replace(position_enu_m=place, R_body_to_enu=R, camera=self._sound.camera)
            state = state._replace(position_std_m=math.inf)
        silent_s = max(state.silent_s, self._asked_s)
        return state._replace(time_s=state.time_s + self.went_back_s, silent_s=silent_s)


def has_place(state: VehicleState) -> bool:
    """Whether place and attitude are numbers: those of the camera are made of them."""
    return math.isfinite(sum(state.camera.position_enu_m.tolist()))
