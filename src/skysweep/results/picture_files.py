"""The pictures of candidates and of the film: their names, and files that show when they are damaged.

A comment in front of the JPEG has the file's name and a checksum.
"""

from __future__ import annotations

import re
import zlib
from pathlib import Path

from skysweep.files.writing import replace_file

SAME_LOOK_S = 0.06  # a name rounds the time to a tenth of a second
_NAME = re.compile(r"candidate-(\d+)-(\d+\.\d)s$")
_START, _COMMENT = b"\xff\xd8", b"\xff\xfe"  # markers of ITU-T T.81, table B.1


def picture_name(candidate: int, time_s: float) -> str:
    """File name of the picture of a candidate at mission time ``time_s``."""
    return f"candidate-{candidate}-{time_s:.1f}s.jpg"


def told_by_name(path: Path) -> tuple[int, float] | None:
    """Candidate and mission time in seconds from such a name, or None."""
    told = _NAME.match(path.stem)
    return None if told is None else (int(told[1]), float(told[2]))


def write_picture(path: Path, jpeg: bytes) -> None:
    """Write a JPEG, whole or not at all. Raises OSError."""
    replace_file(path, _sealed(path.name, jpeg))


def read_picture(path: Path) -> bytes | None:
    """A JPEG; None if it was changed since ``write_picture`` wrote it under this name. Raises OSError."""
    if path.exists() and not path.is_file():  # a pipe would be waited for
        return None
    data = path.read_bytes()
    before = len(_START) + len(_segment(path.name, b""))
    return data if data == _sealed(path.name, _START + data[before:]) else None


def _sealed(name: str, jpeg: bytes) -> bytes:
    return _START + _segment(name, jpeg) + jpeg[len(_START) :]


def _segment(name: str, jpeg: bytes) -> bytes:
    """The comment: the file's name and the CRC-32 of name and picture."""
    text = f"{name} {zlib.crc32(jpeg, zlib.crc32(name.encode())):08x}".encode()
    return _COMMENT + (len(text) + 2).to_bytes(2, "big") + text
