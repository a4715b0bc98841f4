"""A pilot's sticks: MANUAL_CONTROL messages, and flying by them.

Semantics of PX4 v1.17: manual_control (which sender counts, which motion takes over) and the multicopter's
Position mode (speed by deflection).
"""

from __future__ import annotations

import numpy as np

from skysweep.types import F64
from skysweep.vehicles.mavlink.modes import TICK_S
from skysweep.vehicles.mavlink.wire import Message
from skysweep.vehicles.served.link import Key
from skysweep.vehicles.served.pilot import Pilot

RC_ONLY, MAVLINK_ONLY, FALL_BACK, KEEP_FIRST, NONE = range(5)  # COM_RC_IN_MODE; PX4's 5 to 8 sort by link
_CENTRED = np.zeros(4)
_MOVED_OVER_S = 0.1  # time constant of the filter on how fast they move
_LET_GO_S = 1.0  # centred for so long, they are let go of
_DEAD_ZONE, _EXPONENTIAL = 0.1, 0.6  # MAN_DEADZONE; MPC_XY_MAN_EXPO, MPC_Z_MAN_EXPO and MPC_YAW_EXPO


class Sticks:
    """The position of the sticks: (4,) forward, right, up and clockwise, each from -1 to 1."""

    def __init__(self) -> None:
        self.lost = True
        self.moving = False  # enough for the pilot to take over
        self.in_use = False  # moved, or away from the centre, a moment ago
        self.source: Key | None = None  # whose they are
        self._position = self._before = _CENTRED
        self._speed = _CENTRED  # of the sticks, 1/s, filtered
        self._first: Key | None = None
        self._heard_s = self._used_s = -np.inf

    @property
    def position(self) -> F64:
        return _CENTRED if self.lost else self._position

    def hear(self, message: Message, key: Key, in_mode: int, time_s: float) -> None:
        """Takes MANUAL_CONTROL if ``in_mode`` (COM_RC_IN_MODE) admits this sender."""
        if in_mode in (RC_ONLY, NONE) or (not self.lost and key != self.source):
            return
        if in_mode == KEEP_FIRST and self._first not in (None, key):
            return
        self._first = self._first or key
        axes = np.array([message.x, message.y, 2.0 * message.z - 1000.0, message.r]) / 1000.0
        self._position = np.where(np.abs(axes) <= 1.0, axes, 0.0)
        if self.lost:
            self._before, self._speed = self._position, _CENTRED
        self.source, self._heard_s, self.lost = key, time_s, False

    def tick(self, time_s: float, lost_after_s: float, moved_percent: float) -> None:
        """Updates ``lost``, ``moving`` and ``in_use`` by COM_RC_LOSS_T and COM_RC_STICK_OV, once a tick."""
        self.lost = self.lost or time_s - self._heard_s > lost_after_s
        self.moving = False
        if not self.lost:
            share = TICK_S / (TICK_S + _MOVED_OVER_S)
            self._speed = self._speed + share * ((self._position - self._before) / TICK_S - self._speed)
            self._before = self._position
            self.moving = bool((np.abs(self._speed) > 0.01 * moved_percent).any())
            if self.moving or (np.abs(self._position) > _DEAD_ZONE).any():
                self._used_s = time_s
        self.in_use = not self.lost and time_s - self._used_s <= _LET_GO_S


class ByStick:
    """Speed follows the deflection, relative to the heading; a centred axis holds its place.

    Without a pilot it lands, as PX4 does, which descends at MPC_LAND_SPEED all the way.
    """

    def __init__(self, sticks: Sticks) -> None:
        self._sticks = sticks
        self._place: F64 | None = None
        self._sinking = False
        self._moving = np.ones(3, dtype=bool)
        self._yaw_rad = 0.0

    def step(self, pilot: Pilot) -> None:
        if not pilot.flying:
            return
        state = pilot.state
        if not state.airborne:
            pilot.touch_down()
            return
        if self._sticks.lost:
            if not self._sinking:
                self._sinking, self._place, self._moving = True, None, np.ones(3, dtype=bool)
                pilot.touch_down()
            return
        self._sinking = False
        if self._place is None:
            self._place, self._yaw_rad = state.position_enu_m, pilot.yaw_rad
        velocity, turn = _wanted(self._sticks, pilot)
        moving = np.array([velocity[:2].any(), velocity[:2].any(), velocity[2] != 0.0])
        if not (moving.any() or turn or self._moving.any()):
            return
        self._yaw_rad -= turn * TICK_S
        # Half a tick ahead: the position controller does not act on a moving axis.
        drifting = state.position_enu_m + 0.5 * TICK_S * velocity
        stopping = state.position_enu_m + state.velocity_enu_mps / pilot.parameters["MPC_XY_P"]
        held = np.where(self._moving, stopping, self._place)
        self._place, self._moving = np.where(moving, drifting, held), moving
        pilot.fly_to(self._place, self._yaw_rad, np.inf, velocity)


def _wanted(sticks: Sticks, pilot: Pilot) -> tuple[F64, float]:
    """ENU velocity (3,) and clockwise yaw rate in rad/s."""
    p, (forward, right, up, turn) = pilot.parameters, _shaped(sticks.position)
    size = max(float(np.hypot(forward, right)), 1.0)
    ahead, aside = p["MPC_VEL_MANUAL"] / size * np.array([forward, right])
    c, s = np.cos(pilot.yaw_rad), np.sin(pilot.yaw_rad)
    climb = up * p["MPC_Z_VEL_MAX_UP" if up > 0.0 else "MPC_Z_VEL_MAX_DN"]
    velocity = np.array([c * ahead + s * aside, s * ahead - c * aside, climb])
    return velocity, float(turn * np.radians(p["MPC_MAN_Y_MAX"]))


def _shaped(sticks: F64) -> F64:
    """With dead zone and exponential."""
    beyond = np.sign(sticks) * np.maximum(np.abs(sticks) - _DEAD_ZONE, 0.0) / (1.0 - _DEAD_ZONE)
    return np.asarray((1.0 - _EXPONENTIAL) * beyond + _EXPONENTIAL * beyond**3)
