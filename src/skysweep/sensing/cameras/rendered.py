"""The embedded camera: renders the world from the true pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skysweep.geometry.camera import CameraPose
from skysweep.scenarios.model import CameraModel
from skysweep.sensing.cameras.effects import CameraEffects
from skysweep.types import Frame, VehicleState
from skysweep.worlds.rendering.renderer import Backend, Painter, make_renderer
from skysweep.worlds.world import World

F64 = NDArray[np.float64]

MIN_DISTANCE_M = 0.5


@dataclass(frozen=True, slots=True)
class TruePose:
    """Where the camera really is and how it moves."""

    camera: CameraPose
    velocity_enu_mps: F64  # (3,)
    rate_enu_radps: F64  # (3,) angular velocity


class RenderedCamera:
    """A :class:`skysweep.types.Camera` in a simulated world.

    ``truth`` gives the true pose at the time of the state passed to ``capture``; the frame carries the
    camera pose of that state (see :class:`skysweep.sensing.exposures.Exposures` for its delay). One seed
    gives the same frame bytes. ``backend`` is the renderer, or its name.
    """

    def __init__(
        self,
        world: World,
        camera: CameraModel,
        truth: Callable[[], TruePose],
        seed: int,
        backend: Backend | Painter = "auto",
    ) -> None:
        self._terrain = world.terrain
        self._lens = camera.lens
        self._truth = truth
        self._renderer = make_renderer(world, backend) if isinstance(backend, str) else backend
        self.backend = self._renderer.backend
        self._effects = CameraEffects(
            camera.lens, camera.exposure_s, camera.noise_std, camera.jpeg_quality, seed
        )
        self._frame_index = 0

    def capture(self, state: VehicleState) -> Frame:
        """The picture of this moment."""
        true = self._truth()
        clean = self._renderer.render(self._lens, true.camera, state.time_s)
        image = self._effects.apply(
            clean,
            self._frame_index,
            true.camera,
            true.velocity_enu_mps,
            true.rate_enu_radps,
            self._distance_m(true.camera),
        )
        self._frame_index += 1
        return Frame(state.time_s, image, state.camera, self._lens)

    def skip(self, state: VehicleState) -> Frame:
        """The frame of this moment with an empty picture; the next ones are as if it had been taken."""
        self._frame_index += 1
        return Frame(state.time_s, np.empty((0, 0, 3), np.uint8), state.camera, self._lens)

    def close(self) -> None:
        """Let go of the renderer."""
        self._renderer.close()

    def _distance_m(self, pose: CameraPose) -> float:
        """About how far the ground is along the optical axis."""
        height = pose.position_enu_m[2] - float(self._terrain.height_m(pose.position_enu_m[:2])[0])
        down = max(-float(pose.R_camera_to_enu[2, 2]), 0.2)
        return float(max(height / down, MIN_DISTANCE_M))
