"""Signed links: nothing moves without the key."""

import time

import pytest
from mavlink_clients import HOLD, Program, Sky, local, scenario, wait
from pymavlink.dialects.v20 import common as m

from skysweep.errors import UserError
from skysweep.vehicles.embedded.at_home import embedded_vehicle
from skysweep.vehicles.mavlink import signing as signing_module
from skysweep.vehicles.mavlink.signing import Signing, read_signing_key
from skysweep.vehicles.mavlink.signing_memory import SigningMemory
from skysweep.vehicles.mavlink.wire import Voice, read_frames
from skysweep.vehicles.served.server import VehicleServer

KEY, OTHER_KEY = bytes(range(32)), bytes(32)


def arm_message():
    return m.MAVLink_command_long_message(1, 1, m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)


def test_a_signed_program_flies_and_hears_signed_frames():
    sky = Sky(signing_key=KEY)
    program = Program(sky, key=KEY)
    program.take_off(5.0)
    assert program.mode(*HOLD) == 0
    assert sky.pilot.flying
    listener = m.MAVLink(None)
    listener.signing.secret_key = KEY
    program.forget()
    sky.fly(2.0)
    assert len([listener.decode(bytearray(d)) for d in program._datagrams]) > 100
    assert listener.signing.badsig_count == 0


@pytest.mark.parametrize("key", [None, OTHER_KEY])
def test_unsigned_and_wrongly_signed_frames_do_nothing(key):
    sky = Sky(signing_key=KEY)
    stranger = Program(sky, key=key)
    stranger.say(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    stranger.say(arm_message())
    stranger.say(local(0, 0, -10))
    sky.fly(1.0)
    assert not sky.pilot.armed
    assert sky.pilot.offboard.owner is None
    assert not stranger.heard, "a stranger is not even told where the vehicle is"


def test_a_recorded_frame_played_again_does_nothing():
    sky = Sky(signing_key=KEY)
    recorded = Voice(190, Signing(KEY)).pack(arm_message())
    sky.face.receive(recorded, ("10.0.0.1", 1))
    assert sky.pilot.armed
    sky.pilot.disarm()
    sky.face.receive(recorded, ("10.0.0.1", 1))
    assert not sky.pilot.armed


def test_an_old_recording_does_not_open_a_new_stream(monkeypatch):
    now = time.time()
    monkeypatch.setattr("time.time", lambda: now - 120.0)
    old = Voice(190, Signing(KEY)).pack(arm_message())
    monkeypatch.setattr("time.time", lambda: now)
    assert not list(read_frames(old, Signing(KEY)))


def test_a_forged_timestamp_does_not_lock_the_owner_out():
    signing = Signing(KEY)
    voice = Voice(190, Signing(KEY))
    assert list(read_frames(voice.pack(arm_message()), signing))
    forged = bytearray(voice.pack(arm_message()))
    forged[-12:-6] = b"\xff" * 6
    assert not list(read_frames(bytes(forged), signing))
    assert list(read_frames(voice.pack(arm_message()), signing))


SECOND = 100_000  # of a timestamp


def signed(timestamp: int, link: int = 0, system: int = 245) -> bytes:
    """A frame rightly signed, at any time."""
    speaker = m.MAVLink(None, system, 190)
    speaker.signing.secret_key, speaker.signing.sign_outgoing = KEY, True
    speaker.signing.timestamp, speaker.signing.link_id = timestamp, link
    return arm_message().pack(speaker)


def now() -> int:
    return Signing(None).stamp()


def later(monkeypatch, seconds: float) -> None:
    """Time passes, for the clock that nobody sets."""
    elapsed_s = signing_module._elapsed_s
    monkeypatch.setattr(signing_module, "_elapsed_s", lambda: elapsed_s() + seconds)


@pytest.fixture
def memory(tmp_path):
    return SigningMemory(tmp_path / "deep" / "streams.json")


def test_what_was_heard_before_a_restart_is_not_heard_again(memory):
    before, begun = Signing(KEY, memory), now()
    recorded = [signed(begun + i * SECOND // 4, link) for i in range(20) for link in (0, 7)]
    assert all(map(before.accepts, recorded))
    before.close()
    after = Signing(KEY, memory)
    assert not any(map(after.accepts, recorded))
    assert after.accepts(signed(begun + 8 * SECOND)), "and it goes on from there"


def test_a_program_that_is_killed_has_written_down_what_it_heard(memory):
    before, begun = Signing(KEY, memory), now()
    wait(lambda: before.accepts(signed(now())) and memory.read(), 5.0)
    for _ in range(30):
        last = signed(now())
        assert before.accepts(last)
        time.sleep(0.1)
    assert not Signing(KEY, memory).accepts(last)
    assert now() - begun > 2 * SECOND, "longer than it was written down for at first"


def test_a_served_vehicle_that_is_started_again_does_not_take_off_for_a_recording(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    of, recorded = scenario(), signed(now() - 19 * SECOND)
    armed = []
    for _ in range(2):
        server = VehicleServer(embedded_vehicle(of, 0), of, [], signing_key=KEY)
        server.face.receive(recorded, ("10.0.0.1", 1))
        armed.append(server.face.pilot.armed)
        server.stop()
    assert armed == [True, False]


def test_programs_that_share_a_key_keep_each_others_streams(memory):
    one, two, begun = Signing(KEY, memory), Signing(KEY, memory), now()
    for system, signing in enumerate((one, two), 1):
        assert signing.accepts(signed(begun, system=system))
        signing.close()
    after = Signing(KEY, memory)
    assert not any(after.accepts(signed(begun, system=system)) for system in (1, 2))


def test_a_damaged_memory_refuses_all_that_is_older_than_the_restart(memory, tmp_path):
    path = tmp_path / "deep" / "streams.json"
    for damaged in ("", "{", "[1]", "null", '{"0/1": 5}'):
        path.parent.mkdir(exist_ok=True)
        path.write_text(damaged)
        after = Signing(KEY, memory)
        assert not after.accepts(signed(now() - 5 * SECOND, link=9))
        assert after.accepts(signed(now() + SECOND, link=9))
        after.close()
        assert len(memory.read()) == 1, "it is whole again"


def test_a_place_that_cannot_be_written_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="XDG_STATE_HOME"):
        Signing(KEY, SigningMemory(tmp_path / "file" / "streams.json"))


def test_the_memory_is_written_once_a_second_not_for_every_frame(memory, monkeypatch):
    written, write = [], memory.write
    monkeypatch.setattr(memory, "write", lambda *given: (written.append(given), write(*given)))
    signing, begun = Signing(KEY, memory), now()
    written.clear()
    assert all(signing.accepts(signed(begun + i * SECOND // 50)) for i in range(500))
    assert len(written) <= 11


@pytest.mark.parametrize("seconds", [61, 3600, 2_700_000_000])
def test_a_time_far_ahead_is_refused_and_silences_nobody(seconds):
    signing = Signing(KEY)
    owner = Voice(190, Signing(KEY), system_id=245)
    assert list(read_frames(owner.pack(arm_message()), signing))
    ahead = min(now() + seconds * SECOND, 2**48 - 1)
    for link in (0, 1):
        assert not signing.accepts(signed(ahead, link))
    assert signing.stamp() < now() + SECOND
    assert list(read_frames(owner.pack(arm_message()), signing))


@pytest.mark.parametrize(("seconds", "is_heard"), [(-61, False), (-59, True), (59, True), (61, False)])
def test_a_program_whose_clock_is_off_by_less_than_a_minute_is_heard(seconds, is_heard):
    assert Signing(KEY).accepts(signed(now() + seconds * SECOND)) is is_heard


def test_a_frame_that_was_held_back_for_minutes_is_refused_on_a_stream_that_is_known(monkeypatch):
    signing, begun = Signing(KEY), now()
    assert signing.accepts(signed(begun))
    held_back = signed(begun + SECOND)
    later(monkeypatch, 90.0)
    assert not signing.accepts(held_back)
    assert signing.accepts(signed(begun + 90 * SECOND))


@pytest.mark.skipif(not hasattr(time, "CLOCK_BOOTTIME"), reason="this system's clocks stand still in sleep")
def test_a_computer_that_slept_is_not_deaf(monkeypatch):
    """The monotonic clock stands still meanwhile."""
    signing, begun, begun_s, read = Signing(KEY), now(), time.monotonic(), time.clock_gettime
    monkeypatch.setattr("time.monotonic", lambda: begun_s)
    monkeypatch.setattr("time.clock_gettime", lambda clock: read(clock) + 90.0)
    assert signing.accepts(signed(begun + 90 * SECOND))
    assert signing.stamp() > begun + 89 * SECOND


@pytest.mark.parametrize("hours", [-1, 1])
def test_a_clock_that_is_set_in_flight_does_not_make_the_vehicle_deaf(monkeypatch, hours):
    signing, begun, begun_s = Signing(KEY), now(), time.time()
    assert signing.accepts(signed(begun))
    monkeypatch.setattr("time.time", lambda: begun_s + 3600 * hours)
    assert signing.accepts(signed(begun + SECOND))
    assert abs(signing.stamp() - begun) < 2 * SECOND


@pytest.mark.parametrize("silent", [False, True])
def test_a_clock_that_lost_its_time_is_set_by_the_first_good_frame(monkeypatch, memory, silent):
    """Not by a recording, even of a stream that was silent for so long that nobody remembers it."""
    begun, begun_s = now(), time.time()
    recorded = [signed(begun, link=9), signed(begun)]
    before = Signing(KEY, memory)
    assert all(map(before.accepts, recorded))
    later(monkeypatch, 100.0)
    if not silent:
        recorded.append(signed(begun + 100 * SECOND))
        assert before.accepts(recorded[-1])
    before.close()
    monkeypatch.setattr("time.time", lambda: begun_s - 9e6)
    after = Signing(KEY, memory)
    assert not any(map(after.accepts, recorded))
    days_later = begun + 3 * 86_400 * SECOND
    assert after.accepts(signed(days_later))
    assert not after.accepts(signed(days_later + 3600 * SECOND)), "once"


def test_many_link_ids_lock_nobody_out_and_open_no_recording():
    signing, begun = Signing(KEY), now()
    early = signed(begun, link=255, system=9)
    assert signing.accepts(early)
    for i in range(5000):
        assert signing.accepts(signed(begun + 1 + i, link=i % 256, system=1 + i // 256))
        if i % 50 == 0:
            assert signing.accepts(signed(begun + 1 + i, link=0, system=245)), "the owner"
    assert not signing.accepts(early)
    assert len(signing._streams) <= 1024


def test_key_files(tmp_path):
    path = tmp_path / "key"
    path.write_text(KEY.hex() + "\n")
    assert read_signing_key(path) == KEY
    for bad in ("", "abcd", "z" * 64, KEY.hex() * 2):
        path.write_text(bad)
        with pytest.raises(UserError, match="64 hexadecimal"):
            read_signing_key(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(UserError, match="64 hexadecimal"):
        read_signing_key(path)
    with pytest.raises(UserError, match="no such file"):
        read_signing_key(tmp_path / "none")
