"""The belief strategy on whole missions without pictures."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.strategies.contexts import context_of

from skysweep.flights.build import build_mission
from skysweep.flights.fly import fly_in_memory, fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import Flight
from skysweep.results.metrics import compute_summary
from skysweep.results.run_folder import Run
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.strategies.belief.search import BeliefSearch
from skysweep.types import Candidate, EventKind, Look, Mode, Observation, Sighting, VehicleState

SEEDS = range(31_000, 31_006)


def scenario(name="clusters", strategy="belief", **search):
    changes = {f"search.{key}": value for key, value in search.items()}
    return change_scenario(load_scenario(name), {"scatter_m": 5.0, "search.strategy": strategy, **changes})


def flown(name="clusters", seed=31_000, **search):
    journal = MemoryJournal()
    with Flight(build_mission(scenario(name, **search), seed, Rig("statistical")), journal) as flight:
        for _ in flight:
            pass
    return journal.lines


def of_kind(records, *kinds):
    return [r for r in records if r["kind"] in kinds]


def test_it_is_quicker_than_algorithm_1_and_finds_as_many():
    ours = [fly_in_memory(scenario(), seed) for seed in SEEDS]
    papers = [fly_in_memory(scenario(strategy="scan-check"), seed) for seed in SEEDS]
    assert all(s["completed"] for s in ours)
    missed = [sum(s["n_targets"] * (1.0 - s["recall"]) for s in found) for found in (ours, papers)]
    assert missed[0] <= missed[1] + 1.001, "of 48 targets"
    assert sum(s["mission_time_s"] for s in ours) < 0.7 * sum(s["mission_time_s"] for s in papers)


def test_a_resumed_search_expects_as_much_success():
    """After the scan, too, where nothing of it is left."""
    mission = build_mission(scenario(), 31_000, Rig("statistical"))
    strategy = mission.strategy
    with Flight(mission, MemoryJournal()) as flight:
        for _ in flight:
            if not strategy._to_scan and strategy._success() > 0.0:
                break
        again = build_mission(scenario(), 31_000, Rig("statistical")).strategy
        again.restore(json.loads(json.dumps(strategy.snapshot())))
        assert again._success() == pytest.approx(strategy._success(), rel=0.01)


def test_it_ends_once_those_who_are_missing_are_probably_found():
    whole = flown(parameters={"n_missing": 8})
    assert "reason" not in of_kind(whole, EventKind.FINISHED)[0]
    records = flown(parameters={"n_missing": 8, "end_at_success": 0.6})
    (finished,) = of_kind(records, EventKind.FINISHED)
    assert "probability of success is 0." in finished["reason"]
    assert len(of_kind(records, EventKind.CONFIRMED)) >= 5
    assert finished["t"] < of_kind(whole, EventKind.FINISHED)[0]["t"] - 20.0
    decided = of_kind(records, EventKind.CONFIRMED, EventKind.REJECTED, EventKind.UNCHECKED)
    assert len(decided) == len({r["candidate"] for r in of_kind(records, EventKind.SCANNED)})


def test_how_many_are_missing_is_estimated_from_what_was_flown():
    """Half of the scan says nothing of the other half: the stated probability takes most of the area."""
    ends = [of_kind(flown(parameters={"end_at_success": at}), EventKind.FINISHED)[0] for at in (0.4, 0.8)]
    assert 0.3 * 142.0 < ends[0]["t"] < ends[1]["t"]
    assert ends[1]["t"] > 0.75 * 142.0, "scan-only takes 142 s"


def test_it_ends_after_the_time_that_there_is():
    records = flown(parameters={"end_after_s": 60.0})
    (finished,) = of_kind(records, EventKind.FINISHED)
    begun_s = next(r["t"] for r in of_kind(records, "state") if r["mode"] == Mode.SCAN)
    assert 59.0 <= finished["t"] - begun_s < 64.0
    assert "has lasted 60 s" in finished["reason"]
    assert of_kind(records, "end")[-1]["reason"] == "completed"


MANY_LOOK_ALIKES = {
    "area.polygon_enu_m": [[0, 0], [200, 0], [200, 150], [0, 150]],
    "vehicle.battery_wh": 300,
    "targets": [],
    "distractors": [],
    "generators": [
        {"class": "stop sign", "pattern": "uniform", "count": 4, "size_m": 0.9, "seed": None},
        {"class": "red round sign", "pattern": "uniform", "count": 24, "seed": None},
    ],
}


def test_among_many_look_alikes_a_probability_is_what_it_says():
    """Before anything was looked at closely, from what the scan saw."""
    said, true = [], []
    for seed in SEEDS:
        made, journal = change_scenario(scenario(), MANY_LOOK_ALIKES), MemoryJournal()
        with Flight(build_mission(made, seed, Rig("statistical")), journal) as flight:
            for _ in flight:
                pass
        targets = [o.position_enu_m for o in Run(made, tuple(journal.lines)).world.objects if o.is_target]
        first = {}
        for r in of_kind(journal.lines, EventKind.CHECK_STARTED, EventKind.CONFIRMED, EventKind.REJECTED):
            first.setdefault(r["candidate"], r)
        said += [r["probability"] for r in first.values()]
        away_m = [min(np.linalg.norm(np.array(r["p"]) - t) for t in targets) for r in first.values()]
        true += [m < 3.0 for m in away_m]
    assert len(said) > 100
    assert np.mean((np.array(said) - true) ** 2) < 0.25, "Brier score"


def test_one_seed_is_one_mission():
    assert flown() == flown()


def test_every_verdict_says_its_probability_and_reason():
    records = flown("maritime")
    verdicts = of_kind(records, EventKind.CONFIRMED, EventKind.REJECTED)
    assert len(verdicts) > 8
    for verdict in verdicts:
        assert 0.0 <= verdict["probability"] <= 1.0
        assert verdict["reason"]
    assert all(r["probability"] > 0.1 for r in of_kind(records, EventKind.CONFIRMED))


@pytest.mark.parametrize("highest_m", [8.0, 20.0])
def test_a_team_may_insist_on_a_close_look(highest_m):
    records = flown(confirm_height_max_m=highest_m)
    confirmed = [r["candidate"] for r in of_kind(records, EventKind.CONFIRMED)]
    assert len(confirmed) >= 7
    for candidate in confirmed:
        heights = [r["altitude_agl_m"] for r in of_kind(records, "sighting") if r["candidate"] == candidate]
        assert min(heights) <= highest_m
    options = {what for r in of_kind(records, EventKind.CHECK_STARTED) for what, _ in r["alternatives"]}
    heights_m = [h for h in (4.0, 6.0, 8.8, highest_m - 0.8) if h <= highest_m]
    assert options <= {"reject", "confirm", *(f"look from {h:.0f} m" for h in heights_m)}


LONG = {
    "area.polygon_enu_m": [[0, 0], [1200, 0], [1200, 120], [0, 120]],
    "vehicle.battery_wh": 400,
    "distractors": [],
    "targets": [
        {"class": "stop sign", "position_enu_m": place, "size_m": 0.9}
        for place in ([300, 20], [700, 50], [500, 100])
    ],
    "search.strategy": "belief",
    "search.transect_heading_deg": 90,
    "search.confirm_height_max_m": 8.0,
}


def test_a_victim_need_not_wait_for_the_scan():
    """A scan of 12 minutes; it is left where waiting is dear, and goes on where it was left."""
    halves_s, seen = [], []
    for waiting_cost in (0.0, 0.2):
        search = change_scenario(
            load_scenario("clusters"), LONG | {"search.parameters.waiting_cost": waiting_cost}
        )
        journal = MemoryJournal()
        with Flight(build_mission(search, 1, Rig("statistical")), journal) as flight:
            for _ in flight:
                pass
        records = journal.lines
        scanned_s = of_kind(records, EventKind.WAYPOINT_REACHED)[-1]["t"]
        left = [r for r in of_kind(records, EventKind.CHECK_STARTED) if r["t"] < scanned_s]
        assert bool(left) == bool(waiting_cost)
        assert all("waiting for the scan's end" in r["reason"] for r in left)
        assert len(of_kind(records, EventKind.SCAN_RESUMED)) == len(left)
        confirmed = sorted(r["t"] for r in of_kind(records, EventKind.CONFIRMED))
        assert len(confirmed) == 3
        halves_s.append(confirmed[1])
        seen.append(compute_summary(Run(search, tuple(records)))["area_covered"])
    assert halves_s[1] < 0.5 * halves_s[0]
    assert seen[1] >= seen[0] - 0.005


@pytest.mark.parametrize("of", [{}, LONG | {"search.parameters.waiting_cost": 0.2}], ids=["tour", "detours"])
def test_it_goes_on_from_a_snapshot_as_if_nothing_had_happened(of):
    """Broken off at any step: but for the newest looks, everything that decides is in the snapshot."""
    search = change_scenario(load_scenario("clusters"), of) if of else scenario("maritime")
    mission = build_mission(search, 31_003, Rig("statistical"))
    strategy, again = mission.strategy, build_mission(search, 31_003, Rig("statistical")).strategy
    step, told = strategy.step, []

    def both(seen):
        command = step(seen)
        if len(told) % 200 == 199:
            again.restore(json.loads(json.dumps(before[0])))
            told.append((again.step(seen), command))
        else:
            told.append((command, command))
        before[0] = strategy.snapshot()
        return command

    before = [strategy.snapshot()]
    strategy.step = both
    with Flight(mission, MemoryJournal()) as flight:
        for _ in flight:
            pass
    assert len(told) > 2000
    for one, other in told:
        assert one.waypoint == other.waypoint
        assert one.events == other.events


def test_a_place_that_must_not_be_flown_to_is_left_and_reported():
    """The clusters' second group lies where nobody may fly; it is reported, not lost."""
    barred = change_scenario(
        scenario(confirm_height_max_m=8.0),
        {"safety.altitude_max_agl_m": 31.0, "safety.descent_floor_agl_m": 4.0},
    )
    barred = change_scenario(barred, {"safety.no_fly_enu_m": [[[70, 80], [105, 80], [105, 104], [70, 104]]]})
    journal = MemoryJournal()
    with Flight(build_mission(barred, 31_000, Rig("statistical")), journal) as flight:
        for _ in flight:
            pass
    unchecked = of_kind(journal.lines, EventKind.UNCHECKED)
    assert unchecked
    assert all("geofence" in r["reason"] for r in unchecked if "reason" in r)
    assert of_kind(journal.lines, "end")[-1]["reason"] == "completed"


def test_the_page_lists_every_parameter_with_its_default():
    page = (Path(__file__).parents[3] / "docs" / "belief.md").read_text("utf-8")
    for name, field in BeliefParameters.model_fields.items():
        default = "none" if field.default is None else f"{field.default:g}"
        assert f"| `{name}` | {default} | {field.description} |" in page


def test_two_candidates_do_not_take_turns_for_ever():
    """Here one was not worth the way as soon as the vehicle turned to the other, and again back there."""
    layout = {
        "targets": [],
        "distractors": [],
        "generators": [
            {"class": "stop sign", "pattern": "sparse", "count": 6, "size_m": 0.9, "seed": None},
            {"class": "red bucket", "pattern": "uniform", "count": 2, "seed": None},
            {"class": "red round sign", "pattern": "uniform", "count": 2, "seed": None},
        ],
        "search.strategy": "belief",
    }
    summary = fly_in_memory(change_scenario(load_scenario("sparse"), layout), 50_131)
    assert summary["completed"]
    assert summary["n_checks"] <= 2 * summary["n_scanned"]


def test_two_targets_beside_each_other_are_two(tmp_path):
    """Each was seen from another transect; the first looks at the second could be of either."""
    summary = fly_to_folder(load_scenario("clusters").with_search(strategy="belief"), 3, tmp_path / "run")
    assert summary["recall"] == 1.0
    assert summary["duplicates"] == 0


class Beside:
    """Two candidates beside each other, in doubt whatever is seen, and a strategy whose scan is over."""

    def __init__(self, east_m, north_m, monkeypatch):
        self.context = context_of([(0.0, 0.0)], parameters=BeliefParameters())
        self.strategy = BeliefSearch(self.context)
        monkeypatch.setattr(self.strategy._suspects, "probability", lambda _k: 0.5)
        self.places = np.array([[40.0, 40.0, 0.0], [40.0 + east_m, 40.0 + north_m, 0.0]])
        self.at, self.velocity_mps = np.array([0.0, 0.0, 30.0]), np.zeros(3)
        self.time_s, self.candidates = 0.0, {}

    def step(self, refused=""):
        """One look from where the vehicle is; its command, towards which it flies."""
        camera = CameraPose(self.at, rotation_camera_to_enu(0.0, -np.pi / 2))
        hits = []
        for k, place in enumerate(self.places):
            before = self.candidates[k].confidences if k in self.candidates else ()
            self.candidates[k] = Candidate(
                k, "stop sign", place, np.eye(2) * 0.01, self.time_s, self.time_s, (*before, 0.5)
            )
            hits.append(Sighting(k, not before, self.time_s, place, 0.5, float(self.at[2])))
        state = VehicleState(
            self.time_s, self.at, self.velocity_mps, np.eye(3), camera, 1.0, 0.0, airborne=True
        )
        look = Look(self.time_s, camera, self.context.lens, tuple(hits))
        seen = Observation(state, float(self.at[2]), (look,), self.candidates, refused=refused)
        command = self.strategy.step(seen)
        if command.waypoint is not None:
            way = np.array([*command.waypoint.xy_enu_m, command.waypoint.altitude_agl_m]) - self.at
            step = way * min(1.0, 2.0 / max(float(np.linalg.norm(way)), 1e-9))
            self.at, self.velocity_mps = self.at + step, step / 0.4
        self.time_s += 0.4
        return command


@pytest.mark.parametrize("north", [False, True])
@pytest.mark.parametrize("apart_m", np.linspace(0.6, 2.4, 10).tolist())
def test_candidates_a_side_apart_do_not_take_turns_for_ever(apart_m, north, monkeypatch):
    beside = Beside(0.0 if north else apart_m, apart_m if north else 0.0, monkeypatch)
    assert any(beside.step().waypoint is None for _ in range(1500))


def test_a_refused_view_is_no_refused_candidate(monkeypatch):
    """It is looked at from above then; only what is refused there is left unchecked."""
    beside = Beside(60.0, 0.0, monkeypatch)
    while not any("another view" in e.reason for e in beside.step().events):
        assert beside.time_s < 200.0
    k = beside.strategy._goal.id
    command = beside.step("a no-fly area")
    assert command.waypoint.xy_enu_m == tuple(beside.places[k, :2])
    assert not [e for e in command.events if e.kind is EventKind.UNCHECKED]
    (event,) = [e for e in beside.step("a no-fly area").events if e.kind is EventKind.UNCHECKED]
    assert (event.candidate_id, event.reason) == (k, "a no-fly area")


def test_legs_flown_blind_begin_at_the_height_of_the_scan(monkeypatch):
    """Though they are told while the vehicle is low, at one of their ends."""
    beside = Beside(60.0, 0.0, monkeypatch)
    while beside.step().mode is not Mode.CHECK or beside.at[2] > 15.0:
        assert beside.time_s < 200.0
    beside.strategy._settled = {0: EventKind.REJECTED, 1: EventKind.REJECTED}
    beside.strategy._goal = None
    here = tuple(beside.at[:2].tolist())
    state = VehicleState(beside.time_s, beside.at, np.zeros(3), np.eye(3), None, 1.0, 0.0, airborne=True)
    leg = (here, (here[0] + 30.0, here[1]))
    command = beside.strategy.step(Observation(state, float(beside.at[2]), (), {}, unsearched=(leg,)))
    assert (command.mode, command.waypoint.xy_enu_m) == (Mode.SCAN, here)
    assert command.waypoint.altitude_agl_m == beside.context.search.scan_altitude_agl_m
    assert beside.strategy.snapshot()["to_scan"][0] == list(here)


def test_a_flight_that_goes_on_after_a_detour_scans_the_rest_of_its_lane():
    """The place where it was left is known by this name to what resumes flights."""
    strategy = BeliefSearch(context_of([(0.0, 0.0), (100.0, 0.0)], parameters=BeliefParameters()))
    strategy._left = (30.0, 0.0)
    assert strategy.snapshot()["left_xy"] == [30.0, 0.0]
