"""Whole missions with the statistical sensor: what is flown, found and written."""

import json
import math
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.mission.notes import UNDECIDED
from skysweep.scenarios.model import Scenario

SMALL = {
    "name": "small",
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
    "home": {"position_enu_m": [-5, -5]},
    "targets": [
        {"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9},
        {"class": "stop sign", "position_enu_m": [45, 12], "size_m": 0.9},
    ],
    "distractors": [{"class": "red bucket", "position_enu_m": [30, 32]}],
    "camera": {"hfov_rad": 1.2},
}


def flown(seed=0, **changes):
    search = changes.pop("search", {})
    scenario = Scenario.model_validate(SMALL | changes).with_search(**search)
    journal = MemoryJournal()
    reason = fly(build_mission(scenario, seed, Rig("statistical")), journal)
    return reason, journal.lines


def of_kind(lines, kind):
    return [line for line in lines if line["kind"] == kind]


@pytest.fixture(scope="module")
def mission():
    return flown()


def test_both_targets_are_confirmed_where_they_are(mission):
    reason, lines = mission
    assert reason == "completed"
    places = np.array([line["p"][:2] for line in of_kind(lines, "confirmed")])
    for target in SMALL["targets"]:
        assert np.hypot(*(places - target["position_enu_m"]).T).min() < 1.5


def test_the_story_has_its_order(mission):
    _, lines = mission
    kinds = [line["kind"] for line in lines if line["kind"] not in ("state", "sighting", "waypoint_reached")]
    assert kinds[:2] == ["start", "plan"]
    assert kinds[-3:] == ["finished", "landed", "end"]
    assert kinds.index("scanned") < kinds.index("check_started") < kinds.index("confirmed")
    modes = list(dict.fromkeys(line["mode"] for line in of_kind(lines, "state")))
    assert modes == ["TAKEOFF", "SCAN", "CHECK", "RETURN", "LAND"]


def test_confirmations_happen_low(mission):
    _, lines = mission
    states = of_kind(lines, "state")
    for line in of_kind(lines, "confirmed"):
        nearest = min(states, key=lambda s: abs(s["t"] - line["t"]))
        assert nearest["p"][2] < 5.5


def test_it_lands_at_home(mission):
    _, lines = mission
    last = of_kind(lines, "state")[-1]
    assert np.hypot(last["p"][0] + 5, last["p"][1] + 5) < 2.0
    assert last["p"][2] < 1.0


@pytest.mark.parametrize("strategy", ["scan-only", "low-only"])
def test_baselines_fly_at_one_altitude(strategy):
    reason, lines = flown(search={"strategy": strategy})
    assert reason == "completed"
    heights = [line["p"][2] for line in of_kind(lines, "state") if line["mode"] == "SCAN"]
    assert np.ptp(heights) < 2.5
    assert of_kind(lines, "check_started") == []
    if strategy == "low-only":
        assert len(of_kind(lines, "confirmed")) >= 2


def test_what_a_strategy_does_not_decide_on_is_left_to_people(mission):
    reason, lines = flown(search={"strategy": "scan-only", "c_t": 0.95})
    assert reason == "completed"
    scanned = {line["candidate"] for line in of_kind(lines, "scanned")}
    decided = {line["candidate"] for line in of_kind(lines, "confirmed")}
    left = of_kind(lines, "unchecked")
    assert {line["candidate"] for line in left} == scanned - decided
    assert {line["reason"] for line in left} == {UNDECIDED}
    assert lines.index(of_kind(lines, "finished")[0]) < lines.index(left[0])
    _, lines = mission
    assert of_kind(lines, "unchecked") == []


def test_hills_are_followed():
    _, lines = flown(terrain={"hills_height_m": 15, "hills_wavelength_m": 120}, search={"n_c": math.inf})
    scenario = Scenario.model_validate(SMALL | {"terrain": {"hills_height_m": 15, "hills_wavelength_m": 120}})
    from skysweep.worlds.world import build_terrain

    terrain = build_terrain(scenario)
    low = [
        s["p"][2] - terrain.height_m(s["p"][:2])[0] for s in of_kind(lines, "state") if s["mode"] == "CHECK"
    ]
    assert min(low) > 2.0


def test_a_check_that_the_battery_does_not_allow_is_refused_and_reported():
    reason, lines = flown(vehicle={"battery_wh": 10.0}, search={"n_c": 1, "check_speed_mps": 0.1})
    assert reason == "completed"
    unchecked = {line["candidate"] for line in of_kind(lines, "unchecked")}
    assert unchecked == {line["candidate"] for line in of_kind(lines, "scanned")}
    assert {(line["cause"], line["action"]) for line in of_kind(lines, "safety")} == {
        ("return energy", "REFUSE_CHECK")
    }


def test_a_slow_camera_does_not_slow_the_vehicle_down():
    """Rules and setpoints are due twice a second, however rarely a picture is taken."""
    _, lines = flown(camera={"hfov_rad": 1.2, "rate_hz": 0.2}, search={"strategy": "scan-only"})
    states = of_kind(lines, "state")
    assert max(b["t"] - a["t"] for a, b in pairwise(states)) <= 0.5 + 1e-6
    seen = [line["t"] for line in of_kind(lines, "sighting")]
    assert len(seen) > 1
    assert min(b - a for a, b in pairwise(seen)) == pytest.approx(5.0)


def test_it_comes_home_while_the_battery_lasts():
    reason, lines = flown(vehicle={"battery_wh": 7.0}, search={"n_c": 1, "check_speed_mps": 0.6})
    assert reason == "return energy"
    assert of_kind(lines, "finished") == []
    last = of_kind(lines, "state")[-1]
    assert last["battery"] > 0.09
    assert np.hypot(last["p"][0] + 5, last["p"][1] + 5) < 2.0


def test_one_seed_one_journal_in_any_process():
    program = (
        "import json, hashlib; from tests_small import flown; print(json.dumps(flown(5)[1], sort_keys=True))"
    )
    source = f"import sys; sys.path.insert(0, {str(__file__.rsplit('/', 1)[0])!r})\n"
    program = source + program.replace("tests_small", "test_loop")
    texts = [
        subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert texts[0] == texts[1]
    assert json.loads(texts[0]) == json.loads(json.dumps(flown(5)[1]))
    assert json.loads(texts[0]) != json.loads(json.dumps(flown(6)[1]))


def test_an_unknown_sensor_or_strategy_is_named():
    scenario = Scenario.model_validate(SMALL)
    with pytest.raises(UserError, match="imaging, statistical"):
        build_mission(scenario, 0, Rig("radar"))
    with pytest.raises(UserError, match="scan-check, scan-only, low-only, belief"):
        build_mission(scenario.with_search(strategy="spiral"), 0, Rig("statistical"))
