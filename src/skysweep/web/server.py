"""Runs the server."""

from __future__ import annotations

import socket
from contextlib import closing
from pathlib import Path

import uvicorn

from skysweep.errors import UserError
from skysweep.web.app import App, Give
from skysweep.web.places import Places
from skysweep.web.security import Access

PORT = 8765
_TRIES = 20  # ports after that
_GRACE_S = 1


def listen(host: str, port: int | None) -> socket.socket:
    """A socket on ``port``, or on the first free one from ``PORT``. Raises UserError if none is free."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    wanted = range(PORT, PORT + _TRIES) if port is None else [port]
    reason = ""
    for number in wanted:
        listener = socket.socket(family, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, number))
        except (TypeError, UnicodeError):  # of its encoding
            listener.close()
            raise UserError(f"--host {host}: is no name or address of this computer") from None
        except (OSError, OverflowError) as error:
            listener.close()
            reason = getattr(error, "strerror", None) or str(error)
        else:
            listener.listen()
            return listener
    option = f"--port {wanted[0]}" if port is not None else f"--host {host}"
    raise UserError(f"{option}: cannot be listened at ({reason}); choose another")


def address(listener: socket.socket, access: Access) -> str:
    """What to open in a browser. The token is in the fragment, which browsers send to nobody."""
    port = listener.getsockname()[1]
    name = f"[{access.host}]" if ":" in access.host else access.host
    if name in ("0.0.0.0", "[::]"):
        name = socket.gethostname()
    return f"http://{name}:{port}/#token={access.token}"


def serve(
    root: Path,
    listener: socket.socket,
    access: Access,
    live: str | None = None,
    give: Give | None = None,
) -> None:
    """Serve a folder until SIGINT or SIGTERM. ``live`` and ``give`` are as in ``App``."""
    app = App(Places(root), access, live, give).asgi()
    config = uvicorn.Config(
        app,
        log_level="critical",
        access_log=False,
        server_header=False,
        ws_per_message_deflate=not access.is_loopback,
        timeout_graceful_shutdown=_GRACE_S,
        lifespan="off",
    )
    with closing(listener):
        uvicorn.Server(config).run([listener])
