"""The statistical sensor at poses of one's choosing."""

from __future__ import annotations

import numpy as np

from skysweep.arrays import F64
from skysweep.geometry.camera import CameraMotion, CameraPose
from skysweep.scenarios.model import Scenario
from skysweep.sensing.exposures import Exposures
from skysweep.sensing.statistical.model import StatisticalModel
from skysweep.sensing.statistical.sensor import StatisticalSensor
from skysweep.types import Detections, VehicleState
from skysweep.worlds.world import World


class PosedSensor:
    """What would be reported of a world from given poses, without a flight."""

    def __init__(self, scenario: Scenario, world: World, model: StatisticalModel, seed: int) -> None:
        self._eye = _Eye()
        at_once = scenario.camera.model_copy(update={"latency_s": 0.0})
        classes = scenario.target_classes
        self._sensor = StatisticalSensor(
            world,
            at_once,
            scenario.detector,
            self._eye,
            _Always(),
            classes,
            seed,
            model,
            smallest_m=scenario.smallest_size_m,
        )

    def detect(self, pose: CameraPose, velocity_enu_mps: F64) -> Detections:
        """A new draw each time, the same in every process."""
        self._eye.pose, self._eye.velocity_enu_mps = pose, velocity_enu_mps
        found = self._sensor.sense(self._eye.state())
        assert found is not None
        return found


class _Eye:
    """Position and motion of the camera. Implements ``types.Truth``."""

    pose: CameraPose
    velocity_enu_mps: F64

    @property
    def true_position_enu_m(self) -> F64:
        return self.pose.position_enu_m

    def true_camera_pose(self) -> CameraPose:
        return self.pose

    def true_camera_motion(self) -> CameraMotion:
        return CameraMotion(self.pose.R_camera_to_enu.T @ self.velocity_enu_mps, np.zeros(3))

    def state(self) -> VehicleState:
        position, R = self.pose
        return VehicleState(0.0, position, self.velocity_enu_mps, R, self.pose, 1.0, 0.0, True)


class _Always(Exposures):
    """Makes every state an exposure."""

    def __init__(self) -> None:
        super().__init__(rate_hz=1.0, pose_delay_s=0.0)

    def due(self, state: VehicleState) -> CameraPose:
        return state.camera
