"""Missions that take more than one battery, with the statistical sensor."""

import json
import math
import signal
import subprocess
import sys

import numpy as np
import pytest

from skysweep.flights.build import build_mission
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.resume import resume_folder
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal, read_journal
from skysweep.mission.loop import fly
from skysweep.mission.orders import CONTINUE, HOLD, RETURN, TAKE_BACK, Order
from skysweep.planning.flight_plan import plan_scenario
from skysweep.results.metrics import compute_summary, seen_area, whole_summary
from skysweep.results.run_folder import Run, load_run
from skysweep.scenarios.files import dump_scenario
from skysweep.scenarios.model import Scenario
from skysweep.vehicles.embedded.at_home import embedded_vehicle

HOME = (-5.0, -5.0)
FIELD = {
    "name": "field",
    "area": {"polygon_enu_m": [[0, 0], [160, 0], [160, 140], [0, 140]]},
    "home": {"position_enu_m": HOME},
    "targets": [
        {"class": "stop sign", "position_enu_m": [25, 77], "size_m": 0.9},
        {"class": "stop sign", "position_enu_m": [150, 130], "size_m": 0.9},
    ],
    "vehicle": {"battery_wh": 12.0, "batteries": 6, "swap_s": 60.0},
    "camera": {"hfov_rad": 1.0},
    "search": {"strategy": "scan-only"},
}
FAR_CHECKS = {"strategy": "scan-check", "n_c": 1, "check_speed_mps": 0.6}


def field(search=None, **vehicle) -> Scenario:
    changes = {"vehicle": FIELD["vehicle"] | vehicle, "search": search or FIELD["search"]}
    return Scenario.model_validate(FIELD | changes)


def flown(of, operator=lambda _mode, _s: None, wrap=None):
    """The run, and the end's reason. ``operator`` is told the mode, and the seconds that it has lasted."""
    vehicle = None if wrap is None else wrap(embedded_vehicle(of, 0))
    mission, journal, now = build_mission(of, 0, Rig("statistical", vehicle=vehicle)), MemoryJournal(), []

    def watch(state, mode, _new):
        if not now or now[0] != mode:
            now[:] = [mode, state.time_s]
        now[2:] = [state.time_s]

    reason = fly(mission, journal, watch, lambda: operator(now[0], now[2] - now[1]) if now else None)
    return Run(of, tuple(journal.lines)), reason


@pytest.fixture(scope="module")
def sorties():
    return flown(field())


def test_the_search_is_completed_with_as_many_batteries_as_planned(sorties):
    run, reason = sorties
    _, estimate = plan_scenario(field())
    assert reason == "completed"
    assert run.n_sorties == estimate.batteries == 3
    assert run.landed_s == pytest.approx(estimate.time_s, rel=0.1)
    assert run.states.energy_wh[-1] == pytest.approx(estimate.energy_wh, rel=0.1)
    assert run.search_end_s == pytest.approx(estimate.search_time_s, rel=0.1)


def test_nothing_lies_unseen_between_two_sorties(sorties):
    run, _ = sorties
    whole, _ = flown(field(battery_wh=100.0))
    assert whole.n_sorties == 1
    unseen = seen_area(whole).difference(seen_area(run))
    assert unseen.area < 0.001 * whole.scenario.area_enu_m.area


def test_every_sortie_lands_at_home_with_its_reserve_and_stands_while_the_battery_is_changed(sorties):
    run, _ = sorties
    for line in run.events("sortie"):
        assert line["why"] == "return energy"
        assert line["battery"] > 0.05
        stands = [
            p
            for t, p, mode in zip(run.states.time_s, run.states.position_enu_m, run.states.mode, strict=True)
            if mode == "SWAP" and t >= line["t"]
        ]
        assert math.dist(stands[0][:2], HOME) < 2.0
        assert np.ptp(stands[:100], axis=0).max() < 1.0
    for landed, again in zip(run.events("sortie"), run.events("next_sortie"), strict=True):
        assert again["t"] - landed["t"] == pytest.approx(60.0, abs=1.5)
        assert again["battery"] > 0.99


def test_the_figures_are_those_of_all_sorties(sorties):
    run, _ = sorties
    summary = whole_summary(run)
    assert summary["sorties"] == 3
    assert summary["completed"]
    assert summary["total_energy_wh"] == pytest.approx(sum(s.energy_wh for s in run.sorties), abs=0.01)
    assert summary["total_energy_wh"] > 12.0 * 1.5
    assert summary["mission_time_s"] > 2 * 60.0 + 300.0
    assert summary["scan_only_time_s"] == pytest.approx(summary["mission_time_s"], rel=0.1)
    assert summary["path_length_m"] > plan_scenario(field())[1].path_length_m
    assert [s.number for s in run.sorties] == [1, 2, 3]
    assert run.sorties[-1].landed_s == run.landed_s


def test_a_ridge_on_the_way_home_is_reserved_for():
    """It climbs 80 m on the way and comes down behind: without, it landed at once with 5 % of its battery."""
    east_m = np.linspace(-100.0, 520.0, 63)
    ridge_m = np.maximum(0.0, 80.0 * (1.0 - np.abs(east_m - 150.0) / 60.0))
    behind = Scenario.model_validate(
        FIELD
        | {
            "area": {"polygon_enu_m": [[300, 0], [420, 0], [420, 120], [300, 120]]},
            "home": {"position_enu_m": (0.0, 0.0)},
            "terrain": {"heightmap_m": np.tile(ridge_m, (8, 1)).tolist()},
            "targets": [],
            "vehicle": {"battery_wh": 20.0, "batteries": 8, "swap_s": 60.0},
        }
    )
    run, reason = flown(behind)
    _, estimate = plan_scenario(behind)
    assert reason == "completed"
    assert run.n_sorties == estimate.batteries == 3
    assert run.landed_s == pytest.approx(estimate.time_s, rel=0.1)
    assert run.states.energy_wh[-1] == pytest.approx(estimate.energy_wh, rel=0.1)
    assert min(line["battery"] for line in run.events("sortie")) > 0.06
    assert all(line["cause"] == "return energy" for line in run.events("safety") if "battery" in str(line))


def test_with_one_battery_the_search_ends_and_the_journal_knows_no_sorties():
    run, reason = flown(field(batteries=1))
    assert reason == "return energy"
    assert run.n_sorties == 1
    assert not run.events("sortie", "next_sortie")
    assert {"batteries", "swap_s"}.isdisjoint(dump_scenario(field(batteries=1, swap_s=120.0)).split())
    assert run.search_end_s < run.landed_s


def test_batteries_that_are_used_up_end_the_search():
    run, reason = flown(field(batteries=2))
    assert reason == "return energy"
    assert run.n_sorties == 2
    landed_s = run.events("sortie")[0]["t"]
    assert landed_s + 60.0 < run.search_end_s < run.landed_s


def test_a_check_that_this_battery_does_not_allow_is_made_with_the_next():
    run, reason = flown(field(FAR_CHECKS, battery_wh=16.0))
    assert reason == "completed"
    assert compute_summary(run)["n_confirmed"] == 2
    assert not run.events("unchecked")
    refused = [r for r in run.events("safety") if "is not flown to" in r["sentence"]]
    assert {r["action"] for r in refused} == {"RETURN"}


def test_belief_does_not_end_its_search_for_one_battery():
    run, reason = flown(field({"strategy": "belief"}, battery_wh=16.0))
    assert reason == "completed"
    assert run.n_sorties > 1
    assert compute_summary(run)["n_confirmed"] == 2


def test_places_that_an_operator_asked_for_wait_for_another_battery():
    asked = [(150.0, 130.0), (10.0, 130.0)] * 2
    orders = [Order("look", None, place) for place in asked]
    run, reason = flown(
        field(batteries=9), lambda mode, s: orders.pop(0) if mode == "SCAN" and orders else None
    )
    assert reason == "completed"
    assert [tuple(line["p"][:2]) for line in run.events("looked")] == asked
    first_s = run.events("sortie")[0]["t"]
    assert run.events("looked")[0]["t"] < first_s < run.events("looked")[-1]["t"]
    waits = [r for r in run.events("safety") if "waits for another battery" in r["sentence"]]
    assert {(r["action"], r["cause"]) for r in waits} == {("RETURN", "return energy")}
    assert not [r for r in run.events("safety") if "is not looked at" in r["sentence"]]


def test_the_operator_who_calls_it_home_in_the_air_ends_the_mission():
    run, reason = flown(field(), lambda mode, _s: Order(RETURN) if mode == "RETURN" else None)
    assert reason == "operator"
    assert run.n_sorties == 1
    assert run.landed_s is not None


def test_the_operator_ends_the_mission_on_the_ground():
    run, reason = flown(field(), lambda mode, s: Order(RETURN) if mode == "SWAP" and s > 10.0 else None)
    assert reason == "operator"
    assert run.n_sorties == 1
    assert run.landed_s == pytest.approx(run.events("sortie")[0]["t"] + 10.0, abs=1.0)
    assert "TAKEOFF" not in run.states.mode[run.states.mode.index("SWAP") :]


def test_held_on_the_ground_it_waits_for_continue():
    said = []

    def operator(mode, lasted_s):
        if mode == "SWAP" and not said:
            said.append(HOLD)
            return Order(HOLD)
        if mode == "SWAP" and said == [HOLD] and lasted_s > 100.0:
            said.append(CONTINUE)
            return Order(CONTINUE)
        return None

    run, reason = flown(field(), operator)
    assert reason == "completed"
    landed, again = run.events("sortie")[0], run.events("next_sortie")[0]
    assert again["t"] - landed["t"] == pytest.approx(100.0, abs=1.5)


class Gusty:
    """A vehicle that reports strong wind from its landing on, for ``lasts_s``."""

    def __init__(self, vehicle, lasts_s):
        self._vehicle, self._lasts_s, self._landed_s = vehicle, lasts_s, None
        self.truth = vehicle.truth
        self.command, self.advance, self.hold = vehicle.command, vehicle.advance, vehicle.hold
        self.land, self.change_battery = vehicle.land, vehicle.change_battery

    def takeoff(self, altitude_agl_m):
        self._vehicle.takeoff(altitude_agl_m)
        self._has_flown = True

    def state(self):
        state = self._vehicle.state()
        if self._landed_s is None and state.time_s > 30.0 and not state.airborne:
            self._landed_s = state.time_s
        blows = self._landed_s is not None and state.time_s < self._landed_s + self._lasts_s
        return state._replace(wind_enu_mps=np.array([12.0, 0.0, 0.0])) if blows else state


def test_in_too_much_wind_it_does_not_take_off_again():
    run, reason = flown(field(), wrap=lambda vehicle: Gusty(vehicle, 200.0))
    assert reason == "completed"
    landed, again = run.events("sortie")[0], run.events("next_sortie")[0]
    assert again["t"] - landed["t"] == pytest.approx(200.0, abs=2.0)
    said = [(r["action"], r["sentence"]) for r in run.events("safety") if r["cause"] == "wind"]
    assert said == [("HOLD", "The wind blows at 12 m/s."), ("CONTINUE", "The wind has dropped.")]


def test_wind_that_does_not_drop_ends_the_mission():
    run, reason = flown(field(), wrap=lambda vehicle: Gusty(vehicle, math.inf))
    assert reason == "wind"
    assert run.n_sorties == 1
    assert run.landed_s is not None


FLOWN_UNTIL_KILLED = """
import os, signal, sys
from pathlib import Path
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.scenarios.files import load_scenario

scenario, folder, mode, tick = sys.argv[1:]
ticks = []

def kill(_state, now, _new):
    ticks.append(now == mode)
    if sum(ticks) == int(tick):
        os.kill(os.getpid(), signal.SIGKILL)

fly_to_folder(load_scenario(scenario), 0, Path(folder), Rig("statistical", watch=kill))
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "run"
    fly_to_folder(field(), 0, folder, Rig("statistical"))
    return folder


@pytest.mark.parametrize(
    ("mode", "tick"),
    [
        ("SWAP", 300),
        ("TRANSIT", 40),
        *(pytest.param("SWAP", tick, marks=pytest.mark.exhaustive) for tick in (1, 600, 601)),
    ],
)
def test_killed_between_two_sorties_it_resumes_bit_for_bit(whole, tmp_path, mode, tick):
    """With SIGKILL as it lands, while it waits, right before it takes off again, and so on."""
    killed = tmp_path / "killed"
    (tmp_path / "field.yaml").write_text(dump_scenario(field()))
    told = [tmp_path / "field.yaml", killed, mode, str(tick)]
    flyer = subprocess.run([sys.executable, "-c", FLOWN_UNTIL_KILLED, *told], check=False)
    assert flyer.returncode == -signal.SIGKILL
    assert len(read_journal(killed / "journal.jsonl")) < len(read_journal(whole / "journal.jsonl"))
    assert resume_folder(killed)["sorties"] == 3
    assert read_journal(killed / "journal.jsonl") == read_journal(whole / "journal.jsonl")
    told = [json.loads((folder / "summary.json").read_text()) for folder in (whole, killed)]
    timings = ("wall_time_s", "real_time_factor", "crc")
    assert [{k: v for k, v in t.items() if k not in timings} for t in told[:1]] == [
        {k: v for k, v in t.items() if k not in timings} for t in told[1:]
    ]


def test_a_check_that_the_battery_breaks_off_is_begun_again():
    held = []

    def holds(mode, lasted_s):
        if mode == "CHECK" and lasted_s > 4.0 and not held:
            held.append(HOLD)
            return Order(HOLD)
        return None

    run, reason = flown(field(FAR_CHECKS | {"check_speed_mps": 2.0}, battery_wh=25.0), holds)
    assert reason == "completed"
    again_s = run.events("next_sortie")[0]["t"]
    (before, *_) = [r["t"] for r in run.events("check_started")]
    settled = run.events("confirmed", "rejected")
    assert before < run.events("operator")[0]["t"] < run.events("sortie")[0]["t"]
    assert settled[0]["t"] > again_s
    assert "CHECK" in [m for t, m in zip(run.states.time_s, run.states.mode, strict=True) if t > again_s]
    assert compute_summary(run)["n_confirmed"] == 2


class DriftsOff(Gusty):
    """A vehicle that comes down 100 m east of where it was going to land."""

    def state(self):
        state = self._vehicle.state()
        landed = state.time_s > 30.0 and not state.airborne
        return (
            state._replace(position_enu_m=state.position_enu_m + np.array([100.0, 0.0, 0.0]))
            if landed
            else state
        )


def test_away_from_home_nobody_changes_its_battery():
    run, reason = flown(field(), wrap=lambda vehicle: DriftsOff(vehicle, 0.0))
    assert reason == "return energy"
    assert run.n_sorties == 1
    assert not run.events("sortie")
    assert "It landed 100 m from home, where nobody changes its battery." in [
        r["sentence"] for r in run.events("safety")
    ]
    assert [r["kind"] for r in run.records][-2:] == ["landed", "end"]


class Manned:
    """A vehicle whose battery a person changes. ``ground(self, seconds since it landed)`` gives the order."""

    truth = None

    def __init__(self, vehicle, ground):
        self._vehicle, self._ground, self._landed_s = vehicle, ground, None
        self.command, self.advance, self.hold = vehicle.command, vehicle.advance, vehicle.hold
        self.takeoff, self.land, self.new_battery = vehicle.takeoff, vehicle.land, vehicle.change_battery
        self.now = {}  # fields of the state that are wrong

    def state(self):
        return self._vehicle.state()._replace(**self.now)

    def asked(self, mode):
        time_s = self._vehicle.state().time_s
        if mode != "SWAP":
            self._landed_s = None
            return None
        self._landed_s = time_s if self._landed_s is None else self._landed_s
        return self._ground(self, time_s - self._landed_s)


def manned(ground):
    """The journal's lines of a mission with two batteries."""
    of = field(batteries=2)
    vehicle = Manned(embedded_vehicle(of, 0), ground)
    mission, journal, modes = build_mission(of, 0, Rig("statistical", vehicle=vehicle)), MemoryJournal(), [""]
    fly(
        mission,
        journal,
        lambda _state, mode, _new: modes.append(str(mode)),
        lambda: vehicle.asked(modes[-1]),
    )
    return journal.lines


def at(*steps):
    """A ``ground``: each step, ``(s, does)``, once it is that late; its result is the order."""
    left = list(steps)

    def ground(vehicle, lasted_s):
        return left.pop(0)[1](vehicle) if left and lasted_s >= left[0][0] else None

    return ground


def says(word):
    return lambda _vehicle: Order(word)


def gets(**fields):
    def does(vehicle):
        vehicle.now = fields

    return does


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"position_std_m": math.inf}, "The position is not known well enough to take off."),
        ({"wind_enu_mps": np.array([12.0, 0.0, 0.0])}, "The wind blows at 12 m/s."),
        ({"silent_s": 5.0}, "No telemetry for 5.0 s."),
        ({"taken_over": "it is in Position"}, "Somebody else flies the vehicle: take it back first."),
        ({"battery_remaining": 0.5}, "The battery is at 50%, less than 80%: put in a charged one."),
    ],
)
def test_a_word_that_cannot_be_followed_is_refused_and_must_be_said_again(wrong, why):
    lines = manned(
        at(
            (10.0, lambda vehicle: vehicle.new_battery()),
            (11.0, gets(**wrong)),
            (20.0, says(CONTINUE)),
            (40.0, gets()),
            (100.0, says(CONTINUE)),
        )
    )
    (landed,), (again,) = ([r for r in lines if r["kind"] == kind] for kind in ("sortie", "next_sortie"))
    assert again["t"] - landed["t"] == pytest.approx(100.0, abs=1.0)
    said = [r["sentence"] for r in lines if r["kind"] == "safety" and r["cause"] == "battery change"]
    assert f"{why} Say continue when it is ready." in said
    assert said.count("The wait for another battery is over.") == 1


@pytest.mark.parametrize("word", [TAKE_BACK, HOLD])
def test_no_other_word_says_that_the_battery_was_changed(word):
    lines = manned(
        at((10.0, lambda vehicle: vehicle.new_battery()), (20.0, says(word)), (90.0, says(RETURN)))
    )
    assert "next_sortie" not in [r["kind"] for r in lines]
    assert lines[-1]["reason"] == "operator"


def changes_it(vehicle, lasted_s):
    """A person who puts in a battery after each landing."""
    if lasted_s < 5.0:
        return None
    vehicle.new_battery()
    vehicle.now = {}
    return Order(CONTINUE)


class Killed(Exception):
    """Our side ends."""


def gone_on_with(folder, of, mode, meanwhile=lambda _vehicle: None):
    """The run of a real vehicle's mission that was killed in this mode, and resumed after ``meanwhile``."""
    vehicle, modes = Manned(embedded_vehicle(of, 0), changes_it), [""]

    def watch(_state, now, _new):
        modes.append(str(now))
        if mode is not None and modes.count(mode) == 20:
            raise Killed

    rig = Rig("statistical", vehicle=vehicle, watch=watch, operator=lambda: vehicle.asked(modes[-1]))
    with pytest.raises(Killed):
        fly_to_folder(of, 0, folder, rig)
    mode = None
    meanwhile(vehicle)
    resume_folder(folder, rig)
    return load_run(folder)


def test_killed_on_the_way_to_another_battery_it_gets_it(tmp_path):
    run = gone_on_with(tmp_path / "run", field(), "RETURN")
    assert run.end_reason == "completed"
    assert run.n_sorties == 3
    unseen = seen_area(flown(field(battery_wh=100.0))[0]).difference(seen_area(run))
    assert unseen.area < 0.001 * run.scenario.area_enu_m.area


def test_killed_in_a_check_it_makes_that_with_another_battery(tmp_path):
    nearly_empty = gets(battery_remaining=0.3)
    run = gone_on_with(tmp_path / "run", field(FAR_CHECKS, battery_wh=16.0), "CHECK", nearly_empty)
    assert run.end_reason == "completed"
    assert not run.events("unchecked")
    assert compute_summary(run)["n_confirmed"] == 2


def test_a_landing_for_another_battery_that_nobody_saw_counts(tmp_path):
    def lands(vehicle):
        vehicle.land()
        vehicle.advance(60.0)
        vehicle.new_battery()

    run = gone_on_with(tmp_path / "run", field(), "LAND", lands)
    assert run.end_reason == "completed"
    first, *_, last = run.sorties
    assert (first.why, last.number, last.why) == ("broken off", 3, "completed")
    assert 0.05 < first.battery < 0.3
    assert first.energy_wh == pytest.approx((1.0 - first.battery) * 12.0, abs=0.1)
