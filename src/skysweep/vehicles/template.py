"""A template for a vehicle: a point that flies straight to its setpoint at constant speed, without errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import rotation_camera_to_enu, rotation_from_euler
from skysweep.types import Setpoint, Truth, VehicleState


class PointVehicle:
    """Implements ``types.Vehicle``; looks straight down. Starts landed at ``home_enu_m`` on flat ground."""

    def __init__(
        self, home_enu_m: ArrayLike, vertical_speed_mps: float = 1.5, power_w: float = 250.0
    ) -> None:
        self._home = np.asarray(home_enu_m, dtype=float)
        self._position = self._home.copy()
        self._vertical_speed_mps = vertical_speed_mps
        self._power_w = power_w
        self._target = Setpoint(self._home, 0.0, 0.0)
        self._airborne = False
        self._time_s = 0.0
        self._energy_wh = 0.0
        self.truth: Truth | None = None

    def state(self) -> VehicleState:
        camera = CameraPose(self._position.copy(), rotation_camera_to_enu(self._target.yaw_rad, -np.pi / 2))
        return VehicleState(
            self._time_s,
            self._position.copy(),
            np.zeros(3),
            rotation_from_euler(0.0, 0.0, self._target.yaw_rad),
            camera,
            1.0,
            self._energy_wh,
            self._airborne,
        )

    def command(self, setpoint: Setpoint) -> None:
        self._target = setpoint

    def takeoff(self, altitude_agl_m: float) -> None:
        self._airborne = True
        up = self._position + np.array([0.0, 0.0, altitude_agl_m])
        self._target = Setpoint(up, 0.0, self._target.yaw_rad)

    def land(self) -> None:
        ground = np.array([*self._position[:2], self._home[2]])
        self._target = Setpoint(ground, 0.0, self._target.yaw_rad)

    def hold(self) -> None:
        self._target = Setpoint(self._position.copy(), 0.0, self._target.yaw_rad)

    def advance(self, duration_s: float) -> None:
        self._time_s += duration_s
        if not self._airborne:
            return
        gap = self._target.position_enu_m - self._position
        distance = float(np.hypot(gap[0], gap[1]))
        self._position[:2] += gap[:2] * min(1.0, self._target.speed_mps * duration_s / max(distance, 1e-9))
        reach = self._vertical_speed_mps * duration_s
        self._position[2] += np.clip(gap[2], -reach, reach)
        self._energy_wh += self._power_w * duration_s / 3600.0
        self._airborne = bool(self._position[2] > self._home[2])
