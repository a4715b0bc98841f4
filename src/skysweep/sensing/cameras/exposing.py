"""A camera's pictures of a rendered world, with the effects of its kind."""

from __future__ import annotations

from collections.abc import Callable

from skysweep.arrays import F64, U8
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose
from skysweep.scenarios.model import CameraModel
from skysweep.sensing.cameras.effects import CameraEffects
from skysweep.sensing.cameras.thermal import ThermalEffects
from skysweep.worlds.rendering.renderer import Painter, is_renderer

# Of frame index, pose, time, velocity and turning rate in ENU, and the distance to the ground along the
# optical axis, which scales the blur: the picture (H, W, 3) RGB.
Expose = Callable[[int, CameraPose, float, F64, F64, float], U8]


def exposing(camera: CameraModel, painter: Painter, seed: int) -> Expose:
    """How a camera takes pictures of what ``painter`` draws. One seed gives the same pictures.

    Raises UserError if the camera is thermal and the painter is a simulator, which knows no temperatures.
    """
    lens = camera.lens
    if camera.kind == "visible":
        effects = CameraEffects(lens, camera.exposure_s, camera.noise_std, camera.jpeg_quality, seed)

        def photograph(
            index: int, pose: CameraPose, time_s: float, velocity: F64, rate: F64, distance_m: float
        ) -> U8:
            clean = painter.render(lens, pose, time_s)
            return effects.apply(clean, index, pose, velocity, rate, distance_m)

        return photograph
    if not is_renderer(painter):
        raise UserError(
            f"camera.kind: {painter.backend} draws no thermal pictures; write visible, or take renderer auto"
        )
    thermal = ThermalEffects(lens, camera.exposure_s, camera.netd_k, camera.jpeg_quality, seed)

    def measure(
        index: int, pose: CameraPose, time_s: float, velocity: F64, rate: F64, distance_m: float
    ) -> U8:
        heat_c = painter.render_heat_c(lens, pose, time_s)
        return thermal.apply(heat_c, index, pose, velocity, rate, distance_m)

    return measure
