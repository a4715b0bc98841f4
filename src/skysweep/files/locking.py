"""Locks for a single writer. A lock ends with its process, so that a kill leaves nothing to clean up."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from skysweep.errors import UserError

try:
    import fcntl
except ImportError:  # only POSIX has it; elsewhere two writers are not prevented
    fcntl = None  # type: ignore[assignment]


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder. Raises UserError if another process holds it."""
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        lock(descriptor, folder)
        yield
    finally:
        os.close(descriptor)


def lock(descriptor: int, path: Path) -> None:
    """Lock an open file until it is closed. Raises UserError if another process holds the lock."""
    if fcntl is None:
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            raise UserError(
                f"{path}: another skysweep is writing it; wait until that one has ended, or stop it"
            ) from None
        if error.errno not in (
            errno.EBADF,
            errno.ENOLCK,
            errno.ENOSYS,
            errno.ENOTSUP,
        ):  # file systems without locks
            raise
