"""What a viewer gets of one run: the journal's lines and the names of its pictures, as they appear."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any

from skysweep.errors import UserError
from skysweep.files.line_file import scan_lines
from skysweep.results.journal_lines import can_be_told
from skysweep.results.picture_files import told_by_name
from skysweep.results.run_folder import CLOCK, CONFIG, FILM, JOURNAL_FILE, PICTURES
from skysweep.web.coverage import Coverage
from skysweep.web.places import refuse_link
from skysweep.web.versions import newer_version

BATCH_BYTES = 1 << 18  # of a message
_READ_BYTES = 1 << 19  # at a time, so that others are served in between
_LONGEST_LINE_BYTES = 1 << 25  # a snapshot with thousands of candidates has less
FLYING_S = 10.0  # since the journal's last line: it may still fly
_COVER_S, _COVER_LINES = 0.1, 50  # of coverage at a time
_HEAD_LINES = 5  # within which a journal tells of its mission
_LOOK_S = 0.5  # between looks into the folders of pictures
_END = "end"  # kind of a whole journal's last line


@dataclass(frozen=True, slots=True)
class Status:
    """Whether a mission flies or has ended; ``error`` says why no more of its journal can be shown."""

    flying: bool = False
    ended: bool = False
    error: str | None = None


@dataclass(slots=True)
class Place:
    """What one viewer has been sent."""

    edition: int = -1  # of the journal
    line: int = 0
    mission: str | None = None  # to which these lines belong, as ``Feed.mission`` has it; None: not said
    n_coverage: int = 0
    n_film: int = 0
    of: dict[str, str] = field(default_factory=dict)  # pictures by candidate
    status: Status | None = None


class Feed:
    """Reads a run folder as it grows, once for all its viewers.

    Nothing is held for a viewer but its ``Place``: a slow one gets more at once, later.
    """

    def __init__(self, folder: Path, is_live: bool = False) -> None:
        self.folder = folder
        self.is_live = is_live  # its mission's process has started this server, and runs
        self._forget()
        self._edition = 0
        self._covering = Lock()
        self._looked_s = -1.0
        self._is_read = False  # to the journal's end, at least once
        self._film: list[str] = []
        self._film_time_ns = self._pictures_time_ns = 0
        self._pictures: dict[str, str] = {}

    def _forget(self) -> None:
        self.records: list[dict[str, Any]] = []  # without snapshots
        self._lines: list[str] = []
        self._offset, self._seal = 0, 0  # of the newest line, which is read again with those after it
        self._end = 0
        self._n_lines = 0
        self._chunk = _READ_BYTES
        self._coverage = Coverage(self.folder)
        self._error: str | None = None  # in what was read
        self._unread: str | None = None  # why nothing can be read now
        self._ended = False
        self._written_s = 0.0

    def refresh(self) -> bool:
        """Read what is new; whether there is more to be read at once."""
        now_s = time.monotonic()
        if now_s - self._looked_s > _LOOK_S:
            self._looked_s = now_s
            self._list_pictures()
        try:
            more = self._read()
            self._is_read = self._is_read or not more
            return more
        except FileNotFoundError:
            self._unread = None if self.is_live else f"There is no {JOURNAL_FILE}: the mission has not begun."
        except UserError as error:
            self._unread = str(error)
        except OSError as error:
            self._unread = f"{JOURNAL_FILE} cannot be read ({error.strerror})."
        return False

    def cover(self) -> bool:
        """Take some more lines into the coverage, for about ``_COVER_S``; whether there are still others.

        May be called in any thread; only one does the work.
        """
        if not self._covering.acquire(blocking=False):
            return False
        try:
            records, coverage = self.records, self._coverage
            until_s = time.monotonic() + _COVER_S
            while coverage.n_lines < len(records) and time.monotonic() < until_s:
                coverage.add(records[coverage.n_lines : coverage.n_lines + _COVER_LINES])
            return coverage.n_lines < len(records)
        finally:
            self._covering.release()

    def _read(self) -> bool:
        path = self.folder / JOURNAL_FILE
        refuse_link(path)
        stat = path.stat()
        self._unread = None
        self._written_s = stat.st_mtime
        if stat.st_size < self._end:  # cut off by a resumption
            self._forget()
            self._edition += 1
        if stat.st_size == self._end or self._error is not None:
            return False
        with path.open("rb") as file:
            file.seek(self._offset)
            data = file.read(self._chunk)
        found = scan_lines(data, self._seal)
        known = 1 if self._offset < self._end else 0  # the newest line is read again, for its checksum
        new = found.records[known:]
        for k, record in enumerate(new, start=self._n_lines + 1):
            self._take(record, k)
        if self._error is None and found.damaged is not None:
            damaged = self._n_lines + len(new) + 1
            self._error = f"Line {damaged} of {JOURNAL_FILE} is damaged; the mission is shown up to it."
        if not new:
            is_cut = len(data) == self._chunk
            self._chunk *= 2
            if is_cut and self._error is None and self._chunk > _LONGEST_LINE_BYTES:
                number = self._n_lines + 1
                self._error = f"Line {number} of {JOURNAL_FILE} is longer than any that a mission writes."
            return is_cut and self._error is None
        self._chunk = _READ_BYTES
        self._n_lines += len(new)
        n = len(found.records)
        self._end = self._offset + found.n_bytes
        self._seal = found.seals[n - 2] if n > 1 else self._seal
        self._offset += found.ends[n - 2] if n > 1 else 0
        return self._end < stat.st_size

    def _take(self, record: dict[str, Any], number: int) -> None:
        if self._error is not None:
            return
        if number == 1 and (newer := newer_version(record)) is not None:
            self._error = newer
        elif not (can_be_told(record) and is_finite(record)):
            self._error = f"Line {number} of {JOURNAL_FILE} was not written by a mission."
        elif record["kind"] != "snapshot":
            self._ended = self._ended or record["kind"] == _END
            self.records.append(record)
            self._lines.append(json.dumps(record, separators=(",", ":")))

    @property
    def mission(self) -> str:
        """What tells its mission from others: the configuration and, in real time, when it began."""
        utc = next((r["utc"] for r in self.records[:_HEAD_LINES] if r["kind"] == CLOCK), "")
        return f"{self.records[0].get(CONFIG, '')} {utc}" if self.records else ""

    def _list_pictures(self) -> None:
        film, pictures = self.folder / FILM, self.folder / PICTURES
        if (changed := _changed(film)) != self._film_time_ns:
            self._film_time_ns = changed
            known = set(self._film)
            self._film += sorted((p.stem for p in film.glob("*.jpg") if p.stem not in known), key=_number)
        if (changed := _changed(pictures)) != self._pictures_time_ns:
            self._pictures_time_ns = changed
            told = [(told, p.name) for p in pictures.glob("*.jpg") if (told := told_by_name(p)) is not None]
            self._pictures = {str(of): name for (of, _), name in sorted(told, key=lambda each: each[0])}

    @property
    def status(self) -> Status:
        """The mission's."""
        flies = self.is_live or time.time() - self._written_s < FLYING_S
        return Status(flies and not self._ended, self._ended, self._error or self._unread)

    def news(self, place: Place) -> list[str]:
        """The messages that a viewer at ``place`` gets now, of about ``BATCH_BYTES``; the place moves on."""
        messages: list[str] = []
        if place.edition != self._edition:
            if place.edition >= 0:
                place.line = place.n_coverage = 0
            place.edition = self._edition
        if place.mission is not None and self.records:
            if place.mission != self.mission:  # another's page, which was left open
                place.line = 0
            place.mission = None
        if place.line > len(self._lines):  # by a page that has seen more than there is, or is read yet
            if not self._is_read:
                return messages
            place.line = 0
        if place.line < len(self._lines):
            first, size = place.line, 0
            while place.line < len(self._lines) and size < BATCH_BYTES:
                size += len(self._lines[place.line])
                place.line += 1
            lines = ",".join(self._lines[first : place.line])
            messages.append(f'{{"type":"lines","from":{first},"lines":[{lines}]}}')
        frames, size = self._coverage.frames, 0
        while place.n_coverage < len(frames) and size < BATCH_BYTES:
            messages.append(_message("coverage", **frames[place.n_coverage]))
            size += len(messages[-1])
            place.n_coverage += 1
        if place.n_film < len(self._film):
            messages.append(_message("film", times=self._film[place.n_film :]))
            place.n_film = len(self._film)
        if place.of != self._pictures:
            place.of = self._pictures
            messages.append(_message("pictures", of=place.of))
        status = self.status
        if place.status != status and place.line == len(self._lines):
            place.status = status
            messages.append(_message("status", flying=status.flying, ended=status.ended, error=status.error))
        return messages


def is_finite(record: dict[str, Any]) -> bool:
    """Whether a line has neither infinities nor NaN, which no mission writes and no browser reads."""
    try:
        json.dumps(record, allow_nan=False)
    except ValueError:
        return False
    return True


def _message(kind: str, **fields: Any) -> str:
    return json.dumps({"type": kind, **fields}, separators=(",", ":"))


def _changed(folder: Path) -> int:
    try:
        return folder.stat().st_mtime_ns
    except OSError:
        return 0


def _number(stem: str) -> float:
    try:
        return float(stem)
    except ValueError:
        return -1.0
