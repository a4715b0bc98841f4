"""Frames on the wire: messages out of datagrams, and one voice for each component that speaks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from skysweep.vehicles.mavlink.dialect import mavlink
from skysweep.vehicles.mavlink.px4 import SYSTEM_ID
from skysweep.vehicles.mavlink.signing import SIGNATURE_BYTES, SIGNED, Signing

Message = Any  # a pymavlink message
_V1, _V2 = 0xFE, 0xFD
_HEADER_BYTES = {_V1: 6, _V2: 10}
_CRC_BYTES = 2
_MAX_FALSE_STARTS = 64  # in a datagram; the rest of one with more is noise


def read_frames(datagram: bytes, signing: Signing) -> Iterator[Message]:
    """Every sound message of a datagram in order; what is no frame or not authentic is passed over."""
    decoder = mavlink.MAVLink(None)
    at = false_starts = 0
    while at < len(datagram) and false_starts < _MAX_FALSE_STARTS:
        end = _end_of_frame(datagram, at)
        if end is not None:
            frame = datagram[at:end]
            try:
                message = decoder.decode(bytearray(frame))
            except mavlink.MAVError:
                message = None
            if message is not None and not isinstance(message, mavlink.MAVLink_unknown):
                if signing.accepts(frame):
                    yield message
                at = end
                continue
            false_starts += 1
        at += 1


def _end_of_frame(datagram: bytes, at: int) -> int | None:
    """Where the frame that begins at ``at`` ends, None where none does."""
    header = _HEADER_BYTES.get(datagram[at])
    if header is None or at + header > len(datagram):
        return None
    length = header + datagram[at + 1] + _CRC_BYTES
    if datagram[at] == _V2:
        if datagram[at + 2] & ~SIGNED:
            return None
        length += SIGNATURE_BYTES if datagram[at + 2] & SIGNED else 0
    return at + length if at + length <= len(datagram) else None


class Voice:
    """What one component says to one listener: with its own sequence numbers, signed where there is a key."""

    def __init__(self, component_id: int, signing: Signing, system_id: int = SYSTEM_ID) -> None:
        self._encoder = mavlink.MAVLink(None, system_id, component_id)
        self._encoder.signing.secret_key = signing.key
        self._encoder.signing.sign_outgoing = signing.key is not None
        self._signing = signing

    def pack(self, message: Message) -> bytes:
        """The frame of a message."""
        encoder = self._encoder
        if self._signing.key is not None:
            encoder.signing.timestamp = self._signing.stamp()
        frame: bytes = message.pack(encoder)
        encoder.seq = (encoder.seq + 1) % 256
        return frame
