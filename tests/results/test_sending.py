"""Events over real sockets."""

from __future__ import annotations

import json
import socket
import struct
import threading
import time

import defusedxml.ElementTree as ET
import pytest
from results_data import event, state, tiny_records, write_run

from skysweep.errors import UserError
from skysweep.results import run_folder, sending
from skysweep.results.run_folder import JOURNAL_FILE, load_run
from skysweep.results.sending import follow, send_once, udp

GROUP = "239.2.3.1"


@pytest.fixture
def receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bound:
        bound.bind(("127.0.0.1", 0))
        bound.settimeout(10.0)
        yield bound


def address_of(receiver):
    return f"udp://127.0.0.1:{receiver.getsockname()[1]}"


def next_event(receiver):
    return ET.fromstring(receiver.recv(65_536))


def append(folder, *records):
    with (folder / JOURNAL_FILE).open("a") as file:
        file.writelines(json.dumps(r) + "\n" for r in records)


def test_a_socket_gets_one_event_a_datagram(tiny_run, receiver):
    with udp(address_of(receiver), 1) as send:
        assert send_once(tiny_run, send) == 4
    callsigns = [next_event(receiver).find("detail/contact").get("callsign") for _ in range(4)]
    assert callsigns == [f"stop sign {k}" for k in (1, 2, 3, 4)]


def test_a_multicast_group_gets_them_with_its_ttl(tiny_run):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as member:
        member.bind(("", 0))
        member.settimeout(10.0)
        try:
            joined = struct.pack("4s4s", socket.inet_aton(GROUP), socket.inet_aton("0.0.0.0"))
            member.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, joined)
            with udp(f"udp://{GROUP}:{member.getsockname()[1]}", 7) as send:
                send_once(tiny_run, send)
        except (OSError, UserError) as error:
            pytest.skip(f"no multicast on this machine: {error}")
        assert next_event(member).get("version") == "2.0"


def test_a_mission_is_followed_to_its_end(tmp_path, receiver, monkeypatch):
    monkeypatch.setattr(sending, "_PERIOD_S", 0.02)
    folder = write_run(tmp_path / "run", tiny_records()[:7])
    warnings = []

    def run():
        with udp(address_of(receiver), 1) as send:
            follow(folder, send, warnings.append)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    candidate = next_event(receiver)
    assert candidate.find("detail/contact").get("callsign") == "candidate 1: stop sign?"
    places = []
    for t in (15, 16):
        append(folder, state(t, [t, 10, 2], "CHECK"))
        vehicle = next_event(receiver)
        assert vehicle.get("type") == "a-f-A-M-H-Q"
        places.append(vehicle.find("point").get("lon"))
    assert places[0] < places[1]
    append(folder, event(16, "confirmed", 1, [5.5, 10, 0]))
    found, _ = next_event(receiver), next_event(receiver)
    assert found.get("uid") == candidate.get("uid")
    assert found.find("detail/contact").get("callsign") == "stop sign 1"
    append(folder, event(17, "scanned", 2, [5, 12, 0]))
    second, _ = next_event(receiver), next_event(receiver)
    append(folder, event(20, "rejected", 2, [5, 12, 0]))
    deleted, _ = next_event(receiver), next_event(receiver)
    assert deleted.get("type") == "t-x-d-d"
    assert deleted.find("detail/link").get("uid") == second.get("uid")
    append(folder, {"t": 21, "kind": "end", "reason": "completed"})
    thread.join(10.0)
    assert not thread.is_alive()
    assert not warnings


def test_a_target_is_sent_again_after_a_while(tiny_run):
    sent = []
    board = sending._Board()
    for now_s in (0.0, 10.0, 31.0, 62.0):
        board.send_due(tiny_run, lambda event: sent.append(event.uid), now_s)
    assert len(sent) == 3 * (4 + 1), "and what was rejected is taken off the maps again"


def test_a_follower_that_begins_again_takes_off_what_was_rejected_meanwhile(tmp_path):
    folder = write_run(tmp_path / "run", tiny_records()[:12])
    first, second = [], []
    sending._Board().send_due(load_run(folder), first.append, 0.0)
    assert "candidate-2" in first[-1].uid
    append(folder, event(20, "rejected", 2, [5, 12, 0]))
    sending._Board().send_due(load_run(folder), second.append, 0.0)
    assert [e.uid for e in second if e.uid.endswith("candidate-2")] == []
    assert [e.uid for e in second if "candidate-2" in e.uid] == [f"{first[-1].uid}.delete"]


def test_a_picture_that_a_better_one_replaces_is_not_damaged(tmp_path):
    assert not run_folder._is_spoilt(tmp_path / "candidate-1-15.0s.jpg")
    (tmp_path / "candidate-1-16.0s.jpg").write_bytes(b"torn")
    assert run_folder._is_spoilt(tmp_path / "candidate-1-16.0s.jpg")


def test_a_folder_that_cannot_be_read_for_a_while_is_warned_of_once(tmp_path, monkeypatch):
    monkeypatch.setattr(sending, "_PERIOD_S", 0.01)
    folder, warnings, sent = write_run(tmp_path / "run", tiny_records()[:7]), [], []
    load, calls = sending.load_flown, []

    def loads(path):
        calls.append(path)
        if 1 < len(calls) < 5:
            raise OSError("busy")
        return load(path)

    monkeypatch.setattr(sending, "load_flown", loads)

    def send(event):
        sent.append(event)
        if len(sent) == 1:
            append(folder, *tiny_records()[7:])

    follow(folder, send, warnings.append)
    assert len(warnings) == 1
    assert "still trying" in warnings[0]
    assert len(sent) > 4


def test_a_network_that_is_away_is_warned_of_once_and_tried_again(tmp_path, monkeypatch):
    monkeypatch.setattr(sending, "_PERIOD_S", 0.01)
    folder, warnings, sent = write_run(tmp_path / "run", tiny_records()), [], []
    back_s = time.monotonic() + 0.2

    def send(event):
        if time.monotonic() < back_s:
            raise UserError("no network")
        sent.append(event)

    follow(folder, send, warnings.append)
    assert warnings == ["no network; still trying"]
    assert len(sent) == 4 + 1


@pytest.mark.parametrize(
    "address",
    [
        "",
        "239.2.3.1:6969",
        "tcp://127.0.0.1:6969",
        "udp://127.0.0.1",
        "udp://:6969",
        "udp://h:99999",
        "udp://[",
    ],
)
def test_an_address_that_is_none_is_refused_in_one_sentence(address):
    with pytest.raises(UserError, match=r"write udp://HOST:PORT"), udp(address, 1):
        pass


def test_a_host_that_is_not_known_is_named():
    with pytest.raises(UserError, match="is not known"), udp("udp://nowhere.invalid:6969", 1):
        pass
