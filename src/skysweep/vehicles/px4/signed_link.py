"""MAVLink 2 signing for MAVSDK, which cannot sign.

A relay in this process between MAVSDK on loopback and the vehicle. It signs outgoing frames and drops
incoming ones that are unsigned, signed with another key, or replayed.
"""

from __future__ import annotations

import secrets
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any
from urllib.parse import urlparse

from skysweep.errors import MissingExtraError, UserError
from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.mavlink.signing_memory import SigningMemory
from skysweep.vehicles.mavlink.wire import Frames, Message, Voice

_LOOPBACK = "127.0.0.1"
_LOOK_UP_S = 0.2  # until a relay notices that it is closed
_AGAIN_S = 1.0  # until a broken connection is retried
_SEND_S = 1.0
_READ_BYTES = 65_536
_BAUD = 57_600
_MAX_SENDERS = 16  # with incomplete frames


class _Wire:
    """Frames from and to the vehicle. Every method raises OSError if the connection is gone."""

    fileno: Callable[[], int]
    close: Callable[[], None]
    write: Callable[[bytes], Any]

    def read(self) -> Iterator[tuple[Message, bytes]]:
        """The complete frames of known messages; others can be neither checked nor signed."""
        raise NotImplementedError

    def trust(self) -> None:
        """The last frames came from the vehicle."""


class SignedLink:
    """A relay between MAVSDK, which connects to ``url``, and the vehicle at ``vehicle_url``.

    ``accepted`` and ``refused`` count the vehicle's frames with and without a good signature. A broken
    connection is opened again. Raises UserError if ``vehicle_url`` cannot be opened in ``timeout_s``, or the
    times of frames cannot be stored (``SigningMemory``).
    """

    def __init__(self, vehicle_url: str, key: bytes, timeout_s: float) -> None:
        self.accepted = self.refused = 0
        self._vehicle_url, self._timeout_s = vehicle_url, timeout_s
        try:
            self._vehicle = _open(vehicle_url, timeout_s)
        except (OSError, ValueError) as error:
            raise UserError(f"--connection {vehicle_url}: cannot be opened ({error})") from None
        try:
            self._signing = Signing(key, SigningMemory.of(key))
        except UserError:
            self._vehicle.close()
            raise
        self._program = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._program.bind((_LOOPBACK, 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((_LOOPBACK, 0))
            self._program_address = probe.getsockname()
        self.url = "udpin://{}:{}".format(*self._program_address)
        self._from_program = Frames()
        self._link_id = secrets.randbelow(256)  # two MAVSDK programs have the same ids
        self._voices: dict[tuple[int, int], Voice] = {}
        self._open = True
        self._thread = threading.Thread(target=self._relay, name="signed link", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Relays MAVSDK's last messages and closes both sides."""
        self._open = False
        self._thread.join()
        self._program.close()
        self._vehicle.close()
        self._signing.close()

    def _relay(self) -> None:
        while self._open:
            try:
                self._pass_on(_LOOK_UP_S)
            except OSError:
                self._connect_again()
        with suppress(OSError):
            self._hear_program()

    def _pass_on(self, wait_s: float) -> None:
        vehicle, program = self._vehicle.fileno(), self._program.fileno()
        ready, _, _ = select.select([vehicle, program], [], [], wait_s)
        if program in ready:
            self._hear_program()
        if vehicle in ready:
            self._hear_vehicle()

    def _hear_vehicle(self) -> None:
        for message, frame in self._vehicle.read():
            is_ours = _who(message) in self._voices  # sent back by somebody who has no key
            if not is_ours and self._signing.accepts(frame):
                self.accepted += 1
                self._vehicle.trust()
                self._program.sendto(frame, self._program_address)
            else:
                self.refused += 1

    def _hear_program(self) -> None:
        while select.select([self._program], [], [], 0.0)[0]:
            datagram, sender = self._program.recvfrom(_READ_BYTES)
            if sender != self._program_address:
                continue
            for message, _ in self._from_program.read(datagram):
                who = _who(message)
                if who not in self._voices:
                    self._voices[who] = Voice(who[1], self._signing, who[0], self._link_id)
                self._vehicle.write(self._voices[who].pack(message))

    def _connect_again(self) -> None:
        self._vehicle.close()
        while self._open:
            time.sleep(_AGAIN_S)
            try:
                self._vehicle = _open(self._vehicle_url, self._timeout_s)
                return
            except (OSError, ValueError):
                continue


class _Udp(_Wire):
    """Listens; sends to the last sender of a signed frame."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((host, port))
        self.fileno, self.close = self._socket.fileno, self._socket.close
        self._sender: Any = None
        self._vehicle: Any = None
        self._frames: dict[Any, Frames] = {}  # by sender, so that they do not mix; the newest last

    def read(self) -> Iterator[tuple[Message, bytes]]:
        datagram, self._sender = self._socket.recvfrom(_READ_BYTES)
        frames = self._frames[self._sender] = self._frames.pop(self._sender, Frames())
        if len(self._frames) > _MAX_SENDERS:
            del self._frames[next(iter(self._frames))]
        return frames.read(datagram)

    def trust(self) -> None:
        self._vehicle = self._sender

    def write(self, frame: bytes) -> None:
        if self._vehicle is not None:
            self._socket.sendto(frame, self._vehicle)


class _Tcp(_Wire):
    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        self._socket = socket.create_connection((host, port), timeout_s)
        self._socket.settimeout(_SEND_S)
        self.fileno, self.close, self.write = self._socket.fileno, self._socket.close, self._socket.sendall
        self._frames = Frames()

    def read(self) -> Iterator[tuple[Message, bytes]]:
        data = self._socket.recv(_READ_BYTES)
        if not data:
            raise ConnectionError("closed by the other side")
        return self._frames.read(data)


class _Serial(_Wire):
    def __init__(self, path: str, baud: int) -> None:
        try:
            import serial
        except ImportError:
            raise MissingExtraError("a serial link", "px4") from None
        self._port = serial.Serial(path, baud, timeout=0, write_timeout=_SEND_S)
        self.fileno, self.close, self.write = self._port.fileno, self._port.close, self._port.write
        self._frames = Frames()

    def read(self) -> Iterator[tuple[Message, bytes]]:
        return self._frames.read(bytes(self._port.read(_READ_BYTES)))


def _who(message: Message) -> tuple[int, int]:
    """System and component that a frame names as its sender."""
    return message.get_srcSystem(), message.get_srcComponent()


def _open(url: str, timeout_s: float) -> _Wire:
    """The connection of an address in MAVSDK's form. Raises OSError and ValueError."""
    parts = urlparse(url)
    if parts.scheme == "serial":
        path, _, baud = url.removeprefix("serial://").partition(":")
        return _Serial(path, int(baud or _BAUD))
    if parts.scheme in ("udpin", "tcpout") and parts.hostname and parts.port:
        if parts.scheme == "udpin":
            return _Udp(parts.hostname, parts.port)
        return _Tcp(parts.hostname, parts.port, timeout_s)
    raise ValueError("write udpin://0.0.0.0:14540, tcpout://HOST:PORT or serial:///dev/ttyUSB0:57600")
