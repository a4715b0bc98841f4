"""Frames on the wire: decoding of incoming bytes, and encoding per component."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from skysweep.vehicles.mavlink.dialect import mavlink
from skysweep.vehicles.mavlink.modes import SYSTEM_ID
from skysweep.vehicles.mavlink.signing import SIGNATURE_BYTES, SIGNED, Signing

Message = Any  # a pymavlink message
_V1, _V2 = 0xFE, 0xFD
_HEADER_BYTES = {_V1: 6, _V2: 10}
_FLAGS_END = 3  # bytes of a header that determine the length of the frame
_CRC_BYTES = 2
_FALSE_STARTS, _MORE_FALSE_STARTS = 64, 4  # allowed in one piece, and more per valid frame; then it is noise


class Frames:
    """Finds the frames in the bytes of one sender; a frame may come in pieces.

    Bytes that only look like the start of a frame delay the following frames, but lose none.
    """

    def __init__(self) -> None:
        self._decoder = mavlink.MAVLink(None)
        self._begun = b""  # an incomplete frame

    def read(self, piece: bytes, is_last: bool = False) -> Iterator[tuple[Message, bytes]]:
        """Every valid message that is complete by now, with its frame. ``is_last``: nothing will follow."""
        data, self._begun = self._begun + piece, b""
        at, false_starts = 0, _FALSE_STARTS
        while at < len(data) and false_starts > 0:
            end = _end_of_frame(data, at)
            if end is not None and end > len(data) and not is_last:
                self._begun = data[at:]
                return
            if end is not None and end <= len(data):
                frame = data[at:end]
                try:
                    message = self._decoder.decode(bytearray(frame))
                except mavlink.MAVError:
                    message = None
                if message is not None and not isinstance(message, mavlink.MAVLink_unknown):
                    yield message, frame
                    at = end
                    false_starts += _MORE_FALSE_STARTS
                    continue
                false_starts -= 1
            at += 1


def read_frames(datagram: bytes, signing: Signing) -> Iterator[Message]:
    """Every valid and authentic message of a datagram, in order."""
    for message, frame in Frames().read(datagram, is_last=True):
        if signing.accepts(frame):
            yield message


def _end_of_frame(data: bytes, at: int) -> int | None:
    """The end of the frame that begins at ``at``, perhaps beyond the data; None if none begins there."""
    header = _HEADER_BYTES.get(data[at])
    if header is None:
        return None
    if at + _FLAGS_END > len(data):
        return at + header
    length = header + data[at + 1] + _CRC_BYTES
    if data[at] == _V2:
        if data[at + 2] & ~SIGNED:
            return None
        length += SIGNATURE_BYTES if data[at + 2] & SIGNED else 0
    return at + length


class Voice:
    """Encodes the messages of one component to one listener, signed if there is a key.

    Programs with the same ids and key need different ``link_id``s: a shared stream refuses the slower clock.
    """

    def __init__(
        self, component_id: int, signing: Signing, system_id: int = SYSTEM_ID, link_id: int = 0
    ) -> None:
        self._encoder = mavlink.MAVLink(None, system_id, component_id)
        self._encoder.signing.secret_key = signing.key
        self._encoder.signing.sign_outgoing = signing.key is not None
        self._encoder.signing.link_id = link_id
        self._signing = signing

    def pack(self, message: Message) -> bytes:
        encoder = self._encoder
        if self._signing.key is not None:
            encoder.signing.timestamp = self._signing.stamp()
        frame: bytes = message.pack(encoder)
        encoder.seq = (encoder.seq + 1) % 256
        return frame
