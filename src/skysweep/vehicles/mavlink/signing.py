"""MAVLink 2 message signing: who may speak to the vehicle, and what it signs itself.

Rules of the MAVLink guide, "Message Signing": SHA-256 over key and frame, first 6 bytes; a timestamp in units
of 10 us since 2015 that must grow on every stream (link id, system, component).
"""

from __future__ import annotations

import hashlib
import hmac
import time
from pathlib import Path

from skysweep.errors import UserError
from skysweep.files.reading import read_limited

SIGNED = 0x01  # incompatibility flag
SIGNATURE_BYTES = 13
_EPOCH_2015_S = 1_420_070_400
_NEW_STREAM_MAY_LAG = 60 * 100_000  # a minute
_MAX_STREAMS = 256
_MAX_KEY_FILE_BYTES = 1000


def read_signing_key(path: str | Path) -> bytes:
    """The 32 bytes in a file of 64 hexadecimal digits. Raises UserError where it holds anything else."""
    try:
        key = bytes.fromhex(read_limited(path, _MAX_KEY_FILE_BYTES).decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != 32:
        raise UserError(f"{path}: is no signing key; write 64 hexadecimal digits (openssl rand -hex 32)")
    return key


class Signing:
    """Signs and checks frames with one key. Without a key everything passes and nothing is signed."""

    def __init__(self, key: bytes | None) -> None:
        self.key = key
        self._newest = 0
        self._streams: dict[tuple[int, int, int], int] = {}

    def accepts(self, frame: bytes) -> bool:
        """Whether a whole frame may be acted on. Only a good signature moves its stream's clock."""
        if self.key is None:
            return True
        if frame[0] != 0xFD or not frame[2] & SIGNED:
            return False
        body, signature = frame[:-6], frame[-6:]
        if not hmac.compare_digest(hashlib.sha256(self.key + body).digest()[:6], signature):
            return False
        stream = (body[-7], frame[5], frame[6])
        timestamp = int.from_bytes(body[-6:], "little")
        last = self._streams.get(stream)
        if timestamp <= (self._now() - _NEW_STREAM_MAY_LAG if last is None else last):
            return False
        if last is None and len(self._streams) >= _MAX_STREAMS:
            return False
        self._streams[stream] = timestamp
        self._newest = max(self._newest, timestamp)
        return True

    def stamp(self) -> int:
        """The timestamp of the next frame of ours."""
        self._newest = max(self._newest + 1, self._now())
        return self._newest

    @staticmethod
    def _now() -> int:
        return int((time.time() - _EPOCH_2015_S) * 1e5)
