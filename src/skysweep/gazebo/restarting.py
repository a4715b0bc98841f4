"""A simulator as a renderer: the common part of both Gazebos."""

from __future__ import annotations

import logging
import math
import shutil
import tempfile
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skysweep.errors import UserError
from skysweep.gazebo.export import Format, write_world
from skysweep.gazebo.transport import TransportError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.scenarios.model import Scenario
from skysweep.worlds.rendering.renderer import Backend
from skysweep.worlds.world import World

ANSWER_S = 10.0  # a simulator that is silent for longer is replaced; each further start gets twice the time
STARTS = 4  # in a row, without a picture in between
STEP_MAX_S = 0.05
_RGB_INT8 = 3  # in both Gazebos
_OPTICAL_TO_FLU = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

log = logging.getLogger(__name__)


class SimulatorRenderer(ABC):
    """Draws one world in a simulator's process; the same pose gives the same picture.

    Every picture advances the simulator's clock by one camera period of ``1 / rate_hz``; nothing else does. A
    simulator that does not answer within ANSWER_S is replaced by another one. Rendering raises UserError if
    the simulator cannot load the world, or STARTS of them in a row do not answer. ``parts`` (models, plugins)
    are added to the world.
    """

    backend: Backend

    def __init__(
        self, world: World, scenario: Scenario, rate_hz: float, fmt: Format, *parts: ET.Element
    ) -> None:
        self._lens = scenario.camera.lens
        self.steps = max(math.ceil(1.0 / rate_hz / STEP_MAX_S - 1e-9), 1)  # a picture
        self.step_s = 1.0 / rate_hz / self.steps
        self.folder = Path(tempfile.mkdtemp(prefix="skysweep-gazebo-"))
        self.world_file = write_world(
            world, scenario, self.folder / "world", fmt, parts, self.step_s, in_real_time=False
        )
        self.starts = 0  # simulators so far
        self._runs = False

    def render(self, lens: Lens, pose: CameraPose, time_s: float = 0.0) -> NDArray[np.uint8]:
        """The picture (H, W, 3) RGB through the scenario's lens, the same at any time."""
        if lens != self._lens:
            raise ValueError(f"the camera in Gazebo has {self._lens}, not {lens}")
        why = ""
        for attempt in range(STARTS):
            try:
                if not self._runs:
                    self.starts += 1
                    self.start(pose, ANSWER_S * 2**attempt)
                    self._runs = True
                return self.picture(pose, ANSWER_S)
            except TransportError as error:
                why = str(error)
                log.warning("Gazebo does not answer (%s): starting another one", why)
                self._end()
        raise UserError(
            f"Gazebo did not answer {STARTS} times in a row ({why}); check that it runs by itself"
        )

    def close(self) -> None:
        """Ends the simulator and removes its world."""
        self._end()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _end(self) -> None:
        self._runs = False
        self.stop()

    @abstractmethod
    def start(self, pose: CameraPose, patience_s: float) -> None:
        """Starts a simulator, connects and discards its first picture. Raises TransportError on a timeout."""

    @abstractmethod
    def picture(self, pose: CameraPose, patience_s: float) -> NDArray[np.uint8]:
        """Steps one period with the camera at a pose; the picture. Raises TransportError on a timeout."""

    @abstractmethod
    def stop(self) -> None:
        """Ends the simulator, if there is one."""


def pose_fields(pose: CameraPose) -> dict[str, dict[str, float]]:
    """Fields of the camera's pose message in either Gazebo: axes forward, left, up."""
    R_flu_to_enu = pose.R_camera_to_enu @ _OPTICAL_TO_FLU.T
    position = dict(zip("xyz", pose.position_enu_m.tolist(), strict=True))
    orientation = dict(zip("xyzw", Rotation.from_matrix(R_flu_to_enu).as_quat().tolist(), strict=True))
    return {"position": position, "orientation": orientation}


def rgb_pixels(image: Any, pixel_format: int, topic: str) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) of an image message. Raises UserError if its format is not RGB."""
    if pixel_format != _RGB_INT8 or len(image.data) != 3 * image.width * image.height:
        raise UserError(
            f"{topic}: carries pictures of pixel format {pixel_format} with {len(image.data)} bytes; "
            "set the camera's image format to R8G8B8"
        )
    return np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)
