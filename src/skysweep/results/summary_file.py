"""``summary.json``: a mission's numbers, with a checksum of the file and of the journal behind them.

The last two fields are ``journal``, the checksum of the journal's last line, which covers all lines, and
``crc``, the CRC-32 (zlib's, in hexadecimal) of the file up to the comma before it.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from skysweep.errors import UserError
from skysweep.files.reading import read_limited
from skysweep.files.writing import replace_file

_SEAL = ',\n "crc": "%08x"\n}\n'
_SEAL_LENGTH = len(_SEAL % 0)
_MAX_BYTES = 1 << 24


def write_summary(path: Path, summary: Mapping[str, Any], journal: int) -> None:
    """Write a summary, whole or not at all. Raises OSError."""
    text = json.dumps({**summary, "journal": f"{journal:08x}"}, indent=1, allow_nan=False)
    text = text.removesuffix("\n}")
    replace_file(path, (text + _SEAL % zlib.crc32(text.encode())).encode(), sync=True)


def read_summary(path: Path) -> tuple[dict[str, Any], int]:
    """A summary and the checksum of its journal's last line. Raises UserError where it is damaged."""
    data = read_limited(path, _MAX_BYTES)
    text = data[:-_SEAL_LENGTH]
    if data[-_SEAL_LENGTH:] != (_SEAL % zlib.crc32(text)).encode():
        raise UserError(f"{path}: is damaged; delete it, and 'skysweep report {path.parent}' writes it anew")
    summary: dict[str, Any] = json.loads(text + b"}")
    return summary, int(summary.pop("journal"), 16)
