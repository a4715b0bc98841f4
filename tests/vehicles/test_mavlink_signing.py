"""Signed links: nothing moves without the key."""

import pytest
from mavlink_clients import HOLD, Program, Sky, local
from pymavlink.dialects.v20 import common as m

from skysweep.errors import UserError
from skysweep.vehicles.mavlink.signing import Signing, read_signing_key
from skysweep.vehicles.mavlink.wire import Voice, read_frames

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
    import time

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
