"""The real gzserver: what it draws, that it keeps step, and what happens when it dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from numpy.typing import NDArray

from skysweep.errors import UserError
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.gazebo import restarting
from skysweep.gazebo.install import Install
from skysweep.gazebo.lockstep import GazeboRenderer
from skysweep.gazebo.server import GazeboServer, wait_for_port
from skysweep.geometry.camera import CameraPose, Lens, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.worlds.rendering.renderer import Renderer, make_renderer
from skysweep.worlds.world import World, build_world

START_S = 60.0
DOWN = -np.pi / 2


def field() -> Scenario:
    """One sign on grass, and hills."""
    return change_scenario(
        load_scenario("clusters"),
        {
            "name": "field",
            "area.polygon_enu_m": [[0, 0], [45, 0], [45, 30], [0, 30]],
            "targets": [{"class": "stop sign", "position_enu_m": [24, 16], "size_m": 0.9}],
            "distractors": [],
            "search.scan_altitude_agl_m": 20,
            "search.n_c": 1,
        },
    )


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(field(), 0)


@pytest.fixture(scope="module")
def painter(world: World, gazebo: Install) -> Iterator[GazeboRenderer]:
    made = GazeboRenderer(world, field(), 2.5, gazebo)
    yield made
    made.close()


@pytest.fixture(scope="module")
def ours(world: World) -> Iterator[Renderer]:
    made = make_renderer(world)
    yield made
    made.close()


def _lens() -> Lens:
    return field().camera.lens


def _poses(world: World) -> list[CameraPose]:
    sign = world.targets[0].position_enu_m
    views = [
        ((0.0, 0.0, 6.0), 0.0, DOWN, 0.0),
        ((1.5, -0.8, 6.0), 2.0, DOWN, 0.0),
        ((-6.0, 0.5, 5.0), 0.0, -0.7, 0.1),
        ((0.3, 5.0, 8.0), -np.pi / 2 + 0.1, -1.0, -0.2),
    ]
    return [
        CameraPose(sign + offset, rotation_camera_to_enu(yaw, pitch, roll))
        for offset, yaw, pitch, roll in views
    ]


def _red_centre(image: NDArray[np.uint8]) -> NDArray[np.float64]:
    r, g, b = image.astype(int).transpose(2, 0, 1)
    rows, columns = np.nonzero((r > 120) & (r > 2 * g) & (r > 1.6 * b))
    assert len(rows) > 50
    return np.array([columns.mean(), rows.mean()]) + 0.5


def test_every_picture_is_of_the_pose_that_it_was_asked_for(
    painter: GazeboRenderer, ours: Renderer, world: World
) -> None:
    poses = _poses(world)
    for pose in [*poses, *reversed(poses), *poses[::2], *poses]:
        seen = _red_centre(painter.render(_lens(), pose))
        assert np.abs(seen - _red_centre(ours.render(_lens(), pose))).max() < 1.5
        expected = project(_lens(), pose, world.targets[0].position_enu_m)[0][0]
        assert np.abs(seen - expected).max() < 12  # the sign lies a little above its place


def test_it_looks_like_ours(painter: GazeboRenderer, ours: Renderer, world: World) -> None:
    for pose in _poses(world)[:2]:
        theirs, mine = (p.render(_lens(), pose).mean(axis=(0, 1)) for p in (painter, ours))
        assert np.abs(theirs - mine).max() < 25


def test_same_pose_same_bytes(painter: GazeboRenderer, world: World) -> None:
    one, two, _ = _poses(world)[:3]
    first = painter.render(_lens(), one)
    painter.render(_lens(), two)
    assert (painter.render(_lens(), one) == first).all()


def test_a_lens_that_gazebo_does_not_have(painter: GazeboRenderer, world: World) -> None:
    with pytest.raises(ValueError, match="the camera in Gazebo has"):
        painter.render(Lens(320, 240, 1.0), _poses(world)[0])


def _children(pid: int) -> list[int]:
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rsplit(")", 1)[1].split()
        except (OSError, IndexError):
            continue
        if int(fields[1]) == pid:
            child = int(status.parent.name)
            found += [child, *_children(child)]
    return found


def _is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGSTOP])
def test_a_gzserver_that_dies_or_hangs_is_replaced(
    painter: GazeboRenderer, world: World, monkeypatch: pytest.MonkeyPatch, sent: signal.Signals
) -> None:
    pose = _poses(world)[0]
    before = painter.render(_lens(), pose)
    starts = painter.starts
    assert painter.pid is not None
    gzserver = _children(painter.pid)[0]
    monkeypatch.setattr(restarting, "ANSWER_S", 3.0)
    os.kill(gzserver, sent)
    after = painter.render(_lens(), pose)
    assert painter.starts > starts
    assert not _is_alive(gzserver)
    assert (after == before).all()


def test_nothing_is_left_after_close_or_after_our_own_kill(gazebo: Install) -> None:
    script = """
import os, signal, sys
from test_gazebo_camera import GazeboRenderer, build_world, field, _lens, _poses
world = build_world(field(), 0)
painter = GazeboRenderer(world, field(), 2.5)
painter.render(_lens(), _poses(world)[0])
print(painter.pid, flush=True)
sys.stdin.read()
"""
    ours = subprocess.Popen(
        [sys.executable, "-c", script],
        cwd=Path(__file__).parent,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert ours.stdout is not None
    watcher = int(ours.stdout.readline())
    started = [watcher, *_children(watcher)]
    assert len(started) >= 3  # the watcher, gzserver, the screen
    ours.kill()
    ours.communicate()
    give_up = time.monotonic() + 10
    while any(map(_is_alive, started)) and time.monotonic() < give_up:
        time.sleep(0.05)
    assert not any(map(_is_alive, started))


def test_a_world_that_does_not_load_is_told(world: World, gazebo: Install) -> None:
    painter = GazeboRenderer(world, field(), 2.5, gazebo)
    painter.world_file.write_text("<sdf version='1.6'><world name='default'><model></sdf>")
    try:
        with pytest.raises(UserError, match=r"^gzserver: .*Error.*; the world is .*field\.world$"):
            painter.render(_lens(), _poses(world)[0])
    finally:
        painter.close()


def test_a_model_that_is_not_there_is_never_waited_for(tmp_path: Path, gazebo: Install) -> None:
    root = ET.fromstring(
        "<sdf version='1.6'><world name='default'><include><uri>model://nowhere</uri></include></world></sdf>"
    )
    ET.ElementTree(root).write(tmp_path / "gap.world")
    server = GazeboServer(gazebo, tmp_path / "gap.world")
    try:
        assert wait_for_port(server, START_S)
    finally:
        server.close()
    assert not _is_alive(server.pid)


def test_a_whole_mission_with_gazebos_pictures(tmp_path: Path, gazebo: Install) -> None:
    summary = fly_to_folder(field(), 0, tmp_path / "run", Rig(renderer="gazebo"))
    assert summary["completed"]
    assert summary["n_confirmed"] == 1
    assert summary["false_positives"] == 0
