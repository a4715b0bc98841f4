"""Lines that no mission writes, beside those that it does."""

import math

import pytest
from results_data import scenario_data, tiny_records

from skysweep.flights.fly import fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal, read_journal
from skysweep.results.journal_lines import can_be_told
from skysweep.scenarios.model import Scenario


def test_every_line_of_a_mission_can_be_told(tmp_path):
    fly_to_folder(Scenario.model_validate(scenario_data(camera={})), 0, tmp_path / "run", Rig("statistical"))
    records = read_journal(tmp_path / "run" / "journal.jsonl")
    assert {"start", "plan", "state", "sighting", "end"} <= {record["kind"] for record in records}
    assert [record for record in records if not can_be_told(record)] == []


def test_what_a_vehicle_does_not_know_can_be_told():
    journal = MemoryJournal()
    journal.write(1.0, "state", p=[math.nan] * 3, battery=math.nan, energy_wh=None, cam=None)
    assert all(map(can_be_told, journal.lines))


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("start", {"seed": "x"}),
        ("start", {"t": math.inf}),
        ("plan", {"waypoints_enu_m": [[0, 1]]}),
        ("plan", {"waypoints_enu_m": [[0, 1, math.nan]]}),
        ("state", {"p": []}),
        ("state", {"cam": {"p": [0, 0, 0], "R": [1]}}),
        ("state", {"cam": {"p": [0, 0, 0], "R": [-1, 0, 0, 0, 1, 0, 0, 0, 1]}}),
        ("sighting", {"candidate": []}),
        ("sighting", {"confidence": "sure"}),
        ("confirmed", {"covariance_m2": [[math.nan, 0], [0, 1]]}),
        ("confirmed", {"probability": 1.1}),
        ("check_started", {"probability": "high"}),
        ("check_started", {"alternatives": [["confirm"]]}),
        ("rejected", {"alternatives": [["confirm", math.inf]]}),
        ("rejected", {"reason": 3}),
        ("safety", {"action": "PANIC", "sentence": "x"}),
        ("unsearched", {"length_m": [], "again": True}),
        ("end", {"reason": None}),
        ("anything", {"t": None}),
    ],
)
def test_what_no_mission_says(kind, change):
    record = next((r for r in tiny_records() if r["kind"] == kind), {"t": 1.0, "kind": kind})
    assert not can_be_told(record | change)
