"""The embedded camera, visible or thermal: renders the world from the true pose."""

from __future__ import annotations

import numpy as np

from skysweep.geometry.camera import CameraPose
from skysweep.scenarios.model import CameraModel
from skysweep.sensing.cameras.exposing import exposing
from skysweep.types import Frame, Truth, VehicleState
from skysweep.worlds.rendering.renderer import Backend, Painter, make_renderer
from skysweep.worlds.world import World

MIN_DISTANCE_M = 0.5


class RenderedCamera:
    """A :class:`skysweep.types.Camera` in a simulated world.

    ``eye`` gives the true pose; the frame carries the camera pose of the state passed to ``capture`` (delayed
    by :class:`skysweep.sensing.exposures.Exposures`). One seed gives the same frame bytes. ``renderer`` is
    one, or its name. Raises UserError if the camera is thermal and the renderer a simulator.
    """

    def __init__(
        self,
        world: World,
        camera: CameraModel,
        eye: Truth,
        seed: int,
        renderer: Backend | Painter = "auto",
    ) -> None:
        self._terrain = world.terrain
        self._lens = camera.lens
        self._eye = eye
        self._renderer = make_renderer(world, renderer) if isinstance(renderer, str) else renderer
        self.renderer: str | None = self._renderer.backend
        self._expose = exposing(camera, self._renderer, seed)
        self._frame_index = 0

    def capture(self, state: VehicleState) -> Frame:
        """The picture at this moment."""
        true = self._eye.true_camera_pose()
        velocity_mps, rates_radps = self._eye.true_camera_motion()
        image = self._expose(
            self._frame_index,
            true,
            state.time_s,
            true.R_camera_to_enu @ velocity_mps,
            true.R_camera_to_enu @ rates_radps,
            self._distance_m(true),
        )
        self._frame_index += 1
        return Frame(state.time_s, image, state.camera, self._lens)

    def skip(self, state: VehicleState) -> Frame:
        """The frame of this moment with an empty picture; later frames are unaffected."""
        self._frame_index += 1
        return Frame(state.time_s, np.empty((0, 0, 3), np.uint8), state.camera, self._lens)

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()

    def _distance_m(self, pose: CameraPose) -> float:
        """Approximate distance of the ground along the optical axis."""
        height = pose.position_enu_m[2] - float(self._terrain.height_m(pose.position_enu_m[:2])[0])
        down = max(-float(pose.R_camera_to_enu[2, 2]), 0.2)
        return float(max(height / down, MIN_DISTANCE_M))
