"""Gazebo Classic 11 as a renderer: each picture takes one camera period of steps."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skysweep.errors import UserError
from skysweep.gazebo import rig
from skysweep.gazebo.install import Install, find_install
from skysweep.gazebo.messages import ImageStamped, Pose, seconds
from skysweep.gazebo.restarting import SimulatorRenderer, pose_fields, rgb_pixels
from skysweep.gazebo.server import GazeboServer, wait_for_port
from skysweep.gazebo.transport import Transport, TransportError
from skysweep.geometry.camera import CameraPose
from skysweep.scenarios.model import Scenario
from skysweep.worlds.rendering.renderer import Backend
from skysweep.worlds.world import World

_NUDGE_S = 0.5  # without a picture, until one more step is granted


class GazeboRenderer(SimulatorRenderer):
    """A world in our own gzserver. Raises UserError if there is no Gazebo Classic 11."""

    backend: Backend = "gazebo"

    def __init__(
        self, world: World, scenario: Scenario, rate_hz: float, install: Install | None = None
    ) -> None:
        self._install = install or find_install()
        camera = rig.camera_rig(scenario.camera.lens, rate_hz)
        super().__init__(world, scenario, rate_hz, "gazebo-classic", camera, rig.gate(self._install.plugin))
        self._server: GazeboServer | None = None
        self._transport: Transport | None = None
        self._granted = 0

    @property
    def pid(self) -> int | None:
        """Process id of the running gzserver's watcher."""
        return self._server.pid if self._server else None

    def start(self, pose: CameraPose, patience_s: float) -> None:
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
        if self._transport is not None:
            self._transport.close()
        if self._server is not None:
            self._server.close()
        self._transport = self._server = None

    def picture(self, pose: CameraPose, patience_s: float) -> NDArray[np.uint8]:
        """Grants one period, then single steps until a picture taken within it arrives."""
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
    """The pose of the camera and the number of steps that the world may take there."""
    return Pose(id=steps, **pose_fields(pose))


def image_of(image: Any, topic: str) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) of an Image message. Raises UserError if its format is not RGB."""
    return rgb_pixels(image, image.pixel_format, topic)
