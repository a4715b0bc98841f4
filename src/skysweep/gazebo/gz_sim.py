"""gz-sim (Harmonic and newer), through its own Python bindings.

They come with Gazebo, not from PyPI: ``python3-gz-transport13`` for Harmonic.
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
from skysweep.gazebo.export import MODELS_FOLDER, Clock, write_world
from skysweep.gazebo.gz_messages import Boolean, Image, Pose, WorldControl
from skysweep.gazebo.restarting import SimulatorRenderer, quaternion_flu
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
_RGB_INT8 = 3
_KEPT = 4  # pictures that nobody took yet
_REQUEST_MS = 1000


def find_node() -> type[Any]:
    """The class of nodes of the newest transport that is installed; raises UserError when there is none."""
    for transport in VERSIONS:
        try:
            node: type[Any] = importlib.import_module(transport).Node
            return node
        except (ImportError, AttributeError):
            continue
    raise UserError(f"The gz camera needs the Python bindings of gz.transport: {HOW_TO_GET}")


class GzLink:
    """One node: newest pictures of a topic, poses of models, steps of a paused world, angles of a gimbal.

    The bindings keep Python's lock while a request waits: a picture that comes in just then holds the answer
    up until the request is given up.
    """

    def __init__(self, world: str = "") -> None:
        self._world = world
        self._node = find_node()()
        self._news = threading.Condition()
        self._pictures: deque[Any] = deque(maxlen=_KEPT)
        self._topics: list[str] = []

    def subscribe_images(self, topic: str) -> None:
        """Pictures of this topic come out of ``image``. Raises TransportError when that is refused."""
        if not self._node.subscribe(Image, topic, self._on_image):
            raise TransportError(f"{topic} cannot be subscribed to")
        self._topics.append(topic)

    def close(self) -> None:
        """No more pictures."""
        for topic in self._topics:
            self._node.unsubscribe(topic)

    def _on_image(self, message: Any) -> None:
        with self._news:
            self._pictures.append(message)
            self._news.notify_all()

    def image(self, taken_after_s: float, timeout_s: float) -> Any | None:
        """The first picture exposed after a time of the simulation's clock, or None when none came."""
        give_up = time.monotonic() + timeout_s
        with self._news:
            while self._news.wait_for(lambda: self._pictures, give_up - time.monotonic()):
                message = self._pictures.popleft()
                if exposure_s(message) > taken_after_s:
                    return message
        return None

    def set_pose(self, model: str, pose: CameraPose) -> bool:
        """Put a model's origin where a camera is; False when Gazebo does not answer or refuses."""
        w, x, y, z = quaternion_flu(pose)
        request = Pose(name=model)
        for axis, value in zip("xyz", pose.position_enu_m.tolist(), strict=True):
            setattr(request.position, axis, value)
        for axis, value in zip("wxyz", (w, x, y, z), strict=True):
            setattr(request.orientation, axis, value)
        return self._request("set_pose", request)

    def step(self, count: int) -> bool:
        """Let the paused world take ``count`` steps; False when Gazebo does not answer or refuses."""
        return self._request("control", WorldControl(pause=True, multi_step=count))

    def _request(self, service: str, message: Any) -> bool:
        answered, reply = self._node.request(
            f"/world/{self._world}/{service}", message, type(message), Boolean, _REQUEST_MS
        )
        return bool(answered and reply.data)


def exposure_s(image: Any) -> float:
    """When a picture was taken, by the simulation's clock."""
    return float(image.header.stamp.sec + 1e-9 * image.header.stamp.nsec)


def image_of(image: Any, topic: str) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) of a gz.msgs.Image; raises UserError for another encoding than RGB."""
    if image.pixel_format_type != _RGB_INT8 or len(image.data) != 3 * image.width * image.height:
        raise UserError(
            f"{topic}: carries pictures of pixel format {image.pixel_format_type} with {len(image.data)} "
            "bytes; set the camera's image format to R8G8B8"
        )
    return np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)


class GzRenderer(SimulatorRenderer):
    """A world in a ``gz sim`` of our own, paused but for the steps that we ask for."""

    backend: Backend = "gz"

    def __init__(self, world: World, scenario: Scenario, rate_hz: float) -> None:
        find_node()
        if shutil.which("gz") is None:
            raise UserError("The gz camera needs the command gz: install Gazebo Harmonic or newer")
        lens = scenario.camera.lens
        super().__init__(lens, rate_hz)
        os.environ["GZ_PARTITION"] = self._partition = f"skysweep-{uuid.uuid4().hex[:8]}"
        self._world = scenario.name
        sensor = rig.camera(lens, rate_hz)
        sensor.append(tag("topic", IMAGE_TOPIC))
        link = tag("link", None, tag("gravity", False), sensor, name="head")
        self.world_file = write_world(
            world,
            scenario.name,
            scenario.home,
            scenario.wind,
            self.folder / "world",
            "gz",
            Clock(self.step_s, rate_hz=0.0),
            (tag("model", None, link, name=rig.MODEL),),
        )
        self._process: subprocess.Popen[bytes] | None = None
        self._link: GzLink | None = None
        self._stepped = 0

    def start(self, pose: CameraPose, patience_s: float) -> None:
        """``gz sim``, answering, with its first picture taken and thrown away."""
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
        """End ``gz sim``."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._process = self._link = None

    def picture(self, pose: CameraPose, patience_s: float) -> NDArray[np.uint8]:
        """Step one period; the picture taken within it."""
        assert self._link is not None
        taken_after_s = (self._stepped + 0.5) * self.step_s
        self._stepped += self.steps
        give_up = time.monotonic() + patience_s
        while not self._link.set_pose(rig.MODEL, pose):
            if time.monotonic() > give_up:
                raise TransportError("gz sim does not answer")
        self._link.step(self.steps)  # whether it was heard, the picture says
        message = self._link.image(taken_after_s, patience_s)
        if message is None:
            raise TransportError(f"no picture for {patience_s:g} s")
        return image_of(message, IMAGE_TOPIC)
