"""A link over UDP that can be cut."""

from __future__ import annotations

import select
import socket
import threading

from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.served.server import LOOPBACK


class Relay:
    """Carries datagrams between a vehicle and a program at ``program_port``, while ``open``.

    ``port`` is where the vehicle sends to (0: any free one), ``commands`` the program's that went through.
    """

    def __init__(self, program_port: int, port: int = 0) -> None:
        self.open, self._running = True, True
        self.commands: list[int] = []
        self._decoder = m.MAVLink(None)
        self._decoder.robust_parsing = True
        self._there = (LOOPBACK, program_port)
        self._vehicle: tuple[str, int] | None = None
        self._near, self._far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._near.bind((LOOPBACK, port))
        self._far.bind((LOOPBACK, 0))
        self.port = self._near.getsockname()[1]
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def _carry(self) -> None:
        while self._running:
            for ready in select.select([self._near, self._far], [], [], 0.05)[0]:
                datagram, sender = ready.recvfrom(65_535)
                if ready is self._near:
                    self._vehicle = sender
                if self.open and ready is self._near:
                    self._far.sendto(datagram, self._there)
                elif self.open and self._vehicle is not None:
                    self._near.sendto(datagram, self._vehicle)
                    said = self._decoder.parse_buffer(datagram) or ()
                    self.commands += [int(x.command) for x in said if x.get_type() == "COMMAND_LONG"]

    def close(self) -> None:
        self._running = False
        self._thread.join()
        self._near.close()
        self._far.close()
