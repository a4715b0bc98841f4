"""The camera of a gzserver that somebody else runs."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.gazebo import rig
from skysweep.gazebo.export import write_world
from skysweep.gazebo.install import Install
from skysweep.gazebo.live import MASTER_VARIABLE, LiveCamera
from skysweep.gazebo.server import GazeboServer, wait_for_port
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.scenarios.files import load_scenario
from skysweep.types import VehicleState
from skysweep.worlds.world import build_world

SOURCE = f"gazebo:{rig.IMAGE_TOPIC}"
LENS = Lens(320, 240, 1.2)


def _state() -> VehicleState:
    pose = CameraPose(np.array([0.0, 0.0, 10.0]), np.eye(3))
    return VehicleState(7.0, np.zeros(3), np.zeros(3), np.eye(3), pose, 1.0, 0.0, True)


@pytest.fixture(scope="module")
def server(gazebo: Install, tmp_path_factory: pytest.TempPathFactory) -> Iterator[GazeboServer]:
    """A world that runs by itself, with our camera looking along the ground."""
    scenario = load_scenario("sparse")
    folder: Path = tmp_path_factory.mktemp("live") / "world"
    camera = rig.camera_rig(LENS, 10.0)
    world_file = write_world(build_world(scenario, 0), scenario, folder, "gazebo-classic", [camera])
    server = GazeboServer(gazebo, world_file)
    assert wait_for_port(server, 60.0)
    yield server
    server.close()


def test_the_newest_picture_of_a_topic(server: GazeboServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(MASTER_VARIABLE, f"http://127.0.0.1:{server.port}")
    monkeypatch.setattr("skysweep.gazebo.live.OPEN_S", 60.0)
    with pytest.raises(UserError, match=r"its pictures are 320 x 240; write camera\.width_px: 320"):
        LiveCamera(SOURCE, Lens(640, 360, 1.2))
    with closing(LiveCamera(SOURCE, LENS)) as camera:
        frame = camera.capture(_state())
        assert frame.image.shape == (240, 320, 3)
        assert frame.time_s == 7.0
        assert frame.image.std() > 5  # sky above, grass below
        time.sleep(3.0)  # thirty pictures that nobody wants
        begun_s = time.monotonic()
        for _ in range(20):
            camera.capture(_state())
        assert time.monotonic() - begun_s > 0.7  # ten come a second: none waited
    monkeypatch.setattr("skysweep.gazebo.live.OPEN_S", 2.0)
    with pytest.raises(UserError, match=f"no such image topic; there are: {rig.IMAGE_TOPIC}"):
        LiveCamera("gazebo:/gazebo/default/eye", LENS)


def test_nothing_runs_there(monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as unused:
        port = unused.getsockname()[1]
    monkeypatch.setenv(MASTER_VARIABLE, f"http://127.0.0.1:{port}")
    monkeypatch.setattr("skysweep.gazebo.live.OPEN_S", 0.3)
    with pytest.raises(UserError, match=f"nothing answers at 127.0.0.1:{port}; is Gazebo running"):
        LiveCamera(SOURCE, LENS)


def test_another_kind_of_source() -> None:
    with pytest.raises(UserError, match="write gazebo:TOPIC or gz:TOPIC"):
        LiveCamera("topic", LENS)
