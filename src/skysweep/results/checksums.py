"""``SHA256SUMS``: the digests of a folder's files, as coreutils' ``sha256sum`` writes and checks them.

Parquet's own checksums leave out footer and statistics, where a flipped bit gives other numbers. A file may
have two digests: while it is replaced, the old and the new content are both right.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping

from skysweep.errors import UserError

SUMS_FILE = "SHA256SUMS"

Sums = Mapping[str, frozenset[str]]  # name -> SHA-256 of what the file may hold, in hexadecimal

_LINE = re.compile(r"([0-9a-f]{64})  ([^/\s]+)")


def sha256(content: bytes) -> str:
    """In hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def dump_sums(sums: Sums) -> bytes:
    """What ``SHA256SUMS`` holds."""
    lines = [f"{digest}  {name}\n" for name in sorted(sums) for digest in sorted(sums[name])]
    return "".join(lines).encode()


def read_sums(content: bytes, where: str) -> Sums:
    """The digests in ``SHA256SUMS``. Raises UserError where it is damaged."""
    *lines, rest = content.decode("utf-8", "replace").split("\n")
    found = [_LINE.fullmatch(line) for line in lines]
    sums: dict[str, frozenset[str]] = {}
    for match in found:
        if match is not None:
            sums[match[2]] = sums.get(match[2], frozenset()) | {match[1]}
    if rest or None in found:
        raise UserError(f"{where}: is damaged; put back the one that was there, or fly into another folder")
    return sums


def refuse_changed(sums: Sums | None, name: str, content: bytes, where: str) -> None:
    """Raises UserError where a file is not what was written. ``sums`` None: an older skysweep kept none."""
    if sums is not None and sha256(content) not in sums.get(name, ()):
        raise UserError(
            f"{where}: is damaged ({SUMS_FILE} has another digest); put back the one that was there"
        )


def refuse_misnamed(name: str, content: bytes, where: str) -> None:
    """Raises UserError where a file that is named by its digest holds something else."""
    if name.rpartition("/")[2].partition(".")[0] != sha256(content):
        raise UserError(
            f"{where}: is damaged, or of an older skysweep; delete it and give the sweep again: what it held "
            "is flown anew"
        )
