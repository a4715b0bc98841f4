"""MAVLink 2 signing for programs whose library cannot sign, as MAVSDK's cannot.

A relay in this process: MAVSDK speaks to it on loopback, it speaks to the vehicle. What goes out is signed;
what comes in unsigned, signed with another key, or played back goes no further.
"""

from __future__ import annotations

import selectors
import socket
import threading
from urllib.parse import urlparse

from skysweep.errors import UserError
from skysweep.vehicles.mavlink.dialect import mavlink, mavutil
from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.mavlink.wire import Voice

_LOOPBACK = "127.0.0.1"
_LOOK_UP_S = 0.2  # how often a closing relay notices
_READ_BYTES = 65_536
_BAUD = 57_600


class SignedLink:
    """Stands between MAVSDK, which connects to ``url``, and the vehicle at ``vehicle_url``.

    ``refused`` counts the frames of the vehicle that had no good signature. Raises UserError where
    ``vehicle_url`` cannot be opened.
    """

    def __init__(self, vehicle_url: str, key: bytes) -> None:
        self.refused = 0
        self._vehicle = _open(vehicle_url)
        self._program = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._program.bind((_LOOPBACK, 0))
        self._program_address = (_LOOPBACK, _free_port())
        self.url = "udpin://{}:{}".format(*self._program_address)
        self._from_vehicle, self._from_program = (mavlink.MAVLink(None) for _ in range(2))
        self._from_vehicle.signing.secret_key = key
        for parser in (self._from_vehicle, self._from_program):
            parser.robust_parsing = True
        self._signing = Signing(key)
        self._voices: dict[tuple[int, int], Voice] = {}
        self._open = True
        self._thread = threading.Thread(target=self._relay, name="signed link", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Lets go of both sides."""
        self._open = False
        self._thread.join()
        self._program.close()
        self._vehicle.close()

    def _relay(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._vehicle.fd, selectors.EVENT_READ, self._hear_vehicle)
            selector.register(self._program, selectors.EVENT_READ, self._hear_program)
            while self._open:
                for ready, _ in selector.select(_LOOK_UP_S):
                    ready.data()

    def _hear_vehicle(self) -> None:
        for message in self._from_vehicle.parse_buffer(self._vehicle.recv(_READ_BYTES)) or ():
            if message.get_type() == "BAD_DATA":
                self.refused += "signature" in message.reason
            else:
                self._program.sendto(message.get_msgbuf(), self._program_address)

    def _hear_program(self) -> None:
        for message in self._from_program.parse_buffer(self._program.recv(_READ_BYTES)) or ():
            if message.get_type() == "BAD_DATA":
                continue
            who = message.get_srcSystem(), message.get_srcComponent()
            if who not in self._voices:
                self._voices[who] = Voice(who[1], self._signing, system_id=who[0])
            self._vehicle.write(self._voices[who].pack(message))


def _open(url: str) -> mavutil.mavfile:
    """pymavlink's connection for an address as MAVSDK writes it."""
    parts = urlparse(url)
    try:
        if parts.scheme == "serial":
            path, _, baud = url.removeprefix("serial://").partition(":")
            return mavutil.mavserial(path, int(baud or _BAUD))
        address = f"{parts.hostname}:{parts.port}"
        if parts.scheme == "udpin":
            return mavutil.mavudp(address)
        if parts.scheme == "tcpout":
            return mavutil.mavtcp(address, retries=0)
    except (OSError, ValueError) as error:
        raise UserError(f"--connection {url}: cannot be opened ({error})") from None
    raise UserError(
        f"--connection {url}: write udpin://0.0.0.0:14540, tcpout://HOST:PORT or serial:///dev/ttyUSB0:57600"
    )


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((_LOOPBACK, 0))
        return int(probe.getsockname()[1])
