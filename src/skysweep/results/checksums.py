"""``SHA256SUMS``: the digests of a folder's files, as coreutils' ``sha256sum`` writes and checks them.

Parquet's own checksums do not cover the footer and statistics, where a flipped bit changes numbers. A file
has two digests while it is replaced, since old and new content are both valid.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping

from skysweep.errors import UserError

SUMS_FILE = "SHA256SUMS"

Sums = Mapping[str, frozenset[str]]  # name -> SHA-256 of each valid content, in hexadecimal

_LINE = re.compile(r"([0-9a-f]{64})  ([^/\s]+)")


def sha256(content: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def dump_sums(sums: Sums) -> bytes:
    """The content of ``SHA256SUMS``."""
    lines = [f"{digest}  {name}\n" for name in sorted(sums) for digest in sorted(sums[name])]
    return "".join(lines).encode()


def read_sums(content: bytes, where: str) -> Sums:
    """The digests in ``SHA256SUMS``. Raises UserError where it is damaged."""
    *lines, rest = content.decode("utf-8", "replace").split("\n")
    found = [_LINE.fullmatch(line) for line in lines]
    if rest or not found or None in found:
        raise UserError(f"{where}: is damaged; restore the original, or fly into another folder")
    sums: dict[str, frozenset[str]] = {}
    for match in filter(None, found):
        sums[match[2]] = sums.get(match[2], frozenset()) | {match[1]}
    return sums


def refuse_changed(sums: Sums | None, name: str, content: bytes, where: str) -> None:
    """Raises UserError where a file was changed. ``sums`` is None for an older skysweep, which kept none."""
    if sums is not None and sha256(content) not in sums.get(name, ()):
        instead = (
            ", or delete it and give the command that flew it again" if name.endswith(".parquet") else ""
        )
        raise UserError(
            f"{where}: is damaged ({SUMS_FILE} has another digest); restore the original{instead}"
        )


def refuse_misnamed(name: str, content: bytes, where: str) -> None:
    """Raises UserError where a file's name is not its digest."""
    if name.rpartition("/")[2].partition(".")[0] != sha256(content):
        raise UserError(
            f"{where}: is damaged, or of an older skysweep; delete it and give the sweep again to fly its "
            "missions anew"
        )
