"""Plans, fences and rally points: up, down, and flown."""

import numpy as np
import pytest
from mavlink_clients import HOLD, MISSION, Program, Sky, item
from pymavlink.dialects.v20 import common as m

from skysweep.vehicles.served.items import Item

NAN = float("nan")
ACCEPTED, FENCE, RALLY, ALL = 0, 1, 2, 255


@pytest.fixture
def sky():
    return Sky()


@pytest.fixture
def gcs(sky):
    return Program(sky)


def lap(sky):
    """Take-off, slower, a square with a stop, camera trigger, home and landing."""
    return [
        item(sky, m.MAV_CMD_NAV_TAKEOFF, 0, 0, 12.0),
        item(sky, m.MAV_CMD_DO_CHANGE_SPEED, params=(1.0, 3.0, -1.0, 0.0)),
        item(sky, m.MAV_CMD_DO_SET_CAM_TRIGG_DIST, params=(25.0, 0.0, 1.0, 0.0)),
        item(sky, m.MAV_CMD_NAV_WAYPOINT, 40, 0, 12.0),
        item(sky, m.MAV_CMD_NAV_WAYPOINT, 40, 30, 16.0, params=(5.0, 0.0, 0.0, NAN)),
        item(sky, m.MAV_CMD_NAV_RETURN_TO_LAUNCH),
    ]


def square(sky, half, command=m.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, east=0.0, north=0.0):
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    return [item(sky, command, east + e, north + n, 0.0, params=(4.0, 0.0, 0.0, 0.0)) for e, n in corners]


def test_what_went_up_comes_down_the_same(sky, gcs):
    circle = item(sky, m.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, 0, 0, params=(300.0, 0.0, 0.0, 0.0))
    sent = {
        0: lap(sky),
        FENCE: [*square(sky, 200.0), circle],
        RALLY: [item(sky, m.MAV_CMD_NAV_RALLY_POINT, 10, 20, 5.0)],
    }
    for kind, items in sent.items():
        assert gcs.upload(items, kind) == ACCEPTED
    for kind, items in sent.items():
        for back, there in zip(gcs.download(kind), items, strict=True):
            assert (back.frame, back.command, back.x, back.y, back.z) == (
                there.frame,
                there.command,
                there.x,
                there.y,
                there.z,
            )
            assert back.params == pytest.approx(there.params, nan_ok=True)
    gcs.say(m.MAVLink_mission_clear_all_message(1, 1, FENCE))
    assert [len(gcs.download(kind)) for kind in sent] == [6, 0, 1]
    gcs.say(m.MAVLink_mission_clear_all_message(1, 1, ALL))
    assert [len(gcs.download(kind)) for kind in sent] == [0, 0, 0]


def test_a_lost_item_is_asked_for_again_and_a_silent_client_forgotten(sky, gcs, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    gcs.say(m.MAVLink_mission_count_message(1, 1, 2, 0))
    for _ in range(9):
        now[0] += 0.6
        sky.fly(0.02)
    assert {r.seq for r in gcs.of("MISSION_REQUEST_INT")} == {0}
    assert len(gcs.of("MISSION_REQUEST_INT")) >= 8
    assert gcs.of("MISSION_ACK")[-1].type == m.MAV_MISSION_OPERATION_CANCELLED
    assert gcs.upload(lap(sky)) == ACCEPTED


def test_two_programs_cannot_upload_at_once(sky, gcs):
    other = Program(sky, port=2)
    gcs.say(m.MAVLink_mission_count_message(1, 1, 2, 0))
    (ack,) = other.answers(m.MAVLink_mission_count_message(1, 1, 1, 0), "MISSION_ACK")
    assert ack.type == m.MAV_MISSION_DENIED


def test_a_program_that_sends_no_item_loses_its_turn_when_another_asks(sky, gcs, monkeypatch):
    now, other = [100.0], Program(sky, port=2)
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    (first, *_) = lap(sky)
    place = (first.x, first.y, first.z, 0)
    out_of_turn = m.MAVLink_mission_item_int_message(1, 1, 7, 6, first.command, 0, 1, *first.params, *place)
    count = m.MAVLink_mission_count_message(1, 1, 2, 0)
    other.say(count)
    for stalling in (out_of_turn, count):
        now[0] += 0.45
        other.say(stalling)
    assert gcs.upload(lap(sky)) == m.MAV_MISSION_DENIED, "it has a second"
    now[0] += 0.2
    other.forget()
    assert gcs.upload(lap(sky)) == ACCEPTED
    assert other.of("MISSION_ACK")[0].type == m.MAV_MISSION_OPERATION_CANCELLED


def test_one_frame_every_four_seconds_denies_nobody_an_upload(sky, gcs, monkeypatch):
    now, other, denied = [100.0], Program(sky, port=2), 0
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    for tenths in range(200):
        if tenths % 40 == 0:
            other.say(m.MAVLink_mission_count_message(1, 1, 2, 0))
        denied += gcs.upload(lap(sky)) == m.MAV_MISSION_DENIED
        now[0] += 0.1
    assert denied <= 55, "the first second after each frame"


def test_a_mission_swapped_in_flight_is_held_against_the_fence_as_before_take_off(sky, gcs):
    assert gcs.upload(square(sky, 60.0), FENCE) == ACCEPTED
    assert gcs.upload(lap(sky)) == ACCEPTED
    assert gcs.command(m.MAV_CMD_MISSION_START) == 0
    sky.fly(until=lambda: sky.pilot.mission.current == 3)
    outside = item(sky, m.MAV_CMD_NAV_WAYPOINT, 65.5, 0, 12.0)
    assert gcs.upload([outside]) == m.MAV_MISSION_ERROR
    assert "geofence" in gcs.texts()
    assert len(gcs.download()) == 6
    assert sky.pilot.mode.name == "MISSION"
    assert gcs.upload([item(sky, m.MAV_CMD_NAV_WAYPOINT, 55, 0, 12.0)]) == ACCEPTED
    sky.fly(until=lambda: sky.pilot.mission.finished)
    assert sky.ned[:2] == pytest.approx([0.0, 55.0], abs=3.0)


@pytest.mark.parametrize(
    ("change", "result"),
    [
        ({"command": 4242}, m.MAV_MISSION_UNSUPPORTED),
        ({"frame": m.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT}, m.MAV_MISSION_UNSUPPORTED_FRAME),
        ({"x": 900_000_001}, m.MAV_MISSION_INVALID_PARAM5_X),
        ({"y": -(2**31)}, m.MAV_MISSION_INVALID_PARAM6_Y),
        ({"z": NAN}, m.MAV_MISSION_INVALID_PARAM7),
    ],
)
def test_a_bad_item_ends_the_upload_and_what_was_there_stays(sky, gcs, change, result):
    assert gcs.upload(lap(sky)) == ACCEPTED
    good = item(sky, m.MAV_CMD_NAV_WAYPOINT, 40, 0, 12.0)
    fields = {name: getattr(good, name) for name in good.__slots__} | change
    assert gcs.upload([good, Item(**fields), good]) == result
    assert len(gcs.download()) == 6


def as_degrees(i: Item, seq: int, **changes):
    """MISSION_ITEM, as programs send it that are older than MISSION_ITEM_INT."""
    place = {"x": i.x * 1e-7, "y": i.y * 1e-7, "z": i.z} | changes
    head = 1, 1, seq, i.frame, i.command, 0, 1
    return m.MAVLink_mission_item_message(*head, *i.params, place["x"], place["y"], place["z"])


def test_items_may_come_in_degrees(sky, gcs):
    items = lap(sky)
    gcs.say(m.MAVLink_mission_count_message(1, 1, len(items), 0))
    for seq, i in enumerate(items):
        assert gcs.of("MISSION_REQUEST_INT")[-1].seq == seq
        gcs.say(as_degrees(i, seq))
    assert gcs.of("MISSION_ACK")[-1].type == ACCEPTED
    for back, there in zip(gcs.download(), items, strict=True):
        assert (back.frame, back.command, back.z) == (there.frame, there.command, there.z)
        assert (back.x, back.y) == pytest.approx((there.x, there.y), abs=100)  # floats: a metre
        assert back.params == pytest.approx(there.params, nan_ok=True)


@pytest.mark.parametrize(
    ("change", "result"),
    [
        ({"x": NAN}, m.MAV_MISSION_INVALID_PARAM5_X),
        ({"x": 90.1}, m.MAV_MISSION_INVALID_PARAM5_X),
        ({"y": float("inf")}, m.MAV_MISSION_INVALID_PARAM6_Y),
        ({"y": -1e38}, m.MAV_MISSION_INVALID_PARAM6_Y),
    ],
)
def test_degrees_that_are_no_place_are_refused(sky, gcs, change, result):
    gcs.say(m.MAVLink_mission_count_message(1, 1, 1, 0))
    gcs.say(as_degrees(item(sky, m.MAV_CMD_NAV_WAYPOINT, 40, 0, 12.0), 0, **change))
    assert gcs.of("MISSION_ACK")[-1].type == result


def test_too_many_items_have_no_room(gcs):
    (ack,) = gcs.answers(m.MAVLink_mission_count_message(1, 1, 65535, 0), "MISSION_ACK")
    assert ack.type == m.MAV_MISSION_NO_SPACE


def test_a_fence_that_is_none_is_refused_whole(sky, gcs):
    assert gcs.upload(square(sky, 100.0), FENCE) == ACCEPTED
    bow_tie = square(sky, 50.0)
    bow_tie[2], bow_tie[3] = bow_tie[3], bow_tie[2]
    assert gcs.upload(bow_tie, FENCE) == m.MAV_MISSION_ERROR
    assert gcs.upload(square(sky, 50.0)[:3], FENCE) == m.MAV_MISSION_ERROR
    assert len(gcs.download(FENCE)) == 4


def test_a_mission_is_flown_item_by_item_and_ends_disarmed_at_home(sky, gcs):
    assert gcs.upload(lap(sky)) == ACCEPTED
    assert gcs.arm() == 0
    assert gcs.mode(*MISSION) == 0
    gcs.forget()
    track, speeds = [], []
    while sky.pilot.armed:
        sky.fly(0.2)
        track.append(sky.ned)
        if sky.pilot.mission.current == 3:
            speeds.append(np.hypot(*sky.vehicle.true_velocity_enu_mps[:2]))
    track = np.array(track)
    for corner in ([0.0, 40.0, -12.0], [30.0, 40.0, -16.0]):
        assert np.linalg.norm(track - corner, axis=1).min() < 2.0
    assert max(speeds) == pytest.approx(3.0, abs=0.4)
    near_stop = np.linalg.norm(track - [30.0, 40.0, -16.0], axis=1) < 2.2
    assert near_stop.sum() * 0.2 >= 5.0
    assert [r.seq for r in gcs.of("MISSION_ITEM_REACHED")] == [0, 1, 2, 3, 4, 5]
    assert gcs.of("MISSION_CURRENT")[-1].mission_state == m.MISSION_STATE_COMPLETE
    assert np.hypot(*sky.ned[:2]) < 1.2


def test_a_mission_that_was_held_goes_on_where_it_was(sky, gcs):
    assert gcs.upload(lap(sky)) == ACCEPTED
    gcs.arm()
    gcs.mode(*MISSION)
    sky.fly(until=lambda: sky.pilot.mission.current == 4)
    assert gcs.mode(*HOLD) == 0
    sky.fly(10.0)
    here = sky.ned
    sky.fly(5.0)
    assert sky.ned == pytest.approx(here, abs=0.3)
    assert sky.pilot.cruise_mps == sky.scenario.vehicle.cruise_speed_mps
    assert gcs.mode(*MISSION) == 0
    assert sky.pilot.mission.current == 4
    sky.tick()
    assert sky.pilot.cruise_mps == 3.0, "that of the items before"
    sky.fly(until=lambda: sky.pilot.mode.name == "RETURN")
    assert sky.pilot.cruise_mps == sky.scenario.vehicle.cruise_speed_mps


def test_landing_where_the_last_item_says(sky, gcs):
    there = item(sky, m.MAV_CMD_NAV_LAND, 25, -10, 0.0)
    assert gcs.upload([item(sky, m.MAV_CMD_NAV_TAKEOFF, 0, 0, 10.0), there]) == ACCEPTED
    assert gcs.command(m.MAV_CMD_MISSION_START) == 0, "it arms, as PX4's does"
    assert sky.pilot.armed
    sky.fly(until=lambda: not sky.pilot.armed)
    assert sky.ned[:2] == pytest.approx([-10.0, 25.0], abs=2.1)
    assert not sky.vehicle.state().airborne


def test_a_mission_cleared_in_flight_is_a_hold(sky, gcs):
    assert gcs.upload(lap(sky)) == ACCEPTED
    gcs.command(m.MAV_CMD_MISSION_START)
    sky.fly(until=lambda: sky.pilot.mission.current == 3)
    gcs.say(m.MAVLink_mission_clear_all_message(1, 1, ALL))
    sky.fly(0.1)
    assert sky.pilot.mode.name == "HOLD"


def test_home_is_moved_but_not_to_the_other_side_of_the_earth(sky, gcs):
    latitude, longitude, altitude = sky.geodetic([50.0, 20.0, 0.0])
    assert gcs.command(m.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, -latitude, longitude, 0) == m.MAV_RESULT_DENIED
    gcs.take_off(5.0)
    assert gcs.command(m.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, latitude, longitude, altitude) == 0
    gcs.command(m.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    sky.fly(until=lambda: not sky.pilot.armed)
    assert sky.ned[:2] == pytest.approx([50.0, 20.0], abs=1.5)


def test_jumps_delays_and_a_chosen_item(sky, gcs):
    up = item(sky, m.MAV_CMD_NAV_TAKEOFF, 0, 0, 6.0)
    out, back = item(sky, m.MAV_CMD_NAV_WAYPOINT, 12, 0, 6.0), item(sky, m.MAV_CMD_NAV_WAYPOINT, 0, 0, 6.0)
    jump = item(sky, m.MAV_CMD_DO_JUMP, params=(1.0, 2.0, 0.0, 0.0))
    delay = item(sky, m.MAV_CMD_NAV_DELAY, params=(4.0, 0.0, 0.0, 0.0))
    assert gcs.upload([up, out, back, jump, delay]) == ACCEPTED
    gcs.command(m.MAV_CMD_MISSION_START)
    sky.fly(until=lambda: sky.pilot.mission.current == 4)
    assert sky.fly(until=lambda: sky.pilot.mission.finished) == pytest.approx(4.0, abs=0.1)
    reached = [r.seq for r in gcs.of("MISSION_ITEM_REACHED")]
    assert reached == [0, 1, 2, 3, 1, 2, 3, 1, 2, 3, 4]
    assert sky.pilot.mode.name == "HOLD"
    assert gcs.command(m.MAV_CMD_DO_SET_MISSION_CURRENT, 9) == m.MAV_RESULT_DENIED
    assert gcs.command(m.MAV_CMD_DO_SET_MISSION_CURRENT, 2) == 0
    assert gcs.mode(*MISSION) == 0
    sky.fly(until=lambda: sky.pilot.mission.finished)


def test_a_jump_for_ever_does_not_hang(sky, gcs):
    up = item(sky, m.MAV_CMD_NAV_TAKEOFF, 0, 0, 6.0)
    assert gcs.upload([up, item(sky, m.MAV_CMD_DO_JUMP, params=(1.0, -1.0, 0.0, 0.0))]) == ACCEPTED
    gcs.command(m.MAV_CMD_MISSION_START)
    sky.fly(30.0)
    assert gcs.mode(*HOLD) == 0


def test_the_nearest_rally_point_is_where_it_returns(sky, gcs):
    assert gcs.upload([item(sky, m.MAV_CMD_NAV_RALLY_POINT, 60, 0, 0.0)], RALLY) == ACCEPTED
    gcs.take_off(10.0)
    there = item(sky, m.MAV_CMD_NAV_WAYPOINT, 50, 10, 10.0)
    gcs.upload([there])
    gcs.mode(*MISSION)
    sky.fly(until=lambda: sky.pilot.mission.finished)
    gcs.command(m.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    sky.fly(until=lambda: not sky.pilot.armed)
    assert sky.ned[:2] == pytest.approx([0.0, 60.0], abs=1.2)


@pytest.mark.parametrize("limit", ["GF_MAX_HOR_DIST", "GF_MAX_VER_DIST"])
def test_farther_or_higher_than_allowed_is_outside_too(sky, gcs, limit):
    gcs.set(limit, 15.0)
    gcs.take_off(10.0)
    latitude, longitude, altitude = sky.geodetic([0.0, 14.0, -14.0])
    assert gcs.command(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, latitude, longitude, altitude) == 0
    latitude, longitude, altitude = sky.geodetic([0.0, 16.0, -16.0])
    refused = gcs.command(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, latitude, longitude, altitude)
    assert refused == m.MAV_RESULT_DENIED


def test_exclusions_keep_the_mission_and_the_vehicle_out(sky, gcs):
    no_go = square(sky, 10.0, m.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION, east=40.0)
    assert gcs.upload(no_go, FENCE) == ACCEPTED
    assert gcs.upload(lap(sky)) == ACCEPTED
    assert gcs.arm() == 0
    assert gcs.mode(*MISSION) == m.MAV_RESULT_TEMPORARILY_REJECTED
    assert "geofence" in gcs.texts()
    assert gcs.upload(square(sky, 10.0, m.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION), FENCE) == ACCEPTED
    gcs.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    assert gcs.arm() == m.MAV_RESULT_TEMPORARILY_REJECTED
    assert "geofence" in gcs.texts()
