"""What is told of a mission while it flies."""

import csv
import json
import re
from contextlib import closing

import pytest

from skysweep.errors import UserError
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.resume import resume_folder
from skysweep.flights.rig import Rig
from skysweep.mission.journal import FileJournal
from skysweep.results.announcements import Announcer
from skysweep.scenarios.model import Scenario

SIGNS = {
    "name": "signs",
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
    "home": {"position_enu_m": [-5, -5], "latitude_deg": 60.448999, "longitude_deg": 22.296601},
    "targets": [
        {"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9},
        {"class": "stop sign", "position_enu_m": [45, 12], "size_m": 0.9},
    ],
    "camera": {"hfov_rad": 1.2},
    "search": {"n_c": 1},
}


def line(t, kind, **fields):
    return {"t": t, "kind": kind} | fields


def sighting(t, candidate, confidence, name="stop sign"):
    p = [12.3, 45.6, 0.0]
    return line(t, "sighting", candidate=candidate, class_name=name, p=p, confidence=confidence)


def told(records, before=(), **more):
    said = []
    announcer = Announcer(Scenario.model_validate(SIGNS), before, said.append, **more)
    for record in records:
        announcer.hear(record)
    return said


def confirmed(t, candidate, p=(12.3, 45.6, 0.0)):
    return line(t, "confirmed", candidate=candidate, p=list(p), covariance_m2=[[0.1, 0.0], [0.0, 0.1]])


def test_a_find_says_where_how_sure_when_and_which_picture(tmp_path):
    asked = []

    def picture_of(candidate):
        asked.append(candidate)
        return tmp_path / "7.jpg"

    records = [
        sighting(60.0, 7, 0.5),
        sighting(132.0, 7, 0.87),
        sighting(132.5, 8, 0.99),
        confirmed(133.2, 7),
    ]
    assert told(records, picture_of=picture_of) == [
        "found stop sign 1 at 60.4494083, 22.2968245 (E 12.3 m, N 45.6 m), confidence up to 0.87, "
        f"2:13 after take-off, picture {tmp_path / '7.jpg'}"
    ]
    assert asked == [7]


def test_only_what_is_new_is_said_and_the_counting_goes_on():
    before = [sighting(10.0, 1, 0.9), confirmed(11.0, 1), sighting(12.0, 2, 0.7, "boat")]
    (said,) = told([confirmed(20.0, 2)], before)
    assert said.startswith("found boat 2 at ")
    assert "confidence up to 0.70, 0:20 after" in said
    assert "picture" not in said


def test_alarms_and_what_stayed_unchecked_are_said_and_nothing_else():
    records = [
        line(1.0, "state", p=[0, 0, 30], mode="SCAN"),
        sighting(2.0, 3, 0.6),
        line(2.1, "scanned", candidate=3, p=[12.3, 45.6, 0.0]),
        line(3.0, "safety", cause="wind", action="HOLD", sentence="The wind blows at 12 m/s."),
        line(4.0, "unsearched", legs_enu_m=[], length_m=31.0, again=True),
        line(5.0, "rejected", candidate=9, p=[0, 0, 0]),
        line(6.0, "unchecked", candidate=3, p=[12.5, 45.5, 0.0]),
        line(6.5, "finished", reason="it has lasted 60 s"),
        line(7.0, "end", reason="completed"),
    ]
    hold, blind, unchecked, early = told(records)
    assert early == "The search ends early: it has lasted 60 s."
    assert hold == "The vehicle holds: The wind blows at 12 m/s."
    assert blind.startswith("31 m of the scan")
    assert re.fullmatch(
        r"not checked: candidate 3 \(stop sign\) at 60\.44\d{5}, 22\.29\d{5} \(E 12\.5 m, N 45\.5 m\)",
        unchecked,
    )


def test_a_mission_says_each_find_once_as_its_files_do(tmp_path):
    folder, said = tmp_path / "run", []
    fly_to_folder(Scenario.model_validate(SIGNS), 0, folder, Rig("statistical", say=said.append))
    finds = [words for words in said if words.startswith("found")]
    with (folder / "targets.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(finds) == len(rows) == 2
    for words, row in zip(finds, rows, strict=True):
        place = f"{float(row['latitude_deg']):.7f}, {float(row['longitude_deg']):.7f}"
        assert words.startswith(f"found {row['name']} at {place} (")
        assert f"confidence up to {float(row['confidence']):.2f}" in words


@pytest.mark.parametrize("again", [False, True], ids=["replayed", "complete"])
def test_a_resumed_mission_says_only_what_is_new(tmp_path, again):
    folder, said, later = tmp_path / "run", [], []
    fly_to_folder(Scenario.model_validate(SIGNS), 0, folder, Rig("statistical", say=said.append))
    path = folder / "journal.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    first = next(k for k, text in enumerate(lines) if json.loads(text)["kind"] == "confirmed")
    if not again:
        path.write_text("".join(lines[: first + 1]))
        (folder / "summary.json").unlink()
    resume_folder(folder, Rig(say=later.append))
    assert later == ([] if again else said[1:])
    assert path.read_text() == "".join(lines)


def test_a_full_disk_does_not_silence_the_mission(tmp_path):
    heard = []
    with closing(FileJournal(tmp_path / "journal.jsonl")) as journal:
        journal.listeners.append(heard.append)
        journal.write(1.0, "safety", x=0.123456)
        journal.failed = "the disk is full"
        journal.write(2.0, "end")
    assert heard == [{"t": 1.0, "kind": "safety", "x": 0.1235}, {"t": 2.0, "kind": "end"}]
    assert len((tmp_path / "journal.jsonl").read_text().splitlines()) == 1


def test_a_folder_that_holds_a_mission_says_nothing(tmp_path):
    folder, said = tmp_path / "run", []
    fly_to_folder(Scenario.model_validate(SIGNS), 0, folder, Rig("statistical"))
    with pytest.raises(UserError):
        fly_to_folder(Scenario.model_validate(SIGNS), 0, folder, Rig("statistical", say=said.append))
    assert said == []


def test_the_operators_verdicts_are_said_to_be_theirs():
    records = [
        sighting(2.0, 3, 0.6),
        confirmed(5.0, 3) | {"by": "operator"},
        confirmed(6.0, 3) | {"kind": "rejected", "by": "operator"},
    ]
    looked = line(9.0, "looked", p=[12.3, 45.6, 0.0])
    found, rejected, seen = told([*records, looked])
    assert seen == "Looked at 12 m east, 46 m north for the operator."
    assert found.startswith("confirmed by the operator: stop sign 1 at 60.4494083, 22.2968245")
    assert rejected.startswith("rejected by the operator: candidate 3 (stop sign) at 60.4494083, 22.2968245")


def test_a_line_that_cannot_be_announced_ends_no_flight():
    said = told(
        [sighting(60.0, 7, 0.5), confirmed(61.0, 7, p=(1.0,)), sighting(62.0, 8, 0.5), confirmed(63.0, 8)]
    )
    assert said[0].startswith("the journal's line 'confirmed' at 1:01 cannot be announced (")
    assert said[1].startswith("found stop sign")


def test_nobody_to_be_told_ends_no_flight():
    def gone(_words):
        raise BrokenPipeError

    announcer = Announcer(Scenario.model_validate(SIGNS), (), gone)
    for record in (sighting(60.0, 7, 0.5), confirmed(61.0, 7)):
        announcer.hear(record)
