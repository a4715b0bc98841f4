"""What a PX4 says about itself, as a ``VehicleState``: read defensively, by the vehicle's clock."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import (
    LocalFrame,
    enu_from_ned,
    ned_from_enu,
    rotation_camera_to_enu,
    rotation_flu_to_enu,
    wrap_angle,
)
from skysweep.types import VehicleState
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import PX4Mode, mode_of
from skysweep.vehicles.px4.link import Fields, PX4Link

F64 = NDArray[np.float64]
PxMode = tuple[int, int]  # PX4's main and sub mode

SILENCE_S = 0.5  # on the wall, without a position
_POSITION_GOOD = m.ESTIMATOR_POS_HORIZ_ABS | m.ESTIMATOR_POS_HORIZ_REL
_IN_AIR = (m.MAV_LANDED_STATE_IN_AIR, m.MAV_LANDED_STATE_TAKEOFF, m.MAV_LANDED_STATE_LANDING)
_GIMBAL_TOLERANCE_RAD = 0.1
_CAMERA_BELOW_M = 0.1  # as on the embedded vehicle
_UNSAID_S = 10.0  # that the vehicle is heard without a word of its battery
_RANGE_UNSAID_S = 1.0
_LONGEST_STEP_S = 1.0  # between two positions; longer is a silence of the whole vehicle
_LAWLESS_MPS = 100.0  # faster than any multicopter: a broken message
_MODE_NAMES = {
    (1, 0): "Manual", (2, 0): "Altitude", (3, 0): "Position", (3, 1): "Orbit", (4, 1): "Ready",
    (4, 2): "Take-off", (4, 3): "Hold", (4, 4): "Mission", (4, 5): "Return", (4, 6): "Land",
    (4, 8): "Follow", (4, 9): "Precision land", (5, 0): "Acro", (6, 0): "Offboard", (7, 0): "Stabilized",
}  # fmt: skip


def mode_name(mode: PxMode) -> str:
    """A mode as ground stations call it."""
    return _MODE_NAMES.get(mode, f"mode {mode[0]}.{mode[1]}")


def _mode(custom_mode: int) -> PxMode:
    return custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF


@dataclass(frozen=True, slots=True)
class Anchor:
    """Where the vehicle's local NED lies in the scenario's ENU."""

    frame: LocalFrame
    home_enu_m: F64  # (3,)
    home_ned_m: F64  # (3,)

    def enu(self, ned_m: F64) -> F64:
        """A position (3,) of local NED."""
        return enu_from_ned(ned_m - self.home_ned_m) + self.home_enu_m

    def ned(self, enu_m: F64) -> F64:
        """A position (3,) in local NED."""
        return ned_from_enu(enu_m - self.home_enu_m) + self.home_ned_m


@dataclass(frozen=True, slots=True)
class Battery:
    """One battery, by the vehicle's clock. ``share`` (0..1) is NaN while it does not say how full it is."""

    share: float
    said_share: bool  # ever
    heard_s: float  # by ``Telemetry.heard_s``
    power_at_s: float


class Telemetry:
    """Keeps what the link hears. ``gimbal_pitch_rad`` is where a gimbal looks that does not report."""

    def __init__(self, link: PX4Link, gimbal_pitch_rad: float, battery_wh: float) -> None:
        self._link = link
        self.gimbal_pitch_rad = gimbal_pitch_rad
        self._battery_wh = battery_wh
        self._boot_s = 0.0
        self._used_wh = 0.0
        self._batteries: dict[int, Battery] = {}
        self._heard_s = 0.0  # of the vehicle's time, without its silences
        self._moved_s = -math.inf  # by the link's clock: when the vehicle's clock last went on
        self._range: tuple[float, float] | None = None  # metres down, and heard when
        self.ned_m = np.zeros(3)
        self.velocity_ned_mps = np.zeros(3)
        self.R_body_to_enu = np.eye(3)
        self.has_position = self.has_attitude = False
        self.restarted = False
        self.flown: PxMode = (0, 0)
        self.intended: PxMode | None = None  # None: it does not say
        self.mode_heard_s = self.intended_heard_s = -math.inf  # by the link's clock
        link.on("HEARTBEAT", self._heartbeat)
        link.on("CURRENT_MODE", self._current_mode)
        link.on("LOCAL_POSITION_NED", self._position)
        link.on("ATTITUDE_QUATERNION", self._attitude)
        link.on("BATTERY_STATUS", self._power)
        link.on("DISTANCE_SENSOR", self._distance)

    # ---- now -----------------------------------------------------------------------------------------

    @property
    def boot_s(self) -> float:
        """The vehicle's clock: of the newest position."""
        return self._boot_s

    @property
    def silent_s(self) -> float:
        """Seconds on the wall without a newer position: one whose clock stands still is no news."""
        return self._link.now_s() - self._moved_s

    @property
    def armed(self) -> bool:
        heartbeat = self._link.newest("HEARTBEAT") or {}
        return bool(heartbeat.get("base_mode", 0) & m.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def mode(self) -> PX4Mode | None:
        """The mode that it flies; None for one that is not ours (those with sticks, for example)."""
        return mode_of(*self.flown)

    @property
    def manual_control(self) -> bool:
        """Whether a pilot's sticks are heard; in doubt they are."""
        status = self._link.newest("SYS_STATUS")
        return status is None or bool(
            status["onboard_control_sensors_present"] & m.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
        )

    @property
    def airborne(self) -> bool:
        """What the land detector says, the motors where it says nothing."""
        landed = (self._link.newest("EXTENDED_SYS_STATE") or {}).get("landed_state", 0)
        if landed == m.MAV_LANDED_STATE_UNDEFINED:
            return self.armed
        return landed in _IN_AIR

    @property
    def battery_remaining(self) -> float:
        """0..1, of the emptiest battery; NaN where one does not say, or no more.

        A battery that never said is not counted beside others that do.
        """
        telling = [b for b in list(self._batteries.values()) if b.said_share]
        if not telling or any(self._heard_s - b.heard_s > _UNSAID_S for b in telling):
            return math.nan
        shares = [b.share for b in telling]
        return math.nan if any(map(math.isnan, shares)) else min(shares)

    @property
    def ground_below_m(self) -> float | None:
        """What a rangefinder that looks down measures, along the vehicle's axis; None: nothing now."""
        if self._range is None or self._heard_s - self._range[1] > _RANGE_UNSAID_S:
            return None
        return self._range[0] * float(self.R_body_to_enu[2, 2])

    @property
    def yaw_rad(self) -> float:
        """ENU."""
        return math.atan2(self.R_body_to_enu[1, 0], self.R_body_to_enu[0, 0])

    @property
    def position_std_m(self) -> float:
        """Horizontal, 1 sigma; inf where the estimator has no position."""
        status = self._link.newest("ESTIMATOR_STATUS")
        if status is None:
            return 0.0 if self.has_position else math.inf
        accuracy = status.get("pos_horiz_accuracy")
        if not status["flags"] & _POSITION_GOOD or accuracy is None:
            return math.inf
        return float(accuracy)

    @property
    def wind_enu_mps(self) -> F64 | None:
        """(3,) where it is estimated."""
        wind = self._link.newest("WIND_COV")
        if wind is None or wind.get("wind_x") is None or wind.get("wind_y") is None:
            return None
        return enu_from_ned([wind["wind_x"], wind["wind_y"], wind.get("wind_z") or 0.0])

    @property
    def home(self) -> Fields | None:
        """The newest HOME_POSITION."""
        return self._link.newest("HOME_POSITION")

    def state(self, anchor: Anchor, since_boot_s: float) -> VehicleState:
        """The vehicle now; time begins ``since_boot_s`` after its boot."""
        position, R = anchor.enu(self.ned_m), self.R_body_to_enu
        return VehicleState(
            self._boot_s - since_boot_s,
            position,
            enu_from_ned(self.velocity_ned_mps),
            R,
            CameraPose(position - _CAMERA_BELOW_M * R[:, 2], self._camera_to_enu()),
            self.battery_remaining,
            self._used_wh,
            self.airborne,
            self.position_std_m,
            self.silent_s,
            self.wind_enu_mps,
            ground_below_m=self.ground_below_m,
        )

    # ---- hearing -------------------------------------------------------------------------------------

    def _heartbeat(self, said: Fields) -> None:
        self.flown, self.mode_heard_s = _mode(int(said["custom_mode"])), self._link.now_s()

    def _current_mode(self, said: Fields) -> None:
        self.flown, self.mode_heard_s = _mode(int(said["custom_mode"])), self._link.now_s()
        if said["intended_custom_mode"]:
            self.intended, self.intended_heard_s = _mode(int(said["intended_custom_mode"])), self.mode_heard_s

    def _position(self, said: Fields) -> None:
        numbers = [said.get(k) for k in ("x", "y", "z", "vx", "vy", "vz")]
        if not all(isinstance(v, int | float) and math.isfinite(v) for v in numbers):
            return
        boot_s = said["time_boot_ms"] * 1e-3
        if boot_s < self._boot_s:
            self.restarted = self.restarted or boot_s < self._boot_s - 1.0
            return
        values = np.array(numbers, dtype=float)
        if np.abs(values[3:]).max() > _LAWLESS_MPS:
            return
        if boot_s > self._boot_s:
            self._heard_s += min(boot_s - self._boot_s, _LONGEST_STEP_S)
            self._moved_s = self._link.now_s()
        self._boot_s, self.ned_m, self.velocity_ned_mps = boot_s, values[:3], values[3:]
        self.has_position = True

    def _attitude(self, said: Fields) -> None:
        q = [said.get(k) for k in ("q1", "q2", "q3", "q4")]
        R = _rotation(q)
        if R is not None:
            self.R_body_to_enu = rotation_flu_to_enu(R)
            self.has_attitude = True

    def _power(self, said: Fields) -> None:
        """Energy from voltage and current, from the charge where there is no current."""
        now_s, percent = self._boot_s, said.get("battery_remaining", -1)
        share = min(percent / 100.0, 1.0) if percent >= 0 else math.nan
        before = self._batteries.get(said.get("id", 0), Battery(share, False, 0.0, math.inf))
        says = before.said_share or percent >= 0
        self._batteries[said.get("id", 0)] = Battery(share, says, self._heard_s, now_s)
        cells = [v for v in said.get("voltages", ()) if 0 < v < 65535]
        current_a = said.get("current_battery", -1) * 1e-2
        if current_a > 0.0 and cells:
            self._used_wh += sum(cells) * 1e-3 * current_a * max(now_s - before.power_at_s, 0.0) / 3600.0
        elif percent >= 0:
            self._used_wh = max(self._used_wh, (1.0 - share) * self._battery_wh)

    def _distance(self, said: Fields) -> None:
        """Centimetres; only what looks down and lies between the sensor's limits is a measurement."""
        low, measured, high = said["min_distance"], said["current_distance"], said["max_distance"]
        if said["orientation"] == m.MAV_SENSOR_ROTATION_PITCH_270 and low < measured < high:
            self._range = measured * 1e-2, self._heard_s

    @property
    def reported_gimbal_pitch_rad(self) -> float | None:
        """Where the gimbal says that it looks, above the horizon; None where it says nothing."""
        R = self._gimbal_to_its_frame()
        return None if R is None else _pitch(R)

    @property
    def gimbal_is_off(self) -> bool:
        """Whether the gimbal says that it looks elsewhere than it was told."""
        pitch_rad = self.reported_gimbal_pitch_rad
        return pitch_rad is not None and abs(pitch_rad - self.gimbal_pitch_rad) > _GIMBAL_TOLERANCE_RAD

    def _camera_to_enu(self) -> F64:
        """Where the gimbal says that it looks, else the pitch it was told and the vehicle's nose."""
        R = self._gimbal_to_its_frame()
        if R is None:
            return rotation_camera_to_enu(self.yaw_rad, self.gimbal_pitch_rad)
        turn = math.atan2(-R[0, 1], R[1, 1])  # clockwise from above, also when it looks straight down
        said = self._link.newest("GIMBAL_DEVICE_ATTITUDE_STATUS") or {}
        if said["flags"] & m.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME:
            return rotation_camera_to_enu(wrap_angle(0.5 * math.pi - turn), _pitch(R))
        return rotation_camera_to_enu(wrap_angle(self.yaw_rad - turn), _pitch(R))

    def _gimbal_to_its_frame(self) -> F64 | None:
        """(3, 3) as the gimbal reports it: forward, right, down to north or nose, east or right, down."""
        said = self._link.newest("GIMBAL_DEVICE_ATTITUDE_STATUS")
        return None if said is None else _rotation(said.get("q") or [])


def _pitch(R: F64) -> float:
    """Of the forward axis, above the horizon."""
    return math.asin(max(-1.0, min(1.0, -float(R[2, 0]))))


def _rotation(q: list[float | None]) -> F64 | None:
    """(3, 3) of a quaternion (w, x, y, z); None where it is none."""
    if len(q) != 4 or not all(isinstance(v, int | float) and math.isfinite(v) for v in q):
        return None
    wxyz = np.array(q, dtype=float)
    norm = np.linalg.norm(wxyz)
    if not 0.5 < norm < 2.0:
        return None
    w, x, y, z = wxyz / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
