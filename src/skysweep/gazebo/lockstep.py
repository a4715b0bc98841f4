"""Gazebo Classic 11 as a renderer: pose in, one camera period of steps, picture out."""

from __future__ import annotations

import logging
import math
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skysweep.errors import UserError
from skysweep.gazebo import rig
from skysweep.gazebo.export import Clock, write_world
from skysweep.gazebo.install import Install, find_install
from skysweep.gazebo.messages import ImageStamped, Pose, Quaternion, Vector3d, seconds
from skysweep.gazebo.server import GazeboServer, wait_for_port
from skysweep.gazebo.transport import Transport, TransportError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.scenarios.model import Scenario
from skysweep.scenarios.world import World
from skysweep.sensing.render import Backend

F64 = NDArray[np.float64]

ANSWER_S = 10.0  # a gzserver that is silent for longer is replaced; the next one may take twice as long
STARTS = 4  # in a row, without a picture in between
STEP_MAX_S = 0.05
_NUDGE_S = 0.5  # without a picture: one step more
_OPTICAL_TO_FLU = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_RGB_INT8 = 3

log = logging.getLogger(__name__)


class GazeboRenderer:
    """Draws one world with Gazebo's engine; the same pose gives the same picture.

    Gazebo's clock counts camera periods of ``1 / rate_hz``: it advances one for every picture, and only then.
    A gzserver that does not answer within ANSWER_S is ended and another one started. Raises UserError when
    there is no Gazebo, when it cannot load the world, and when STARTS gzservers in a row did not answer.
    """

    backend: Backend = "gazebo"

    def __init__(
        self, world: World, scenario: Scenario, rate_hz: float, install: Install | None = None
    ) -> None:
        self._install = install or find_install()
        self._lens = scenario.camera.lens
        self._period_s = 1.0 / rate_hz
        self._steps = max(math.ceil(self._period_s / STEP_MAX_S - 1e-9), 1)
        step_s = self._period_s / self._steps
        self._folder = Path(tempfile.mkdtemp(prefix="skysweep-gazebo-"))
        self.world_file = write_world(
            world,
            scenario.name,
            scenario.home,
            scenario.wind,
            self._folder / "world",
            "gazebo-classic",
            Clock(step_s, rate_hz=0.0),
            (rig.camera_rig(self._lens, rate_hz), rig.gate(self._install.plugin)),
        )
        self._step_s = step_s
        self._server: GazeboServer | None = None
        self._transport: Transport | None = None
        self._granted = 0
        self.starts = 0  # gzservers so far

    @property
    def pid(self) -> int | None:
        """Of the running gzserver's watcher."""
        return self._server.pid if self._server else None

    def render(self, lens: Lens, pose: CameraPose, time_s: float = 0.0) -> NDArray[np.uint8]:
        """The picture (H, W, 3) RGB through the scenario's lens. Nothing moves with time."""
        if lens != self._lens:
            raise ValueError(f"the camera in Gazebo has {self._lens}, not {lens}")
        why: str | None = None
        for attempt in range(STARTS):
            try:
                if self._transport is None:
                    self._start(pose, ANSWER_S * 2**attempt)
                return self._picture(pose, ANSWER_S)
            except TransportError as error:
                why = (self._server.complaint() if self._server else None) or str(error)
                log.warning("gzserver does not answer (%s): starting another one", error)
                self._stop()
        raise UserError(
            f"gzserver did not answer {STARTS} times in a row ({why}); check that it runs by itself"
        )

    def close(self) -> None:
        """End gzserver and remove its world."""
        self._stop()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _start(self, pose: CameraPose, patience_s: float) -> None:
        """gzserver, connected, with its first picture taken and thrown away."""
        self._granted = 0
        self.starts += 1
        self._server = GazeboServer(self._install, self.world_file)
        if not wait_for_port(self._server, patience_s):
            raise TransportError("it does not listen")
        self._transport = Transport(self._server.port, patience_s)
        self._transport.subscribe(rig.IMAGE_TOPIC, ImageStamped)
        try:
            self._transport.advertise(rig.POSE_TOPIC, Pose, patience_s)
        except TransportError:
            complaint = self._server.complaint()
            if complaint:
                raise UserError(f"gzserver: {complaint}; the world is {self.world_file}") from None
            raise
        self._picture(pose, patience_s)

    def _stop(self) -> None:
        if self._transport is not None:
            self._transport.close()
        if self._server is not None:
            self._server.close()
        self._transport = self._server = None

    def _picture(self, pose: CameraPose, patience_s: float) -> NDArray[np.uint8]:
        """Grant one period; the picture taken within it. Grants more, step by step, when none comes."""
        assert self._transport is not None
        taken_after_s = (self._granted + 0.5) * self._step_s
        self._grant(pose, self._steps)
        give_up = time.monotonic() + patience_s
        while time.monotonic() < give_up:
            received = self._transport.receive(_NUDGE_S)
            if received is None:
                self._grant(pose, 1)
            elif seconds(received[1].time) > taken_after_s:
                return image_of(received[1].image, rig.IMAGE_TOPIC)
        raise TransportError(f"no picture for {patience_s:g} s")

    def _grant(self, pose: CameraPose, steps: int) -> None:
        assert self._transport is not None
        self._transport.publish(rig.POSE_TOPIC, pose_message(pose, steps))
        self._granted += steps


def pose_message(pose: CameraPose, steps: int) -> Any:
    """A camera pose as a Gazebo pose: axes forward, left, up."""
    x, y, z, w = Rotation.from_matrix(pose.R_camera_to_enu @ _OPTICAL_TO_FLU.T).as_quat().tolist()
    px, py, pz = pose.position_enu_m.tolist()
    return Pose(id=steps, position=Vector3d(x=px, y=py, z=pz), orientation=Quaternion(w=w, x=x, y=y, z=z))


def image_of(image: Any, topic: str) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) of an Image message; raises UserError for another encoding than RGB."""
    if image.pixel_format != _RGB_INT8 or len(image.data) != 3 * image.width * image.height:
        raise UserError(
            f"{topic}: carries pictures of pixel format {image.pixel_format} with {len(image.data)} bytes; "
            "set the camera's image format to R8G8B8"
        )
    return np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)
