"""Finds Gazebo Classic 11: this machine's own, or the folder that ``tools/gazebo-root`` makes."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from skysweep.errors import UserError

ROOT_VARIABLE = "SKYSWEEP_GAZEBO_ROOT"
DEFAULT_ROOT = Path("~/.cache/skysweep/gazebo-root")
PLUGIN_CACHE = Path("~/.cache/skysweep/gazebo-plugin")
MAJOR_VERSION = "11"
HOW_TO_GET = (
    "install Gazebo Classic 11 (Ubuntu 20.04 and 22.04: apt-get install gazebo libgazebo-dev xvfb), "
    "or make a folder with it: sudo tools/gazebo-root"
)
_READY = ".skysweep-ready"
_PLUGIN_IN_ROOT = Path("opt/skysweep")
_BUILD = Path(__file__).parent / "plugin" / "build.sh"


@dataclass(frozen=True, slots=True)
class Install:
    """An installed Gazebo Classic 11: ``root`` is a folder with a complete system, or ``/``."""

    root: Path
    plugin: Path  # our world plugin, as seen from inside ``root``


@lru_cache(maxsize=1)
def find_install() -> Install:
    """The folder named by SKYSWEEP_GAZEBO_ROOT, else this machine's gzserver, else the default folder.

    Builds the world plugin for this machine's gzserver at first use. Raises UserError if there is none, or if
    it has another version or cannot run here.
    """
    for tool in ("unshare", "setpriv"):
        if shutil.which(tool) is None:
            raise UserError(f"The Gazebo camera needs {tool}: install it with  apt-get install util-linux")
    named = os.environ.get(ROOT_VARIABLE)
    if named:
        return _in_root(Path(named))
    if shutil.which("gzserver"):
        return _native()
    root = DEFAULT_ROOT.expanduser()
    if not (root / _READY).exists():
        raise UserError(f"Gazebo Classic 11 is not here: {HOW_TO_GET}")
    return _in_root(root)


def _in_root(root: Path) -> Install:
    root = root.expanduser().resolve()
    plugins = sorted((root / _PLUGIN_IN_ROOT).glob("*.so"), key=lambda p: p.stat().st_mtime)
    if not (root / _READY).exists() or not plugins:
        raise UserError(f"{root}: holds no complete Gazebo; run  sudo tools/gazebo-root {root}")
    if os.geteuid() != 0:
        raise UserError(f"{root}: only root can run the Gazebo in there; use sudo, or {HOW_TO_GET}")
    return Install(root, Path("/") / plugins[-1].relative_to(root))


def _native() -> Install:
    said = subprocess.run(["gzserver", "--version"], capture_output=True, text=True, check=False).stdout
    version = re.search(r"version (\d+)\.", said)
    if version is None or version[1] != MAJOR_VERSION:
        found = version[1] if version else "another program"
        raise UserError(f"gzserver on the PATH is {found}, not Gazebo Classic {MAJOR_VERSION}: {HOW_TO_GET}")
    cache = PLUGIN_CACHE.expanduser()
    cache.mkdir(parents=True, exist_ok=True)
    built = subprocess.run(["bash", str(_BUILD), str(cache)], capture_output=True, text=True, check=False)
    if built.returncode != 0:
        last = (built.stderr.strip().splitlines() or ["no compiler"])[-1]
        raise UserError(
            f"Our Gazebo plugin does not build ({last}): apt-get install g++ pkg-config libgazebo-dev"
        )
    return Install(Path("/"), Path(built.stdout.strip()))
