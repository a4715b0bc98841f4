"""A PX4's telemetry as a ``VehicleState``, checked for validity and timed by the vehicle's clock."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import enu_from_ned, rotation_camera_to_enu, rotation_flu_to_enu, wrap_angle
from skysweep.types import F64, VehicleState
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import PX4Mode, Site, mode_of
from skysweep.vehicles.px4.link import Fields, PX4Link

PxMode = tuple[int, int]  # PX4's main and sub mode

SILENCE_S = 0.5  # on the wall, without a position
_POSITION_GOOD = m.ESTIMATOR_POS_HORIZ_ABS | m.ESTIMATOR_POS_HORIZ_REL
_IN_AIR = (m.MAV_LANDED_STATE_IN_AIR, m.MAV_LANDED_STATE_TAKEOFF, m.MAV_LANDED_STATE_LANDING)
_GIMBAL_TOLERANCE_RAD = 0.1
_CAMERA_BELOW_M = 0.1  # as on the embedded vehicle
_UNSAID_S = 10.0  # of telemetry without a battery message
_FALL = 0.1  # of a battery's share between two reports: more counts once the next says so, too
_RANGE_UNSAID_S = 1.0
_ATTITUDE_UNSAID_S = 2.0  # of the vehicle and of its gimbal
_LONGEST_STEP_S = 1.0  # between two positions; longer is a silence of the whole vehicle
_LAWLESS_MPS = 100.0  # faster than any multicopter: a broken message
_PACE_S = 1.0  # of telemetry that tells the pace of the vehicle's clock
_JUMP_M = 5.0  # between two positions, beyond what the velocity explains
_JUMP_SETTLES_S = 30.0  # longer than most jumps last
_RESTARTED = 5  # positions of an earlier time, one after the other
_STAMPS = 64  # of the newest positions: the same message may come over two ways
_ALTERNATIONS, _ALTERNATING_S = 10, 5.0  # of two clocks, on the wall: more than a network's disorder
_MODE_NAMES = {
    (1, 0): "Manual", (2, 0): "Altitude", (3, 0): "Position", (3, 1): "Orbit", (4, 1): "Ready",
    (4, 2): "Take-off", (4, 3): "Hold", (4, 4): "Mission", (4, 5): "Return", (4, 6): "Land",
    (4, 8): "Follow", (4, 9): "Precision land", (5, 0): "Acro", (6, 0): "Offboard", (7, 0): "Stabilized",
}  # fmt: skip


def mode_name(mode: PxMode) -> str:
    """A mode's name in ground stations."""
    return _MODE_NAMES.get(mode, f"mode {mode[0]}.{mode[1]}")


def _mode(custom_mode: float) -> PxMode:
    return int(custom_mode) >> 16 & 0xFF, int(custom_mode) >> 24 & 0xFF


@dataclass(frozen=True, slots=True)
class Battery:
    """The last report of one battery. ``share`` (0..1) is NaN if it is not reported."""

    share: float
    said_share: bool  # ever
    heard_s: float  # in vehicle time without silences
    power_at_s: float  # by the vehicle's clock
    is_doubted: bool = False  # the newest report fell too far, and is not counted until the next


class Silence(NamedTuple):
    """A time without positions, or in which this program did not run."""

    until_s: float  # by the link's clock
    over_boot_s: float  # the vehicle's clock then: what is told from before that is old


class Telemetry:
    """The newest telemetry of a link. ``gimbal_pitch_rad``: the pitch of a gimbal that does not report it."""

    def __init__(self, link: PX4Link, gimbal_pitch_rad: float, battery_wh: float) -> None:
        self._link = link
        self.gimbal_pitch_rad = gimbal_pitch_rad
        self._battery_wh = battery_wh
        self.boot_s = 0.0  # the vehicle's clock at the newest position
        self._used_wh = self._before_wh = 0.0  # in all; of earlier batteries
        self._batteries: dict[int, Battery] = {}
        self._heard_s = 0.0  # of the vehicle's time, without its silences
        self._moved_s = -math.inf  # by the link's clock: when the vehicle's clock last advanced
        self._range: tuple[float, float] | None = None  # metres down, and heard when
        self.ned_m = np.zeros(3)
        self.velocity_ned_mps = np.zeros(3)
        self.R_body_to_enu = np.eye(3)
        self.has_position = self.has_attitude = False
        self.restarted = False
        self.silence = Silence(-math.inf, -math.inf)  # the last one that has ended
        self._first: tuple[float, float] | None = None  # by both clocks, of the first position
        self._stamps = deque[float](maxlen=_STAMPS)
        self._back: list[float] = []  # the newest positions, by the vehicle's clock, if of an earlier time
        self._jumped_s = self._attitude_s = -math.inf  # in vehicle time without silences: the newest of each
        self._said_s: dict[str, float] = {}  # likewise
        self._alternations = deque[float](maxlen=_ALTERNATIONS)  # when its clock was the later one again
        self.flown: PxMode = (0, 0)
        self.intended: PxMode | None = None  # None: not reported
        self.mode_heard_s = self.intended_heard_s = -math.inf  # by the link's clock
        link.on("HEARTBEAT", self._take_mode)
        link.on("CURRENT_MODE", self._take_mode)
        link.on("LOCAL_POSITION_NED", self._position)
        link.on("ATTITUDE_QUATERNION", self._attitude)
        for name in ("ESTIMATOR_STATUS", "WIND_COV", "GIMBAL_DEVICE_ATTITUDE_STATUS"):
            link.on(name, partial(self._note, name))
        link.on("BATTERY_STATUS", self._power)
        link.on("DISTANCE_SENSOR", self._distance)

    @property
    def silent_s(self) -> float:
        """Seconds on the wall without a position of a newer time."""
        return self._link.now_s() - self._moved_s

    @property
    def are_two(self) -> bool:
        """Whether two vehicles of one system id answer: their clocks come in turn."""
        times_s = list(self._alternations)
        return len(times_s) == _ALTERNATIONS and self._link.now_s() - times_s[0] < _ALTERNATING_S

    @property
    def armed(self) -> bool:
        heartbeat = self._link.newest("HEARTBEAT") or {}
        return bool(heartbeat.get("base_mode", 0) & m.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def mode(self) -> PX4Mode | None:
        """The flown mode; None for one that skysweep does not know."""
        return mode_of(*self.flown)

    @property
    def manual_control(self) -> bool:
        """Whether the vehicle hears a pilot's sticks; true in doubt."""
        status = self._link.newest("SYS_STATUS")
        return status is None or bool(
            status["onboard_control_sensors_present"] & m.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
        )

    @property
    def airborne(self) -> bool:
        """By the land detector, or by the motors if it reports nothing."""
        landed = (self._link.newest("EXTENDED_SYS_STATE") or {}).get("landed_state", 0)
        if landed == m.MAV_LANDED_STATE_UNDEFINED:
            return self.armed
        return landed in _IN_AIR

    @property
    def battery_remaining(self) -> float:
        """0..1, of the emptiest battery; NaN if one stops reporting.

        A battery that never reported its share does not count beside others that do.
        """
        telling = [b for b in list(self._batteries.values()) if b.said_share]
        if not telling or any(self._heard_s - b.heard_s > _UNSAID_S for b in telling):
            return math.nan
        shares = [b.share for b in telling]
        return math.nan if any(map(math.isnan, shares)) else min(shares)

    @property
    def ground_below_m(self) -> float | None:
        """The height above ground from a downward rangefinder; None without a recent measurement."""
        if self._range is None or self._heard_s - self._range[1] > _RANGE_UNSAID_S:
            return None
        return self._range[0] * float(self.R_body_to_enu[2, 2])

    @property
    def yaw_rad(self) -> float:
        """ENU."""
        return math.atan2(self.R_body_to_enu[1, 0], self.R_body_to_enu[0, 0])

    @property
    def position_std_m(self) -> float:
        """Horizontal, 1 sigma; inf if the estimator has no position, or it or the attitude falls silent."""
        if self.has_attitude and self._heard_s - self._attitude_s > _ATTITUDE_UNSAID_S:
            return math.inf
        if self._link.newest("ESTIMATOR_STATUS") is None:
            return 0.0 if self.has_position else math.inf
        status = self._recent("ESTIMATOR_STATUS", _UNSAID_S)
        accuracy = None if status is None else status.get("pos_horiz_accuracy")
        if status is None or not status["flags"] & _POSITION_GOOD or accuracy is None:
            return math.inf
        return float(accuracy)

    @property
    def wind_enu_mps(self) -> F64 | None:
        """(3,); None if it is not estimated."""
        wind = self._recent("WIND_COV", _UNSAID_S)
        if wind is None or wind.get("wind_x") is None or wind.get("wind_y") is None:
            return None
        return enu_from_ned([wind["wind_x"], wind["wind_y"], wind.get("wind_z") or 0.0])

    @property
    def has_jumped(self) -> bool:
        """Whether the position has jumped lately: its place may be a false one."""
        return self._heard_s - self._jumped_s < _JUMP_SETTLES_S

    @property
    def home(self) -> Fields | None:
        return self._link.newest("HOME_POSITION")

    def state(self, site: Site, since_boot_s: float) -> VehicleState:
        """The vehicle now; time begins ``since_boot_s`` after its boot."""
        position, R = site.enu_from_ned(self.ned_m), self.R_body_to_enu
        return VehicleState(
            self.boot_s - since_boot_s,
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

    def begin_battery(self) -> None:
        """From now on another battery is used."""
        self._before_wh = self._used_wh

    def _recent(self, name: str, longest_s: float) -> Fields | None:
        """The last message of a kind; None if there is none, or an old one."""
        is_old = self._heard_s - self._said_s.get(name, 0.0) > longest_s
        return None if is_old else self._link.newest(name)

    def _note(self, name: str, _said: Fields) -> None:
        self._said_s[name] = self._heard_s

    def _take_mode(self, said: Fields) -> None:
        self.flown, self.mode_heard_s = _mode(said["custom_mode"]), self._link.now_s()
        intended = said.get("intended_custom_mode")  # not in HEARTBEAT
        if intended:
            self.intended, self.intended_heard_s = _mode(intended), self.mode_heard_s

    def _position(self, said: Fields) -> None:
        numbers = [said.get(k) for k in ("x", "y", "z", "vx", "vy", "vz")]
        if not all(isinstance(v, int | float) and math.isfinite(v) for v in numbers):
            return
        boot_s = said["time_boot_ms"] * 1e-3
        if boot_s in self._stamps:
            return
        self._stamps.append(boot_s)
        if boot_s < self.boot_s:
            goes_on = self._back and boot_s > self._back[-1]
            self._back = [*self._back, boot_s][-_RESTARTED:] if goes_on else [boot_s]
            is_new = len(self._back) == _RESTARTED and boot_s < self.boot_s - 1.0
            self.restarted = self.restarted or is_new
            return
        if self._back:
            self._alternations.append(self._link.now_s())
            self._back = []
        values = np.array(numbers, dtype=float)
        if np.abs(values[3:]).max() > _LAWLESS_MPS:
            return
        if self._is_jump(boot_s - self.boot_s, values):
            self._jumped_s = self._heard_s
        if boot_s > self.boot_s:
            now_s = self._link.now_s()
            self._heard_s += min(boot_s - self.boot_s, _LONGEST_STEP_S)
            self._note_silence(now_s, boot_s)
            self._moved_s = now_s  # last: who sees it has seen the silence before it
        self.boot_s, self.ned_m, self.velocity_ned_mps = boot_s, values[:3], values[3:]
        self.has_position = True

    def _is_jump(self, step_s: float, values: F64) -> bool:
        mean_mps = 0.5 * (self.velocity_ned_mps + values[3:])
        away_m = float(np.linalg.norm(values[:3] - self.ned_m - step_s * mean_mps))
        return self.has_position and step_s <= _LONGEST_STEP_S and away_m > _JUMP_M

    def _note_silence(self, now_s: float, boot_s: float) -> None:
        """Also one in which this program, or the computer and its clock, stood still."""
        if self._first is None:
            self._first = now_s, boot_s
            return
        first_s, first_boot_s = self._first
        known_s = self._moved_s - first_s
        pace = (self.boot_s - first_boot_s) / known_s if known_s > _PACE_S else 1.0  # of a simulator's clock
        by_boot_s = (boot_s - self.boot_s) / max(pace, 1.0)  # one that was paused is not fast now
        passed_s = max(now_s - self._moved_s, by_boot_s)
        if passed_s >= SILENCE_S:
            self.silence = Silence(now_s, self.boot_s + passed_s * pace)

    def _attitude(self, said: Fields) -> None:
        R = _rotation([said.get(k) for k in ("q1", "q2", "q3", "q4")])
        if R is not None:
            self.R_body_to_enu = rotation_flu_to_enu(R)
            self.has_attitude, self._attitude_s = True, self._heard_s

    def _power(self, said: Fields) -> None:
        """Energy from voltage and current, or from the charge if there is no current."""
        now_s, percent = self.boot_s, said.get("battery_remaining", -1)
        share = min(percent / 100.0, 1.0) if percent >= 0 else math.nan
        before = self._batteries.get(said.get("id", 0), Battery(share, False, 0.0, math.inf))
        says = before.said_share or percent >= 0
        is_doubted = not before.is_doubted and before.share - share > _FALL
        share = before.share if is_doubted else share
        self._batteries[said.get("id", 0)] = Battery(share, says, self._heard_s, now_s, is_doubted)
        cells = [v for v in said.get("voltages", ()) if 0 < v < 65535]
        current_a = said.get("current_battery", -1) * 1e-2
        if current_a > 0.0 and cells:
            self._used_wh += sum(cells) * 1e-3 * current_a * max(now_s - before.power_at_s, 0.0) / 3600.0
        elif percent >= 0:
            self._used_wh = max(self._used_wh, self._before_wh + (1.0 - share) * self._battery_wh)

    def _distance(self, said: Fields) -> None:
        """Takes centimetres from a sensor that looks down, if they are between its limits."""
        low, measured, high = said["min_distance"], said["current_distance"], said["max_distance"]
        if said["orientation"] == m.MAV_SENSOR_ROTATION_PITCH_270 and low < measured < high:
            self._range = measured * 1e-2, self._heard_s

    @property
    def reported_gimbal_pitch_rad(self) -> float | None:
        """The reported pitch above the horizon; None if the gimbal does not report."""
        R = self._gimbal_to_its_frame()
        return None if R is None else _pitch(R)

    @property
    def gimbal_is_off(self) -> bool:
        """Whether the reported pitch differs from the commanded one."""
        pitch_rad = self.reported_gimbal_pitch_rad
        return pitch_rad is not None and abs(pitch_rad - self.gimbal_pitch_rad) > _GIMBAL_TOLERANCE_RAD

    def _camera_to_enu(self) -> F64:
        """From the gimbal's report, or from the commanded pitch and the vehicle's yaw without one."""
        R = self._gimbal_to_its_frame()
        if R is None:
            return rotation_camera_to_enu(self.yaw_rad, self.gimbal_pitch_rad)
        turn = math.atan2(-R[0, 1], R[1, 1])  # clockwise from above, also when it looks straight down
        said = self._link.newest("GIMBAL_DEVICE_ATTITUDE_STATUS") or {}
        in_earth_frame = said["flags"] & m.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
        zero_rad = 0.5 * math.pi if in_earth_frame else self.yaw_rad
        return rotation_camera_to_enu(wrap_angle(zero_rad - turn), _pitch(R))

    def _gimbal_to_its_frame(self) -> F64 | None:
        """(3, 3) from forward, right, down to north or nose, east or right, down."""
        said = self._recent("GIMBAL_DEVICE_ATTITUDE_STATUS", _ATTITUDE_UNSAID_S)
        return None if said is None else _rotation(said.get("q") or [])


def _pitch(R: F64) -> float:
    """The pitch of the forward axis above the horizon."""
    return math.asin(max(-1.0, min(1.0, -float(R[2, 0]))))


def _rotation(q: list[float | None]) -> F64 | None:
    """(3, 3) of a quaternion (w, x, y, z); None if it is invalid."""
    if len(q) != 4 or not all(isinstance(v, int | float) and math.isfinite(v) for v in q):
        return None
    w, x, y, z = np.array(q, dtype=float)
    if not 0.5 < math.hypot(w, x, y, z) < 2.0:
        return None
    return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())
