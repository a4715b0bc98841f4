"""What a restart must not forget of signed links: up to when each stream has been heard.

A file for each key in ``$XDG_STATE_HOME/skysweep`` (``~/.local/state/skysweep``); its name is made from the
key's digest. Programs on one computer that share a key share the file: each keeps what the others wrote.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

from skysweep.errors import UserError
from skysweep.files.writing import replace_file

try:
    import fcntl
except ImportError:  # only POSIX has it; elsewhere two programs at once may forget what the other heard
    fcntl = None  # type: ignore[assignment]

Stream = tuple[int, int, int]  # link id, system, component


class SigningMemory:
    """Newest timestamps by stream, in a file that is replaced whole."""

    def __init__(self, path: Path) -> None:
        self._path = path

    @classmethod
    def of(cls, key: bytes) -> SigningMemory:
        """Where this user's programs keep those of ``key``."""
        state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
        return cls(state / "skysweep" / f"signing-{hashlib.sha256(key).hexdigest()[:16]}.json")

    def read(self) -> dict[Stream, int]:
        """What was kept; nothing where there is no file. Raises ValueError where the file is damaged."""
        try:
            kept = json.loads(self._path.read_text(encoding="ascii"))
            streams = {tuple(map(int, name.split("/"))): int(newest) for name, newest in kept.items()}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, AttributeError, TypeError) as error:
            raise ValueError(str(error)) from None
        return {(link, system, component): newest for (link, system, component), newest in streams.items()}

    def write(self, streams: dict[Stream, int], oldest: int) -> None:
        """Keeps these and what others kept since, from ``oldest`` on. Raises OSError."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.with_suffix(".lock").open("w") as lock:
            if fcntl is not None:
                fcntl.flock(lock, fcntl.LOCK_EX)
            self._write(streams, oldest)

    def _write(self, streams: dict[Stream, int], oldest: int) -> None:
        try:
            kept = self.read()
        except ValueError:
            kept = {}
        for stream, newest in streams.items():
            kept[stream] = max(newest, kept.get(stream, 0))
        text = json.dumps({"/".join(map(str, s)): newest for s, newest in kept.items() if newest >= oldest})
        replace_file(self._path, text.encode("ascii"))

    def must_be_writable(self) -> None:
        """Raises UserError where nothing can be kept."""
        try:
            self.write({}, 0)
        except OSError as error:
            raise UserError(
                f"{self._path}: cannot be written ({error.strerror}), and a signed link needs it to refuse "
                "old frames; set XDG_STATE_HOME to a folder that can be written"
            ) from None
