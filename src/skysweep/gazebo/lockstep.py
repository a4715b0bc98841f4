"""Gazebo Classic 11 as a renderer: pose in, one camera period of steps, picture out."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skysweep.errors import UserError
from skysweep.gazebo import rig
from skysweep.gazebo.export import Clock, write_world
from skysweep.gazebo.install import Install, find_install
from skysweep.gazebo.messages import ImageStamped, Pose, Quaternion, Vector3d, seconds
from skysweep.gazebo.restarting import SimulatorRenderer, quaternion_flu
from skysweep.gazebo.server import GazeboServer, wait_for_port
from skysweep.gazebo.transport import Transport, TransportError
from skysweep.geometry.camera import CameraPose
from skysweep.scenarios.model import Scenario
from skysweep.worlds.rendering.renderer import Backend
from skysweep.worlds.world import World

_NUDGE_S = 0.5  # without a picture: one step more
_RGB_INT8 = 3


class GazeboRenderer(SimulatorRenderer):
    """A world in a gzserver of our own. Raises UserError when there is no Gazebo Classic 11."""

    backend: Backend = "gazebo"

    def __init__(
        self, world: World, scenario: Scenario, rate_hz: float, install: Install | None = None
    ) -> None:
        self._install = install or find_install()
        lens = scenario.camera.lens
        super().__init__(lens, rate_hz)
        self.world_file = write_world(
            world,
            scenario.name,
            scenario.home,
            scenario.wind,
            self.folder / "world",
            "gazebo-classic",
            Clock(self.step_s, rate_hz=0.0),
            (rig.camera_rig(lens, rate_hz), rig.gate(self._install.plugin)),
        )
        self._server: GazeboServer | None = None
        self._transport: Transport | None = None
        self._granted = 0

    @property
    def pid(self) -> int | None:
        """Of the running gzserver's watcher."""
        return self._server.pid if self._server else None

    def start(self, pose: CameraPose, patience_s: float) -> None:
        """gzserver, connected, with its first picture taken and thrown away."""
        self._granted = 0
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
        self.picture(pose, patience_s)

    def stop(self) -> None:
        """End gzserver."""
        if self._transport is not None:
            self._transport.close()
        if self._server is not None:
            self._server.close()
        self._transport = self._server = None

    def picture(self, pose: CameraPose, patience_s: float) -> NDArray[np.uint8]:
        """Grant one period; the picture taken within it. Grants more, step by step, when none comes."""
        assert self._transport is not None
        taken_after_s = (self._granted + 0.5) * self.step_s
        self._grant(pose, self.steps)
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
    w, x, y, z = quaternion_flu(pose)
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
