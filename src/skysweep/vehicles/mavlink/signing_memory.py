"""Keeps the newest timestamp of each signed stream across restarts.

There is one file per key in ``$XDG_STATE_HOME/skysweep`` (``~/.local/state/skysweep``), named by the key's
digest. Programs on one computer that share a key share the file: each keeps the entries of the others.
"""

from __future__ import annotations

import hashlib
import json
import os
from contextlib import suppress
from pathlib import Path

from skysweep.errors import UserError
from skysweep.files.writing import replace_file

try:
    import fcntl
except ImportError:  # only POSIX has it; elsewhere simultaneous programs may lose each other's entries
    fcntl = None  # type: ignore[assignment]

Stream = tuple[int, int, int]  # link id, system, component


class SigningMemory:
    """Newest timestamps by stream, in a file that is replaced as a whole."""

    def __init__(self, path: Path) -> None:
        self._path = path

    @classmethod
    def of(cls, key: bytes) -> SigningMemory:
        """The memory of ``key`` in this user's state folder."""
        state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
        return cls(state / "skysweep" / f"signing-{hashlib.sha256(key).hexdigest()[:16]}.json")

    def read(self) -> dict[Stream, int]:
        """The stored timestamps; none if there is no file. Raises ValueError if the file is damaged."""
        try:
            kept = json.loads(self._path.read_text(encoding="ascii"))
            streams = {tuple(map(int, name.split("/"))): int(newest) for name, newest in kept.items()}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, AttributeError, TypeError) as error:
            raise ValueError(str(error)) from None
        return {(link, system, component): newest for (link, system, component), newest in streams.items()}

    def write(self, streams: dict[Stream, int], oldest: int) -> None:
        """Stores these and the entries of others, from ``oldest`` on, and the newest. Raises OSError."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.with_suffix(".lock").open("w") as lock:
            if fcntl is not None:
                fcntl.flock(lock, fcntl.LOCK_EX)
            kept: dict[Stream, int] = {}
            with suppress(ValueError):
                kept = self.read()
            for stream, newest in streams.items():
                kept[stream] = max(newest, kept.get(stream, 0))
            oldest = min(oldest, max(kept.values(), default=oldest))
            names = {"/".join(map(str, s)): newest for s, newest in kept.items() if newest >= oldest}
            replace_file(self._path, json.dumps(names).encode("ascii"))

    def must_be_writable(self) -> None:
        """Raises UserError if nothing can be stored."""
        try:
            self.write({}, 0)
        except OSError as error:
            raise UserError(
                f"{self._path}: cannot be written ({error.strerror}), and a signed link needs it to refuse "
                "old frames; set XDG_STATE_HOME to a writable folder"
            ) from None
