"""A scenario's world without a mission: its content, its pictures, and simulated detections."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from skysweep.api.checks import whole_seed
from skysweep.api.scenarios import ScenarioLike, load_scenario
from skysweep.arrays import F32, U8
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu, yaw_from_heading
from skysweep.scenarios.model import Scenario
from skysweep.sensing.statistical.model import model_for
from skysweep.sensing.statistical.posed import PosedSensor
from skysweep.types import Detections
from skysweep.worlds import world as worlds

if TYPE_CHECKING:
    from skysweep.worlds.rendering.renderer import Backend, Renderer


def camera_pose(
    position_enu_m: ArrayLike, heading_deg: float = 0.0, pitch_deg: float = -90.0, roll_deg: float = 0.0
) -> CameraPose:
    """A camera at ``position_enu_m`` (3,): east, north and up of the scenario's origin.

    ``heading_deg`` is the compass heading of the view or, if the camera looks straight down (a pitch of -90),
    of the picture's top. ``pitch_deg`` is above the horizon; ``roll_deg`` turns the picture clockwise. Raises
    UserError if the position is not three numbers, or an angle no number.
    """
    try:
        position = np.asarray(position_enu_m, dtype=float)
        pitch, roll = np.radians([float(pitch_deg), float(roll_deg)]).tolist()
        yaw = yaw_from_heading(float(heading_deg))
    except (TypeError, ValueError):
        raise UserError("pose: write numbers: (east, north, up) in metres, and angles in degrees") from None
    if position.shape != (3,) or not np.isfinite([*position, pitch, roll, yaw]).all():
        raise UserError(
            f"position_enu_m: is {position_enu_m!r:.60}; write three numbers: (east, north, up) in metres"
        )
    return CameraPose(position, rotation_camera_to_enu(yaw, pitch, roll))


def build_world(scenario: ScenarioLike, seed: int = 0, renderer: Backend = "auto") -> World:
    """The world of a mission with this scenario and seed. ``renderer``: gl, embree or auto.

    Raises UserError if there is no such scenario.
    """
    chosen = load_scenario(scenario)
    return World(chosen, worlds.build_world(chosen, whole_seed(seed)), renderer)


class World:
    """A world: ground, trees, buildings, targets and look-alikes."""

    def __init__(self, scenario: Scenario, contents: worlds.World, renderer: Backend = "auto") -> None:
        self._scenario, self._contents, self._backend = scenario, contents, renderer

    def __repr__(self) -> str:
        """One line."""
        c = self._contents
        return (
            f"World({self._scenario.name}, seed {c.seed}: {len(c.targets)} targets, "
            f"{len(c.objects) - len(c.targets)} look-alikes, {len(c.trees)} trees, "
            f"{len(c.buildings)} buildings)"
        )

    @property
    def objects(self) -> tuple[worlds.WorldObject, ...]:
        """Targets and look-alikes."""
        return self._contents.objects

    @property
    def targets(self) -> tuple[worlds.WorldObject, ...]:
        """What the mission searches for."""
        return self._contents.targets

    @property
    def lens(self) -> Lens:
        """The lens of the scenario's camera."""
        return self._scenario.camera.lens

    def ground_m(self, east_m: float, north_m: float) -> float:
        """Height of the ground at a place, in metres above the origin."""
        return self._contents.terrain.height_at_m(float(east_m), float(north_m))

    def render(self, pose: CameraPose, time_s: float = 0.0) -> U8:
        """The picture (H, W, 3) RGB of the scenario's camera from a pose, without noise or blur.

        That of a thermal camera is white hot. ``time_s`` moves the waves. Raises UserError if rendering is
        impossible here.
        """
        from skysweep.worlds.rendering.white_hot import seen

        return seen(self._scenario.camera, self._renderer, self.lens, _pose(pose), time_s)

    def temperatures_c(self, pose: CameraPose, time_s: float = 0.0) -> F32:
        """Apparent temperatures (H, W) in degrees C through the scenario's lens, whatever its camera's kind.

        Raises UserError if rendering is impossible here.
        """
        return self._renderer.render_heat_c(self.lens, _pose(pose), time_s)

    def detect(self, pose: CameraPose, velocity_enu_mps: Sequence[float] = (0.0, 0.0, 0.0)) -> Detections:
        """The statistical sensor's report from a pose: a new draw each time, the same in every process.

        Raises UserError if its model was made for another detector or camera than the scenario's.
        """
        return self._statistical.detect(_pose(pose), np.asarray(velocity_enu_mps, dtype=float))

    @cached_property
    def _renderer(self) -> Renderer:
        from skysweep.worlds.rendering.renderer import make_renderer, refuse_unrenderable

        refuse_unrenderable(self._scenario.camera)
        return make_renderer(self._contents, self._backend)

    @cached_property
    def _statistical(self) -> PosedSensor:
        return PosedSensor(self._scenario, self._contents, model_for(self._scenario), self._contents.seed)


def _pose(given: CameraPose) -> CameraPose:
    if not isinstance(given, CameraPose):
        raise UserError(f"pose: is {given!r:.60}; make one with camera_pose((east, north, up), heading_deg)")
    return given
