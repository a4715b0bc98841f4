"""gz-sim (Harmonic and newer), through its own Python bindings.

The bindings come with Gazebo, not from PyPI: ``python3-gz-transport13`` for Harmonic.
"""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import threading
import time
import uuid
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skysweep.errors import UserError
from skysweep.gazebo import rig
from skysweep.gazebo.export import MODELS_FOLDER
from skysweep.gazebo.gz_messages import Boolean, Image, Pose, WorldControl
from skysweep.gazebo.messages import seconds
from skysweep.gazebo.restarting import SimulatorRenderer, pose_fields, rgb_pixels
from skysweep.gazebo.sdf import tag
from skysweep.gazebo.transport import TransportError
from skysweep.geometry.camera import CameraPose
from skysweep.scenarios.model import Scenario
from skysweep.worlds.rendering.renderer import Backend
from skysweep.worlds.world import World

VERSIONS = ("gz.transport", "gz.transport14", "gz.transport13")  # newest first: Jetty, Ionic, Harmonic
HOW_TO_GET = "install them with Gazebo: apt-get install python3-gz-transport13 (Harmonic)"
IMAGE_TOPIC = "/skysweep/camera/image"
_DIES_WITH_US = ("setpriv", "--pdeathsig", "KILL", "--")
_KEPT = 4  # pictures not yet taken
_REQUEST_MS = 1000


def find_node() -> type[Any]:
    """The node class of the newest transport that is installed. Raises UserError if there is none."""
    for transport in VERSIONS:
        try:
            node: type[Any] = importlib.import_module(transport).Node
            return node
        except (ImportError, AttributeError):
            continue
    raise UserError(f"The gz camera needs the Python bindings of gz.transport: {HOW_TO_GET}")


class GzLink:
    """One node: newest pictures of a topic, poses of models, steps of a paused world.

    The bindings hold Python's lock while a request waits: a picture that arrives meanwhile blocks the answer
    until the request times out.
    """

    def __init__(self, world: str = "") -> None:
        self._world = world
        self._node = find_node()()
        self._news = threading.Condition()
        self._pictures: deque[Any] = deque(maxlen=_KEPT)
        self._topics: list[str] = []

    def subscribe_images(self, topic: str) -> None:
        """From now on ``image`` returns pictures of this topic. Raises TransportError if that is refused."""
        if not self._node.subscribe(Image, topic, self._on_image):
            raise TransportError(f"{topic} cannot be subscribed to")
        self._topics.append(topic)

    def close(self) -> None:
        for topic in self._topics:
            self._node.unsubscribe(topic)

    def _on_image(self, message: Any) -> None:
        with self._news:
            self._pictures.append(message)
            self._news.notify_all()

    def image(self, taken_after_s: float, timeout_s: float) -> Any | None:
        """The first picture exposed after a time of the simulation's clock; None if none comes."""
        give_up = time.monotonic() + timeout_s
        with self._news:
            while self._news.wait_for(lambda: self._pictures, give_up - time.monotonic()):
                message = self._pictures.popleft()
                if seconds(message.header.stamp) > taken_after_s:
                    return message
        return None

    def set_pose(self, model: str, pose: CameraPose) -> bool:
        """Moves a model to a camera's pose; False if Gazebo refuses or does not answer."""
        return self._request("set_pose", Pose(name=model, **pose_fields(pose)))

    def step(self, count: int) -> bool:
        """Lets the paused world take ``count`` steps; False if Gazebo refuses or does not answer."""
        return self._request("control", WorldControl(pause=True, multi_step=count))

    def _request(self, service: str, message: Any) -> bool:
        answered, reply = self._node.request(
            f"/world/{self._world}/{service}", message, type(message), Boolean, _REQUEST_MS
        )
        return bool(answered and reply.data)


def image_of(image: Any, topic: str) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) of a gz.msgs.Image. Raises UserError if its format is not RGB."""
    return rgb_pixels(image, image.pixel_format_type, topic)


class GzRenderer(SimulatorRenderer):
    """A world in our own ``gz sim``, paused except for requested steps. Raises UserError without ``gz``."""

    backend: Backend = "gz"

    def __init__(self, world: World, scenario: Scenario, rate_hz: float) -> None:
        find_node()
        if shutil.which("gz") is None:
            raise UserError("The gz camera needs the command gz: install Gazebo Harmonic or newer")
        sensor = rig.camera(scenario.camera.lens, rate_hz)
        sensor.append(tag("topic", IMAGE_TOPIC))
        link = tag("link", None, tag("gravity", False), sensor, name="head")
        super().__init__(world, scenario, rate_hz, "gz", tag("model", None, link, name=rig.MODEL))
        os.environ["GZ_PARTITION"] = self._partition = f"skysweep-{uuid.uuid4().hex[:8]}"
        self._world = scenario.name
        self._process: subprocess.Popen[bytes] | None = None
        self._link: GzLink | None = None
        self._stepped = 0

    def start(self, pose: CameraPose, patience_s: float) -> None:
        self._stepped = 0
        environment = os.environ | {
            "GZ_PARTITION": self._partition,
            "GZ_SIM_RESOURCE_PATH": str(self.world_file.parent / MODELS_FOLDER),
        }
        with (self.folder / "gz.log").open("ab") as log:
            self._process = subprocess.Popen(
                [*_DIES_WITH_US, "gz", "sim", "-s", "--headless-rendering", str(self.world_file)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=environment,
            )
        self._link = GzLink(self._world)
        self._link.subscribe_images(IMAGE_TOPIC)
        give_up = time.monotonic() + patience_s
        while not self._link.set_pose(rig.MODEL, pose):
            if self._process.poll() is not None:
                raise UserError(f"gz sim ended at once; check it with  gz sim -s {self.world_file}")
            if time.monotonic() > give_up:
                raise TransportError("gz sim does not answer")
        self.picture(pose, patience_s)

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._process = self._link = None

    def picture(self, pose: CameraPose, patience_s: float) -> NDArray[np.uint8]:
        assert self._link is not None
        taken_after_s = (self._stepped + 0.5) * self.step_s
        self._stepped += self.steps
        give_up = time.monotonic() + patience_s
        while not self._link.set_pose(rig.MODEL, pose):
            if time.monotonic() > give_up:
                raise TransportError("gz sim does not answer")
        self._link.step(self.steps)  # the picture shows whether it was heard
        message = self._link.image(taken_after_s, patience_s)
        if message is None:
            raise TransportError(f"no picture for {patience_s:g} s")
        return image_of(message, IMAGE_TOPIC)
