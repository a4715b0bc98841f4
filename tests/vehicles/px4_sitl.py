"""PX4's own simulator, where the environment variable PX4_SITL names a build of it."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

_SITL = os.environ.get("PX4_SITL")
_START_S = 60.0
needs_px4 = pytest.mark.skipif(_SITL is None, reason="PX4_SITL names no build of PX4's simulator")


def start_px4(folder: Path, instance: int, factor: int = 1) -> subprocess.Popen:
    """A quadrotor of PX4's built-in simulator (SIH), ready to take off; its log is ``folder/px4.log``."""
    assert _SITL is not None
    build, log = Path(_SITL), folder / "px4.log"
    settings = {
        "PX4_SYS_AUTOSTART": "10040",
        "PX4_SIM_MODEL": "sihsim_quadx",
        "PX4_SIM_SPEED_FACTOR": str(factor),
    }
    with log.open("w") as out:
        px4 = subprocess.Popen(
            [build / "bin/px4", "-d", "-i", str(instance), "-w", str(folder), build / "etc"],
            cwd=folder,
            env=os.environ | settings,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    end_s = time.monotonic() + _START_S
    while "Ready for takeoff" not in log.read_text(errors="replace"):
        assert time.monotonic() < end_s, f"PX4 is not ready, see {log}"
        time.sleep(0.3)
    return px4


def stop_px4(px4: subprocess.Popen) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(px4.pid, signal.SIGKILL)
    px4.wait()
