"""A terminal that never blocks a mission: output, and the Enter key."""

from __future__ import annotations

import io
import os
import select
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from queue import Full, Queue
from threading import Thread
from typing import Any, TextIO

_HELD = 256  # pieces of output that may wait for a reader
_DRAIN_S = 2.0


@contextmanager
def unblocked() -> Iterator[None]:
    """Make standard output and error drop unread output instead of blocking the writer.

    At the end of the block, waiting output has two seconds to be read.
    """
    with ExitStack() as stack:
        for stream, redirect in ((sys.stdout, redirect_stdout), (sys.stderr, redirect_stderr)):
            valve = _valve_of(stream)
            if valve is not None:
                stack.callback(valve.drain)
                unbuffered: Any = valve
                text = io.TextIOWrapper(unbuffered, stream.encoding, "backslashreplace", line_buffering=True)
                stack.callback(text.flush)
                stack.enter_context(redirect(text))
        yield


def enter_pressed() -> bool:
    """Whether Enter was pressed; all input is consumed, so that none of it counts later.

    A program in the background reads nothing: the terminal would stop it.
    """
    pressed = False
    while has_keyboard() and _is_in_front() and select.select([sys.stdin], [], [], 0.0)[0]:
        try:
            if not os.read(sys.stdin.fileno(), 1024):
                break
        except OSError:  # the terminal is gone
            break
        pressed = True
    return pressed


def has_keyboard() -> bool:
    """Whether standard input is a terminal; a closed one is none."""
    return sys.stdin is not None and not sys.stdin.closed and sys.stdin.isatty()


def _is_in_front() -> bool:
    """Whether the terminal's input is this program's; one that does not control it stops nobody."""
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:
        return True


class _Valve(io.RawIOBase):
    """Passes bytes to a file descriptor in a thread; bytes are lost while too many wait."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._waiting: Queue[bytes | None] = Queue(_HELD)
        Thread(target=self._pass_on, name="terminal", daemon=True).start()

    def write(self, data: Any) -> int:
        """Never waits."""
        with suppress(Full):
            self._waiting.put_nowait(bytes(data))
        return len(data)

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._descriptor

    def isatty(self) -> bool:
        return os.isatty(self._descriptor)

    def drain(self) -> None:
        """Give waiting output a little time, and end."""
        with suppress(Full):
            self._waiting.put_nowait(None)
        done = self._waiting.all_tasks_done
        with done:
            done.wait_for(lambda: self._waiting.unfinished_tasks == 0, _DRAIN_S)

    def _pass_on(self) -> None:
        """Straight to the descriptor: a lock of ``sys.stderr`` held here would hang the program's end."""
        while (data := self._waiting.get()) is not None:
            with suppress(OSError):  # the terminal was closed
                while data:
                    data = data[os.write(self._descriptor, data) :]
            self._waiting.task_done()
        self._waiting.task_done()


def _valve_of(stream: TextIO | None) -> _Valve | None:
    """A valve for the stream, or None if there is no file behind it."""
    try:
        return _Valve(stream.fileno()) if stream is not None else None
    except (OSError, ValueError):
        return None
