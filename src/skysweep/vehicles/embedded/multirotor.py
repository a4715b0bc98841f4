"""The embedded multirotor: PX4's cascade on PX4's SIH airframe, with gimbal, battery, wind and errors.

A mission may use the ``Vehicle`` protocol of ``skysweep.types``; names that begin with ``true_`` are for the
simulated sensors and the results only. Model, equations and calibration: docs/vehicle.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skysweep.geometry.camera import CameraMotion, CameraPose
from skysweep.scenarios.model import CameraModel, VehicleLimits, Wind
from skysweep.types import F64, Setpoint, Truth, VehicleState
from skysweep.vehicles.embedded import dynamics as d

_GROUND_EVERY_STEPS = 125  # how often cruise flight asks for the height of the ground
_VEHICLE_STREAM = 0x5D_0E  # keeps this vehicle's random stream apart from others of the same seed


class Multirotor:
    """A multirotor that flies PX4 offboard setpoints in steps of 250 Hz; implements ``types.Vehicle``.

    Starts landed at ``home_enu_m`` (3,). ``ground_at_m`` is the height ENU of the ground at east and north.
    ``drag_per_mass`` is in 1/s. The same arguments and calls give the same bits; another ``unit`` has other
    errors and gusts.
    """

    def __init__(
        self,
        limits: VehicleLimits,
        wind: Wind,
        camera: CameraModel,
        home_enu_m: ArrayLike,
        ground_at_m: Callable[[float, float], float],
        seed: int,
        drag_per_mass: float = d.DRAG_PER_MASS,
        unit: int = 0,
    ) -> None:
        heading = np.radians(wind.from_heading_deg)
        self._q, self._parameters = _record(d.PARAMETERS)
        q = self._q
        q["drag_per_mass"] = drag_per_mass
        q["climb_speed"], q["descent_speed"] = limits.climb_speed_mps, limits.descent_speed_mps
        q["wind"][:2] = -wind.mean_speed_mps * np.array([np.sin(heading), np.cos(heading)])
        q["gust_std"] = wind.gust_std_mps
        q["position_std"] = limits.position_noise_m
        q["attitude_std"] = np.radians(limits.attitude_noise_deg)
        q["gimbal_goal"] = camera.gimbal.pitch_rad
        q["gimbal_rate"] = np.radians(camera.gimbal.max_rate_dps)
        q["gimbal_lag"] = camera.gimbal.lag_s
        q["hover_power"] = limits.hover_power_w
        self._wind_enu_mps = q["wind"].copy()
        self._battery_wh, self._before_wh = limits.battery_wh, 0.0  # of this battery; used of earlier ones
        self._ground_at_m = ground_at_m
        seeds = np.random.SeedSequence([seed, _VEHICLE_STREAM, unit] if unit else [seed, _VEHICLE_STREAM])
        self._rng: NDArray[np.uint64] = seeds.generate_state(1, np.uint64).astype(np.uint64)
        self._time_s = 0.0
        self._ground_at_step = 0
        self._x, self._state = _record(d.STATE)
        self._place(home_enu_m, np.zeros(3), 0.0)
        self._look_at_ground()
        position = self._x["position"]
        position[2] = max(position[2], self._x["ground_height"] + d.LEG_HEIGHT_M)
        d.start(self._state, self._rng, self._parameters)
        self._known_poses: F64 | None = None  # of this moment, computed on demand
        self._followed: Setpoint | None = None
        self.truth: Truth | None = self

    def state(self) -> VehicleState:
        """The estimated state: no delay, but with GNSS and attitude errors. The estimated wind is exact."""
        p = self._poses()
        time_s, energy_wh, airborne = p[18].tolist()
        return VehicleState(
            time_s,
            p[0],
            p[1],
            p[2:5],
            CameraPose(p[5], p[6:9]),
            max(0.0, 1.0 - (energy_wh - self._before_wh) / self._battery_wh),
            energy_wh,
            airborne != 0.0,
            0.0,
            0.0,
            self._wind_enu_mps,
        )

    def command(self, setpoint: Setpoint) -> None:
        """Flies to the setpoint from the next step on, in any mode.

        Raises RuntimeError on the ground and ValueError if a coordinate is not finite.
        """
        if setpoint is self._followed:
            return
        x = self._x
        if x["mode"].item() == d.ON_GROUND:
            raise RuntimeError("the vehicle is on the ground: call takeoff() before command()")
        if not math.isfinite(sum(setpoint.position_enu_m.tolist())):
            raise ValueError(f"a setpoint must be finite, not {setpoint.position_enu_m}")
        feed_forward = setpoint.velocity_enu_mps
        self._set_mode(d.OFFBOARD)
        x["target_position"] = setpoint.position_enu_m
        x["target_velocity"] = 0.0 if feed_forward is None else feed_forward
        x["target_speed"] = setpoint.speed_mps
        x["target_yaw"] = setpoint.yaw_rad
        if setpoint.gimbal_pitch_rad is not None:
            self.look(setpoint.gimbal_pitch_rad)
        self._followed = setpoint

    def advance(self, duration_s: float) -> None:
        """Lets time pass in steps of 4 ms; a fraction of a step is carried over to the next call."""
        x = self._x
        self._time_s += duration_s
        flown = int(x["steps"].item())
        left = round(self._time_s / d.STEP_S) - flown
        while left > 0:
            near_ground = x["mode"].item() != d.OFFBOARD
            if near_ground or flown - self._ground_at_step >= _GROUND_EVERY_STEPS:
                self._look_at_ground()
            steps = min(left, _GROUND_EVERY_STEPS)
            self._known_poses = np.empty((19, 3))
            d.fly(self._state, self._rng, self._parameters, steps, self._known_poses)
            flown += steps
            left -= steps

    def takeoff(self, altitude_agl_m: float) -> None:
        self._look_at_ground()
        self._hold_here()
        self._x["target_position"][2] = self._x["ground_height"] + altitude_agl_m
        self._set_mode(d.OFFBOARD if self._x["airborne"] else d.TAKEOFF)

    def land(self) -> None:
        """Descends here, slower near the ground; it is not airborne one second after touchdown."""
        self._hold_here()
        self._set_mode(d.LAND)

    def hold(self) -> None:
        if self._x["mode"] != d.ON_GROUND:
            self._hold_here()
            self._set_mode(d.OFFBOARD)

    def look(self, pitch_rad: float) -> None:
        """Points the gimbal above (+) or below the horizon at its own rate; its yaw follows the body."""
        self._q["gimbal_goal"] = pitch_rad

    def change_battery(self) -> None:
        """Puts in a full battery. Raises RuntimeError in the air."""
        if self._x["airborne"]:
            raise RuntimeError("the vehicle is in the air: land() before change_battery()")
        self._before_wh = float(self._x["energy_wh"])

    def snapshot(self) -> dict[str, Any]:
        return {
            "state": self._state.tolist(),
            "random": int(self._rng[0]),
            "time_s": self._time_s,
            "ground_at_step": self._ground_at_step,
            "gimbal_goal_rad": float(self._q["gimbal_goal"]),
            "before_wh": self._before_wh,
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continues bit for bit from the ``snapshot`` of a vehicle built with the same arguments."""
        self._state[:] = snapshot["state"]
        self._rng[0] = snapshot["random"]
        self._time_s = snapshot["time_s"]
        self._ground_at_step = snapshot["ground_at_step"]
        self._q["gimbal_goal"] = snapshot["gimbal_goal_rad"]
        self._before_wh = snapshot["before_wh"]
        self._known_poses = self._followed = None

    # ---- simulation only -----------------------------------------------------------------------------

    def place(self, position_enu_m: ArrayLike, velocity_enu_mps: ArrayLike, yaw_rad: float) -> None:
        """Puts the vehicle into level flight anywhere, as after a hover (for calibration and tests)."""
        self._place(position_enu_m, velocity_enu_mps, yaw_rad)
        x = self._x
        x["thrust"], x["airborne"] = d.G, 1.0
        self._look_at_ground()
        d.start(self._state, self._rng, self._parameters)
        self._known_poses = None
        self._hold_here()
        self._set_mode(d.OFFBOARD)
        x["last_velocity"] = x["velocity"] + x["velocity_error"]

    def misjudge(self, velocity_error_enu_mps: ArrayLike, lean_error: ArrayLike) -> None:
        """Adds errors to the estimates from now on (for calibration).

        The velocity errs by (3,) m/s, the position not; the estimated up axis leans (2,) rad farther east and
        north. For a vehicle without errors of its own (``position_noise_m = 0``).
        """
        self._x["velocity_error"] = velocity_error_enu_mps
        self._x["lean_error"] = lean_error
        self._known_poses = None

    @property
    def true_position_enu_m(self) -> F64:
        return self._x["position"].copy()

    @property
    def true_velocity_enu_mps(self) -> F64:
        return self._x["velocity"].copy()

    @property
    def true_R_body_to_enu(self) -> F64:
        return self._poses()[9:12]

    def true_camera_pose(self) -> CameraPose:
        p = self._poses()
        return CameraPose(p[12], p[13:16])

    def true_camera_motion(self) -> CameraMotion:
        p = self._poses()
        return CameraMotion(p[16], p[17])

    def _poses(self) -> F64:
        if self._known_poses is None:
            self._known_poses = np.empty((19, 3))
            d.poses(self._state, self._known_poses)
        return self._known_poses

    def _place(self, position_enu_m: ArrayLike, velocity_enu_mps: ArrayLike, yaw_rad: float) -> None:
        x, steps = self._x, self._x["steps"].item()
        self._state[:] = 0.0
        x["steps"] = steps
        x["position"] = position_enu_m
        x["velocity"] = velocity_enu_mps
        x["attitude"] = np.cos(0.5 * yaw_rad), 0.0, 0.0, np.sin(0.5 * yaw_rad)
        self._known_poses = None

    def _hold_here(self) -> None:
        self._followed = None
        x = self._x
        x["target_position"] = x["position"] + x["position_error"]
        x["target_velocity"] = 0.0
        x["target_speed"] = d.MPC_XY_VEL_MAX
        x["target_yaw"] = x["believed_yaw"]

    def _set_mode(self, mode: float) -> None:
        if self._x["mode"].item() != mode:
            self._x["mode"] = mode
            self._x["mode_time"] = self._x["contact_time"] = 0.0

    def _look_at_ground(self) -> None:
        east_m, north_m, _ = self._x["position"].tolist()
        self._x["ground_height"] = self._ground_at_m(east_m, north_m)
        self._ground_at_step = int(self._x["steps"].item())


def _record(layout: np.dtype[np.void]) -> tuple[NDArray[np.void], F64]:
    """A record of zeros, and a view of it as an array of its floats."""
    floats = np.zeros(layout.itemsize // 8)
    return floats.view(layout).reshape(()), floats
