"""The page of a mission that this process flies: a server in a process of its own."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import socket
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread

from skysweep.errors import UserError
from skysweep.mission.orders import HOLD, RETURN, STEERING, VERDICTS, Order
from skysweep.web.places import ITSELF
from skysweep.web.scene import head_of
from skysweep.web.security import Access
from skysweep.web.server import address, listen, serve

_NICE = 5  # the mission goes first
_ENDS_S = 3.0
_LATE_S = 3.0  # between an order and the mission's next question
_NEVER_LATE = (HOLD, RETURN, *VERDICTS)  # what stops it, brings it home or moves nothing

log = logging.getLogger(__name__)


class LivePage:
    """Serves a run folder, which need not exist yet, while this process flies its mission.

    The two processes are joined only by a pipe through which the operator's orders come: the mission never
    waits for the server. ``address`` is to be opened in a browser. Raises UserError if the port is taken.
    """

    def __init__(self, folder: Path, access: Access, port: int | None = None) -> None:
        self._folder = folder.absolute()
        self._steering: deque[tuple[float, Order]] = deque()  # with the times at which they were given
        self._others: deque[tuple[float, Order]] = deque()
        self._pipe, theirs = multiprocessing.get_context("spawn").Pipe()
        listener = listen(access.host, port)
        self.address = address(listener, access)
        self._server = multiprocessing.get_context("spawn").Process(
            target=_serve, args=(self._folder, listener, access, theirs), name="page", daemon=True
        )
        with _uninterrupted():
            self._server.start()
        listener.close()
        theirs.close()
        Thread(target=self._receive, name="orders", daemon=True).start()

    @property
    def is_there(self) -> bool:
        """Whether the server runs: without it no order comes from the page."""
        return self._server.is_alive()

    def order(self) -> Order | None:
        """The next order that was given on the page, if there is one.

        Words that steer come before looks and verdicts, and in their own order: a ``continue`` that was said
        before a ``hold`` must not follow it. What waited for a real mission that stood still may be meant no
        more: it is left out, unless it stops the vehicle, brings it home, or moves nothing.
        """
        for orders in (self._steering, self._others):
            while orders:
                given_s, order = orders.popleft()
                late_s = time.monotonic() - given_s
                if late_s < _LATE_S or order.word in _NEVER_LATE or _is_simulated(self._folder):
                    return order
                log.warning(
                    "The order to %s waited for %.0f s and is left out: say it again.", order.word, late_s
                )
        return None

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
                given_s, order = self._pipe.recv()
                orders = self._steering if order.word in STEERING else self._others
                orders.append((given_s, order))


def _is_simulated(folder: Path) -> bool:
    """Whether a mission's vehicle is simulated with it, however slowly. In doubt it is not."""
    with suppress(UserError, OSError):
        return head_of(folder).get("replays") is True
    return False


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
        serve(folder, listener, access, ITSELF, lambda order: orders.send((time.monotonic(), order)))


def _end_with(mission: Connection) -> None:
    """End this process when that of the mission is gone."""
    with suppress(EOFError, OSError):
        mission.recv()
    os.kill(os.getpid(), signal.SIGTERM)
