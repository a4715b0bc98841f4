"""A simulator as a renderer: what is the same for every Gazebo."""

from __future__ import annotations

import logging
import math
import shutil
import tempfile
from abc import ABC, abstractmethod
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skysweep.errors import UserError
from skysweep.gazebo.transport import TransportError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.worlds.rendering.renderer import Backend

ANSWER_S = 10.0  # a simulator that is silent for longer is replaced; the next one may take twice as long
STARTS = 4  # in a row, without a picture in between
STEP_MAX_S = 0.05
_OPTICAL_TO_FLU = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

log = logging.getLogger(__name__)


class SimulatorRenderer(ABC):
    """Draws one world in a simulator's process; the same pose gives the same picture.

    The simulator's clock counts camera periods of ``1 / rate_hz``: it advances one for every picture, and
    only then. A simulator that does not answer within ANSWER_S is ended and another one started. Rendering
    raises UserError when it cannot load the world, and when STARTS of them in a row did not answer.
    """

    backend: Backend

    def __init__(self, lens: Lens, rate_hz: float) -> None:
        self._lens = lens
        self.steps = max(math.ceil(1.0 / rate_hz / STEP_MAX_S - 1e-9), 1)  # a picture
        self.step_s = 1.0 / rate_hz / self.steps
        self.folder = Path(tempfile.mkdtemp(prefix="skysweep-gazebo-"))
        self.starts = 0  # simulators so far
        self._runs = False

    def render(self, lens: Lens, pose: CameraPose, time_s: float = 0.0) -> NDArray[np.uint8]:
        """The picture (H, W, 3) RGB through the scenario's lens. Nothing moves with time."""
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
        """End the simulator and remove its world."""
        self._end()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _end(self) -> None:
        self._runs = False
        self.stop()

    @abstractmethod
    def start(self, pose: CameraPose, patience_s: float) -> None:
        """A new simulator, connected, with its first picture taken; raises TransportError in the end."""

    @abstractmethod
    def picture(self, pose: CameraPose, patience_s: float) -> NDArray[np.uint8]:
        """Step one period with the camera at a pose; the picture. Raises TransportError in the end."""

    @abstractmethod
    def stop(self) -> None:
        """End the simulator, if there is one."""


def quaternion_flu(pose: CameraPose) -> tuple[float, float, float, float]:
    """w, x, y, z of the camera as Gazebo has it: axes forward, left, up."""
    x, y, z, w = Rotation.from_matrix(pose.R_camera_to_enu @ _OPTICAL_TO_FLU.T).as_quat().tolist()
    return w, x, y, z
