"""gz-sim without gz-sim: the calls of its bindings, answered with messages as they are on the wire."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.gazebo.gz_messages import Image
from skysweep.gazebo.gz_sim import IMAGE_TOPIC, GzLink, find_node, image_of
from skysweep.gazebo.live import LiveCamera
from skysweep.gazebo.messages import seconds
from skysweep.gazebo.rig import MODEL
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu

LENS = Lens(64, 64, 1.4)

# What a gz-sim 8.14 (Harmonic) said: the camera of GzRenderer 8 m above signs of `clusters`, 64 x 64 pixels,
# at 0.2 s, and the answer to set_pose and control.
RECORDED_IMAGE = Path(__file__).with_name("gz8_image.bin").read_bytes()
RECORDED_TRUE = bytes.fromhex("1001")
RECORDED_S = 0.2


class RecordedNode:
    """A node that answers every request with true, and a step with the recorded picture."""

    requests: list[tuple[str, Any]]
    answers = True

    def __init__(self) -> None:
        self._callbacks: dict[str, Any] = {}

    def subscribe(self, kind: Any, topic: str, callback: Any) -> bool:
        self._callbacks[topic] = kind, callback
        return True

    def unsubscribe(self, topic: str) -> None:
        del self._callbacks[topic]

    def request(self, service: str, message: Any, kind: Any, reply: Any, _ms: int) -> tuple[bool, Any]:
        assert isinstance(message, kind)
        self.requests.append((service, message))
        if service.endswith("/control"):
            self.expose()
        return self.answers, reply.FromString(RECORDED_TRUE)

    def expose(self) -> None:
        for kind, callback in self._callbacks.values():
            callback(kind.FromString(RECORDED_IMAGE))


@pytest.fixture
def gz(monkeypatch: pytest.MonkeyPatch) -> type[RecordedNode]:
    transport = ModuleType("gz.transport13")
    transport.Node = RecordedNode  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "gz", ModuleType("gz"))
    monkeypatch.setitem(sys.modules, "gz.transport13", transport)
    monkeypatch.setattr(RecordedNode, "requests", [], raising=False)
    monkeypatch.setattr(RecordedNode, "answers", True)
    return RecordedNode


def test_recorded_picture() -> None:
    message = Image.FromString(RECORDED_IMAGE)
    assert seconds(message.header.stamp) == pytest.approx(RECORDED_S)
    image = image_of(message, IMAGE_TOPIC)
    assert image.shape == (64, 64, 3)
    red, green = image[:, :, 0].astype(int), image[:, :, 1].astype(int)
    assert np.median(green - red) > 0  # grass
    assert 10 < (red - green > 60).sum() < 600  # signs on it
    message.pixel_format_type = 8
    with pytest.raises(UserError, match="pixel format 8 with 12288 bytes; set the camera's image format"):
        image_of(message, IMAGE_TOPIC)


def test_pose_then_steps_then_the_picture_taken_in_them(gz: type[RecordedNode]) -> None:
    link = GzLink("field")
    link.subscribe_images(IMAGE_TOPIC)
    pose = CameraPose(np.array([1.0, 2.0, 30.0]), rotation_camera_to_enu(0.0, -np.pi / 2))
    assert link.set_pose(MODEL, pose)
    assert link.step(8)
    message = link.image(taken_after_s=RECORDED_S - 0.05, timeout_s=1.0)
    assert message is not None
    assert link.step(8)
    assert link.image(taken_after_s=RECORDED_S + 0.05, timeout_s=0.0) is None  # an older one
    (where, put), (how, control), _ = gz.requests
    assert (where, how) == ("/world/field/set_pose", "/world/field/control")
    assert (put.name, put.position.x, put.position.y, put.position.z) == (MODEL, 1, 2, 30)
    assert put.orientation.y == pytest.approx(np.sqrt(0.5))
    assert (control.pause, control.multi_step) == (True, 8)


def test_a_gazebo_that_does_not_answer(gz: type[RecordedNode], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gz, "answers", False)
    link = GzLink("field")
    assert not link.step(1)


def test_without_bindings_it_says_what_to_install() -> None:
    with pytest.raises(UserError, match=r"needs the Python bindings .*python3-gz-transport13"):
        find_node()


def test_live_camera_knows_its_size(gz: type[RecordedNode], monkeypatch: pytest.MonkeyPatch) -> None:
    subscribe = gz.subscribe

    def subscribe_and_show(self: RecordedNode, kind: Any, topic: str, callback: Any) -> bool:
        subscribe(self, kind, topic, callback)
        self.expose()
        return True

    monkeypatch.setattr(gz, "subscribe", subscribe_and_show)
    with pytest.raises(UserError, match=r"its pictures are 64 x 64; write camera\.width_px: 64"):
        LiveCamera("gz:/camera", Lens(640, 360, 1.0))
    LiveCamera("gz:/camera", LENS).close()
