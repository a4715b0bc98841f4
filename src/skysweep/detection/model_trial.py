"""Tries an unknown model in a separate process before it runs in ours.

A file of a few hundred bytes may loop for ever or ask for all memory. The trial loads it and shows it one
blank picture, within limits. It does not find what a model does only on other pictures.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from math import ceil
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Timer

from skysweep.caching import cache_folder
from skysweep.detection.layouts import Told
from skysweep.detection.model_files import sha256_of, shipped_models
from skysweep.errors import UserError

try:
    import resource
except ImportError:  # only POSIX has it; elsewhere the wall clock is the only limit
    resource = None  # type: ignore[assignment]

MEMORY_BYTES = 1_500_000_000
CPU_S = 10
_WALL_S = 60.0
_SAID_AFTER_S = 3.0
_REFUSED = 2


def try_out(path: Path, told: Told) -> None:
    """Raises UserError if a model does not load, or takes too much time or memory for one picture.

    ``told`` is that of the detector that will use it. The shipped model needs no trial, and a model that
    passed is not tried again.
    """
    digest = sha256_of(path)
    if digest not in map(sha256_of, shipped_models()):
        _try_once(path, digest, told)


def vouch_for(path: Path) -> None:
    """Record that a model needs no trial as long as its file does not change."""
    passed = _passed(sha256_of(path))
    with suppress(OSError):
        passed.parent.mkdir(parents=True, exist_ok=True)
        passed.touch()


def _passed(digest: str) -> Path:
    """The file that exists if a model with this SHA-256 has passed."""
    return cache_folder() / "tried-models" / digest


@lru_cache(maxsize=64)
def _try_once(path: Path, digest: str, told: Told) -> None:
    if _passed(digest).exists():
        return
    try:
        # in an empty folder: Python looks for modules where it starts
        with TemporaryDirectory() as empty, _said_when_slow(path):
            done = subprocess.run(
                [sys.executable, "-m", __name__, str(path.absolute()), *(word or "" for word in told)],
                cwd=empty,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_WALL_S,
                env=os.environ | {"CUDA_VISIBLE_DEVICES": "-1"},
                check=False,
            )
    except subprocess.TimeoutExpired:
        raise _too_slow(path) from None
    if done.returncode == -getattr(signal, "SIGXCPU", 0):
        raise _too_slow(path)
    if done.returncode == _REFUSED and done.stdout:
        raise UserError(done.stdout.splitlines()[-1])  # ONNX Runtime may have printed before
    if done.returncode != 0:
        raise UserError(f"{path}: the model broke the process that tried it; export or download it again")
    vouch_for(path)


@contextmanager
def _said_when_slow(path: Path) -> Iterator[None]:
    words = f"{path}: the model is tried out first; it may take {CPU_S} s for one picture."
    timer = Timer(_SAID_AFTER_S, print, [words], {"file": sys.stderr})
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _too_slow(path: Path) -> UserError:
    return UserError(f"{path}: the model took more than {CPU_S} s for one picture; export a smaller one")


def _limit() -> None:
    """Limit further time and memory of this process, and forbid core files."""
    if resource is None:
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    cpu_s = ceil(used.ru_utime + used.ru_stime) + CPU_S
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):  # only Linux reports and limits it
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        memory_bytes = pages * resource.getpagesize() + MEMORY_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))


def _main(path: Path, told: Told) -> int:
    import cv2

    from skysweep.detection.network import load_network

    _limit()
    try:
        load_network(path, 1, told)
    except UserError as error:
        print(error)
        return _REFUSED
    except (MemoryError, cv2.error):  # OpenCV finds no memory for so large an input
        print(f"{path}: the model takes more than {MEMORY_BYTES / 1e9:g} GB; export a smaller one")
        return _REFUSED
    return 0


if __name__ == "__main__":
    _path, *_told = sys.argv[1:]
    sys.exit(_main(Path(_path), Told(*(word or None for word in _told))))  # type: ignore[arg-type]
