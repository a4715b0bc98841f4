"""MAVLink 2 message signing of incoming and outgoing frames.

Rules of the MAVLink guide, "Message Signing": SHA-256 over key and frame, first 6 bytes; a timestamp in units
of 10 us since 2015 that must grow on every stream (link id, system, component), across restarts too, and must
not be more than a minute old. Unlike in the guide, it must not be more than a minute ahead either: no clock
can push those of all others out of reach.
"""

from __future__ import annotations

import hashlib
import hmac
import threading
import time
from contextlib import suppress
from pathlib import Path
from queue import Queue

from skysweep.errors import UserError
from skysweep.files.reading import read_limited
from skysweep.vehicles.mavlink.signing_memory import SigningMemory, Stream

SIGNED = 0x01  # incompatibility flag
SIGNATURE_BYTES = 13
_EPOCH_2015_S = 1_420_070_400
_SECOND = 100_000
_WINDOW = 60 * _SECOND  # around the local time
_KEPT_AHEAD = 2 * _SECOND  # times are stored that far ahead, and again when half of it is left
_MAX_STREAMS = 1024
_MAX_KEY_FILE_BYTES = 1000


def read_signing_key(path: str | Path) -> bytes:
    """The 32 bytes in a file of 64 hexadecimal digits. Raises UserError for any other content."""
    try:
        key = bytes.fromhex(read_limited(path, _MAX_KEY_FILE_BYTES).decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != 32:
        raise UserError(f"{path}: is not a signing key; write 64 hexadecimal digits (openssl rand -hex 32)")
    return key


class Signing:
    """Signs and checks frames with one key. Without a key everything passes and nothing is signed.

    ``memory`` keeps frames from before a restart refused. The computer's clock is read only once, because a
    clock that is set in flight must not make the vehicle deaf. A clock behind ``memory`` is wrong; the first
    good frame that is newer than all of ``memory`` sets it. Raises UserError if ``memory`` cannot be written.
    """

    def __init__(self, key: bytes | None, memory: SigningMemory | None = None) -> None:
        self.key = key
        self._begun, self._begun_s = round((time.time() - _EPOCH_2015_S) * _SECOND), _elapsed_s()
        self._streams: dict[Stream, int] = {}  # in the order of their last frames
        self._unseen_after = 0  # any other stream must be newer
        self._clock_is_wrong = False
        self._kept = self._recall(memory)
        self._streams.update(self._kept)
        self._newest = min(max(self._kept.values(), default=0), self._begun + _WINDOW)
        self._due: Queue[tuple[dict[Stream, int], int] | None] = Queue(1)
        self._writer: threading.Thread | None = None
        if memory is not None:  # a slow disk must not delay the vehicle
            self._writer = threading.Thread(target=self._write, args=(memory,), name="signing", daemon=True)
            self._writer.start()

    def _recall(self, memory: SigningMemory | None) -> dict[Stream, int]:
        if memory is None:
            return {}
        kept: dict[Stream, int] = {}
        try:
            kept = memory.read()
        except ValueError:  # it may have held anything heard before now
            self._unseen_after = self._begun
        memory.must_be_writable()
        newest = max(kept.values(), default=0) - _KEPT_AHEAD
        self._clock_is_wrong = self._begun < newest - _WINDOW
        if self._clock_is_wrong:
            self._begun, self._unseen_after = newest - _WINDOW, newest
        return kept

    def accepts(self, frame: bytes) -> bool:
        """Whether a complete frame is authentic. Only a good signature advances its stream's time."""
        if self.key is None:
            return True
        if frame[0] != 0xFD or not frame[2] & SIGNED:
            return False
        body, signature = frame[:-6], frame[-6:]
        if not hmac.compare_digest(hashlib.sha256(self.key + body).digest()[:6], signature):
            return False
        stream = (body[-7], frame[5], frame[6])
        timestamp = int.from_bytes(body[-6:], "little")
        if timestamp <= self._streams.get(stream, self._unseen_after):
            return False
        ahead = timestamp - self._now()
        if ahead < -_WINDOW or (ahead > _WINDOW and not self._clock_is_wrong):
            return False
        if self._clock_is_wrong:
            self._begun, self._clock_is_wrong = self._begun + ahead, False
        self._streams.pop(stream, None)
        self._streams[stream] = timestamp
        if len(self._streams) > _MAX_STREAMS:
            longest_silent = next(iter(self._streams))
            self._unseen_after = max(self._unseen_after, self._streams.pop(longest_silent))
        self._newest = max(self._newest, timestamp)
        self._keep(stream)
        return True

    def _keep(self, stream: Stream) -> None:
        """Stores a stream's time before it is reached; that of a new stream soon after."""
        if self._writer is None or self._kept.get(stream, 0) - self._streams[stream] > _KEPT_AHEAD // 2:
            return
        if not self._due.full():
            oldest = self._now() - _WINDOW  # older times are refused anyway
            self._kept = {s: newest + _KEPT_AHEAD for s, newest in self._streams.items() if newest >= oldest}
            self._due.put((self._kept, oldest))

    def _write(self, memory: SigningMemory) -> None:
        while (due := self._due.get()) is not None:
            with suppress(OSError):  # a full disk must not make the vehicle deaf
                memory.write(*due)

    def close(self) -> None:
        """Stores the times of all streams."""
        if self._writer is not None:
            self._due.put((self._streams, self._now() - _WINDOW))
            self._due.put(None)
            self._writer.join()

    def stamp(self) -> int:
        self._newest = max(self._newest + 1, self._now())
        return self._newest

    def _now(self) -> int:
        return self._begun + int((_elapsed_s() - self._begun_s) * _SECOND)


def _elapsed_s() -> float:
    """Of a clock that nobody sets; on Linux it goes on while the computer sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()
