"""When a sensor exposes, and the estimated pose of each exposure."""

from __future__ import annotations

import math
from collections import deque

from skysweep.geometry.camera import CameraPose
from skysweep.sensing.believed import DelayedPose
from skysweep.types import VehicleState

_EPS_S = 1e-6
_TURNED_RAD = 0.035  # within the pose delay: a picture is taken, though its pose is that much off
_SLOWER_AFTER = 2  # looks in a row that do not fit into a period
_FASTER_AFTER = 25  # looks in a row that fit: load comes and goes
_FITS = 0.8  # of a period, to leave room for the next load
_ROUNDING = 0.01  # of a period


class Exposures:
    """Tells a sensor at which of the mission's states to expose.

    ``due(state)`` must see every state. It returns None, or the camera pose of ``pose_delay_s`` ago, as
    telemetry lags behind the picture. No picture is taken while the gimbal turns to another pitch, faster
    than that pose could follow. ``period_s`` is the time between two exposures: ``usual_period_s``, unless
    the sensor cannot keep that (see ``Pace``).
    """

    def __init__(self, rate_hz: float, pose_delay_s: float) -> None:
        self.usual_period_s = self.period_s = 1.0 / rate_hz
        self._poses = DelayedPose(pose_delay_s)
        self._next_s = 0.0

    def due(self, state: VehicleState) -> CameraPose | None:
        """The estimated pose of an exposure now, or None if none is due."""
        self._poses.push(state.time_s, state.camera)
        if state.time_s < self._next_s - _EPS_S:
            return None
        believed = self._poses.at(state.time_s)
        if abs(state.camera.pitch_rad - believed.pitch_rad) > _TURNED_RAD:
            return None
        self._next_s += self.period_s
        if self._next_s <= state.time_s:
            self._next_s = state.time_s + self.period_s
        return believed


class Pace:
    """Adapts the period to the time looks take: every usual period, every second one, every third ..."""

    def __init__(self, exposures: Exposures) -> None:
        self._exposures = exposures
        self._took_s: deque[float] = deque(maxlen=_FASTER_AFTER)

    def took(self, look_s: float) -> None:
        """Take note of how long the newest look took, in the vehicle's time."""
        took_s = self._took_s
        took_s.append(look_s)
        usual_s, now = self._exposures.usual_period_s, self._exposures.period_s
        newest_s = [*took_s][-_SLOWER_AFTER:]
        period_s = now
        if len(newest_s) == _SLOWER_AFTER:
            period_s = max(now, _periods(min(newest_s), usual_s))
        if len(took_s) == _FASTER_AFTER:
            period_s = min(period_s, _periods(max(took_s) / _FITS, usual_s))
        if period_s != now:
            self._exposures.period_s = period_s
            took_s.clear()


def _periods(look_s: float, usual_s: float) -> float:
    """The shortest multiple of the usual period in which a look fits."""
    return usual_s * max(1, math.ceil(look_s / usual_s - _ROUNDING))
