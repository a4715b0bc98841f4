"""Who may see and control: addresses, origins, the token, and what a page may load."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import secrets
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_OPEN = ("/api/session",)  # checks the token itself
_REFUSED = 1008  # code of a closed websocket: policy violation


@dataclass(frozen=True, slots=True)
class Access:
    """Who may see and control a server that listens at ``host``.

    On loopback everybody on this computer may see; elsewhere seeing needs the token, too. Controls always
    need it.
    """

    host: str
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    tiles: str | None = None  # address of map tiles that the page may load

    @property
    def is_loopback(self) -> bool:
        """Whether only this computer can reach the server."""
        return is_loopback(self.host)

    @property
    def cookie(self) -> str:
        """The name of the cookie of a session: browsers do not tell servers on two ports apart."""
        return f"skysweep-{hashlib.sha256(self.token.encode()).hexdigest()[:8]}"

    @property
    def sight(self) -> str:
        """The value of that cookie: it lets see, and never order, whatever server of this host gets it."""
        return hmac.new(self.token.encode(), b"see", hashlib.sha256).hexdigest()

    def has_token(self, connection: HTTPConnection) -> bool:
        """Whether a request shows the token as its bearer."""
        scheme, _, given = connection.headers.get("authorization", "").partition(" ")
        return scheme.lower() == "bearer" and _are_equal(given, self.token)

    def may_see(self, connection: HTTPConnection) -> bool:
        """Whether a request may read."""
        given = connection.cookies.get(self.cookie, "")
        return self.is_loopback or self.has_token(connection) or _are_equal(given, self.sight)

    def is_expected(self, connection: HTTPConnection) -> bool:
        """Whether a request is for this server and comes from its own pages, if from any.

        The host is checked because another name may be made to lead here (DNS rebinding).
        """
        host, origin = connection.headers.get("host", ""), connection.headers.get("origin")
        try:
            is_here = not self.is_loopback or is_loopback(_name_of(host))
            return is_here and (origin is None or (origin != "null" and urlsplit(origin).netloc == host))
        except ValueError:  # no address
            return False

    @property
    def policy(self) -> str:
        """The content security policy of the page."""
        tiles = f" {_origin_of(self.tiles)}" if self.tiles else ""
        return (
            "default-src 'none'; script-src 'self'; style-src 'self'; style-src-attr 'unsafe-inline'; "
            f"font-src 'self'; img-src 'self' data: blob:{tiles}; connect-src 'self'{tiles}; "
            "worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )


class Guard:
    """Refuses requests that ``access`` does not allow, and puts the headers on the others' answers."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request. As ASGI says."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        refusal = self._refusal(connection)

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.setdefault("content-security-policy", self._access.policy)
                is_data = scope["path"].startswith("/api/")
                headers.setdefault("cache-control", "no-store" if is_data else "no-cache")
                headers["x-content-type-options"] = "nosniff"
                headers["referrer-policy"] = "no-referrer"
                headers["cross-origin-resource-policy"] = "same-origin"
                headers["cross-origin-opener-policy"] = "same-origin"
            await send(message)

        if refusal is None:
            await self._app(scope, receive, send_guarded)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": _REFUSED, "reason": refusal[1]})
        else:
            answer = JSONResponse({"error": refusal[1]}, refusal[0])
            await answer(scope, receive, send_guarded)

    def _refusal(self, connection: HTTPConnection) -> tuple[int, str] | None:
        if not self._access.is_expected(connection):
            return 403, "This request comes from another page or is for another address."
        path = connection.scope["path"]
        if path.startswith("/api/") and path not in _OPEN and not self._access.may_see(connection):
            return 401, "Open the address that skysweep printed: it holds the token."
        return None


def is_loopback(host: str) -> bool:
    """Whether a name or address is this computer's own and reachable only from it."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _are_equal(given: str, wanted: str) -> bool:
    """Whether two texts are equal; how long that takes says nothing of them."""
    return hmac.compare_digest(given.encode(), wanted.encode())


def _name_of(host: str) -> str:
    """The name or address in ``NAME:PORT``."""
    return urlsplit(f"//{host}").hostname or ""


def _origin_of(address: str) -> str:
    parts = urlsplit(address)
    return f"{parts.scheme}://{parts.netloc}"
