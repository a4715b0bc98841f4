"""A vehicle's states made usable, whatever is wrong with their clock or numbers."""

from __future__ import annotations

import math

from skysweep.types import Setpoint, Vehicle, VehicleState

_LATE_S = 1.0  # a state older than the newest by more is not late: the clock went back


class Believable:
    """A vehicle whose time never goes back and whose position is finite. Implements ``types.Vehicle``.

    - A clock that stands still, or a repeated state, counts as silent telemetry.
    - A state older than the newest is dropped. A clock that goes back by more than a second is followed from
      there; ``went_back_s`` is the total.
    - A state with NaN has no position: it keeps the place and attitude of the last sound state.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self.truth = vehicle.truth
        self._newest = self._sound = vehicle.state()
        self._asked_s = self.went_back_s = 0.0

    def state(self) -> VehicleState:
        state = self._vehicle.state()
        finite = math.isfinite(sum(state.camera.position_enu_m.tolist()))
        if finite and state.time_s > self._newest.time_s and self.went_back_s == 0.0:
            self._newest = self._sound = state
            self._asked_s = 0.0
            return state
        return self._doubted(state)

    def advance(self, duration_s: float) -> None:
        self._vehicle.advance(duration_s)
        self._asked_s += duration_s

    def takeoff(self, altitude_agl_m: float) -> None:
        """Take off; the vehicle's time may start here."""
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
    """Whether place and attitude are finite: the camera's place is derived from both."""
    return math.isfinite(sum(state.camera.position_enu_m.tolist()))
