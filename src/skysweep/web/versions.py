"""Run folders that a later skysweep wrote."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from skysweep import __version__


def newer_version(setup: Mapping[str, Any]) -> str | None:
    """A sentence if a journal that begins with this line is from a later skysweep than this one."""
    version = str(setup.get("version", ""))
    if _parts(version) <= _parts(__version__):
        return None
    return f"The mission was flown with skysweep {version}, and this is {__version__}; update it to see it."


def _parts(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d{1,9}", version)[:3])
