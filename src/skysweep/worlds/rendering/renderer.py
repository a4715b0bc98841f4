"""The renderer interface, and the choice of a renderer that this machine can run."""

from __future__ import annotations

import logging
from typing import Literal, Protocol, TypeGuard

from skysweep.arrays import F32, I32, U8
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.scenarios.model import CameraModel
from skysweep.worlds.scene import build_scene
from skysweep.worlds.world import World

Backend = Literal["auto", "gl", "embree", "gazebo", "gz"]
MAX_RENDERED_PX = 10_000_000

log = logging.getLogger(__name__)


class Painter(Protocol):
    """Draws one world. The same lens, pose and time give the same bytes."""

    @property
    def backend(self) -> Backend: ...

    def render(self, lens: Lens, pose: CameraPose, time_s: float = 0.0) -> U8:
        """The picture (H, W, 3) RGB. Time moves the waves and the objects that move."""
        ...

    def close(self) -> None:
        """Free all resources; the renderer cannot be used afterwards."""
        ...


class Renderer(Painter, Protocol):
    """A painter that also tells how warm what it shows is, and which object each pixel shows."""

    def render_heat_c(self, lens: Lens, pose: CameraPose, time_s: float = 0.0) -> F32:
        """Apparent temperatures (H, W) in degrees C of the same view, through the air."""
        ...

    def render_ids(self, lens: Lens, pose: CameraPose, occluders: bool = True, time_s: float = 0.0) -> I32:
        """What each pixel's centre shows (H, W): 0 or 1 + index in ``world.objects``.

        Without ``occluders`` only the objects are drawn: an object's visible fraction is its pixel count
        with occluders over that without.
        """
        ...


def is_renderer(painter: Painter) -> TypeGuard[Renderer]:
    """Whether a painter is a renderer; a simulator's knows neither temperatures nor objects."""
    return hasattr(painter, "render_heat_c")


def refuse_unrenderable(camera: CameraModel) -> None:
    """Raises UserError if a camera's pictures would take more than 2 GB to render."""
    if camera.width_px * camera.height_px > MAX_RENDERED_PX:
        raise UserError(
            f"camera.width_px: {camera.width_px} x {camera.height_px} pixels are more than can be rendered "
            f"({MAX_RENDERED_PX / 1e6:g} million); write fewer, or fly with --sensor statistical"
        )


def make_renderer(world: World, backend: Backend = "auto") -> Renderer:
    """A renderer of ``world``: OpenGL through EGL (CPU or GPU), or ray casting with Embree.

    ``auto`` takes OpenGL and falls back to Embree with one warning. Raises UserError if the backend
    cannot run here, MissingExtraError if Embree is not installed.
    """
    from skysweep.worlds.rendering.gl import GLRenderer

    if backend not in ("auto", "gl", "embree"):
        raise UserError(f"backend: '{backend}' is unknown; write auto, gl or embree")
    scene = build_scene(world)
    if backend != "embree":
        try:
            return GLRenderer(scene)
        except UserError as error:
            if backend == "gl":
                raise
            log.warning("%s Falling back to Embree, which is several times slower.", error)
    from skysweep.worlds.rendering.embree import EmbreeRenderer

    return EmbreeRenderer(scene)
