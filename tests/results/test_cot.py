from __future__ import annotations

import math
from datetime import datetime, timedelta, timezone

import defusedxml.ElementTree as ET
import pytest
from results_data import event, state, tiny_records, write_run

from skysweep.results.cot import UNKNOWN, deletion, events_of, events_xml, vehicle_event
from skysweep.results.run_folder import load_run

NOW = datetime(2026, 5, 17, 9, 30, tzinfo=timezone.utc)
TIMES = ("time", "start", "stale")
REAL = {"t": 0, "kind": "setup", "truth": False}


def told(run, now=NOW):
    return [ET.fromstring(e.xml) for e in events_of(run, now)]


def time_of(element, name):
    return datetime.fromisoformat(element.get(name).replace("Z", "+00:00"))


def with_covariance(records):
    return [
        r | {"covariance_m2": [[4.0, 0.0], [0.0, 1.0]]} if r["kind"] == "confirmed" else r for r in records
    ]


def test_each_target_is_an_event_of_the_schema(tmp_path):
    run = load_run(write_run(tmp_path / "run", with_covariance(tiny_records())))
    found = told(run)
    assert len(found) == 4
    for element in found:
        assert element.tag == "event"
        assert element.get("version") == "2.0"
        assert element.get("how") == "m-g"
        assert [child.tag for child in element] == ["point", "detail"]
        assert time_of(element, "time") == NOW
        assert time_of(element, "start") <= time_of(element, "time") < time_of(element, "stale")
        point = element.find("point").attrib
        assert set(point) == {"lat", "lon", "hae", "ce", "le"}
        assert all(math.isfinite(float(value)) for value in point.values())
        assert float(point["ce"]) == pytest.approx(2.0, abs=0.01)  # sigma of the longer axis
        assert point["hae"] == point["le"] == UNKNOWN
    first = found[0]
    assert first.find("detail/contact").get("callsign") == "stop sign 1"
    assert float(first.find("point").get("lat")) == pytest.approx(60.4490 + 10 / 111_412, abs=2e-7)
    assert "MGRS 34VEN" in first.findtext("detail/remarks")


def test_uids_are_of_the_mission_and_the_candidate(tmp_path):
    first = load_run(write_run(tmp_path / "a", tiny_records()))
    again = load_run(write_run(tmp_path / "b", tiny_records()))
    uids = [e.uid for e in events_of(first, NOW)]
    assert len(set(uids)) == 4
    assert uids == [e.uid for e in events_of(again, NOW + timedelta(hours=1))]
    clock = {"t": 0, "kind": "clock", "utc": "2026-05-17T09:00:00.000+00:00"}
    on_the_day = load_run(write_run(tmp_path / "c", [clock, *tiny_records()]))
    assert not set(uids) & {e.uid for e in events_of(on_the_day, NOW)}


def test_what_an_event_says_changes_with_its_news_and_not_with_the_time(tiny_run, tmp_path):
    before, later = events_of(tiny_run, NOW), events_of(tiny_run, NOW + timedelta(minutes=1))
    assert [e.says for e in before] == [e.says for e in later]
    assert [e.xml for e in before] != [e.xml for e in later]
    moved = [r | {"p": [6.0, 10, 0]} if r.get("candidate") == 1 else r for r in tiny_records()]
    other = events_of(load_run(write_run(tmp_path / "moved", moved)), NOW)
    assert [a.says == b.says for a, b in zip(before, other, strict=True)] == [False, True, True, True]


def test_the_start_is_when_it_was_found_where_the_mission_has_wall_time(tmp_path):
    clock = {"t": 0, "kind": "clock", "utc": "2026-05-17T09:00:00.000+00:00"}
    run = load_run(write_run(tmp_path / "run", [clock, *tiny_records()]))
    assert time_of(told(run)[0], "start") == datetime(2026, 5, 17, 9, 0, 16, tzinfo=timezone.utc)


def test_a_mission_that_still_flies_shows_its_vehicle_and_its_candidates(tmp_path):
    records = [*tiny_records()[:7], state(15, [5, 10, 2], "CHECK"), state(15.5, [6, 10, 2], "CHECK")]
    run = load_run(write_run(tmp_path / "run", records))
    (candidate,), vehicle = told(run), ET.fromstring(vehicle_event(run, NOW).xml)
    assert candidate.find("detail/contact").get("callsign") == "candidate 1: stop sign?"
    assert candidate.find("detail/color").get("argb") != "-65536"
    assert vehicle.get("type") == "a-f-A-M-H-Q"
    track = vehicle.find("detail/track").attrib
    assert (float(track["course"]), float(track["speed"])) == (90.0, 2.0)
    assert vehicle.find("detail/status").get("battery") == "98"
    assert "CHECK, 2 m above ground, 32 m above mean sea level" in vehicle.findtext("detail/remarks")
    assert time_of(vehicle, "stale") - NOW == timedelta(seconds=30)


def test_a_simulation_says_so_and_a_real_flight_does_not(tmp_path):
    simulated = told(load_run(write_run(tmp_path / "a", tiny_records())))[0]
    assert simulated.get("opex").startswith("s")
    assert simulated.findtext("detail/remarks").startswith("SIMULATED")
    real = told(load_run(write_run(tmp_path / "b", [REAL, *tiny_records()])))[0]
    assert real.get("opex") is None
    assert "SIMULATED" not in real.findtext("detail/remarks")


def test_a_deletion_names_what_it_deletes(tiny_run):
    uid = events_of(tiny_run, NOW)[0].uid
    element = ET.fromstring(deletion(uid, NOW).xml)
    assert element.get("type") == "t-x-d-d"
    assert element.find("detail/link").get("uid") == uid
    assert element.find("detail/__forcedelete") is not None


@pytest.mark.parametrize("name", ["<script>alert(1)</script>", 'a" b="c', "]]>", "\x00"])
def test_a_name_from_outside_is_text(tmp_path, name):
    records = [r | {"class_name": name} if r["kind"] == "sighting" else r for r in tiny_records()]
    document = ET.fromstring(events_xml(load_run(write_run(tmp_path / "run", records)), NOW))
    assert [e.tag for e in document] == ["event"] * 4
    callsign = document[0].find("detail/contact").get("callsign")
    assert callsign == f"{load_run(tmp_path / 'run').candidates[0].class_name} 1"


def test_rejected_candidates_are_no_events(tmp_path):
    records = [*tiny_records()[:13], event(20, "rejected", 2, [5, 12, 0])]
    callsigns = [
        e.find("detail/contact").get("callsign") for e in told(load_run(write_run(tmp_path / "r", records)))
    ]
    assert callsigns == ["stop sign 1"]
