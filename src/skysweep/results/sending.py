"""Sends a mission's Cursor-on-Target events over UDP, once or as the mission goes on."""

from __future__ import annotations

import ipaddress
import math
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from urllib.parse import urlsplit

from skysweep.errors import UserError
from skysweep.results.cot import CotEvent, deletion, events_of, uids_of_nothing, vehicle_event
from skysweep.results.run_folder import JOURNAL_FILE, Run, load_flown

_AGAIN_S = 30.0  # between two of the same event: datagrams get lost, and devices join late
_PERIOD_S = 1.0  # between two looks into the journal

Send = Callable[[CotEvent], None]


@contextmanager
def udp(address: str, ttl: int) -> Iterator[Send]:
    """What sends an event to ``udp://HOST:PORT``, one a datagram; ``ttl`` is of multicast.

    Raises UserError where that is no such address, and ``send`` does where it cannot be reached.
    """
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port or parts.scheme != "udp" or parts.path.strip("/"):
        raise UserError(f"--to {address}: is no address; write udp://HOST:PORT, such as udp://239.2.3.1:6969")
    try:
        family, *_, there = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError) as error:
        raise UserError(f"--to {address}: {host} is not known ({error}); check its name") from None
    with socket.socket(family, socket.SOCK_DGRAM) as sender:
        if ipaddress.ip_address(str(there[0]).partition("%")[0]).is_multicast:
            if family == socket.AF_INET6:
                sender.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, ttl)
            else:
                sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, ttl)

        def send(event: CotEvent) -> None:
            try:
                sender.sendto(event.xml, there)
            except OSError as error:
                raise UserError(
                    f"--to {address}: cannot be reached ({error.strerror}); check address and network"
                ) from None

        yield send


def send_once(run: Run, send: Send) -> int:
    """Send the targets of a mission so far, and take off the maps what is nothing; how many targets."""
    now = _now()
    events = events_of(run, now)
    for event in (*events, *(deletion(uid, now) for uid in sorted(uids_of_nothing(run)))):
        send(event)
    return len(events)


def follow(folder: Path, send: Send, warn: Callable[[str], None]) -> None:
    """Send the events of a mission as it flies, until its journal has its end.

    A target is sent when it is new or changed, and again every ``_AGAIN_S``; the vehicle while its journal
    grows. What is nothing after all is taken off the maps, whoever sent it. A network that is away for a
    while, or a folder that cannot be read, is warned of once.
    """
    journal, board, is_away = folder / JOURNAL_FILE, _Board(), False
    size, run = journal.stat().st_size, load_flown(folder)
    while True:
        try:
            grown = journal.stat().st_size != size
            if grown:
                size, run = journal.stat().st_size, load_flown(folder)
            board.send_due(run, send, time.monotonic())
            if grown and not run.ended and len(run.states):
                send(vehicle_event(run, _now()))
            is_away = False
        except (UserError, OSError) as error:
            if not is_away:
                warn(f"{error}; still trying")
            is_away = True
        if run.ended and not is_away:
            return
        time.sleep(_PERIOD_S)


class _Board:
    """The targets that the receivers have been sent."""

    def __init__(self) -> None:
        self._sent: dict[str, tuple[bytes, float]] = {}  # what an event said, and when (monotonic)
        self._standing: set[str] = set()  # uids of what is on the maps
        self._gone: set[str] = set()  # and was taken off them

    def send_due(self, run: Run, send: Send, now_s: float) -> None:
        """Send what is new, changed or due again."""
        now = _now()
        events = events_of(run, now)
        standing = {event.uid for event in events}
        self._gone = (self._gone | self._standing | uids_of_nothing(run)) - standing
        self._standing = standing
        for event in (*events, *(deletion(uid, now) for uid in sorted(self._gone))):
            said, sent_s = self._sent.get(event.uid, (b"", -math.inf))
            if event.says != said or now_s - sent_s >= _AGAIN_S:
                send(event)
                self._sent[event.uid] = event.says, now_s


def _now() -> datetime:
    return datetime.now(timezone.utc)
