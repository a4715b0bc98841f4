"""A mission of a vehicle that cannot be flown again goes on from its last snapshot."""

import math
from contextlib import closing
from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest

from skysweep.flights.build import build_mission
from skysweep.flights.fly import begin, fly_in, fly_to_folder
from skysweep.flights.resume import resume_folder
from skysweep.flights.rig import Rig
from skysweep.mission.journal import FileJournal, read_journal
from skysweep.mission.orders import Order
from skysweep.results.run_folder import load_run
from skysweep.scenarios.model import Scenario
from skysweep.vehicles.embedded.at_home import embedded_vehicle

SCENARIO = Scenario.model_validate(
    {
        "name": "fields",
        "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
        "home": {"position_enu_m": [-5, -5]},
        "targets": [
            {"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9},
            {"class": "stop sign", "position_enu_m": [45, 12], "size_m": 0.9},
        ],
        "camera": {"hfov_rad": 1.2},
        "search": {"n_c": 1},
    }
)


class Broken(Exception):
    """Our side ends."""


def broken_off(folder, until, changed=lambda mission: mission, operator=lambda: None):
    """Fly until ``until(record)``; the vehicle, which is left as it is."""
    folder.mkdir()
    vehicle = embedded_vehicle(SCENARIO, 0)
    rig = Rig("statistical", threads=1, vehicle=vehicle, operator=operator)
    mission = changed(build_mission(SCENARIO, 0, rig))
    assert not mission.replays

    class Breaking(FileJournal):
        def write(self, time_s, kind, **fields):
            super().write(time_s, kind, **fields)
            if until({"t": time_s, "kind": kind} | fields):
                raise Broken

    with closing(Breaking(folder / "journal.jsonl")) as journal:
        begin(folder, mission, journal, rig)
        with pytest.raises(Broken):
            fly_in(folder, mission, journal, rig)
    return vehicle


def first_verdict(record):
    return record["kind"] == "confirmed"


def half_way(record):
    return record["kind"] == "waypoint_reached" and record["t"] > 40.0


@pytest.mark.parametrize("until", [first_verdict, half_way, lambda r: r["kind"] == "check_started"])
@pytest.mark.parametrize("stays_up", [True, False])
def test_it_goes_on_from_where_the_vehicle_is(tmp_path, until, stays_up):
    folder = tmp_path / "run"
    vehicle = broken_off(folder, until)
    if not stays_up:
        vehicle = embedded_vehicle(SCENARIO, 1)
    before = read_journal(folder / "journal.jsonl")
    summary = resume_folder(folder, Rig(vehicle=vehicle))
    assert summary["recall"] == 1.0
    assert summary["false_positives"] == 0
    assert summary["completed"]
    after = read_journal(folder / "journal.jsonl")
    resumed = max(k for k, r in enumerate(after) if r["kind"] == "clock")
    assert after[resumed + 1]["kind"] == "resumed"
    assert after[:resumed] == before[:resumed]
    assert len(before) - resumed <= 3, "no more than the step in which it was broken off is done again"
    times = [r["t"] for r in after if r["kind"] == "state"]
    assert times == sorted(times)
    settled = [r["candidate"] for r in after if r["kind"] in ("confirmed", "rejected")]
    assert len(settled) == len(set(settled)), "nothing is checked twice"
    assert after[-1]["kind"] == "end"


def test_the_journal_tells_the_utc_of_a_vehicle_in_real_time(tmp_path):
    before = datetime.now(timezone.utc)
    folder = tmp_path / "run"
    broken_off(folder, first_verdict)
    run = load_run(folder)
    found_s = run.candidates[0].verdict_s
    assert abs((run.utc_of(found_s) - before).total_seconds() - found_s) < 30.0
    resume_folder(folder, Rig(vehicle=embedded_vehicle(SCENARIO, 1)))
    run = load_run(folder)
    clocks = run.events("clock")
    assert len(clocks) == 2
    assert run.utc_of(clocks[1]["t"]).isoformat(timespec="milliseconds") == clocks[1]["utc"]
    simulated = tmp_path / "simulated"
    fly_to_folder(SCENARIO, 0, simulated, Rig("statistical"))
    assert load_run(simulated).utc_of(10.0) is None


def test_nothing_stays_unseen_where_it_was_broken_off(tmp_path):
    folder = tmp_path / "run"
    states = []

    def in_the_middle_of_a_leg(record):
        if record["kind"] == "state" and record["mode"] == "SCAN":
            states.append(record["p"][:2])
        return record["kind"] == "state" and record["t"] > 30.0 and record["mode"] == "SCAN"

    broken_off(folder, in_the_middle_of_a_leg)
    resume_folder(folder, Rig(vehicle=embedded_vehicle(SCENARIO, 1)))
    run = load_run(folder)
    after = run.states.position_enu_m[run.states.time_s > run.events("resumed")[0]["t"], :2]
    assert np.linalg.norm(after - states[-1], axis=1).min() < 5.0


def test_what_was_flown_blind_before_is_scanned_again(tmp_path):
    """The camera died, the search went on for a while, and somebody ended the program to mend it."""
    folder, dead_s = tmp_path / "run", 14.0

    class Dies:
        def __init__(self, sensor):
            self.sensor, self.close = sensor, sensor.close

        def sense(self, state):
            found = self.sensor.sense(state)
            if found is not None and found.time_s >= dead_s:
                raise RuntimeError("the camera is gone")
            return found

    vehicle = broken_off(
        folder,
        lambda r: r["kind"] == "state" and r["t"] > 38.0,
        lambda mission: replace(mission, sensor=Dies(mission.sensor)),
    )
    blind = [
        line["p"][:2]
        for line in read_journal(folder / "journal.jsonl")
        if line["kind"] == "state" and line["mode"] == "SCAN" and line["t"] > dead_s
    ]
    assert math.dist(blind[0], blind[-1]) > 40.0
    summary = resume_folder(folder, Rig(vehicle=vehicle))
    assert summary["recall"] == 1.0
    run = load_run(folder)
    (said,) = run.events("unsearched")
    assert said["again"]
    assert said["length_m"] > 50.0
    after = run.states.position_enu_m[run.states.time_s > run.events("resumed")[0]["t"], :2]
    assert max(np.linalg.norm(after - place, axis=1).min() for place in blind) < 4.0


@pytest.mark.parametrize("seed", range(2))
def test_looks_on_the_way_back_reject_nothing(tmp_path, seed):
    """Broken off while it hovered over a candidate, held there by a person until then."""
    folder, held_s = tmp_path / "run", []

    def operator():
        if not held_s and mission.strategy.snapshot()["arrived_s"] is not None:
            held_s.append(vehicle.state().time_s)
            return Order("hold")
        return None

    def watch(state, _mode, _new):
        if held_s and state.time_s > held_s[0] + 5.0:
            raise Broken

    folder.mkdir()
    vehicle = embedded_vehicle(SCENARIO, seed)
    rig = Rig("statistical", threads=1, vehicle=vehicle, operator=operator, watch=watch)
    mission = build_mission(SCENARIO, seed, rig)
    with closing(FileJournal(folder / "journal.jsonl")) as journal:
        begin(folder, mission, journal, rig)
        with pytest.raises(Broken):
            fly_in(folder, mission, journal, rig)
    summary = resume_folder(folder, Rig(vehicle=vehicle))
    assert summary["recall"] == 1.0
    assert summary["wrong_rejections"] == 0


def test_landed_with_the_search_unfinished_it_does_not_take_off_again(tmp_path):
    folder = tmp_path / "run"
    orders = iter([None] * 400 + [Order("return")])
    broken_off(folder, lambda r: r["kind"] == "landed", operator=lambda: next(orders, None))
    vehicle = embedded_vehicle(SCENARIO, 1)
    summary = resume_folder(folder, Rig(vehicle=vehicle))
    assert summary["end_reason"] == "broken off"
    assert vehicle.state().time_s == 0.0


def test_landed_before_the_last_line_it_only_writes_the_end(tmp_path):
    folder = tmp_path / "run"
    broken_off(folder, lambda r: r["kind"] == "landed")
    vehicle = embedded_vehicle(SCENARIO, 1)
    summary = resume_folder(folder, Rig(vehicle=vehicle))
    assert summary["end_reason"] == "completed"
    assert not vehicle.state().airborne
    assert vehicle.state().time_s == 0.0


def test_each_kind_of_mission_names_the_command_that_goes_on(tmp_path):
    folder = tmp_path / "run"
    broken_off(folder, first_verdict)
    with pytest.raises(Exception, match=r"cannot be replayed; .* with  skysweep fly "):
        resume_folder(folder)
    with pytest.raises(Exception, match="resume it with  skysweep fly "):
        fly_to_folder(SCENARIO, 0, folder, Rig("statistical"))
    lines = read_journal(folder / "journal.jsonl")
    lines[0]["replays"] = True
    (folder / "journal.jsonl").unlink()
    with closing(FileJournal(folder / "journal.jsonl")) as journal:
        for line in lines:
            journal.write(line.pop("t"), line.pop("kind"), **line)
    with pytest.raises(Exception, match="the mission was simulated; resume it with  skysweep resume"):
        resume_folder(folder, Rig(vehicle=embedded_vehicle(SCENARIO, 1)))
