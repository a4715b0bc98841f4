"""A CSV that says where and how pictures or the frames of a video were taken."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import fields
from pathlib import Path
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


class PoseTable(NamedTuple):
    """Rows by the name of their picture, and rows by their time; a table has one of both."""

    by_file: dict[str, Taken]
    times_s: tuple[float, ...]  # ascending
    by_time: tuple[Taken, ...]

    def of_file(self, path: Path) -> Taken:
        """What the table says of a picture; nothing where it has no row."""
        return self.by_file.get(path.name, Taken())

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
        lines = csv.DictReader(io.StringIO(read_text_limited(path, _MAX_BYTES)), strict=True)
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
    by_file: dict[str, Taken] = {}
    by_time: list[tuple[float, Taken]] = []
    for line, row in rows:
        if None in row or None in row.values():
            raise UserError(
                f"{path}: line {line} has not {len(header)} cells as the header has; write as many"
            )
        taken = _row(path, line, row)
        name = row.get("file", "").strip()
        if name:
            by_file[Path(name).name] = taken
        elif taken.time_s is not None:
            by_time.append((taken.time_s, taken))
        else:
            raise UserError(f"{path}: line {line} has neither file nor time_s; write one of them")
    by_time.sort(key=lambda each: each[0])
    return PoseTable(by_file, tuple(t for t, _ in by_time), tuple(taken for _, taken in by_time))


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
