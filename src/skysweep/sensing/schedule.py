"""When a sensor exposes, and which pose the mission believes that it exposed from."""

from __future__ import annotations

from skysweep.geometry.camera import CameraPose
from skysweep.sensing.believed import DelayedPose
from skysweep.types import VehicleState

_EPS_S = 1e-6


class Exposures:
    """Tells a sensor which of the states it is shown are exposures.

    ``due(state)`` must see every state of the mission. It returns None, or the camera pose of
    ``pose_delay_s`` ago: telemetry that lags behind the picture is what mission software has.
    """

    def __init__(self, rate_hz: float, pose_delay_s: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._poses = DelayedPose(pose_delay_s)
        self._next_s = 0.0

    def due(self, state: VehicleState) -> CameraPose | None:
        """The pose that an exposure now is believed to have, or None."""
        self._poses.push(state.time_s, state.camera)
        if state.time_s < self._next_s - _EPS_S:
            return None
        self._next_s += self._period_s
        if self._next_s <= state.time_s:
            self._next_s = state.time_s + self._period_s
        return self._poses.at(state.time_s)
