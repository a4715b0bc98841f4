"""`skysweep serve-vehicle` as a process, and a ground station that asks as QGroundControl does."""

import os
import signal
import socket
import subprocess
import sys
import time

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as m
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.errors import UserError
from skysweep.vehicles.served.server import LOOPBACK, VehicleServer, address_of

SERVE = [sys.executable, "-m", "skysweep.cli", "serve-vehicle"]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]


class Station:
    """A ground station on pymavlink's own link."""

    def __init__(self, port: int, key: bytes | None = None) -> None:
        self.link = mavutil.mavlink_connection(
            f"udpin:{LOOPBACK}:{port}", source_system=255, dialect="common"
        )
        if key is not None:
            self.link.setup_signing(key)

    def hear(self, kind: str, seconds: float = 60.0, **fields):
        """The next message of a kind with these fields."""
        end = time.monotonic() + seconds
        while True:
            assert time.monotonic() < end, f"no {kind}"
            message = self.link.recv_match(type=kind, blocking=True, timeout=1.0)
            if message is not None and all(getattr(message, k) == v for k, v in fields.items()):
                return message

    def ask(self, send, kind: str, **fields):
        """Asks again until it is answered, as a ground station does on a link that loses datagrams."""
        for _ in range(20):
            send()
            try:
                return self.hear(kind, 2.0, **fields)
            except AssertionError:
                continue
        raise AssertionError(f"no {kind}")

    def command(self, number: int, *params: float) -> int:
        params = (*params, *[0.0] * (7 - len(params)))
        send = self.link.mav.command_long_send
        return self.ask(lambda: send(1, 1, number, 0, *params), "COMMAND_ACK", command=number).result

    def upload(self, items, kind: int) -> int:
        self.ask(
            lambda: self.link.mav.mission_count_send(1, 1, len(items), kind), "MISSION_REQUEST_INT", seq=0
        )
        for seq, (command, frame, params, x, y, z) in enumerate(items):
            self.link.mav.mission_item_int_send(1, 1, seq, frame, command, 0, 1, *params, x, y, z, kind)
        return self.hear("MISSION_ACK").type

    def download(self, kind: int):
        mav = self.link.mav
        count = self.ask(
            lambda: mav.mission_request_list_send(1, 1, kind), "MISSION_COUNT", mission_type=kind
        )
        items = []
        for seq in range(count.count):
            ask = lambda seq=seq: mav.mission_request_int_send(1, 1, seq, kind)  # noqa: E731
            items.append(self.ask(ask, "MISSION_ITEM_INT", seq=seq, mission_type=kind))
        mav.mission_ack_send(1, 1, 0, kind)
        return [(i.command, i.frame, (i.param1, i.param2, i.param3, i.param4), i.x, i.y, i.z) for i in items]


@pytest.fixture
def serve(tmp_path, monkeypatch):
    """Starts the command with options; gives the process and the port of the ground station."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    started = []

    def start(*options: str):
        port = free_port()
        process = subprocess.Popen(
            [*SERVE, "--local-port", "0", "--port", str(free_port()), "--gcs-port", str(port), *options],
            cwd=tmp_path,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process, port

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stderr.close()


def test_a_ground_station_connects_reads_writes_and_ends(serve):
    process, port = serve("--speed", "10")
    station = Station(port)
    beat = station.hear("HEARTBEAT", autopilot=m.MAV_AUTOPILOT_PX4)
    assert (beat.type, beat.custom_mode) == (m.MAV_TYPE_QUADROTOR, 4 << 16 | 3 << 24)
    station.link.mav.heartbeat_send(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, m.MAV_STATE_ACTIVE)
    ask_version = m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    assert station.command(*ask_version) == 0

    station.link.mav.param_request_list_send(1, 1)
    listed: dict = {}
    first = station.hear("PARAM_VALUE")
    listed[first.param_index] = first
    while len(listed) < first.param_count:
        value = station.hear("PARAM_VALUE")
        listed[value.param_index] = value
    assert "MPC_XY_VEL_MAX" in {p.param_id for p in listed.values()}

    home = station.hear("HOME_POSITION")
    lat, lon = home.latitude, home.longitude
    zeros = (0.0, 0.0, 0.0, 0.0)
    up, there = (22, 6, zeros, lat, lon, 10.0), (16, 6, zeros, lat + 3000, lon + 3000, 10.0)
    fence = [(5003, 5, (200.0, 0.0, 0.0, 0.0), lat, lon, 0.0)]
    rally = [(5100, 6, zeros, lat + 500, lon, 0.0)]
    for kind, items in ((0, [up, there]), (1, fence), (2, rally)):
        assert station.upload(items, kind) == 0
        assert station.download(kind) == items

    assert station.command(m.MAV_CMD_MISSION_START) == 0
    station.hear("MISSION_ITEM_REACHED", seq=1)
    assert station.command(m.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    station.hear("EXTENDED_SYS_STATE", landed_state=m.MAV_LANDED_STATE_LANDING)
    station.hear("EXTENDED_SYS_STATE", landed_state=m.MAV_LANDED_STATE_ON_GROUND)
    station.link.close()

    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=30)[1]
    assert process.returncode == 0
    assert "Traceback" not in said
    assert "stopped after" in said


def test_with_a_key_only_signed_frames_count(serve, tmp_path, monkeypatch):
    monkeypatch.setenv("MAVLINK20", "1")  # version 1 has no signatures; pymavlink begins with it
    key = os.urandom(32)
    (tmp_path / "key").write_text(key.hex())
    _, port = serve("--signing-key", "key")
    station = Station(port, key)
    station.hear("HEARTBEAT")
    assert station.link.mav.signing.badsig_count == 0
    assert station.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    while station.link.recv_match(type="COMMAND_ACK", blocking=True, timeout=1.0) is not None:
        pass  # answers to what was asked twice
    station.link.disable_signing()
    station.link.mav.command_long_send(1, 1, m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, *[0.0] * 6)
    assert station.link.recv_match(type="COMMAND_ACK", blocking=True, timeout=1.0) is None
    station.link.close()


def test_two_vehicles_at_one_ground_station_are_two_systems(serve):
    _, port = serve()
    serve("--system-id", "2", "--gcs-port", str(port))
    station, systems = Station(port), set()
    while systems != {1, 2}:
        systems.add(station.hear("HEARTBEAT", autopilot=m.MAV_AUTOPILOT_PX4).get_srcSystem())
    station.link.close()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--host", "no host"], ["--host", "no host"]),
        (["--signing-key", "missing"], ["missing", "no such file"]),
        (["no-such-scenario"], ["no-such-scenario"]),
    ],
)
def test_bad_input_is_one_sentence(options, words):
    result = CliRunner().invoke(app, ["serve-vehicle", *options])
    assert result.exit_code == 2
    assert result.stderr.count("error:") == 1
    for word in words:
        assert word in result.stderr


def test_a_taken_port_is_one_sentence():
    from mavlink_clients import scenario

    from skysweep.vehicles.embedded.at_home import embedded_vehicle

    of = scenario()
    with VehicleServer(embedded_vehicle(of, 0), of, []) as server:
        port = server.address[1]
        with pytest.raises(UserError, match=f"{port} is not available") as error:
            VehicleServer(embedded_vehicle(of, 0), of, [], local_port=port)
    for needed in ("--local-port", "--port", "--system-id", "--gcs-port"):
        assert needed in str(error.value)


def test_a_client_may_call_the_server_instead():
    from mavlink_clients import scenario

    from skysweep.vehicles.embedded.at_home import embedded_vehicle

    of = scenario()
    with VehicleServer(embedded_vehicle(of, 0), of, [], speed=5.0) as server:
        url = f"udpout:{LOOPBACK}:{server.address[1]}"
        link = mavutil.mavlink_connection(url, source_system=255, dialect="common")
        link.mav.heartbeat_send(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, m.MAV_STATE_ACTIVE)
        assert link.recv_match(type="HEARTBEAT", blocking=True, timeout=20.0) is not None
        link.close()


def test_names_of_this_computer():
    assert address_of("localhost") == LOOPBACK


def test_it_waits_longer_for_programs_where_time_runs_faster():
    from mavlink_clients import scenario

    from skysweep.vehicles.embedded.at_home import embedded_vehicle

    of = scenario()
    defaults = {"COM_OF_LOSS_T": 1.0, "COM_RC_LOSS_T": 1.0, "COM_DISARM_PRFLT": 10.0}
    for speed in (3.0, 50.0):
        with VehicleServer(embedded_vehicle(of, 0), of, [], speed=speed) as server:
            parameters = server.face.parameters
            waits = {name: parameters[name] for name in defaults}
            assert parameters.set("COM_RC_LOSS_T", 35.0 * speed)
            assert not parameters.set("COM_RC_LOSS_T", 35.1 * speed)
        assert waits == {name: value * speed for name, value in defaults.items()}
