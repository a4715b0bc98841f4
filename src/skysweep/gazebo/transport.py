"""A client of Gazebo Classic's transport: TCP and protobuf, one thread, no Gazebo libraries.

A frame is the length of its payload in 8 hexadecimal digits, then the payload. Clients announce their topics
to the *master* in ``Packet`` messages, and it tells who publishes what. A subscriber connects to the
publisher, sends ``sub`` in a Packet, and then receives bare messages. Source: Gazebo 11, gazebo/transport.
"""

from __future__ import annotations

import selectors
import socket
import time
from collections import deque
from collections.abc import Iterator
from typing import Any

from skysweep.gazebo.messages import Packet, Publish, Publishers, Subscribe, Time, type_name

HOST = "127.0.0.1"
ADVERTISE_AGAIN_S = 1.0  # an announcement may get lost while a world loads
_HEADER = 8
_CHUNK = 1 << 20


class TransportError(Exception):
    """The other side is gone or does not speak Gazebo's protocol."""


class _Connection:
    """Frames over a socket. Its methods raise TransportError when the connection ends."""

    def __init__(self, sock: socket.socket) -> None:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.sock = sock
        self._buffer = bytearray()
        self._chunk = bytearray(_CHUNK)

    def send(self, payload: bytes) -> None:
        try:
            self.sock.sendall(b"%08X" % len(payload) + payload)
        except OSError as error:
            raise TransportError(f"the connection broke ({error})") from error

    def receive(self) -> Iterator[bytes]:
        """The frames that are complete after one read."""
        try:
            count = self.sock.recv_into(self._chunk)
        except OSError as error:
            raise TransportError(f"the connection broke ({error})") from error
        if count == 0:
            raise TransportError("the other side closed the connection")
        self._buffer += self._chunk[:count]
        while len(self._buffer) >= _HEADER:
            try:
                length = int(self._buffer[:_HEADER], 16)
            except ValueError:
                raise TransportError(f"this is not Gazebo's protocol: {bytes(self._buffer[:16])!r}") from None
            if len(self._buffer) < _HEADER + length:
                return
            frame = bytes(self._buffer[_HEADER : _HEADER + length])
            del self._buffer[: _HEADER + length]
            yield frame


class Transport:
    """Publishes to and subscribes from one gzserver, whose master is at ``host``:``port``.

    Messages arrive only inside ``receive``. Raises TransportError if nothing answers in ``timeout_s``, and
    later when the master or a subscribed publisher goes away.
    """

    def __init__(self, port: int, timeout_s: float, host: str = HOST) -> None:
        self._selector = selectors.DefaultSelector()
        self._master = _Connection(_connect(host, port, timeout_s))
        self._listener = socket.create_server((HOST, 0))
        self._port = self._listener.getsockname()[1]
        self._selector.register(self._master.sock, selectors.EVENT_READ, self._on_master)
        self._selector.register(self._listener, selectors.EVENT_READ, self._on_listener)
        self._connections = [self._master]
        self._publishers: dict[tuple[str, str, int], str] = {}
        self._subscribed: dict[str, Any] = {}
        self._pulled: set[tuple[str, str, int]] = set()
        self._subscribers: dict[str, _Connection | None] = {}
        self._received: deque[tuple[str, Any]] = deque()

    def close(self) -> None:
        for connection in self._connections:
            connection.sock.close()
        self._listener.close()
        self._selector.close()

    def topics(self) -> dict[str, str]:
        """The message type of every topic that the master reported as published."""
        return {topic: kind for (topic, _, _), kind in self._publishers.items()}

    def subscribe(self, topic: str, message_class: Any) -> None:
        """From now on ``receive`` returns messages of this topic, from any publisher."""
        self._subscribed[topic] = message_class
        self._master.send(_packet("subscribe", self._subscription(topic)))
        for publisher in list(self._publishers):
            self._pull(publisher)

    def advertise(self, topic: str, message_class: Any, timeout_s: float) -> None:
        """Announces a topic and waits for a subscriber. Raises TransportError after ``timeout_s``."""
        self._subscribers[topic] = None
        give_up = time.monotonic() + timeout_s
        announcement = Publish(topic=topic, msg_type=type_name(message_class), host=HOST, port=self._port)
        while self._subscribers[topic] is None:
            if time.monotonic() >= give_up:
                raise TransportError(f"nobody listens to {topic}")
            self._master.send(_packet("advertise", announcement))
            again = time.monotonic() + ADVERTISE_AGAIN_S
            while self._subscribers[topic] is None and time.monotonic() < again:
                self._wait(again - time.monotonic())

    def publish(self, topic: str, message: Any) -> None:
        connection = self._subscribers[topic]
        if connection is not None:
            connection.send(message.SerializeToString())

    def receive(self, timeout_s: float) -> tuple[str, Any] | None:
        """The next (topic, message); None if none comes within ``timeout_s``."""
        give_up = time.monotonic() + timeout_s
        while not self._received:
            left = give_up - time.monotonic()
            if left <= 0:
                return None
            self._wait(left)
        return self._received.popleft()

    def _wait(self, timeout_s: float) -> None:
        for key, _ in self._selector.select(max(timeout_s, 0.0)):
            key.data()

    def _on_master(self) -> None:
        for frame in self._master.receive():
            packet = Packet.FromString(frame)
            if packet.type == "publishers_init":
                news = Publishers.FromString(packet.serialized_data).publisher
            elif packet.type in ("publisher_add", "publisher_subscribe", "publisher_advertise"):
                news = [Publish.FromString(packet.serialized_data)]
            elif packet.type == "publisher_del":
                gone = Publish.FromString(packet.serialized_data)
                self._publishers.pop((gone.topic, gone.host, gone.port), None)
                continue
            else:
                continue
            for p in news:
                self._publishers[(p.topic, p.host, p.port)] = p.msg_type
                self._pull((p.topic, p.host, p.port))

    def _pull(self, publisher: tuple[str, str, int]) -> None:
        topic, host, port = publisher
        if topic not in self._subscribed or publisher in self._pulled or port == self._port:
            return
        message_class = self._subscribed[topic]
        published = self._publishers[publisher]
        if published != type_name(message_class):
            raise TransportError(f"{topic} carries {published}, not {type_name(message_class)}")
        self._pulled.add(publisher)
        connection = self._adopt(_connect(host, port, timeout_s=1.0))
        connection.send(_packet("sub", self._subscription(topic)))

        def on_messages() -> None:
            for frame in connection.receive():
                self._received.append((topic, message_class.FromString(frame)))

        self._selector.register(connection.sock, selectors.EVENT_READ, on_messages)

    def _on_listener(self) -> None:
        connection = self._adopt(self._listener.accept()[0])

        def on_subscriber() -> None:
            try:
                for frame in connection.receive():
                    packet = Packet.FromString(frame)
                    if packet.type == "sub":
                        topic = Subscribe.FromString(packet.serialized_data).topic
                        if topic in self._subscribers:
                            self._subscribers[topic] = connection  # only the newest: no message twice
            except TransportError:
                self._drop(connection)

        self._selector.register(connection.sock, selectors.EVENT_READ, on_subscriber)

    def _drop(self, connection: _Connection) -> None:
        self._selector.unregister(connection.sock)
        connection.sock.close()
        self._connections.remove(connection)
        for topic, subscriber in self._subscribers.items():
            if subscriber is connection:
                self._subscribers[topic] = None

    def _adopt(self, sock: socket.socket) -> _Connection:
        connection = _Connection(sock)
        self._connections.append(connection)
        return connection

    def _subscription(self, topic: str) -> Any:
        kind = type_name(self._subscribed[topic])
        return Subscribe(topic=topic, host=HOST, port=self._port, msg_type=kind, latching=False)


def _packet(kind: str, message: Any) -> bytes:
    now = time.time_ns()
    stamp = Time(sec=now // 10**9, nsec=now % 10**9)
    packet = Packet(stamp=stamp, type=kind, serialized_data=message.SerializeToString())
    return bytes(packet.SerializeToString())


def _connect(host: str, port: int, timeout_s: float) -> socket.socket:
    give_up = time.monotonic() + timeout_s
    while True:
        try:
            return socket.create_connection((host, port), timeout=timeout_s)
        except OSError as error:
            if time.monotonic() >= give_up:
                raise TransportError(f"nothing answers at {host}:{port}") from error
            time.sleep(0.05)
