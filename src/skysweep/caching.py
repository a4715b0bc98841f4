"""What is kept between runs, and where."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path


def cache_folder() -> Path:
    """Ours: ``$XDG_CACHE_HOME/skysweep`` or ``~/.cache/skysweep``."""
    return _user_cache() / "skysweep"


def _user_cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())


def prepare_numba_cache() -> None:
    """Makes sure that Numba can cache, also from a read-only installation without a home.

    Numba caches beside the sources or in the user's cache folder, and refuses to compile where it can
    write to neither: then a temporary folder serves, for this process and those that it starts. Call it
    before Numba is imported. A NUMBA_CACHE_DIR set by the user stands.
    """
    beside_sources = Path(__file__).parent / "__pycache__"
    if "NUMBA_CACHE_DIR" in os.environ or first_writable([beside_sources, _user_cache() / "numba"]):
        return
    folder = tempfile.mkdtemp(prefix="skysweep-numba-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = folder


def first_writable(folders: Iterable[Path]) -> Path | None:
    """The first of the folders that files can be made in, made if need be; None if there is none."""
    for folder in folders:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    return None
