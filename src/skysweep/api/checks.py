"""Checks of arguments of the public functions."""

from __future__ import annotations

import operator
import os
from pathlib import Path
from typing import Any

from skysweep.errors import UserError


def whole_seed(seed: Any) -> int:
    """The seed. Raises UserError if it is no whole number from 0 on."""
    try:
        number = operator.index(seed)
    except TypeError:
        number = -1
    if number < 0 or isinstance(seed, bool):
        raise UserError(f"seed: is {seed!r:.60}; write a whole number from 0 on")
    return number


def folder(out: Any) -> Path | None:
    """A folder to write into, or None. Raises UserError if ``out`` is no path."""
    if out is None:
        return None
    if not isinstance(out, str | os.PathLike) or not os.fspath(out):
        raise UserError(f"out: is {out!r:.60}; write the path of a new folder, or leave it out")
    return Path(out).expanduser()
