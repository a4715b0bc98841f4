"""What this machine can fly: each part that a mission may need, whether it works, and what mends it."""

from __future__ import annotations

import os
import platform
import re
import shutil
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import skysweep
from skysweep.caching import cache_folder, first_writable
from skysweep.errors import MissingExtraError, UserError, install_command, is_clone
from skysweep.vehicles.px4.serial_ports import serial_ports

PX4_PORT = 14540  # of UDP, which PX4's simulators send to
_HEARTBEAT_S = 1.3  # a vehicle sends one each second
_FOR_DEVELOPERS = ("dev", "docs")  # extras
_SOFTWARE_GL = ("llvmpipe", "softpipe", "swrast", "software")  # in the names of devices
_FREE_GB, _LEAST_FREE_GB = 2.0, 0.1  # on the disk, for comfort and for a mission
_MEMORY_GB = 2.0
_PAGE = Path(skysweep.__file__).parent / "web" / "static" / "index.html"
_GL_PACKAGES = "apt-get install libegl1 libgl1 libgl1-mesa-dri"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the examination.

    ``passed`` is None for what is missing but not needed to fly a simulated mission with pictures; ``mend``
    is the command that adds or repairs it.
    """

    name: str
    passed: bool | None
    said: str
    mend: str | None = None


def can_fly(findings: list[Finding]) -> bool:
    """Whether a simulated mission with pictures can be flown here."""
    return all(finding.passed is not False for finding in findings)


def python() -> Iterator[Finding]:
    """Python and skysweep."""
    yield Finding("Python", True, f"{platform.python_version()} on {platform.system()} {platform.machine()}")
    yield Finding("skysweep", True, f"{metadata.version('skysweep')} in {Path(skysweep.__file__).parent}")


def cameras() -> Iterator[Finding]:
    """The renderers, one of which is needed."""
    from skysweep.worlds.rendering.gl import gl_device

    has_embree = find_spec("embreex") is not None
    try:
        device = gl_device()
    except UserError as error:
        yield Finding("OpenGL", None if has_embree else False, str(error).partition(": ")[0], _GL_PACKAGES)
    else:
        drawn_by = "software" if any(name in device.lower() for name in _SOFTWARE_GL) else "GPU"
        yield Finding("OpenGL", True, f"{drawn_by}: {device}")
    if has_embree:
        yield Finding("Embree", True, "installed; renders where OpenGL does not work")
    else:
        yield Finding(
            "Embree", None, "not installed; needed only where OpenGL does not work", install_command("embree")
        )


def detector() -> Iterator[Finding]:
    """The shipped detector, asked for one picture."""
    from skysweep.detection.yolo import YoloDetector
    from skysweep.flights.rig import Rig
    from skysweep.geometry.camera import CameraPose, Lens
    from skysweep.types import Frame

    threads = Rig().threads
    found = YoloDetector(threads=threads)
    lens = Lens(640, 360, 1.2)
    picture = np.full((lens.height_px, lens.width_px, 3), 128, dtype=np.uint8)
    frame = Frame(0.0, picture, CameraPose(np.zeros(3), np.eye(3)), lens)
    found.detect(frame)
    began_s = time.perf_counter()
    found.detect(frame)
    took_ms = 1000.0 * (time.perf_counter() - began_s)
    yield Finding("detector", True, f"answers a picture in {took_ms:.0f} ms with {threads} threads")


def ros() -> Iterator[Finding]:
    """ROS 2."""
    from skysweep.ros.support import load_rclpy

    try:
        where = Path(load_rclpy().__file__).parent
    except MissingExtraError:
        yield Finding("ROS 2", None, "not installed", install_command("ros"))
    except UserError as error:
        yield Finding("ROS 2", None, str(error))
    else:
        yield Finding("ROS 2", True, f"rclpy in {where}")


def gazebo() -> Iterator[Finding]:
    """Gazebo Classic 11 and gz-sim."""
    from skysweep.gazebo.gz_sim import find_node
    from skysweep.gazebo.install import find_install

    try:
        yield Finding("Gazebo Classic", True, f"in {find_install().root}")
    except UserError as error:
        yield Finding("Gazebo Classic", None, str(error), "sudo tools/gazebo-root" if is_clone() else None)
    program = shutil.which("gz")
    try:
        bindings = find_node().__module__
    except UserError:
        bindings = None
    if program and bindings:
        yield Finding("gz-sim", True, f"{program}, {bindings}")
    else:
        what = "the command gz" if not program else "the Python bindings of gz.transport"
        install = "apt-get install gz-harmonic python3-gz-transport13"
        yield Finding("gz-sim", None, f"{what}: not installed", install)


def px4() -> Iterator[Finding]:
    """A vehicle on PX4's usual port, and serial ports."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as port:
        port.settimeout(_HEARTBEAT_S)
        try:
            port.bind(("127.0.0.1", PX4_PORT))
            _, sender = port.recvfrom(1)
        except TimeoutError:
            said = f"nothing on this computer sends to UDP port {PX4_PORT}"
            yield Finding("PX4 port", None, said, "skysweep serve-vehicle")
        except OSError as error:
            said = f"UDP port {PX4_PORT} cannot be listened on ({error.strerror}): another program has it"
            yield Finding("PX4 port", None, said)
        else:
            yield Finding("PX4 port", True, f"a vehicle at {sender[0]} sends to UDP port {PX4_PORT}")
    ports = serial_ports()
    yield Finding("serial ports", True if ports else None, ", ".join(ports) or "none: no radio is plugged in")


def extras() -> Iterator[Finding]:
    """The optional parts."""
    needs = metadata.requires("skysweep") or []
    for extra in metadata.metadata("skysweep").get_all("Provides-Extra") or []:
        if extra in _FOR_DEVELOPERS:
            continue
        wanted = [need for need in needs if re.search(rf"extra == ['\"]{extra}['\"]", need)]
        names = [re.split(r"[^\w.-]", need, maxsplit=1)[0] for need in wanted]
        missing = [name for name in names if not _is_installed(name)]
        if missing:
            yield Finding(f"extra {extra}", None, f"lacks {', '.join(missing)}", install_command(extra))
        else:
            yield Finding(f"extra {extra}", True, ", ".join(names))


def live_page() -> Iterator[Finding]:
    """The built page that shows a mission in a browser."""
    if _PAGE.is_file():
        yield Finding("live page", True, str(_PAGE.parent))
    else:
        yield Finding("live page", None, "not built", "tools/setup.sh web" if is_clone() else None)


def machine() -> Iterator[Finding]:
    """Cores, memory, disk and caches."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield Finding("cores", True, f"{cores}")
    if hasattr(os, "sysconf"):
        memory_gb = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
        yield Finding("memory", True if memory_gb >= _MEMORY_GB else None, f"{memory_gb:.1f} GB")
    free_gb = shutil.disk_usage(Path.cwd()).free / 1e9
    enough = False if free_gb < _LEAST_FREE_GB else None if free_gb < _FREE_GB else True
    yield Finding("disk", enough, f"{free_gb:.1f} GB free in {Path.cwd()}")
    cache = cache_folder()
    said = f"{cache}" if first_writable([cache]) else f"{cache} cannot be written to; work is done anew"
    yield Finding("caches", True if first_writable([cache]) else None, said)


CHECKS: dict[str, Callable[[], Iterator[Finding]]] = {
    "Python": python,
    "cameras": cameras,
    "detector": detector,
    "ROS 2": ros,
    "Gazebo": gazebo,
    "PX4": px4,
    "extras": extras,
    "live page": live_page,
    "machine": machine,
}
_NEEDED = ("Python", "cameras", "detector")


def examine(name: str) -> list[Finding]:
    """The findings of one of ``CHECKS``, also where it fails in a way that nobody foresaw."""
    try:
        return list(CHECKS[name]())
    except Exception as error:
        said = " ".join(f"{error}".split()) or type(error).__name__
        return [Finding(name, False if name in _NEEDED else None, f"fails: {said}")]


def _is_installed(distribution: str) -> bool:
    try:
        metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return False
    return True
