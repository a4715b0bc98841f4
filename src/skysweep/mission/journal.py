"""The journal: one JSON object a line, appended as things happen, so that a killed mission loses nothing."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.errors import UserError


class Journal(Protocol):
    """Takes down what happens. ``state_change`` lines must be on disk before the mission goes on."""

    def write(self, time_s: float, kind: str, **fields: Any) -> None: ...


class FileJournal:
    """Appends to a file; every line but the periodic ``state`` lines is fsynced."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("a", encoding="utf-8")

    def write(self, time_s: float, kind: str, **fields: Any) -> None:
        """Append one line. Numbers are rounded to a tenth of a millimetre or a tenth of a millisecond."""
        line = {"t": round(time_s, 4), "kind": kind} | {k: _plain(v) for k, v in fields.items()}
        self._file.write(json.dumps(line, allow_nan=False) + "\n")
        self._file.flush()
        if kind != "state":
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class MemoryJournal:
    """Keeps the lines in memory, for missions by the thousand."""

    def __init__(self) -> None:
        self.lines: list[dict[str, Any]] = []

    def write(self, time_s: float, kind: str, **fields: Any) -> None:
        """Keep one line."""
        self.lines.append({"t": round(time_s, 4), "kind": kind} | {k: _plain(v) for k, v in fields.items()})


def read_journal(path: Path) -> Iterator[dict[str, Any]]:
    """The lines of a journal. A torn last line is normal after a crash and is left out.

    Raises UserError naming the line when one in the middle cannot be read.
    """
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            if number == len(lines):
                return
            raise UserError(
                f"{path}: line {number} cannot be read; the {number - 1} lines before it are sound"
            ) from None


def _plain(value: Any) -> Any:
    """Plain rounded data of arrays, tuples and floats; infinity becomes the string 'inf'."""
    if isinstance(value, float):
        return round(float(value), 4) if math.isfinite(value) else str(value)
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray) and value.dtype == np.float64:
        rounded, safe = _rounded(value.ravel())
        if safe:
            return rounded.reshape(value.shape).tolist()
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    return value


@njit(cache=True)
def _rounded(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], bool]:
    """What Python's ``round(value, 4)`` gives, and whether that is certain.

    It is not where a value is not finite, too large, or half way between two, and Python has to look closer.
    """
    out = np.empty(len(values))
    for k, value in enumerate(values):
        scaled = value * 1e4
        whole = np.rint(scaled)
        if not (abs(scaled) < 1e12 and abs(abs(scaled - whole) - 0.5) > 1e-3):
            return out, False
        out[k] = whole / 1e4
    return out, True
