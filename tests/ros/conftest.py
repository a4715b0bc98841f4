"""Real nodes in processes of their own, over DDS on loopback, each test in a domain of its own."""

from __future__ import annotations

import fcntl
import itertools
import os
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

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


@pytest.fixture(autouse=True, scope="session")
def no_dead_shared_memory():
    """What killed nodes, of earlier runs too, left in shared memory swallows messages of living ones.

    Fast DDS holds a lock on the file ..._el of everything that is alive.
    """
    for lock in Path("/dev/shm").glob("fastdds_*_el"):
        with lock.open() as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
        name = lock.name.removesuffix("_el")
        for left in (lock, lock.with_name(name), lock.with_name(f"sem.{name}_mutex")):
            left.unlink(missing_ok=True)


@pytest.fixture(autouse=True)
def ros_domain(monkeypatch):
    """Nobody else hears this test."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str((7 * os.getpid() + next(_DOMAINS)) % 100 + 1))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


@pytest.fixture
def link():
    from skysweep.ros.link import Link

    with closing(Link("test")) as made:
        yield made


@pytest.fixture
def tiny(tmp_path):
    path = tmp_path / "tiny.yaml"
    path.write_text(TINY)
    return path


@pytest.fixture
def start(tmp_path):
    """``start(*arguments)`` runs python with these; at the end it is ended and what it said is shown."""
    running = []

    def start(*arguments: str | Path) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, *map(str, arguments)],
            cwd=tmp_path,
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
