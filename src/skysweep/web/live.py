"""The page of a mission that this process flies: a server in a process of its own."""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread

from skysweep.mission.orders import Order
from skysweep.web.orders import Told
from skysweep.web.places import ITSELF
from skysweep.web.security import Access
from skysweep.web.server import address, listen, serve

_NICE = 5  # the mission goes first
_ENDS_S = 3.0


class LivePage:
    """Serves a run folder, which need not exist yet, while this process flies its mission.

    The two processes are joined only by a pipe through which the operator's orders come: the mission never
    waits for the server. ``address`` is to be opened in a browser. Raises UserError if the port is taken.
    """

    def __init__(self, folder: Path, access: Access, port: int | None = None) -> None:
        self._orders: deque[Told] = deque()
        self._pipe, theirs = multiprocessing.get_context("spawn").Pipe()
        listener = listen(access.host, port)
        self.address = address(listener, access)
        self._server = multiprocessing.get_context("spawn").Process(
            target=_serve, args=(folder.absolute(), listener, access, theirs), name="page", daemon=True
        )
        with _uninterrupted():
            self._server.start()
        listener.close()
        theirs.close()
        Thread(target=self._receive, name="orders", daemon=True).start()

    def order(self) -> Order | None:
        """The next order that was given on the page, if there is one."""
        return Order(*self._orders.popleft()) if self._orders else None

    def wait(self) -> None:
        """Return when the server has ended."""
        self._server.join()

    def close(self) -> None:
        """End the server."""
        self._server.terminate()
        self._server.join(_ENDS_S)
        self._server.kill()
        self._pipe.close()

    def _receive(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                self._orders.append(self._pipe.recv())


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Processes started in the block ignore Ctrl-C, which is for the mission."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _serve(folder: Path, listener: socket.socket, access: Access, orders: Connection) -> None:
    if hasattr(os, "setsid"):
        os.setsid()  # away from the terminal's Ctrl-C
    with suppress(OSError, AttributeError):
        os.nice(_NICE)
    Thread(target=_end_with, args=(orders,), name="mission", daemon=True).start()
    with suppress(KeyboardInterrupt):
        serve(folder, listener, access, ITSELF, orders.send)


def _end_with(mission: Connection) -> None:
    """End this process when that of the mission is gone."""
    with suppress(EOFError, OSError):
        mission.recv()
    os.kill(os.getpid(), signal.SIGTERM)
