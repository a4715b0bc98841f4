"""A flight over a signed link: MAVSDK behind the relay, the embedded vehicle with a key in front of it."""

from __future__ import annotations

import socket
import time
from contextlib import closing

import pytest

pytest.importorskip("mavsdk", reason="needs the extra px4")

from mavlink_clients import free_port, scenario, wait

from skysweep.errors import UserError
from skysweep.flights.on_px4 import Px4Flight
from skysweep.vehicles.embedded.at_home import embedded_vehicle
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.px4.signed_link import SignedLink
from skysweep.vehicles.served.server import VehicleServer

KEY, OTHER_KEY = bytes(range(32)), bytes(32)


@pytest.fixture(autouse=True)
def state(monkeypatch, tmp_path):
    """Where the times of frames are kept."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


@pytest.fixture
def signing_vehicle():
    """The address of a vehicle that hears and says only what is signed with KEY, and the vehicle."""
    of, port = scenario(), free_port()
    with VehicleServer(embedded_vehicle(of, 0), of, [("127.0.0.1", port)], 10.0, signing_key=KEY) as server:
        yield f"udpin://127.0.0.1:{port}", server


def test_a_signed_flight_takes_off_and_holds(signing_vehicle):
    url, server = signing_vehicle
    with Px4Flight(scenario(), url, 30.0, KEY) as flight:
        flight.vehicle.takeoff(6.0)
        for _ in range(200):
            flight.vehicle.advance(0.1)
            if flight.vehicle.state().position_enu_m[2] > 4.0:
                break
        assert flight.vehicle.state().position_enu_m[2] > 4.0
    assert server.face.pilot.armed


def test_before_an_unsigned_flight_the_list_says_that_nothing_is_answered(signing_vehicle, tmp_path):
    url, _ = signing_vehicle
    with Px4Flight(scenario(), url, 30.0) as flight:
        (vehicle,) = (c for c in flight.preflight(False, tmp_path) if c.name == "vehicle")
        assert vehicle.passed is False
        assert "--signing-key" in vehicle.said
    with Px4Flight(scenario(), url, 30.0, KEY) as flight:
        (vehicle,) = (c for c in flight.preflight(False, tmp_path) if c.name == "vehicle")
        assert vehicle.passed


def test_an_unsigned_order_moves_nothing(signing_vehicle):
    url, server = signing_vehicle
    with Px4Flight(scenario(), url, 30.0) as flight:
        for _ in range(3):
            flight.vehicle.link.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
            time.sleep(0.3)
    assert not server.face.pilot.armed


def test_with_another_key_nothing_is_heard(signing_vehicle):
    url, server = signing_vehicle
    with pytest.raises(UserError, match=r"\d frames were received, none signed with this key"):
        Px4Flight(scenario(), url, 3.0, OTHER_KEY)
    assert not server.face.pilot.armed


def test_addresses_that_cannot_be_opened():
    with pytest.raises(UserError, match=r"tcpout://127.0.0.1:1: cannot be opened"):
        SignedLink("tcpout://127.0.0.1:1", KEY, 1.0)
    with pytest.raises(UserError, match="serial:///dev/nothing:57600: cannot be opened"):
        SignedLink("serial:///dev/nothing:57600", KEY, 1.0)
    with pytest.raises(UserError, match=r"udpout://1.2.3.4:5: cannot be opened .write udpin"):
        SignedLink("udpout://1.2.3.4:5", KEY, 1.0)


def test_it_ends_at_once():
    begun_s = time.monotonic()
    with closing(SignedLink(f"udpin://127.0.0.1:{free_port()}", KEY, 1.0)):
        pass
    assert time.monotonic() - begun_s < 2.0


def heartbeat(key=None, timestamp=None, message=None):
    """A frame of a vehicle."""
    speaker = m.MAVLink(None, 1, 1)
    if key is not None:
        speaker.signing.secret_key, speaker.signing.sign_outgoing = key, True
        speaker.signing.timestamp = Signing(None).stamp() if timestamp is None else timestamp
    return (message or m.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)).pack(speaker)


def heard(vehicle, program, frame):
    vehicle.send(frame)
    try:
        return program.recv(1000)
    except TimeoutError:
        return None


def test_forged_and_old_frames_go_no_further_and_stop_nothing():
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        url = f"tcpout://127.0.0.1:{server.getsockname()[1]}"
        with (
            closing(SignedLink(url, KEY, 5.0)) as link,
            closing(server.accept()[0]) as vehicle,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program,
        ):
            program.bind(("127.0.0.1", int(link.url.rpartition(":")[2])))
            program.settimeout(0.5)
            assert heard(vehicle, program, heartbeat()) is None
            assert heard(vehicle, program, heartbeat(OTHER_KEY, timestamp=2**47)) is None
            assert heard(vehicle, program, heartbeat(KEY, timestamp=1)) is None
            program.settimeout(5.0)
            good = heartbeat(KEY)
            assert heard(vehicle, program, good) == good
            program.settimeout(0.5)
            assert heard(vehicle, program, good) is None
            assert (link.accepted, link.refused) == (1, 4)


def test_bytes_of_others_hide_no_frame_of_the_vehicle():
    port, here = free_port(), ("127.0.0.1", 0)
    with (
        closing(SignedLink(f"udpin://127.0.0.1:{port}", KEY, 5.0)) as link,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        for each in (vehicle, stranger):
            each.bind(here)
            each.connect(("127.0.0.1", port))
        for n in range(400):
            if n % 4 == 0:
                stranger.send(b"\xfd\xff")
                stranger.send(b"\xfd\xff\x00")
            vehicle.send(heartbeat(KEY))
            wait(lambda n=n: link.accepted == n + 1, 5.0, f"{link.accepted} of {n + 1} frames came through")


def test_a_connection_that_breaks_is_opened_again():
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        url = f"tcpout://127.0.0.1:{server.getsockname()[1]}"
        with closing(SignedLink(url, KEY, 5.0)) as link:
            server.accept()[0].close()
            server.settimeout(10.0)
            with closing(server.accept()[0]) as vehicle:
                vehicle.send(heartbeat(KEY))
                begun_s = time.monotonic()
                while link.accepted == 0:
                    assert time.monotonic() - begun_s < 5.0
                    time.sleep(0.02)


def test_our_own_frames_sent_back_move_no_order_to_who_sends_them():
    port, here = free_port(), ("127.0.0.1", 0)
    with (
        closing(SignedLink(f"udpin://127.0.0.1:{port}", KEY, 5.0)) as link,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        program.bind(("127.0.0.1", int(link.url.rpartition(":")[2])))
        for each in (vehicle, stranger):
            each.bind(here)
            each.settimeout(5.0)
        vehicle.sendto(heartbeat(KEY), ("127.0.0.1", port))
        assert program.recvfrom(1000)
        ours = m.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3).pack(m.MAVLink(None, 245, 190))
        for n in range(3):
            program.sendto(ours, link._program.getsockname())
            stranger.sendto(vehicle.recv(1000), ("127.0.0.1", port))
            wait(lambda n=n: link.refused == n + 1, 5.0, "what was sent back was not refused")
        assert link.accepted == 1
