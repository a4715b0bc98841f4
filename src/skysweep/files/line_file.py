"""Files of JSON lines that know when they are damaged: the format of journals.

Every line is an object whose last field is a checksum, a CRC-32 (that of zlib) in hexadecimal. ``chain`` goes
on from the checksum of the line before, so that a line that is missing, doubled or in another place is found
too; ``crc``, in older files, is that of the line alone. A file is only ever appended to. Its last line may be
torn, because its writer was killed or the disk was full: such a line has no end, is left out, and cut off
before the next one is written.
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

_SEALS = (b"", b"crc", b"chain")  # a line of a later kind is followed by no line of an earlier one
_SEAL = re.compile(rb', "(crc|chain)": "([0-9a-f]{8})"}\Z')
_LONGEST_SEAL = len(', "chain": "01234567"}')
_LOOKS_SEALED = re.compile(rb'"(crc|chain)"|"[0-9a-f]{8}"}\Z')
_WHOLE_AND_MORE = re.compile(rb', "(crc|chain)": "[0-9a-f]{8}"}.', re.DOTALL)
_OPEN_FLAGS = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)


@dataclass(frozen=True, slots=True)
class Lines:
    """What a file of lines holds."""

    records: list[dict[str, Any]]  # before the first line that is not sound, without their checksums
    ends: list[int]  # where each of them ends, bytes from the file's beginning
    seals: list[int]  # their checksums; 0 where a line has none
    damaged: int | None  # number of that line; None: the last one may be torn, the others are sound

    @property
    def n_bytes(self) -> int:
        """That the records take."""
        return self.ends[-1] if self.ends else 0

    @property
    def seal(self) -> int:
        """The last line's checksum; of chained lines it speaks for all of them."""
        return self.seals[-1] if self.seals else 0

    def first(self, n: int) -> Lines:
        """The first ``n`` lines alone."""
        return Lines(self.records[:n], self.ends[:n], self.seals[:n], self.damaged)

    def refuse_damaged(self, source: str | Path, remedy: str) -> None:
        """Raises UserError where a line is damaged: which, that those before it are sound, and the remedy."""
        if self.damaged is not None:
            raise UserError(
                f"{source}: line {self.damaged} is damaged, {len(self.records)} before it are sound; {remedy}"
            )


class LineFile:
    """A file of lines, open for appending; nobody else can append to it meanwhile.

    ``records`` is what it held when it was opened. Nothing in the file changes before the first line is
    written or ``mend`` is called. With ``set_aside`` a file that is damaged is copied there then, and cut off
    before the damage.

    Raises:
        UserError: it cannot be opened, is a link or no file, somebody is writing it, or it is damaged;
            ``remedy`` then says what to do.
    """

    def __init__(self, path: Path, remedy: str, set_aside: Path | None = None) -> None:
        self._path, self._set_aside = path, set_aside
        try:
            self._file = os.fdopen(os.open(path, _OPEN_FLAGS, 0o666), "a+b", buffering=0)
        except OSError as error:
            reason = "it is a link" if error.errno == errno.ELOOP else error.strerror
            raise UserError(
                f"{path}: cannot be written ({reason}); choose another place or mend its rights"
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
        """The sound lines that there were when it was opened, and that were not cut off."""
        return self._held.records

    def append(self, record: Record, sync: bool) -> None:
        """Write one line, onto the disk itself with ``sync``.

        Raises UserError where the disk takes no more; the file is then what it was before.
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
        """Keep only the first of the lines that there were when the file was opened."""
        self._held = self._held.first(n_lines)
        self._seal, self._end = self._held.seal, self._held.n_bytes

    def mend(self) -> None:
        """Cut off what is behind the records. Raises UserError where a damaged file cannot be set aside."""
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
        """Close the file; others may write it."""
        self._file.close()


def read_lines(path: Path, remedy: str) -> list[dict[str, Any]]:
    """The lines of a file, without their checksums. A torn last one is left out.

    Raises UserError when the file cannot be read, or a line is damaged: it says which, that those before it
    are sound, and the ``remedy``.
    """
    found = read_sound_lines(path)
    found.refuse_damaged(path, remedy)
    return found.records


def scan_lines(data: bytes) -> Lines:
    """What a file with these bytes holds."""
    records: list[dict[str, Any]] = []
    ends: list[int] = []
    seals: list[int] = []
    kind, seal, end = 0, 0, 0
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
    """The lines before the first damaged one. Raises UserError when the file cannot be read."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise UserError(f"{path}: is no file; put the file itself there")
        return scan_lines(path.read_bytes())
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path and its rights") from None


def _encode(record: Record, before: int) -> tuple[bytes, int]:
    """A record as its line, chained to the checksum of the one ``before``, and its own checksum.

    Raises ValueError on infinities and NaN.
    """
    text = json.dumps(record, allow_nan=False)
    seal = zlib.crc32(text.encode(), before)
    return f'{text[:-1]}, "chain": "{seal:08x}"}}\n'.encode(), seal


def _decode(text: bytes) -> dict[str, Any] | None:
    try:
        record = json.loads(text)
        if b"\\ud" in text or b"\\uD" in text:  # half a character can be told in JSON, and nowhere else
            record = json.loads(json.dumps(record, ensure_ascii=False).encode(errors="replace"))
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None
