"""Whatever arrives: no crash, no hang, no motion without the key, and nobody takes a flight away.

Run as a program it sends a million datagrams to each vehicle, and prints its figures.
"""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import time
from collections import deque
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import psutil
import pytest
from mavlink_clients import (
    HOLD,
    LAND,
    MISSION,
    OFFBOARD,
    POSITION,
    RETURN,
    Program,
    Sky,
    free_port,
    item,
    local,
    scenario,
)
from pymavlink.dialects.v20 import development as m

from skysweep.scenarios.files import write_scenario
from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.mavlink.wire import Voice
from skysweep.vehicles.served.server import LOOPBACK

KEY = bytes(range(32))
ODD = [0.0, 1.0, -1.0, 2.0, 400.0, 1e9, 5e9, -1e38, float("nan"), float("inf"), float("-inf")]
STREAMS = 24  # address and ids of the senders
LINK = 77  # the owner's; others may have its ids
IN_A_ROW, WARM = 40, 2000  # datagrams between two pings, and before memory is measured
LONGEST_LEG_S = 20.0  # on the wall
SECOND = 100_000  # of a timestamp
ASKEW = (30 * SECOND, 59 * SECOND, -120 * SECOND, 2**47)  # clocks of some who have the key
FINAL = {m.MAV_CMD_DO_FLIGHTTERMINATION}  # nothing would fly after it
OF_A_PERSON = {  # which whoever asks may give
    m.MAV_CMD_NAV_LAND,
    m.MAV_CMD_NAV_RETURN_TO_LAUNCH,
    m.MAV_CMD_NAV_LOITER_UNLIM,
    m.MAV_CMD_DO_PAUSE_CONTINUE,
}


class Askew(Signing):
    """Signs by a clock that is off."""

    def __init__(self, key: bytes, by: int) -> None:
        super().__init__(key)
        self._by = by

    def stamp(self) -> int:
        return super().stamp() + self._by


def frames(seed: int, sky: Sky, keys: list, recorded: deque[bytes] | None = None):
    """For ever (datagram, port): sensible messages, odd numbers, broken bytes, and noise.

    With ``recorded`` frames of others are played again, clocks and link ids of some who have the key are odd,
    and orders are left out that are done for whoever asks.
    """
    draw = random.Random(seed)
    voices = [Voice(draw.choice([1, 25, 190]), Signing(draw.choice(keys))) for _ in range(STREAMS)]
    for voice in voices:
        voice._encoder.srcSystem = draw.choice([1, 2, 245, 255])
    neighbours = recorded is not None
    if neighbours and KEY in keys:
        voices[: len(ASKEW)] = [Voice(190, Askew(KEY, by), system_id=7) for by in ASKEW]
    known = list(m.mavlink_map.values())
    never = FINAL | OF_A_PERSON if neighbours else FINAL
    unheard = {"MANUAL_CONTROL", "SET_MODE"} if neighbours else set()
    known = [kind for kind in known if kind.msgname not in unheard]
    heard = [kind for kind in known if kind.msgname in sky.face._handle]
    sensible = [said for said in sensible_messages(sky) if not (neighbours and is_of_a_person(said))]
    commands = [number for number in sky.face._commands._do if number not in never]
    while True:
        i = draw.randrange(STREAMS)
        choice = draw.random()
        if choice < 0.05:
            yield draw.randbytes(draw.randrange(1, 80)), i
            continue
        if recorded and choice < 0.1:
            yield draw.choice(recorded), i
            continue
        voices[i]._encoder.signing.link_id = draw.randrange(256) if neighbours and i < 2 else 0
        if choice < 0.3:
            message = draw.choice(sensible)
        else:
            message = odd_message(draw, draw.choice(heard if choice < 0.85 else known), commands, never)
        old = choice > 0.95 and getattr(message, "id", 256) < 256
        datagram = message.pack(voices[i]._encoder, force_mavlink1=True) if old else voices[i].pack(message)
        if draw.random() < 0.2:
            broken = bytearray(datagram)
            for _ in range(draw.randrange(1, 4)):
                broken[draw.randrange(len(broken))] = draw.randrange(256)
            datagram = bytes(broken)
        elif draw.random() < 0.05:
            datagram = datagram[: draw.randrange(len(datagram))] + voices[i].pack(draw.choice(sensible))
        if neighbours:
            recorded.append(datagram)
        yield datagram, i


def is_of_a_person(message) -> bool:
    if message.get_type() != "COMMAND_LONG":
        return message.get_type() == "MANUAL_CONTROL"
    mode = (message.param2, message.param3)
    return message.command == m.MAV_CMD_DO_SET_MODE and mode not in (MISSION, OFFBOARD)


def odd_message(draw: random.Random, kind, commands, never):
    """A message with its fields at or beyond their limits, addressed to the vehicle more often than not."""
    packed = bytearray(draw.randbytes(kind.unpacker.size))
    values = list(kind.unpacker.unpack(packed))
    fields = [kind.ordered_fieldnames[j] for j in range(len(kind.ordered_fieldnames))]
    if len(fields) == len(values):
        for j, name in enumerate(fields):
            if isinstance(values[j], float) and draw.random() < 0.8:
                values[j] = draw.choice(ODD)
            if name in ("target_system", "target_component") and draw.random() < 0.9:
                values[j] = draw.choice([0, 1, 1, 100])
            if name == "command" and (draw.random() < 0.9 or values[j] in never):
                values[j] = draw.choice(commands)
            if name == "mission_type" and draw.random() < 0.9:
                values[j] = draw.choice([0, 1, 2, 255])
            if name in ("seq", "count") and draw.random() < 0.8:
                values[j] = draw.randrange(6)
            if name == "frame" and draw.random() < 0.8:
                values[j] = draw.choice([0, 2, 3, 5, 6])
            if name == "coordinate_frame" and draw.random() < 0.8:
                values[j] = draw.choice([1, 5, 6, 8])
        packed = bytearray(kind.unpacker.pack(*values))
    return Raw(kind, bytes(packed))


class Raw:
    """A message that is its payload."""

    def __init__(self, kind, payload: bytes) -> None:
        self._message = m.MAVLink_message(kind.id, kind.msgname)
        self.id, self._crc_extra, self._bytes = kind.id, kind.crc_extra, payload

    def pack(self, encoder, force_mavlink1=False):
        return self._message._pack(encoder, self._crc_extra, self._bytes, force_mavlink1)


def sensible_messages(sky: Sky):
    """What a program that means to fly says."""
    nan = float("nan")

    def command(number, *params):
        return m.MAVLink_command_long_message(1, 1, number, 0, *params, *[0.0] * (7 - len(params)))

    yield m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    yield command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    yield command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, nan)
    yield command(m.MAV_CMD_MISSION_START)
    for mode in (HOLD, MISSION, OFFBOARD, POSITION, RETURN, LAND):
        yield command(m.MAV_CMD_DO_SET_MODE, 1, *mode)
    yield m.MAVLink_manual_control_message(1, 600, -300, 700, 200, 0)
    yield local(5, 5, -10)
    yield local(0, 0, 0, 0b1101_1100_0111, velocity=(3.0, 1.0, -1.0))
    yield m.MAVLink_param_request_list_message(1, 1)
    for interval in (5e9, 2.0**31, 1e5, -1.0):
        yield command(m.MAV_CMD_SET_MESSAGE_INTERVAL, m.MAVLINK_MSG_ID_ATTITUDE, interval)
        yield command(m.MAV_CMD_GET_MESSAGE_INTERVAL, m.MAVLINK_MSG_ID_ATTITUDE)
    for kind in (0, 1, 2):
        yield m.MAVLink_mission_count_message(1, 1, 3, kind)
        yield m.MAVLink_mission_request_list_message(1, 1, kind)
    for seq in range(3):
        i = item(sky, m.MAV_CMD_NAV_WAYPOINT, 10.0 * seq, 5.0, 10.0)
        place = (i.x, i.y, i.z, 0)
        yield m.MAVLink_mission_item_int_message(1, 1, seq, i.frame, i.command, 0, 1, *i.params, *place)
        place = (i.x * 1e-7, i.y * 1e-7, i.z, 0)
        yield m.MAVLink_mission_item_message(1, 1, seq, i.frame, i.command, 0, 1, *i.params, *place)


def bombard(sky: Sky, count: int, seed: int, keys: list, in_the_air: bool = False) -> tuple[float, set]:
    """Feeds ``count`` datagrams, 6 in a tick: (most processor seconds for one, modes it was in)."""
    source = frames(seed, sky, keys)
    slowest, modes = 0.0, set()
    for n in range(count):
        if in_the_air and n % 600 == 0 and (sky.pilot.landing or not sky.pilot.flying):
            sky.vehicle.place([0.0, 0.0, 15.0], [0.0, 0.0, 0.0], 0.0)
            sky.pilot.armed = sky.pilot.flying = True
            sky.pilot.landing = False
        datagram, port = next(source)
        start = time.thread_time()
        sky.face.receive(datagram, ("10.0.0.2", port))
        slowest = max(slowest, time.thread_time() - start)
        if n % 6 == 0:
            sky.face.tick()
            modes.add(sky.pilot.mode.name)
    assert np.isfinite(sky.vehicle.true_position_enu_m).all()
    assert not sky.face.faulty
    return slowest, modes


def standing(sky: Sky):
    pilot = sky.pilot
    return sky.vehicle.true_position_enu_m.tolist(), pilot.armed, pilot.mode, pilot.offboard.owner


@pytest.mark.parametrize("seed", [1, 2])
def test_nothing_that_arrives_breaks_it(seed):
    sky = Sky()
    gcs = Program(sky)
    slowest, modes = bombard(sky, 6000, seed, [None, KEY], in_the_air=True)
    assert slowest < 1.0
    assert {"HOLD", "RETURN", "LAND"} <= modes
    assert gcs.command(m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == 0, "it still answers"


def test_nothing_moves_without_the_key():
    sky = Sky(signing_key=KEY)
    before, sky.programs = standing(sky), {}
    bombard(sky, 6000, 3, [None, bytes(32)])
    assert standing(sky) == before
    assert sky.face.transfers.stored == {0: (), 1: (), 2: ()}
    assert not sky.face.peers.listening(sky.pilot.time_s)


def test_a_datagram_full_of_frame_starts_takes_no_time():
    sky = Sky()
    for datagram in (b"\xfd" * 65507, b"\xfe" * 65507, b"\xfd\x00\x01" * 21835):
        start = time.thread_time()
        sky.face.receive(datagram, ("10.0.0.2", 1))
        assert time.thread_time() - start < 0.5


class Figures(NamedTuple):
    """What a run under fire came to."""

    datagrams: int
    seconds: float
    slowest_reply_s: float
    slow_replies: int  # which took longer than a second: a busy machine may stop anybody once
    more_memory_mb: float
    items_reached: int


def datagrams_dropped(*ports: int) -> int:
    """By the kernel, because a socket on one of these ports was full."""
    rows = [row.split() for row in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return sum(int(row[-1]) for row in rows if int(row[1].partition(":")[2], 16) in ports)


class Owner:
    """A program that flies a mission over UDP and looks whether anybody takes it away."""

    def __init__(self, port: int, key: bytes | None, recorded: deque[bytes]) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._vehicle = (LOOPBACK, port)
        self._voice, self._recorded = Voice(190, Signing(key), 245, LINK), recorded
        self._decoder, self._beat_s, self._lost = m.MAVLink(None), 0.0, 0
        self.is_flying = False  # its mission: then nothing else may be seen
        self.replies_s, self.items_reached = [], 0
        self.close = self._socket.close

    def say(self, message) -> None:
        frame = self._voice.pack(message)
        self._recorded.append(frame)
        self._socket.sendto(frame, self._vehicle)

    def ask(self, message, kind: str, seconds: float = 10.0, **fields):
        """The answer: a message of that kind with these fields. Asks again where UDP lost something."""
        while (answer := self._hear(message, kind, seconds, fields)) is None:
            lost, self._lost = self._lost, datagrams_dropped(self._vehicle[1], self._socket.getsockname()[1])
            assert self._lost > lost, f"no {kind} in {seconds:g} s, and nothing was lost on the way"
        return answer

    def _hear(self, message, kind: str, seconds: float, fields: dict):
        begun_s = time.monotonic()
        if begun_s - self._beat_s > 1.0:
            self._beat_s = begun_s
            self.say(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        self.say(message)
        while (left_s := begun_s + seconds - time.monotonic()) > 0.0:
            self._socket.settimeout(left_s)
            try:
                heard = self._decoder.decode(bytearray(self._socket.recv(4096)))
            except TimeoutError:
                continue
            self._look(heard)
            if heard.get_type() == kind and all(getattr(heard, k) == v for k, v in fields.items()):
                self.replies_s.append(time.monotonic() - begun_s)
                return heard
        return None

    def _look(self, heard) -> None:
        kind = heard.get_type()
        self.items_reached += kind == "MISSION_ITEM_REACHED"
        if not self.is_flying or heard.get_srcComponent() != 1:
            return
        if kind == "HEARTBEAT":
            assert heard.base_mode & m.MAV_MODE_FLAG_SAFETY_ARMED
            assert (heard.custom_mode >> 16 & 0xFF, heard.custom_mode >> 24) == MISSION
        elif kind == "LOCAL_POSITION_NED":
            assert -5.0 < heard.x < 35.0
            assert -5.0 < heard.y < 45.0
            assert -16.0 < heard.z < -8.0

    def command(self, number: int, *params: float) -> int:
        params = (*params, *[0.0] * (7 - len(params)))
        order = m.MAVLink_command_long_message(1, 1, number, 0, *params)
        return self.ask(order, "COMMAND_ACK", command=number).result

    def upload(self, items, kind: int) -> None:
        said = m.MAVLink_mission_count_message(1, 1, len(items), kind)
        for seq, i in enumerate(items):
            self.ask(said, "MISSION_REQUEST_INT", seq=seq, mission_type=kind)
            place = (*i.params, i.x, i.y, i.z, kind)
            said = m.MAVLink_mission_item_int_message(1, 1, seq, i.frame, i.command, 0, 1, *place)
        assert self.ask(said, "MISSION_ACK", mission_type=kind).type == 0

    def ping(self, number: int) -> None:
        self.ask(m.MAVLink_ping_message(0, number, 0, 0), "PING", seq=number)

    def belongings(self) -> list:
        """What nobody else may change."""
        names = ("COM_OF_LOSS_T", "COM_OBL_RC_ACT", "GF_ACTION", "MPC_XY_VEL_MAX", "RTL_RETURN_ALT")
        reads = {name: m.MAVLink_param_request_read_message(1, 1, name.encode(), -1) for name in names}
        values = [self.ask(said, "PARAM_VALUE", param_id=name).param_value for name, said in reads.items()]
        lists = [m.MAVLink_mission_request_list_message(1, 1, kind) for kind in (0, 1, 2)]
        counts = [self.ask(said, "MISSION_COUNT", mission_type=k).count for k, said in enumerate(lists)]
        request = (m.MAV_CMD_REQUEST_MESSAGE, 0, m.MAVLINK_MSG_ID_HOME_POSITION, *[0.0] * 6)
        home = self.ask(m.MAVLink_command_long_message(1, 1, *request), "HOME_POSITION")
        return [values, counts, (home.latitude, home.longitude, home.altitude)]


def under_fire(count: int, seed: int, keys: list, key: bytes | None, folder: Path) -> Figures:
    """``skysweep serve-vehicle`` flies an owner's mission while neighbours send ``count`` datagrams."""
    vehicle = {"position_noise_m": 0.0, "attitude_noise_deg": 0.0, "battery_wh": 2000.0}
    path = write_scenario(scenario(vehicle=vehicle), folder / "calm.yaml")
    (folder / "key").write_text(KEY.hex())
    port, sky, recorded = free_port(), Sky(), deque(maxlen=2000)
    options = ["--local-port", port, "--port", free_port(), "--gcs-port", free_port(), "--speed", 4]
    options += ["--signing-key", folder / "key"] if key else []
    serve = [sys.executable, "-m", "skysweep.cli", "serve-vehicle", path, *options]
    corners = ((40, 0), (40, 30), (0, 30), (0, 0))
    mission = [item(sky, m.MAV_CMD_NAV_TAKEOFF, 0, 0, 12.0)]
    mission += [item(sky, m.MAV_CMD_NAV_WAYPOINT, e, n, 12.0) for e, n in corners]
    mission += [item(sky, m.MAV_CMD_DO_JUMP, params=(1.0, -1.0, 0.0, 0.0))]
    fence = [item(sky, m.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, 20, 15, params=(60.0, 0.0, 0.0, 0.0))]
    with (folder / "said").open("w") as said, ExitStack() as ending:
        process = subprocess.Popen([str(part) for part in serve], stderr=said)
        ending.callback(process.wait)
        ending.callback(process.kill)
        owner = ending.enter_context(closing(Owner(port, key, recorded)))
        for _ in range(60):
            with suppress(AssertionError):
                owner.ask(m.MAVLink_ping_message(0, 0, 0, 0), "PING", 1.0)
                break
        owner.upload(fence, 1)
        owner.upload(mission, 0)
        assert owner.command(m.MAV_CMD_MISSION_START) == 0
        while owner.items_reached < 1:
            owner.ping(1)
            time.sleep(0.02)
        before = owner.belongings()
        owner.is_flying, owner.replies_s, owner.items_reached = True, [], 0
        senders = []
        for _ in range(STREAMS):
            senders.append(ending.enter_context(closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))))
        source, memory = frames(seed, sky, keys, recorded), psutil.Process(process.pid).memory_info
        begun_s, warm_bytes = time.monotonic(), 0
        for n in range(count):
            datagram, i = next(source)
            senders[i].sendto(datagram, (LOOPBACK, port))
            if n % IN_A_ROW == 0:
                owner.ping(2 + n)
            if n == WARM:
                warm_bytes = memory().rss
        seconds = time.monotonic() - begun_s
        while owner.items_reached == 0 and time.monotonic() < begun_s + seconds + LONGEST_LEG_S:
            owner.ping(1)
            time.sleep(0.02)
        assert owner.belongings() == before
        more_mb = (memory().rss - warm_bytes) / 1e6
        owner.is_flying = False
        assert owner.command(m.MAV_CMD_DO_SET_MODE, 1, *HOLD) == 0
        assert process.poll() is None
    assert "Traceback" not in (folder / "said").read_text()
    slow = sum(reply_s > 1.0 for reply_s in owner.replies_s)
    return Figures(count, seconds, max(owner.replies_s), slow, more_mb, owner.items_reached)


VEHICLES = {"open": ([None, None, KEY], None), "signed": ([KEY, KEY, KEY, None, bytes(32)], KEY)}


def must_hold(figures: Figures) -> None:
    assert figures.slow_replies <= 1 + figures.datagrams // 100_000
    assert figures.slowest_reply_s < 5.0
    assert figures.more_memory_mb < 20.0
    assert figures.items_reached > 0, "its mission goes on"


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_neighbours_do_not_take_a_flight_away(vehicle, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    must_hold(under_fire(20_000, 6, *VEHICLES[vehicle], tmp_path))


if __name__ == "__main__":
    for name, vehicle in VEHICLES.items():
        with TemporaryDirectory() as folder:
            os.environ["XDG_STATE_HOME"] = folder
            figures = under_fire(1_000_000, 7, *vehicle, Path(folder))
        print(name, figures)
        must_hold(figures)
