"""Gazebo's transport protocol, spoken to a peer that the test controls byte by byte."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.errors import UserError
from skysweep.gazebo.lockstep import image_of, pose_message
from skysweep.gazebo.messages import (
    Image,
    ImageStamped,
    Packet,
    Pose,
    Publish,
    Publishers,
    Subscribe,
    Time,
    seconds,
    type_name,
)
from skysweep.gazebo.transport import HOST, Transport, TransportError, _Connection
from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import rotation_camera_to_enu

TOPIC = "/gazebo/default/eye/image"


def framed(payload: bytes) -> bytes:
    return b"%08X" % len(payload) + payload


def packet(kind: str, message: object) -> bytes:
    data = message.SerializeToString()  # type: ignore[attr-defined]
    return framed(Packet(stamp=Time(sec=1, nsec=2), type=kind, serialized_data=data).SerializeToString())


def read_packet(sock: socket.socket) -> tuple[str, bytes]:
    length = int(sock.recv(8, socket.MSG_WAITALL), 16)
    got = Packet.FromString(sock.recv(length, socket.MSG_WAITALL))
    return got.type, got.serialized_data


@pytest.fixture
def master() -> Iterator[socket.socket]:
    with closing(socket.create_server((HOST, 0))) as server:
        server.settimeout(5)
        yield server


def connected(server: socket.socket) -> tuple[Transport, socket.socket]:
    transport = Transport(server.getsockname()[1], timeout_s=5)
    peer = server.accept()[0]
    peer.settimeout(5)
    return transport, peer


def later(action: Callable[[], None]) -> threading.Thread:
    thread = threading.Thread(target=action)
    thread.start()
    return thread


@given(st.lists(st.binary(max_size=300), max_size=8), st.lists(st.integers(1, 200), min_size=1, max_size=40))
def test_frames_do_not_depend_on_how_the_stream_is_cut(payloads: list[bytes], cuts: list[int]) -> None:
    ours, theirs = socket.socketpair()
    with closing(ours), closing(theirs):
        connection = _Connection.__new__(_Connection)
        connection.sock, connection._buffer, connection._chunk = ours, bytearray(), bytearray(256)
        stream, got, k = b"".join(framed(p) for p in payloads), [], 0
        while stream:
            piece, stream = stream[: cuts[k % len(cuts)]], stream[cuts[k % len(cuts)] :]
            theirs.sendall(piece)
            got += list(connection.receive())
            k += 1
        assert got == payloads


def test_a_publisher_known_before_and_one_that_comes_later_are_both_heard(master: socket.socket) -> None:
    transport, peer = connected(master)
    with closing(transport), closing(peer), closing(socket.create_server((HOST, 0))) as publisher:
        publisher.settimeout(5)
        kind = type_name(ImageStamped)
        port = publisher.getsockname()[1]
        here = Publish(topic=TOPIC, msg_type=kind, host=HOST, port=port)
        peer.sendall(packet("publishers_init", Publishers(publisher=[])) + packet("publisher_add", here))
        assert transport.receive(0.2) is None
        assert transport.topics() == {TOPIC: kind}
        transport.subscribe(TOPIC, ImageStamped)
        name, data = read_packet(peer)
        assert (name, Subscribe.FromString(data).topic) == ("subscribe", TOPIC)
        stream = publisher.accept()[0]
        assert read_packet(stream)[0] == "sub"
        picture = ImageStamped(
            time=Time(sec=3, nsec=500_000_000),
            image=Image(width=2, height=1, pixel_format=3, step=6, data=bytes(range(6))),
        )
        stream.sendall(framed(picture.SerializeToString()))
        received = transport.receive(5)
        assert received is not None
        assert received[0] == TOPIC
        assert seconds(received[1].time) == 3.5
        np.testing.assert_array_equal(image_of(received[1].image, TOPIC), [[[0, 1, 2], [3, 4, 5]]])
        stream.close()
        with pytest.raises(TransportError, match="closed the connection"):
            transport.receive(5)


def test_what_we_publish_reaches_a_subscriber_that_comes_after_two_announcements(
    master: socket.socket,
) -> None:
    transport, peer = connected(master)
    got: list[bytes] = []

    def subscriber() -> None:
        read_packet(peer)  # the first announcement gets lost
        name, data = read_packet(peer)
        where = Publish.FromString(data)
        assert name == "advertise"
        sock = socket.create_connection((where.host, where.port))
        topic = Subscribe(topic=where.topic, host=HOST, port=1, msg_type=where.msg_type)
        sock.sendall(packet("sub", topic))
        length = int(sock.recv(8, socket.MSG_WAITALL), 16)
        got.append(sock.recv(length, socket.MSG_WAITALL))
        sock.close()

    with closing(transport), closing(peer):
        thread = later(subscriber)
        transport.advertise("/pose", Pose, timeout_s=5)
        pose = CameraPose(np.array([1.0, 2.0, 30.0]), rotation_camera_to_enu(0.0, -np.pi / 2))
        transport.publish("/pose", pose_message(pose, steps=8))
        thread.join()
    sent = Pose.FromString(got[0])
    assert sent.id == 8
    assert (sent.position.x, sent.position.y, sent.position.z) == (1, 2, 30)
    half = np.sqrt(0.5)  # FLU: looking down is a turn of 90 degrees about left
    q = np.array([sent.orientation.w, sent.orientation.x, sent.orientation.y, sent.orientation.z])
    np.testing.assert_allclose(q * np.sign(q[0]), [half, 0, half, 0], atol=1e-12)


def test_nobody_there_is_told_in_time(master: socket.socket) -> None:
    started = time.monotonic()
    with closing(socket.create_server((HOST, 0))) as unused:
        port = unused.getsockname()[1]
    with pytest.raises(TransportError, match=f"nothing answers at {HOST}:{port}"):
        Transport(port, timeout_s=0.2)
    transport, peer = connected(master)
    with closing(transport), closing(peer), pytest.raises(TransportError, match="nobody listens to /pose"):
        transport.advertise("/pose", Pose, timeout_s=0.3)
    assert time.monotonic() - started < 4


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "this is not Gazebo's protocol"),
        (b"", "closed the connection"),
    ],
)
def test_another_program_on_the_port(master: socket.socket, answer: bytes, message: str) -> None:
    transport, peer = connected(master)
    with closing(transport):
        peer.sendall(answer)
        peer.close()
        with pytest.raises(TransportError, match=message):
            transport.receive(5)


def test_a_topic_of_another_type_is_refused(master: socket.socket) -> None:
    transport, peer = connected(master)
    with closing(transport), closing(peer):
        other = Publish(topic=TOPIC, msg_type="gazebo.msgs.LaserScanStamped", host=HOST, port=1)
        peer.sendall(packet("publisher_add", other))
        transport.receive(0.2)
        with pytest.raises(TransportError, match=r"carries gazebo\.msgs\.LaserScanStamped, not"):
            transport.subscribe(TOPIC, ImageStamped)


def test_pictures_of_another_encoding_are_refused() -> None:
    grey = Image(width=2, height=2, pixel_format=1, step=2, data=bytes(4))
    with pytest.raises(
        UserError, match=r"pixel format 1 with 4 bytes; set the camera's image format to R8G8B8"
    ):
        image_of(grey, TOPIC)
