"""A CSV that says where and how pictures or the frames of a video were taken."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from skysweep.detection.photos.taken import Taken
from skysweep.errors import UserError
from skysweep.files.reading import read_text_limited

_MAX_BYTES = 50_000_000
_LIMITS = {
    "latitude_deg": (-90.0, 90.0),
    "longitude_deg": (-180.0, 180.0),
    "altitude_amsl_m": (-500.0, 20_000.0),
    "height_m": (-1000.0, 20_000.0),
    "altitude_agl_m": (0.0, 20_000.0),
    "heading_deg": (-360.0, 360.0),
    "pitch_deg": (-90.0, 90.0),
    "roll_deg": (-180.0, 180.0),
    "hfov_deg": (1.0, 150.0),
    "time_s": (-math.inf, math.inf),
}
_AROUND = ("heading_deg", "roll_deg")  # angles that go on at 360
COLUMNS = ("file", *_LIMITS)


Parts = tuple[str, ...]


class PoseTable(NamedTuple):
    """Rows by the path of their picture, and rows by their time; a table has one of both."""

    path: Path
    by_file: dict[Parts, Taken]  # by the parts of the path, or of its end, in lower case
    times_s: tuple[float, ...]  # ascending
    by_time: tuple[Taken, ...]

    def of_pictures(self, pictures: Sequence[Path], source: Path) -> list[Taken]:
        """What the table says of each picture of ``source``; nothing where it has no row.

        Raises UserError if it has none for all of them, or leaves open which row is of which picture.
        """
        found = [self._row_of(picture) for picture in pictures]
        if pictures and not any(found):
            raise UserError(
                f"{self.path}: no row names a picture of {source}; write a column file with names such as "
                f"{pictures[0].name}"
            )
        known: dict[Parts, Path] = {}
        for row, picture in zip(found, pictures, strict=True):
            if row and known.setdefault(row, picture) != picture:
                raise UserError(
                    f"{self.path}: the row of {'/'.join(row)} may be of {known[row]} or of {picture}; write "
                    f"file with the folder, such as {picture.parent.name}/{picture.name}"
                )
        return [self.by_file[row] if row else Taken() for row in found]

    def _row_of(self, picture: Path) -> Parts:
        """The row whose path the picture's ends with; empty where there is none."""
        parts = _parts(picture.absolute().as_posix())
        rows = [parts[k:] for k in range(len(parts)) if parts[k:] in self.by_file]
        if len(rows) > 1:
            named = " and ".join("/".join(row) for row in rows)
            raise UserError(f"{self.path}: {named} are both rows of {picture}; leave one of them out")
        return rows[0] if rows else ()

    def at(self, time_s: float) -> Taken | None:
        """What it says of a time, linear between rows; None before the first row and after the last."""
        if not self.times_s or not self.times_s[0] <= time_s <= self.times_s[-1]:
            return None
        k = min(int(np.searchsorted(self.times_s, time_s, side="right")), len(self.times_s) - 1)
        before, after = self.by_time[max(k - 1, 0)], self.by_time[k]
        span_s = self.times_s[k] - self.times_s[max(k - 1, 0)]
        share = (time_s - self.times_s[max(k - 1, 0)]) / span_s if span_s > 0.0 else 1.0
        told: dict[str, Any] = {
            f.name: _between(f.name, before, after, share) for f in fields(Taken) if f.name != "utc"
        }
        return Taken(**{**told, "time_s": time_s})


def read_poses(path: Path) -> PoseTable:
    """Read a CSV with a header of ``COLUMNS``, of which ``file`` or ``time_s`` is needed.

    A cell may be empty. Raises UserError with the line and column of the first mistake.
    """
    try:
        text = read_text_limited(path, _MAX_BYTES).removeprefix("\ufeff")  # as Excel writes it
        lines = csv.DictReader(io.StringIO(text), strict=True)
        header = [name.strip() for name in lines.fieldnames or []]
        unknown = [name for name in header if name not in COLUMNS]
        if unknown or not {"file", "time_s"} & set(header):
            what = f"the column {unknown[0]!r} is not known" if unknown else "has no column file or time_s"
            raise UserError(
                f"{path}: {what}; write a header of {', '.join(COLUMNS)} with one of file, time_s"
            )
        lines.fieldnames = header
        rows = [(lines.line_num, row) for row in lines]
    except (csv.Error, ValueError) as error:  # Python 3.10's csv refuses NUL with a bare csv.Error
        raise UserError(f"{path}: is no CSV ({error}); write one line a picture below a header") from None
    by_file: dict[Parts, Taken] = {}
    by_time: dict[float, Taken] = {}
    for line, row in rows:
        if None in row or None in row.values():
            raise UserError(
                f"{path}: line {line} has not {len(header)} cells as the header has; write as many"
            )
        taken = _row(path, line, row)
        name = row.get("file", "").strip()
        if not name and taken.time_s is None:
            raise UserError(f"{path}: line {line} has neither file nor time_s; write one of them")
        if _parts(name) in by_file or (not name and taken.time_s in by_time):
            what = f"file {name}" if name else f"time_s {row['time_s']}"
            raise UserError(f"{path}: line {line} repeats {what}; write one row for each")
        if name:
            by_file[_parts(name)] = taken
        elif taken.time_s is not None:
            by_time[taken.time_s] = taken
    times_s = sorted(by_time)
    return PoseTable(path, by_file, tuple(times_s), tuple(by_time[t] for t in times_s))


def _parts(path: str) -> Parts:
    return PurePosixPath(path.replace("\\", "/").lower()).parts


def _row(path: Path, line: int, row: dict[str, str]) -> Taken:
    told: dict[str, Any] = {}
    for name, (low, high) in _LIMITS.items():
        text = row.get(name, "").strip()
        if not text:
            continue
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (low <= value <= high and math.isfinite(value)):
            limits = f" from {low:g} to {high:g}" if math.isfinite(low) else ""
            raise UserError(f"{path}: line {line}, {name}: is {text!r}; write a number{limits}")
        told[name] = value
    if "hfov_deg" in told:
        told["hfov_rad"] = math.radians(told.pop("hfov_deg"))
    return Taken(**told)


def _between(name: str, before: Taken, after: Taken, share: float) -> float | None:
    low, high = getattr(before, name), getattr(after, name)
    if low is None or high is None:
        return None
    turn = (high - low + 180.0) % 360.0 - 180.0 if name in _AROUND else high - low
    return float(low + share * turn)
