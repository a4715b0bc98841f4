"""Peers that hear the vehicle, and programs that send to it."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

from skysweep.vehicles.mavlink.dialect import mavlink
from skysweep.vehicles.mavlink.modes import AUTOPILOT
from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.mavlink.wire import Message, Voice

Address = tuple[str, int]
Key = tuple[Address, int, int]  # a program: its address, system and component
NOTICE, WARNING, CRITICAL = 5, 4, 2  # MAV_SEVERITY
_TEXT_BYTES = 50


class Peer:
    """An address that hears the vehicle."""

    def __init__(
        self, address: Address, transmit: Callable[[bytes, Address], None], signing: Signing, system_id: int
    ) -> None:
        self.address, self._transmit, self._signing = address, transmit, signing
        self._system_id = system_id
        self._voices: dict[int, Voice] = {}

    def send(self, message: Message, component: int = AUTOPILOT) -> None:
        """Sends a message as one of the vehicle's components."""
        if component not in self._voices:
            self._voices[component] = Voice(component, self._signing, self._system_id)
        self._transmit(self._voices[component].pack(message), self.address)


@dataclass(frozen=True, slots=True)
class Sender:
    """A program that sends to the vehicle: its address and MAVLink ids."""

    peer: Peer
    system: int
    component: int

    @property
    def key(self) -> Key:
        return self.peer.address, self.system, self.component

    def reply(self, message: Message, component: int = AUTOPILOT) -> None:
        self.peer.send(message, component)

    def tell(self, text: str, severity: int = WARNING) -> None:
        for message in status_texts(text, severity):
            self.reply(message)


def status_texts(text: str, severity: int) -> list[Message]:
    """STATUSTEXT messages of a text: one up to 50 bytes, else chunks with a common id."""
    raw = text.encode()
    parts = [raw[i : i + _TEXT_BYTES] for i in range(0, len(raw), _TEXT_BYTES)]
    text_id = 0 if len(parts) == 1 else 1 + zlib.crc32(raw) % 65535
    return [mavlink.MAVLink_statustext_message(severity, part, text_id, i) for i, part in enumerate(parts)]
