"""A whole mission with rendered pictures and the shipped detector."""

import json

import numpy as np
import pytest

from skysweep.flights.build import build_mission
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.scenarios.model import Scenario

SIGNS = {
    "name": "signs",
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
    "home": {"position_enu_m": [-5, -5]},
    "targets": [
        {"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9},
        {"class": "stop sign", "position_enu_m": [45, 12], "size_m": 0.9},
    ],
    "distractors": [{"class": "red bucket", "position_enu_m": [30, 32]}],
    "camera": {"hfov_rad": 1.2},
    "search": {"n_c": 1},
}


@pytest.mark.slow
def test_real_pictures_and_the_real_detector_find_both_signs(tmp_path):
    summary = fly_to_folder(Scenario.model_validate(SIGNS), 1, tmp_path / "run")
    assert summary["recall"] == 1.0
    assert summary["false_positives"] == 0
    assert summary["median_localisation_error_m"] < 1.0
    assert summary["completed"]
    assert list((tmp_path / "run" / "pictures").glob("*.jpg"))
    written = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert {key: written[key] for key in summary} == summary


@pytest.mark.slow
def test_one_seed_gives_one_mission_with_any_number_of_detector_threads():
    tiny = SIGNS | {
        "area": {"polygon_enu_m": [[0, 0], [30, 0], [30, 20], [0, 20]]},
        "targets": [{"class": "stop sign", "position_enu_m": [15, 8], "size_m": 0.9}],
        "distractors": [],
    }
    flights = []
    for threads in (1, 2):
        journal = MemoryJournal()
        mission = build_mission(Scenario.model_validate(tiny), 3, Rig(threads=threads))
        fly(mission, journal)
        mission.sensor.close()
        flights.append(journal.lines)
    decisions = [[line for line in lines if line["kind"] not in ("state", "sighting")] for lines in flights]
    assert decisions[0] == decisions[1]
    assert any(line["kind"] == "confirmed" for line in flights[0])
    positions = [np.array([s["p"] for s in lines if s["kind"] == "state"]) for lines in flights]
    np.testing.assert_array_equal(*positions)
