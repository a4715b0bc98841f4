"""Listeners: who hears the vehicle, and who said something to it."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

from skysweep.vehicles.mavlink.dialect import mavlink
from skysweep.vehicles.mavlink.modes import AUTOPILOT
from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.mavlink.wire import Message, Voice

Address = tuple[str, int]
Key = tuple[Address, int, int]  # a program: where it speaks from, system and component
NOTICE, WARNING, CRITICAL = 5, 4, 2  # MAV_SEVERITY
_TEXT_BYTES = 50


class Peer:
    """One address that hears the vehicle."""

    def __init__(
        self, address: Address, transmit: Callable[[bytes, Address], None], signing: Signing
    ) -> None:
        self.address = address
        self._transmit = transmit
        self._signing = signing
        self._voices: dict[int, Voice] = {}

    def send(self, message: Message, component: int = AUTOPILOT) -> None:
        """Says something as one of the vehicle's components."""
        voice = self._voices.get(component)
        if voice is None:
            voice = self._voices[component] = Voice(component, self._signing)
        self._transmit(voice.pack(message), self.address)


@dataclass(frozen=True, slots=True)
class Sender:
    """A program that speaks: MAVLink ids and the address it speaks from."""

    peer: Peer
    system: int
    component: int
    key: Key = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "key", (self.peer.address, self.system, self.component))

    def reply(self, message: Message, component: int = AUTOPILOT) -> None:
        """Answers this program alone."""
        self.peer.send(message, component)

    def tell(self, text: str, severity: int = WARNING) -> None:
        """A STATUSTEXT for this program alone."""
        for message in status_texts(text, severity):
            self.reply(message)


def status_texts(text: str, severity: int) -> list[Message]:
    """STATUSTEXT of a text that fits into one (50 bytes), or several chunks with one id."""
    raw = text.encode()
    parts = [raw[i : i + _TEXT_BYTES] for i in range(0, len(raw), _TEXT_BYTES)]
    text_id = 0 if len(parts) == 1 else 1 + zlib.crc32(raw) % 65535
    return [mavlink.MAVLink_statustext_message(severity, part, text_id, i) for i, part in enumerate(parts)]
