"""Whatever arrives: no crash, no hang, and nothing moves without the key."""

import random
import time

import numpy as np
import pytest
from mavlink_clients import HOLD, LAND, MISSION, OFFBOARD, POSITION, RETURN, Program, Sky, item, local
from pymavlink.dialects.v20 import development as m

from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.mavlink.wire import Voice

KEY = bytes(range(32))
ODD = [0.0, 1.0, -1.0, 2.0, 400.0, 1e9, -1e38, float("nan"), float("inf"), float("-inf")]
STREAMS = 24  # address and ids of the senders


def frames(seed: int, sky: Sky, keys: list):
    """For ever (datagram, port): sensible messages, odd numbers, broken bytes, and noise."""
    draw = random.Random(seed)
    voices = [Voice(draw.choice([1, 25, 190]), Signing(draw.choice(keys))) for _ in range(STREAMS)]
    for voice in voices:
        voice._encoder.srcSystem = draw.choice([1, 2, 245, 255])
    known = list(m.mavlink_map.values())
    heard = [kind for kind in known if kind.msgname in sky.face._handle]
    sensible = list(sensible_messages(sky))
    final = m.MAV_CMD_DO_FLIGHTTERMINATION  # nothing would fly after it
    commands = [number for number in sky.face._commands._do if number != final]
    while True:
        i = draw.randrange(STREAMS)
        choice = draw.random()
        if choice < 0.05:
            yield draw.randbytes(draw.randrange(1, 80)), i
            continue
        if choice < 0.3:
            message = draw.choice(sensible)
        else:
            message = odd_message(draw, draw.choice(heard if choice < 0.85 else known), commands)
        old = choice > 0.95 and getattr(message, "id", 256) < 256
        datagram = message.pack(voices[i]._encoder, force_mavlink1=True) if old else voices[i].pack(message)
        if draw.random() < 0.2:
            broken = bytearray(datagram)
            for _ in range(draw.randrange(1, 4)):
                broken[draw.randrange(len(broken))] = draw.randrange(256)
            datagram = bytes(broken)
        elif draw.random() < 0.05:
            datagram = datagram[: draw.randrange(len(datagram))] + voices[i].pack(draw.choice(sensible))
        yield datagram, i


def odd_message(draw: random.Random, kind, commands):
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
            if name == "command" and draw.random() < 0.9:
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
    for kind in (0, 1, 2):
        yield m.MAVLink_mission_count_message(1, 1, 3, kind)
        yield m.MAVLink_mission_request_list_message(1, 1, kind)
    for seq in range(3):
        i = item(sky, m.MAV_CMD_NAV_WAYPOINT, 10.0 * seq, 5.0, 10.0)
        place = (i.x, i.y, i.z, 0)
        yield m.MAVLink_mission_item_int_message(1, 1, seq, i.frame, i.command, 0, 1, *i.params, *place)


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
    assert not sky.face._peers


def test_a_datagram_full_of_frame_starts_takes_no_time():
    sky = Sky()
    for datagram in (b"\xfd" * 65507, b"\xfe" * 65507, b"\xfd\x00\x01" * 21835):
        start = time.thread_time()
        sky.face.receive(datagram, ("10.0.0.2", 1))
        assert time.thread_time() - start < 0.5


@pytest.mark.slow
def test_a_million_frames():
    """Half of them at an open vehicle, which flies about meanwhile, half at one with a key."""
    open_sky, signed_sky = Sky(), Sky(signing_key=KEY)
    before = standing(signed_sky)
    slowest, modes = bombard(open_sky, 500_000, 4, [None, None, KEY], in_the_air=True)
    assert slowest < 2.0
    assert {"HOLD", "RETURN", "LAND", "OFFBOARD"} <= modes
    bombard(signed_sky, 500_000, 5, [None, bytes(32)])
    assert standing(signed_sky) == before
    assert Program(open_sky).command(m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == 0
