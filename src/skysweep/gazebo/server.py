"""One gzserver process for one world, which never outlives this program."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import time
from contextlib import suppress
from pathlib import Path

from skysweep.errors import UserError
from skysweep.gazebo.install import Install

LOG_FILE = "gzserver.log"
_SERVE = Path(__file__).parent / "serve.sh"
_SGR = re.compile(r"\x1b\[[0-9;]*m")
_ERROR = re.compile(r"\[Err\]|Error|error:|terminate called|not found")
_SOUND = re.compile(r"ALSA|OpenAL|AL lib")


class GazeboServer:
    """gzserver with its own screen and process namespace.

    The kernel ends the whole namespace when this object is closed or this process dies, even by kill -9. The
    log is beside the world file.
    """

    def __init__(self, install: Install, world_file: Path) -> None:
        self.port = _free_port()
        self._folder = world_file.parent.resolve()
        self.log = self._folder / LOG_FILE
        as_root = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
        command = ["setpriv", "--pdeathsig", "KILL", "--", "unshare", *as_root, "--mount", "--pid", "--ipc"]
        command += ["--fork", "--kill-child=KILL", "--propagation", "private", "--", "bash", str(_SERVE)]
        command += [str(install.root), str(self._folder), world_file.name, str(self.port)]
        command += [str(install.plugin.parent)]
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C reaches this program only
            )
        self.pid = self._process.pid  # its end ends the namespace

    def is_running(self) -> bool:
        return self._process.poll() is None

    def complaint(self) -> str | None:
        """The first error in the log, in one line."""
        text = _SGR.sub("", self.log.read_text(errors="replace")) if self.log.exists() else ""
        errors = [
            line.strip() for line in text.splitlines() if _ERROR.search(line) and not _SOUND.search(line)
        ]
        return errors[0][:300] if errors else None

    def close(self) -> None:
        """Ends gzserver and all its processes; returns when they are gone."""
        if self.is_running():
            os.kill(self._first_of_namespace() or self.pid, signal.SIGKILL)
        self._process.wait()

    def _first_of_namespace(self) -> int | None:
        """The first process of the namespace: the kernel ends the namespace with it, then our child ends."""
        children = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()
        return int(children[0]) if children else None


def wait_for_port(server: GazeboServer, timeout_s: float) -> bool:
    """Whether the master listens within ``timeout_s``. Raises UserError if gzserver ends before."""
    give_up = time.monotonic() + timeout_s
    while time.monotonic() < give_up:
        if not server.is_running():
            why = server.complaint() or "it said nothing"
            raise UserError(f"gzserver ended at once ({why}); the whole log: {server.log}")
        with suppress(OSError), socket.create_connection(("127.0.0.1", server.port), 0.2):
            return True
        time.sleep(0.05)
    return False


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
