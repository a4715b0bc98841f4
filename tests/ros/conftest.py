"""Real nodes in processes of their own, over DDS on loopback, each test in a domain of its own."""

from __future__ import annotations

import importlib.util
import itertools
import os
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from skysweep.ros.support import load_rclpy

TINY = """
name: tiny
description: Two signs on a meadow
area: {polygon_enu_m: [[0, 0], [36, 0], [36, 20], [0, 20]]}
home: {position_enu_m: [-5, -5]}
terrain: {surface: grass}
camera: {width_px: 640, height_px: 360, hfov_rad: 1.4, rate_hz: 10}
search: {n_c: 2, scan_altitude_agl_m: 12, check_altitude_agl_m: 4, check_speed_mps: 2}
targets:
  - {class: stop sign, position_enu_m: [9, 8], size_m: 0.9, yaw_deg: 0}
  - {class: stop sign, position_enu_m: [27, 12], size_m: 0.9, yaw_deg: 67}
"""
_DOMAINS = itertools.count()


@pytest.fixture(autouse=True)
def ros_environment(monkeypatch):
    """What a user has set who keeps to one computer, and a domain in which nobody else hears this test."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str((7 * os.getpid() + next(_DOMAINS)) % 100 + 1))
    for name in [name for name in os.environ if name.startswith("FAST")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    environment = dict(os.environ)
    if importlib.util.find_spec("rclpy"):
        load_rclpy.cache_clear()
        load_rclpy()
    return environment


@pytest.fixture
def link():
    from skysweep.ros.link import RosLink

    with closing(RosLink("test")) as made:
        yield made


@pytest.fixture
def tiny(tmp_path):
    path = tmp_path / "tiny.yaml"
    path.write_text(TINY)
    return path


@pytest.fixture
def start(tmp_path, ros_environment):
    """``start(*arguments)`` runs python with these; at the end it is ended and what it said is shown."""
    running = []

    def start(*arguments: str | Path) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, *map(str, arguments)],
            cwd=tmp_path,
            env=ros_environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        running.append(process)
        return process

    yield start
    for process in running:
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
        print(process.communicate()[0])
