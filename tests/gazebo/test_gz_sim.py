"""gz-sim without gz-sim: the calls of its bindings, answered with messages as they are on the wire."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.gazebo.gz_messages import Image
from skysweep.gazebo.gz_sim import IMAGE_TOPIC, GzLink, exposure_s, find_node, image_of
from skysweep.gazebo.live import LiveCamera
from skysweep.gazebo.rig import MODEL
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu

LENS = Lens(4, 2, 1.0)

# gz.msgs.Image as it is on the wire: header.stamp 12.4 s, 4 x 2, step 12, RGB_INT8, 24 bytes of 0..23.
RECORDED_IMAGE = bytes.fromhex(
    "0a0a0a08080c108088debe01 1004 1802 200c2a18 000102030405060708090a0b0c0d0e0f1011121314151617 3003"
)
# gz.msgs.Boolean true.
RECORDED_TRUE = bytes.fromhex("1001")


class RecordedNode:
    """A node that answers every request with true, and a step with the recorded picture."""

    requests: list[tuple[str, Any]]
    published: list[tuple[str, float]]
    answers = True

    def __init__(self) -> None:
        self._callbacks: dict[str, Any] = {}

    def subscribe(self, kind: Any, topic: str, callback: Any) -> bool:
        self._callbacks[topic] = kind, callback
        return True

    def request(self, service: str, message: Any, kind: Any, reply: Any, _ms: int) -> tuple[bool, Any]:
        assert isinstance(message, kind)
        self.requests.append((service, message))
        if service.endswith("/control"):
            self.expose()
        return self.answers, reply.FromString(RECORDED_TRUE)

    def expose(self) -> None:
        for kind, callback in self._callbacks.values():
            callback(kind.FromString(RECORDED_IMAGE))

    def advertise(self, topic: str, kind: Any) -> Any:
        class Publisher:
            def publish(self, message: Any) -> None:
                RecordedNode.published.append((topic, message.data))

        return Publisher()


@pytest.fixture
def gz(monkeypatch: pytest.MonkeyPatch) -> type[RecordedNode]:
    transport = ModuleType("gz.transport13")
    transport.Node = RecordedNode  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "gz", ModuleType("gz"))
    monkeypatch.setitem(sys.modules, "gz.transport13", transport)
    monkeypatch.setattr(RecordedNode, "requests", [], raising=False)
    monkeypatch.setattr(RecordedNode, "published", [], raising=False)
    monkeypatch.setattr(RecordedNode, "answers", True)
    return RecordedNode


def test_recorded_picture(gz: type[RecordedNode]) -> None:
    message = Image.FromString(RECORDED_IMAGE)
    assert exposure_s(message) == pytest.approx(12.4)
    image = image_of(message, IMAGE_TOPIC)
    np.testing.assert_array_equal(image, np.arange(24).reshape(2, 4, 3))
    message.pixel_format_type = 8
    with pytest.raises(UserError, match="pixel format 8 with 24 bytes; set the camera's image format"):
        image_of(message, IMAGE_TOPIC)


def test_pose_then_steps_then_the_picture_taken_in_them(gz: type[RecordedNode]) -> None:
    link = GzLink("field")
    link.subscribe_images(IMAGE_TOPIC)
    pose = CameraPose(np.array([1.0, 2.0, 30.0]), rotation_camera_to_enu(0.0, -np.pi / 2))
    assert link.set_pose(MODEL, pose)
    assert link.step(8)
    message = link.image(taken_after_s=12.0, timeout_s=1.0)
    assert message is not None
    assert link.step(8)
    assert link.image(taken_after_s=12.5, timeout_s=0.0) is None  # an older one
    (where, put), (how, control), _ = gz.requests
    assert (where, how) == ("/world/field/set_pose", "/world/field/control")
    assert (put.name, put.position.x, put.position.y, put.position.z) == (MODEL, 1, 2, 30)
    assert put.orientation.y == pytest.approx(np.sqrt(0.5))
    assert (control.pause, control.multi_step) == (True, 8)


def test_a_gazebo_that_does_not_answer(gz: type[RecordedNode], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gz, "answers", False)
    link = GzLink("field")
    assert not link.step(1)


def test_gimbal_of_a_px4_model(gz: type[RecordedNode]) -> None:
    GzLink("field").point_gimbal("x500_gimbal_0", 0.1, -1.5, 0.2)
    base = "/model/x500_gimbal_0/command/gimbal_"
    assert gz.published == [(base + "roll", 0.1), (base + "pitch", -1.5), (base + "yaw", 0.2)]


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
    with pytest.raises(UserError, match=r"its pictures are 4 x 2; write camera\.width_px: 4"):
        LiveCamera("gz:/camera", Lens(640, 360, 1.0))
    LiveCamera("gz:/camera", LENS).close()
