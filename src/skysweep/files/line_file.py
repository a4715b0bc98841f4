"""Files of JSON lines that detect damage: the format of journals.

The last field of every line is a checksum, zlib's CRC-32 in hexadecimal. ``chain`` continues the checksum of
the line before, so that missing, doubled and moved lines are found too; ``crc``, in older files, covers its
line only. A file is only appended to. Its last line may be torn because its writer was killed or the disk was
full: such a line has no end. It is ignored, and cut off before the next line is written.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import stat
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skysweep.errors import UserError
from skysweep.files.locking import lock

Record = Mapping[str, Any]

_SEALS = (b"", b"crc", b"chain")  # a line of an earlier kind never follows one of a later kind
_SEAL = re.compile(rb', "(crc|chain)": "([0-9a-f]{8})"}\Z')
_LONGEST_SEAL = len(', "chain": "01234567"}')
_LOOKS_SEALED = re.compile(rb'"(crc|chain)"|"[0-9a-f]{8}"}\Z')
_WHOLE_AND_MORE = re.compile(rb', "(crc|chain)": "[0-9a-f]{8}"}.', re.DOTALL)
_OPEN_FLAGS = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)


@dataclass(frozen=True, slots=True)
class Lines:
    """The content of a file of lines."""

    records: list[dict[str, Any]]  # before the first damaged line, without their checksums
    ends: list[int]  # end of each record, in bytes from the file's beginning
    seals: list[int]  # checksum of each record; 0 if a line has none
    damaged: int | None  # number of the damaged line; None: all lines are sound but for a torn last one

    @property
    def n_bytes(self) -> int:
        """Size of the records."""
        return self.ends[-1] if self.ends else 0

    @property
    def seal(self) -> int:
        """The last line's checksum; if the lines are chained, it covers all of them."""
        return self.seals[-1] if self.seals else 0

    def first(self, n: int) -> Lines:
        """The first ``n`` lines alone."""
        return Lines(self.records[:n], self.ends[:n], self.seals[:n], self.damaged)

    def refuse_damaged(self, source: str | Path, remedy: str) -> None:
        """Raises UserError with the damaged line, the number of sound ones before it, and the remedy."""
        if self.damaged is not None:
            raise UserError(
                f"{source}: line {self.damaged} is damaged, {len(self.records)} before it are sound; {remedy}"
            )


class LineFile:
    """A file of lines, open for appending and locked against other writers.

    The file does not change before the first line is written or ``mend`` is called. With ``set_aside``, a
    damaged file is then copied there and cut off before the damage.

    Raises:
        UserError: it cannot be opened, is a link or no file, is being written, or is damaged; in the last
            case the message ends with ``remedy``.
    """

    def __init__(self, path: Path, remedy: str, set_aside: Path | None = None) -> None:
        self._path, self._set_aside = path, set_aside
        try:
            self._file = os.fdopen(os.open(path, _OPEN_FLAGS, 0o666), "a+b", buffering=0)
        except OSError as error:
            reason = "it is a link" if error.errno == errno.ELOOP else error.strerror
            raise UserError(
                f"{path}: cannot be written ({reason}); choose another place or fix its permissions"
            ) from None
        try:
            lock(self._file.fileno(), path)
            self._held = read_sound_lines(path)
            if set_aside is None:
                self._held.refuse_damaged(path, remedy)
        except BaseException:
            self._file.close()
            raise
        self._seal, self._end = self._held.seal, self._held.n_bytes

    @property
    def records(self) -> list[dict[str, Any]]:
        """The sound lines from when the file was opened that were not cut off."""
        return self._held.records

    def append(self, record: Record, sync: bool) -> None:
        """Write one line; ``sync`` waits until the disk has it.

        Raises UserError if nothing more can be written; the file is then unchanged.
        """
        self.mend()
        line, seal = _encode(record, self._seal)
        try:
            left = memoryview(line)
            while left:
                left = left[self._file.write(left) :]
            if sync:
                os.fsync(self._file.fileno())
        except OSError as error:
            with suppress(OSError):
                self._file.truncate(self._end)
            raise UserError(
                f"{self._path}: nothing more can be written ({error.strerror}); what it holds is sound"
            ) from None
        self._end += len(line)
        self._seal = seal

    def cut(self, n_lines: int) -> None:
        """Keep only the first ``n_lines`` of the lines from when the file was opened."""
        self._held = self._held.first(n_lines)
        self._seal, self._end = self._held.seal, self._held.n_bytes

    def mend(self) -> None:
        """Cut off everything after the records. Raises UserError if a damaged file cannot be set aside."""
        if os.fstat(self._file.fileno()).st_size == self._end:
            return
        if self._held.damaged is not None and self._set_aside is not None:
            try:
                shutil.copyfile(self._path, self._set_aside)
            except OSError as error:
                raise UserError(
                    f"{self._set_aside}: cannot be written ({error.strerror}); make room, nothing was changed"
                ) from None
            self._set_aside = None
        self._file.truncate(self._end)

    def close(self) -> None:
        """Close the file and release its lock."""
        self._file.close()


def read_lines(path: Path, remedy: str) -> list[dict[str, Any]]:
    """The lines of a file, without their checksums and without a torn last one.

    Raises UserError if the file cannot be read or a line is damaged; the message ends with ``remedy``.
    """
    found = read_sound_lines(path)
    found.refuse_damaged(path, remedy)
    return found.records


def scan_lines(data: bytes, seal: int = 0) -> Lines:
    """The lines in a file's bytes; ``seal`` is the checksum of the line before them."""
    records: list[dict[str, Any]] = []
    ends: list[int] = []
    seals: list[int] = []
    kind, end = 0, 0
    *lines, torn = data.split(b"\n")
    for number, line in enumerate(lines, start=1):
        end += len(line) + 1
        found = _SEAL.search(line[-_LONGEST_SEAL:])
        this_kind = _SEALS.index(found[1]) if found else 0
        sound = this_kind >= kind
        if found:
            line = line[: -len(found[0])] + b"}"
            seal = zlib.crc32(line, seal if found[1] == b"chain" else 0)
            sound = sound and seal == int(found[2], 16)
        else:
            sound = sound and not _LOOKS_SEALED.search(line)
        record = _decode(line) if sound else None
        if record is None:
            return Lines(records, ends, seals, number)
        kind = this_kind
        records.append(record)
        ends.append(end)
        seals.append(seal)
    return Lines(records, ends, seals, len(lines) + 1 if _WHOLE_AND_MORE.search(torn) else None)


def read_sound_lines(path: Path) -> Lines:
    """The lines before the first damaged one. Raises UserError if the file cannot be read."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise UserError(f"{path}: is no file; put the file itself there")
        return scan_lines(path.read_bytes())
    except OSError as error:
        raise UserError(
            f"{path}: cannot be read ({error.strerror}); check the path and its permissions"
        ) from None


def _encode(record: Record, before: int) -> tuple[bytes, int]:
    """A record as a line chained to the checksum ``before`` it, and its own checksum.

    Raises ValueError on infinities and NaN.
    """
    text = json.dumps(record, allow_nan=False)
    seal = zlib.crc32(text.encode(), before)
    return f'{text[:-1]}, "chain": "{seal:08x}"}}\n'.encode(), seal


def _decode(text: bytes) -> dict[str, Any] | None:
    try:
        record = json.loads(text)
        if b"\\ud" in text or b"\\uD" in text:  # a lone surrogate is valid in JSON only
            record = json.loads(json.dumps(record, ensure_ascii=False).encode(errors="replace"))
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None
