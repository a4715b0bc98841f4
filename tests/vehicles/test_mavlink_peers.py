"""Who hears the vehicle: whoever talks, as long as they talk."""

import pytest
from mavlink_clients import Program, Sky
from pymavlink.dialects.v20 import common as m

from skysweep.vehicles.served.face import Face
from skysweep.vehicles.served.peers import MAX_GUESTS

HEARTBEAT = m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


@pytest.fixture
def sky():
    return Sky()


def passer_by(sky: Sky, port: int) -> Program:
    """Somebody who sends one datagram."""
    program = Program(sky, port=port)
    program.say(HEARTBEAT)
    program.beats = False
    return program


def test_one_datagram_is_not_answered_with_telemetry_for_ever(sky):
    stranger = passer_by(sky, 7)
    sky.fly(3.0)
    assert stranger.of("ATTITUDE")
    sky.fly(3.0)
    stranger.forget()
    sky.fly(10.0)
    assert not stranger.heard


def test_what_is_no_frame_is_not_answered_at_all(sky):
    stranger = Program(sky, port=7)
    sky.face.receive(b"\xfd\xff\x00" * 7, stranger.address)
    sky.fly(2.0)
    assert not stranger.heard


def test_those_who_talk_are_not_sent_away_for_others(sky):
    talks = Program(sky, port=1)
    talks.say(HEARTBEAT)
    others = [passer_by(sky, 10 + i) for i in range(3 * MAX_GUESTS)]
    talks.forget()
    sky.fly(3.0)
    assert len(talks.of("HEARTBEAT")) >= 5, "of autopilot and camera"
    assert sum(bool(other.of("ATTITUDE")) for other in others) == MAX_GUESTS - 1


def test_whoever_finds_no_room_is_obeyed_all_the_same_and_hears_it_later(sky):
    owner = Program(sky, port=1)
    owner.take_off(5.0)
    for i in range(MAX_GUESTS):
        passer_by(sky, 10 + i)
    late = Program(sky, port=2)
    assert late.mode(4, 3) == 0
    assert late.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, m.MAVLINK_MSG_ID_ATTITUDE, 1e5) != 0
    late.forget()
    sky.fly(2.0)
    assert not late.of("ATTITUDE")
    sky.fly(4.5)
    assert late.of("ATTITUDE")


def test_a_listener_who_comes_back_finds_its_streams_as_it_left_them(sky):
    program = Program(sky)
    assert program.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, m.MAVLINK_MSG_ID_ATTITUDE, 5e5) == 0
    program.beats = False
    sky.fly(20.0)
    program.say(HEARTBEAT)
    program.forget()
    sky.fly(10.0)
    assert len(program.of("ATTITUDE")) == pytest.approx(20, abs=1)


def test_the_addresses_it_was_told_to_send_to_hear_it_always(sky):
    told, heard = ("10.0.0.1", 14540), []
    face = Face(sky.vehicle, sky.scenario, lambda _, to: heard.append(to), [told])
    for i in range(3 * MAX_GUESTS):
        face.receive(Program(sky)._voice.pack(HEARTBEAT), ("10.0.0.2", i))
    for _ in range(500):
        face.tick()
    assert heard[-1] == told
    assert heard.count(told) > 900


def test_programs_have_as_much_time_on_the_wall_where_vehicle_time_runs_faster(sky):
    port, heard = ("10.0.0.2", 1), []
    face = Face(sky.vehicle, sky.scenario, lambda _, to: heard.append(to), speed=10.0)
    face.receive(Program(sky)._voice.pack(HEARTBEAT), port)
    for _ in range(2000):
        face.tick()
    assert heard[-1] == port
    heard.clear()
    for _ in range(1000):
        face.tick()
    assert heard
    heard.clear()
    face.tick()
    assert not heard
