"""Files of JSON lines that know when they are damaged: the format of journals and ledgers.

Every line is an object whose last field, ``crc``, is the CRC-32 (that of zlib) of the line without it, in
hexadecimal. A file is only ever appended to. Its last line may be torn, because its writer was killed or the
disk was full: such a line is left out, and cut off before the next one is written.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skysweep.errors import UserError

try:
    import fcntl
except ImportError:  # only POSIX has it; elsewhere nobody is kept from writing twice
    fcntl = None  # type: ignore[assignment]

Record = Mapping[str, Any]

_SEAL = ', "crc": "%08x"}'
_SEAL_LENGTH = len(_SEAL % 0)
_LOOKS_SEALED = re.compile(rb'"crc"|"[0-9a-f]{8}"}$')


class LineFile:
    """A file of lines, open for appending; nobody else can append to it meanwhile.

    ``records`` is what it held when it was opened. With ``set_aside`` a file that is damaged in the middle is
    copied there and cut off before the damage.

    Raises:
        UserError: it cannot be opened, somebody is writing it, or it is damaged; ``remedy`` then says what
            to do.
    """

    def __init__(self, path: Path, remedy: str, set_aside: Path | None = None) -> None:
        self._path = path
        try:
            self._file = path.open("a+b", buffering=0)
        except OSError as error:
            raise UserError(
                f"{path}: cannot be written ({error.strerror}); choose another place or mend its rights"
            ) from None
        try:
            self._lock()
            found = _scan(path.read_bytes())
            if found.damaged is not None:
                if set_aside is None:
                    raise found.error(path, remedy)
                shutil.copyfile(path, set_aside)
            self._file.truncate(found.n_bytes)
        except BaseException:
            self._file.close()
            raise
        self.records = found.records
        self._end = found.n_bytes

    def append(self, record: Record, sync: bool) -> None:
        """Write one line, onto the disk itself with ``sync``.

        Raises UserError where the disk takes no more; the file is then what it was before.
        """
        line = encode(record)
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

    def cut(self, n_lines: int) -> None:
        """Keep only the first of the lines that there were when the file was opened."""
        self.records = self.records[:n_lines]
        self._end = sum(len(encode(record)) for record in self.records)
        self._file.truncate(self._end)

    def close(self) -> None:
        """Close the file; others may write it."""
        self._file.close()

    def _lock(self) -> None:
        if fcntl is None:
            return
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                raise UserError(
                    f"{self._path}: another skysweep is writing it; wait until that one has ended, or stop it"
                ) from None
            if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP):
                raise


def read_lines(path: Path, remedy: str) -> list[dict[str, Any]]:
    """The lines of a file, without their checksums. A torn last one is left out.

    Raises UserError when the file cannot be read, or a line in the middle is damaged: it says which, that
    those before it are sound, and the ``remedy``.
    """
    found = _read(path)
    if found.damaged is not None:
        raise found.error(path, remedy)
    return found.records


def read_sound_lines(path: Path) -> tuple[list[dict[str, Any]], int | None]:
    """The lines before the first damaged one, and its number; None: only the last line may be torn.

    Raises UserError when the file cannot be read.
    """
    found = _read(path)
    return found.records, found.damaged


def encode(record: Record) -> bytes:
    """A record as its line. Raises ValueError on infinities and NaN."""
    text = json.dumps(record, allow_nan=False)
    return (text[:-1] + _SEAL % zlib.crc32(text.encode()) + "\n").encode()


@dataclass(frozen=True, slots=True)
class _Scanned:
    records: list[dict[str, Any]]  # before the first line that is not sound
    n_bytes: int  # that they take
    damaged: int | None  # number of that line, unless it is the last: that one is torn

    def error(self, path: Path, remedy: str) -> UserError:
        return UserError(
            f"{path}: line {self.damaged} is damaged, {len(self.records)} before it are sound; {remedy}"
        )


def _read(path: Path) -> _Scanned:
    try:
        return _scan(path.read_bytes())
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path and its rights") from None


def _scan(data: bytes) -> _Scanned:
    records: list[dict[str, Any]] = []
    n_bytes, sealed = 0, False
    *lines, torn = data.split(b"\n")
    for number, line in enumerate(lines, start=1):
        sealed = sealed or bool(_LOOKS_SEALED.search(line))
        record = _decode(line, sealed)
        if record is None:
            is_last = number == len(lines) and not torn
            return _Scanned(records, n_bytes, None if is_last else number)
        records.append(record)
        n_bytes += len(line) + 1
    return _Scanned(records, n_bytes, None)


def _decode(line: bytes, sealed: bool) -> dict[str, Any] | None:
    """The record of a line, None of one that is not sound.

    The first lines of a file may have no checksums: skysweep 0.1 wrote none.
    """
    if sealed:
        bare = line[:-_SEAL_LENGTH] + b"}"
        if line[-_SEAL_LENGTH:] != (_SEAL % zlib.crc32(bare)).encode():
            return None
        line = bare
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None
