"""Serves a vehicle over UDP, in real time or faster."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack

from skysweep.errors import UserError
from skysweep.scenarios.model import Scenario
from skysweep.types import Vehicle
from skysweep.vehicles.mavlink.modes import SYSTEM_ID
from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.mavlink.signing_memory import SigningMemory
from skysweep.vehicles.served.autopilot import Autopilot
from skysweep.vehicles.served.face import Face
from skysweep.vehicles.served.link import Address

LOOPBACK, EVERYWHERE = "127.0.0.1", "0.0.0.0"
OFFBOARD_PORT, GROUND_STATION_PORT = 14540, 14550  # the targets of PX4's simulation
_LARGEST_DATAGRAM = 4_096  # a frame has at most 280 bytes
_RECEIVE_S = 0.02  # on the wall, before the vehicle's next tick
_WATCH_EVERY_S = 0.2  # on the wall
_WAITS_FOR_PROGRAMS = ("COM_OF_LOSS_T", "COM_RC_LOSS_T", "COM_DISARM_PRFLT")
_MAX_LAG_S = 0.5  # on the wall; beyond it vehicle time runs slower


def address_of(host: str) -> str:
    """The IPv4 address of a name. Raises UserError if it has none."""
    try:
        return socket.gethostbyname(host)
    except OSError:
        raise UserError(f"--host: there is no computer '{host}'; write its name or IPv4 address") from None


class VehicleServer:
    """Flies ``vehicle`` for programs that speak MAVLink to it.

    Sends as ``system_id`` from ``local_port`` (0: any free one) on ``host`` to the ``listeners`` and to every
    program that speaks to it. If vehicle time runs faster than the wall clock, its timeouts for programs grow
    by the same factor, as in PX4's own simulations. Use it as a context manager, which runs it in a thread,
    or call ``run``, which blocks. Raises UserError if the port is taken, or the times of a signed link cannot
    be stored (``SigningMemory``).

    Example:
        with VehicleServer(vehicle, scenario, listeners=[("127.0.0.1", 14540)], speed=10.0) as server:
            ...  # a client connects to udpin://127.0.0.1:14540, or to server.address
    """

    def __init__(
        self,
        vehicle: Vehicle,
        scenario: Scenario,
        listeners: Iterable[Address] = ((LOOPBACK, OFFBOARD_PORT), (LOOPBACK, GROUND_STATION_PORT)),
        speed: float = 1.0,
        host: str = LOOPBACK,
        local_port: int = 0,
        signing_key: bytes | None = None,
        system_id: int = SYSTEM_ID,
    ) -> None:
        with ExitStack() as undo:
            self._socket = undo.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            try:
                self._socket.bind((host, local_port))
            except OSError as error:
                raise UserError(
                    f"--local-port: {host}:{local_port} is not available ({error.strerror}); "
                    "choose another one, and for a second vehicle another --port and --system-id as well "
                    "(ground stations tell two vehicles at one --gcs-port apart)"
                ) from None
            signing = None if signing_key is None else Signing(signing_key, SigningMemory.of(signing_key))
            undo.pop_all()
        self._socket.setblocking(False)
        self._speed = speed
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self.face = Face(vehicle, scenario, self._transmit, listeners, signing, time.time(), speed, system_id)
        for name in _WAITS_FOR_PROGRAMS if speed > 1.0 else ():
            self.face.parameters.stretch(name, speed)

    @property
    def address(self) -> Address:
        host, port = self._socket.getsockname()
        return host, port

    def run(self, watch: Callable[[Autopilot], None] = lambda _: None) -> None:
        """Serves until ``stop``; ``watch`` gets the autopilot a few times a second."""
        start_s = watched_s = time.monotonic()
        while not self._stopping.is_set():
            self._receive()
            now_s = time.monotonic()
            if now_s - watched_s >= _WATCH_EVERY_S:
                watched_s = now_s
                watch(self.face.pilot)
            due_s = start_s + self.face.pilot.time_s / self._speed
            if now_s - due_s > _MAX_LAG_S:
                start_s += now_s - due_s
            if now_s >= due_s:
                self.face.tick()
            else:
                select.select([self._socket], [], [], due_s - now_s)

    def stop(self) -> None:
        """Ends ``run`` within a tick."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
        self._socket.close()
        self.face.signing.close()

    def __enter__(self) -> VehicleServer:
        self._thread = threading.Thread(target=self.run, name="vehicle", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _receive(self) -> None:
        end_s = time.monotonic() + _RECEIVE_S
        while time.monotonic() < end_s:
            try:
                datagram, address = self._socket.recvfrom(_LARGEST_DATAGRAM)
            except BlockingIOError:
                return
            except ConnectionError:  # a listener that is not there
                continue
            self.face.receive(datagram, address)

    def _transmit(self, datagram: bytes, address: Address) -> None:
        with contextlib.suppress(OSError):  # not there, or its buffer is full: UDP may lose
            self._socket.sendto(datagram, address)
