"""The journal: one JSON object a line, appended as events happen, so that a killed mission loses nothing."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.errors import UserError
from skysweep.files.line_file import LineFile, read_lines

_MADE_AGAIN = {"state", "look"}  # by every resumed mission
_NOT_MADE_AGAIN = {"setup", "operator", "end"}  # by a resumed simulation; results are written after the end
_EXACT = {"look", "snapshot"}  # not rounded: a mission resumes from them
_PLAIN_TYPES = {str, int, bool, type(None)}


class Journal(Protocol):
    """Records what happens; what is not made again on resuming is on disk before the mission continues.

    ``failed`` says in a sentence why no more can be recorded: it is time to fly home.
    """

    @property
    def failed(self) -> str | None: ...

    def write(self, time_s: float, kind: str, **fields: Any) -> None: ...


class FileJournal:
    """Appends to a run folder's journal; a line that a resumed mission does not make again is fsynced.

    ``replays`` says that the mission is simulated, as its ``Mission`` does: nearly all lines are made again.
    When the disk is full, ``failed`` says so and nothing more is written. ``set_aside`` is for a damaged
    journal, see ``LineFile``. Each of ``listeners`` gets every new line.

    Raises UserError if the journal cannot be written, is being written, or is damaged.
    """

    failed: str | None = None
    replays: bool = False

    def __init__(self, path: Path, set_aside: Path | None = None) -> None:
        self.path = path
        self.listeners: list[Callable[[Mapping[str, Any]], None]] = []
        self._file = LineFile(path, journal_remedy(path), set_aside)

    @property
    def records(self) -> list[dict[str, Any]]:
        """The lines it held when opened, less those cut off."""
        return self._file.records

    def write(self, time_s: float, kind: str, **fields: Any) -> None:
        """Append one line. Numbers are rounded to a tenth of a millimetre or a tenth of a millisecond."""
        line = line_of(time_s, kind, fields)
        if self.failed is None:
            try:
                self._file.append(line, sync=self._is_hurried(kind))
            except UserError as error:
                self.failed = str(error)
        for listener in self.listeners:
            listener(line)

    def _is_hurried(self, kind: str) -> bool:
        return kind in _NOT_MADE_AGAIN if self.replays else kind not in _MADE_AGAIN

    def cut(self, n_lines: int) -> None:
        """Keep only the first of ``records``."""
        self._file.cut(n_lines)

    def mend(self) -> None:
        """Cut off what follows ``records``, as the next line would."""
        self._file.mend()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class MemoryJournal:
    """A journal in memory, for missions by the thousand. Its lines are made when they are read."""

    failed: str | None = None

    def __init__(self) -> None:
        self._told: list[tuple[float, str, dict[str, Any]]] = []

    def write(self, time_s: float, kind: str, **fields: Any) -> None:
        """Keep one line."""
        self._told.append((time_s, kind, fields))

    @property
    def lines(self) -> list[dict[str, Any]]:
        """The lines that a ``FileJournal`` would have written."""
        alike: dict[tuple[str, ...], list[int]] = {}
        for number, (_, kind, fields) in enumerate(self._told):
            alike.setdefault((kind, *fields), []).append(number)
        lines: list[dict[str, Any]] = [{}] * len(self._told)
        for (kind, *_), numbers in alike.items():
            told = [self._told[k] for k in numbers]
            if kind in _EXACT:
                made = [line_of(*each) for each in told]
            else:
                made = _plain_rows([{"t": t, "kind": kind} | fields for t, _, fields in told])
            for number, line in zip(numbers, made, strict=True):
                lines[number] = line
        return lines


def read_journal(path: Path) -> list[dict[str, Any]]:
    """The lines of a journal, less a torn last one, which is normal after a crash.

    Raises UserError naming a damaged line in the middle, and how to save those before it.
    """
    return read_lines(path, journal_remedy(path))


def line_of(time_s: float, kind: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    """A line as plain data, rounded unless a mission resumes from it."""
    plain = _exact if kind in _EXACT else _plain
    return {"t": round(time_s, 4), "kind": kind} | {k: plain(v) for k, v in fields.items()}


def resume_command(folder: Path, replays: bool = True) -> str:
    """The command that resumes the mission of a run folder; a real vehicle's does not replay."""
    return f"skysweep {'resume' if replays else 'fly'} {shlex.quote(str(folder))}"


def journal_remedy(path: Path) -> str:
    """What to do about a damaged journal."""
    folder = shlex.quote(str(path.parent))
    return (
        f"'skysweep report {folder} --from-sound-lines --out NEW_FOLDER' reports those, and "
        f"'{resume_command(path.parent)} --from-sound-lines' (of a flight 'skysweep fly') goes on from those"
    )


def _exact(value: Any) -> Any:
    """Plain data with every digit; what is not finite becomes a string."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else str(value)
    if isinstance(value, list | tuple):
        return [_exact(v) for v in value]
    if isinstance(value, dict):
        return {k: _exact(v) for k, v in value.items()}
    return _exact(value.tolist()) if hasattr(value, "tolist") else value


def _plain(value: Any) -> Any:
    """Plain rounded data; infinity becomes the string 'inf'."""
    if isinstance(value, str | int):
        return value
    if isinstance(value, np.ndarray) and value.dtype == np.float64:
        rounded = np.empty(value.shape)
        if _round(value.ravel(), rounded.ravel()):
            return rounded.tolist()
    if isinstance(value, float):
        return round(float(value), 4) if math.isfinite(value) else str(value)
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    return value


def _plain_rows(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """``_plain`` of mappings with the same keys: much faster than one by one."""
    columns = [_plain_column([row[key] for row in rows]) for key in rows[0]]
    return [dict(zip(rows[0], values, strict=True)) for values in zip(*columns, strict=True)]


def _plain_column(values: list[Any]) -> list[Any]:
    types = set(map(type, values))
    if types <= _PLAIN_TYPES:
        return values
    if types == {dict} and values[0] and len(set(map(tuple, values))) == 1:
        return _plain_rows(values)
    if types == {float} or (types == {np.ndarray} and len({(v.dtype, v.shape) for v in values}) == 1):
        table = np.array(values)
        if table.dtype == np.float64:
            return list(_plain_table(table))
    return [_plain(value) for value in values]


def _plain_table(values: NDArray[np.float64]) -> Any:
    """``_plain`` of each row."""
    rounded = np.empty(values.shape)
    certain = _round(values.ravel(), rounded.ravel())
    plain: Any = rounded.tolist()
    if not certain:
        for k in np.unique(np.argwhere(np.isnan(rounded))[:, 0]).tolist():
            plain[k] = _plain(values[k])
    return plain


@njit(cache=True)
def _round(values: NDArray[np.float64], out: NDArray[np.float64]) -> bool:
    """Write values rounded to four digits into ``out``; False if some are NaN there.

    Those are not finite, large or nearly half way, and left to Python's exact rounding.
    """
    certain = True
    for k, value in enumerate(values):
        scaled = value * 1e4
        whole = np.rint(scaled)
        if abs(scaled) < 1e12 and abs(abs(scaled - whole) - 0.5) > 1e-3:
            out[k] = whole / 1e4
        else:
            out[k] = np.nan
            certain = False
    return certain
