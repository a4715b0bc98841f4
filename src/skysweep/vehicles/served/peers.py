"""The listeners: the configured addresses, and others for as long as they talk."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from skysweep.vehicles.mavlink.wire import Message
from skysweep.vehicles.served.link import Address, Peer
from skysweep.vehicles.served.telemetry import Report, Streams

MAX_GUESTS = 8


@dataclass(slots=True)
class Listener:
    """A peer with its streams."""

    peer: Peer
    streams: Streams
    heard_s: float
    parameters: Iterator[list[Message]] = field(default_factory=lambda: iter(()))  # still to be sent


class Peers:
    """The listeners by address.

    ``hosts`` always hear the vehicle. Others that send a valid message are guests and hear it until they are
    silent for ``silent_s``; ground stations send a heartbeat every second. A talking guest is never dropped
    for another: beyond MAX_GUESTS a program is answered, but gets no telemetry.
    """

    def __init__(
        self,
        hosts: Iterable[Address],
        peer_at: Callable[[Address], Peer],
        reports: dict[int, Report],
        silent_s: float,
    ) -> None:
        self._peer_at, self._reports, self._silent_s = peer_at, reports, silent_s
        self._guests: dict[Address, Listener] = {}
        self._hosts = {address: self._listener(address, 0.0) for address in hosts}

    def get(self, address: Address) -> Listener | None:
        return self._hosts.get(address) or self._guests.get(address)

    def hear(self, address: Address, time_s: float) -> Peer:
        """The peer that sent a valid message."""
        listener = self.get(address)
        if listener is None:
            listener = self._listener(address, time_s)
            if len(self._guests) >= MAX_GUESTS:
                silent = min(self._guests, key=lambda guest: self._guests[guest].heard_s)
                if not self._talks(self._guests[silent], time_s):
                    del self._guests[silent]
            if len(self._guests) < MAX_GUESTS:
                self._guests[address] = listener
        listener.heard_s = time_s
        return listener.peer

    def listening(self, time_s: float) -> list[Listener]:
        """The listeners now. A guest that comes back keeps its streams."""
        guests = (guest for guest in self._guests.values() if self._talks(guest, time_s))
        return [*self._hosts.values(), *guests]

    def _talks(self, listener: Listener, time_s: float) -> bool:
        return time_s - listener.heard_s <= self._silent_s

    def _listener(self, address: Address, time_s: float) -> Listener:
        return Listener(self._peer_at(address), Streams(self._reports), time_s)
