"""When a sensor exposes, and which pose the mission believes that it exposed from."""

from __future__ import annotations

import math
from collections import deque

from skysweep.geometry.camera import CameraPose
from skysweep.sensing.believed import DelayedPose
from skysweep.types import VehicleState

_EPS_S = 1e-6
_SLOWER_AFTER = 2  # looks in a row that do not fit: one is no reason
_FASTER_AFTER = 25  # looks in a row that fit: the load of a busy computer comes and goes
_FITS = 0.8  # of a period: with less to spare the next load would break it again
_ROUNDING = 0.01  # of a period


class Exposures:
    """Tells a sensor which of the states it is shown are exposures.

    ``due(state)`` must see every state of the mission. It returns None, or the camera pose of
    ``pose_delay_s`` ago: telemetry that lags behind the picture is what mission software has. ``period_s`` is
    the time between two exposures: ``usual_period_s``, unless the sensor cannot keep that (see ``Pace``).
    """

    def __init__(self, rate_hz: float, pose_delay_s: float) -> None:
        self.usual_period_s = self.period_s = 1.0 / rate_hz
        self._poses = DelayedPose(pose_delay_s)
        self._next_s = 0.0

    def due(self, state: VehicleState) -> CameraPose | None:
        """The pose that an exposure now is believed to have, or None."""
        self._poses.push(state.time_s, state.camera)
        if state.time_s < self._next_s - _EPS_S:
            return None
        self._next_s += self.period_s
        if self._next_s <= state.time_s:
            self._next_s = state.time_s + self.period_s
        return self._poses.at(state.time_s)


class Pace:
    """Exposes as often as looks can be answered: at every usual period, every second one, every third ..."""

    def __init__(self, exposures: Exposures) -> None:
        self._exposures = exposures
        self._took_s: deque[float] = deque(maxlen=_FASTER_AFTER)

    def took(self, look_s: float) -> None:
        """The newest look kept the sensor busy for so long, in the vehicle's time."""
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
