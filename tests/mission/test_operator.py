"""The operator's orders in whole missions: verdicts on candidates, and looks at places."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_faults import LENS, SCENARIO, Flown, LosesLooks, Taken, ordering

from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import project
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.mission.orders import Order
from skysweep.results.journal_lines import can_be_gone_on_with
from skysweep.results.metrics import compute_summary
from skysweep.results.run_folder import Run
from skysweep.scenarios.model import Scenario
from skysweep.strategies.spec import StrategySpec
from skysweep.types import Command, Event, EventKind, Mode, Waypoint

STRATEGIES = ("scan-check", "belief", "scan-only", "low-only")
FIRST, SECOND = (np.array(target["position_enu_m"]) for target in SCENARIO["targets"])
PLACE = (50.0, 20.0)


def search(strategy, **changes):
    return SCENARIO["search"] | {"strategy": strategy} | changes


class Watches:
    """An operator who gives orders when the journal says something; ``said`` is a journal's line."""

    def __init__(self, answers):
        self.answers, self.orders = answers, []

    def journal(self, _vehicle):
        watcher = self

        class Heard(MemoryJournal):
            def write(self, time_s, kind, **fields):
                super().write(time_s, kind, **fields)
                watcher.orders += watcher.answers({"t": time_s, "kind": kind} | fields) or []

        return Heard()

    def __call__(self):
        return self.orders.pop(0) if self.orders else None


def flown_by(answers, **changes):
    watches = Watches(answers)
    return Flown(operator=watches, journal=watches.journal, **changes)


def run_of(flown, **changes):
    return Run(Scenario.model_validate(SCENARIO | changes), tuple(flown.lines))


# ---- verdicts ------------------------------------------------------------------------------------------


def the_first_is_rejected(line):
    if line["kind"] == "scanned" and line["candidate"] == 1:
        return [Order("reject", 1)]
    return None


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_rejected_candidate_is_no_longer_the_strategys(strategy):
    flown = flown_by(the_first_is_rejected, search=search(strategy))
    assert flown.reason == "completed"
    (order,) = flown.of_kind("operator")
    assert (order["word"], order["candidate"]) == ("reject", 1)
    after = [line for line in flown.lines if line["t"] >= order["t"] and line.get("candidate") == 1]
    told = [line for line in after if line["kind"] not in ("sighting", "operator")]
    assert [line["kind"] for line in told if line["t"] > order["t"]] == []
    rejected = next(line for line in told if line["kind"] == "rejected")
    assert rejected["by"] == "operator"
    assert np.hypot(*(rejected["p"][:2] - FIRST)) < 3.0
    assert np.shape(rejected["covariance_m2"]) == (2, 2)
    others = [line for line in flown.of_kind("confirmed") if line["candidate"] != 1]
    assert others
    assert all("by" not in line for line in others)
    summary = compute_summary(run_of(flown, search=search(strategy)))
    assert summary["wrong_rejections"] == 1


def test_no_check_flies_to_a_candidate_that_the_operator_decided_on():
    flown = flown_by(the_first_is_rejected)
    low = [s["p"] for s in flown.of_kind("state") if s["mode"] == "CHECK" and s["p"][2] < 10.0]
    assert low, "the other one is checked"
    assert min(np.hypot(*(np.array(p[:2]) - FIRST)) for p in low) > 5.0


def test_a_verdict_in_the_middle_of_its_check_ends_the_check():
    def answers(line):
        if line["kind"] == "check_started" and line["candidate"] == 1:
            return [None] * 30 + [Order("confirm", 1)]
        return None

    flown = flown_by(answers)
    order = flown.of_kind("operator")[0]
    resumed = next(line for line in flown.of_kind("scan_resumed") if line["t"] >= order["t"])
    assert resumed["t"] <= order["t"] + 0.2
    assert [line["by"] for line in flown.of_kind("confirmed") if line["candidate"] == 1] == ["operator"]
    flown.assert_found()


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_the_operators_second_verdict_counts(strategy):
    def answers(line):
        if line["kind"] == "scanned" and line["candidate"] == 1:
            return [Order("reject", 1)]
        if line["kind"] == "waypoint_reached" and len(told) < 1:
            told.append(line)
            return [Order("confirm", 1)]
        return None

    told = []
    flown = flown_by(answers, search=search(strategy))
    verdicts = [line for line in flown.lines if line.get("candidate") == 1 and "by" in line]
    run = run_of(flown)
    story = next(c for c in run.candidates if c.id == 1)
    assert verdicts[-1]["kind"] == story.verdict
    assert story.by_operator
    assert story.verdict_s == verdicts[-1]["t"]


def test_a_strategys_verdict_can_be_corrected():
    def answers(line):
        if line["kind"] == "confirmed" and "by" not in line:
            return [Order("reject", line["candidate"])]
        return None

    flown = flown_by(answers)
    run = run_of(flown)
    assert compute_summary(run)["n_confirmed"] == 0
    assert [c.verdict for c in run.candidates if c.by_operator] == ["rejected", "rejected"]


def test_a_verdict_on_the_way_home_counts():
    def answers(line):
        return [Order("reject", 1)] if line["kind"] == "finished" else None

    flown = flown_by(answers)
    assert flown.reason == "completed"
    assert next(c for c in run_of(flown).candidates if c.id == 1).verdict == "rejected"


class Stubborn:
    """Knows nothing of an operator: says all that it can of every candidate, at every step."""

    def __init__(self, context):
        self.to_scan = list(context.waypoints_xy_enu_m)

    def step(self, seen):
        here = seen.vehicle.position_enu_m[:2]
        if self.to_scan and math.dist(here, self.to_scan[0]) < 2.0:
            self.to_scan.pop(0)
        kinds = (EventKind.SCANNED, EventKind.CHECK_STARTED, EventKind.REASSESSED, EventKind.REJECTED)
        events = [
            Event(kind, hit.candidate_id, tuple(hit.position_enu_m), 0.5)
            for hit in seen.sightings
            for kind in kinds
        ]
        if not self.to_scan:
            return Command(Mode.SCAN, None, (*events, Event(EventKind.FINISHED)))
        return Command(Mode.SCAN, Waypoint(self.to_scan[0], 30.0, 5.0), tuple(events))

    def snapshot(self):
        return {"to_scan": self.to_scan}

    def restore(self, snapshot):
        self.to_scan = snapshot["to_scan"]


def test_what_a_strategy_says_of_a_decided_candidate_is_left_out():
    watches = Watches(lambda line: [Order("confirm", 1)] if line["kind"] == "scanned" else None)
    rig = Rig("statistical", strategy=StrategySpec(Stubborn))
    journal = watches.journal(None)
    fly(build_mission(Scenario.model_validate(SCENARIO), 0, rig), journal, operator=watches)
    decided_s = next(line["t"] for line in journal.lines if line.get("by") == "operator")
    said = {line["kind"] for line in journal.lines if line.get("candidate") == 1 and line["t"] > decided_s}
    assert said <= {"sighting", "operator", "confirmed"}
    assert any(line["kind"] == "rejected" for line in journal.lines if line.get("candidate") == 2)


@pytest.mark.parametrize("strategy", ["scan-check", "belief", "scan-only"])
def test_a_candidate_that_the_strategy_never_heard_of_can_be_confirmed(strategy):
    """It lies outside the searched area."""
    outside = {"class": "stop sign", "position_enu_m": [66, 30], "size_m": 0.9}

    def answers(line):
        if line["kind"] == "sighting" and line["p"][0] > 63.0 and not confirmed:
            confirmed.append(line["candidate"])
            return [Order("confirm", line["candidate"])]
        return None

    confirmed = []
    flown = flown_by(answers, targets=[*SCENARIO["targets"], outside], search=search(strategy))
    assert flown.reason == "completed"
    assert [line["candidate"] for line in flown.of_kind("confirmed") if "by" in line] == confirmed
    assert confirmed
    assert [line for line in flown.of_kind("unchecked") if line["candidate"] in confirmed] == []
    flown.assert_found()


@pytest.mark.parametrize(
    ("order", "sentence"),
    [
        (Order("confirm", 99), "There is no candidate 99 to confirm."),
        (Order("reject"), "There is no candidate None to reject."),
        (Order("look"), "The order to look has no place; give east and north in metres from home."),
        (Order("look", None, (math.nan, 3.0)), "The order to look has no place"),
        (Order("look", None, (1e300, 3.0)), "The order to look has no place"),
        (
            Order("look", None, (300.0, 20.0)),
            "The place 300 m east, 20 m north is not looked at: it lies outside",
        ),
        (Order("jump"), "There is no order 'jump'; write hold, continue"),
        (Order("confirm", "abc"), "There is no candidate None to confirm."),
        (Order("confirm", 1.5), "There is no candidate None to confirm."),
        (Order("look", None, (1.0,)), "The order to look has no place"),
        (Order("look", None, "here"), "The order to look has no place"),
        (Order(None), "There is no order 'None'; write hold, continue"),
        (Order(5, "abc", 7), "There is no order '5'; write hold, continue"),
        ("jump", "There is no order 'jump'; write hold, continue"),
    ],
)
def test_an_order_that_cannot_be_done_is_refused_in_a_sentence(order, sentence):
    flown = Flown(operator=ordering((300, order)))
    (line,) = flown.of_kind("operator")
    (refused,) = flown.of_kind("safety")
    assert (refused["t"], refused["cause"]) == (line["t"], "operator")
    assert refused["sentence"].startswith(sentence)
    untroubled = [line for line in Flown().lines if line["kind"] != "clearance"]
    rest = [line for line in flown.lines if line["kind"] not in ("operator", "safety", "clearance")]
    assert rest == untroubled


# ---- look here -----------------------------------------------------------------------------------------


def looked(*orders, **changes):
    return Flown(operator=ordering(*orders), **changes)


def trips(flown):
    """Stretches (since, until) in which the vehicle flew for the operator."""
    away = [(t, mode in ("LOOK", "HOLD")) for t, mode in flown.modes]
    edges = [t for (t, a), (_, b) in zip(away[1:], away, strict=False) if a != b]
    return list(zip(edges[::2], edges[1::2], strict=False))


def test_the_word_alone_is_an_order():
    flown = Flown(operator=ordering((300, "return")))
    (line,) = flown.of_kind("operator")
    assert line["word"] == "return"
    assert flown.reason == "operator"


class FullAt(MemoryJournal):
    """A journal whose disk is full from the first confirmation on."""

    def write(self, time_s, kind, **fields):
        super().write(time_s, kind, **fields)
        if kind == "confirmed":
            self.failed = "there is no room"


@pytest.mark.parametrize("order", [Order("reject", 1), Order("look", None, PLACE)])
def test_what_cannot_be_recorded_is_refused(order):
    journal = FullAt()

    def operator():
        said = journal.failed is not None and not told
        return told.append(order) or order if said else None

    told = []
    flown = Flown(operator=operator, journal=lambda _vehicle: journal)
    assert told
    assert any("cannot be recorded" in line["sentence"] for line in flown.of_kind("safety"))
    assert not [line for line in flown.of_kind("rejected") if "by" in line]


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_it_looks_and_goes_on_where_it_was_left(strategy):
    flown = looked((300, Order("look", None, PLACE)), search=search(strategy))
    assert flown.reason == "completed"
    (seen,) = flown.of_kind("looked")
    assert seen["p"] == [*PLACE, 0.0]
    states = flown.of_kind("state")
    there = min(states, key=lambda s: abs(s["t"] - seen["t"]))
    assert math.dist(there["p"][:2], PLACE) < 2.0
    assert there["p"][2] < 7.0
    since_s = flown.of_kind("operator")[0]["t"]
    left = [s["p"] for s in states if s["t"] <= since_s][-1]
    on = next(s for s in states if s["t"] > seen["t"] and s["mode"] in ("SCAN", "CHECK"))
    assert math.dist(on["p"][:2], left[:2]) < 5.0
    assert on["p"][2] > left[2] - 3.0
    flown.assert_found()
    flown.assert_landed_at_home()


def test_two_looks_at_the_place_are_answered_before_it_goes_on():
    looks = []

    class Counted(LosesLooks):
        def sense(self, state):
            found = super().sense(state)
            if found is not None:
                looks.append(found)
            return found

    flown = looked((300, Order("look", None, PLACE)), sensor=lambda inner: Counted(inner, 1e9))
    (seen,) = flown.of_kind("looked")
    place = np.array([*PLACE, 0.0])
    low = [d for d in looks if d.camera.position_enu_m[2] < 7.0 and d.time_s <= seen["t"]]
    in_view = [d for d in low if np.all(np.abs(project(LENS, d.camera, place)[0] - [320, 180]) < [320, 180])]
    assert len(in_view) >= 2


def test_nothing_of_the_scan_is_missed_beneath_a_detour():
    """The path at scan altitude is that of the mission without an order."""

    def scanned(flown):
        states = [s["p"] for s in flown.of_kind("state") if s["mode"] == "SCAN" and s["p"][2] > 25.0]
        return shapely.MultiPoint([p[:2] for p in states])

    nothing = {"targets": [], "detector": {"confidence_min": 0.9}}
    plain, detoured = Flown(**nothing), looked((300, Order("look", None, (5.0, 35.0))), **nothing)
    for place in scanned(plain).geoms:
        assert scanned(detoured).distance(place) < 4.0


def test_several_places_queue_and_hold_and_continue_work_in_between():
    flown = looked(
        (300, Order("look", None, PLACE)),
        (301, Order("look", None, (10.0, 50.0))),
        (302, Order("hold")),
        (350, Order("look", None, (30.0, 30.0))),
        (400, Order("continue")),
    )
    assert [line["p"][:2] for line in flown.of_kind("looked")] == [[*PLACE], [10.0, 50.0], [30.0, 30.0]]
    assert flown.safety == [("operator", "HOLD"), ("operator", "CONTINUE")]
    held = [s["p"] for s in flown.of_kind("state") if s["mode"] == "HOLD" and s["t"] < 40.0]
    assert np.ptp(np.array(held[4:]), axis=0).max() < 1.5
    assert flown.reason == "completed"
    flown.assert_found()


def test_what_is_seen_at_the_place_is_told_at_once_and_decided_later():
    """The detector sees nothing from the scan altitude, and the target from nearby."""

    class NearSighted(LosesLooks):
        def sense(self, state):
            found = self.inner.sense(state)
            if found is None or state.position_enu_m[2] < 12.0:
                return found
            none = {"boxes_xyxy_px": np.zeros((0, 4)), "confidences": np.zeros(0), "class_names": ()}
            return replace(found, **none)

    flown = looked((250, Order("look", None, tuple(SECOND))), sensor=lambda inner: NearSighted(inner, 1e9))
    (seen,) = flown.of_kind("looked")
    sightings = flown.of_kind("sighting")
    assert sightings
    assert sightings[0]["t"] < seen["t"]
    index = [flown.lines.index(line) for line in (sightings[0], seen)]
    assert index == sorted(index), "journalled before the vehicle leaves"
    assert np.hypot(*(flown.places("confirmed") - SECOND).T).min() < 1.5


def test_a_place_asked_for_during_take_off_is_the_first():
    flown = looked((20, Order("look", None, PLACE)))
    (seen,) = flown.of_kind("looked")
    assert seen["t"] < min(line["t"] for line in flown.of_kind("waypoint_reached"))
    flown.assert_found()


def test_return_ends_a_look_and_says_what_was_not_looked_at():
    flown = looked(
        (300, Order("look", None, PLACE)), (310, Order("look", None, (10, 50))), (320, Order("return"))
    )
    assert flown.reason == "operator"
    assert flown.of_kind("looked") == []
    sentences = [line["sentence"] for line in flown.of_kind("safety")]
    assert sentences[1:] == [
        "The place 50 m east, 20 m north is not looked at: the search is over.",
        "The place 10 m east, 50 m north is not looked at: the search is over.",
    ]
    flown.assert_landed_at_home()


def test_the_battery_ends_a_look():
    asked = [Order("look", None, place) for place in (PLACE, (10.0, 60.0)) * 20]
    flown = looked(*enumerate(asked, start=300), battery_wh=15.0)
    assert flown.reason in ("low battery", "return energy")
    assert 0 < len(flown.of_kind("looked")) < len(asked)
    flown.assert_landed_at_home()


def test_a_place_for_which_the_energy_is_lacking_is_refused():
    wide = {"polygon_enu_m": [[0, 0], [150, 0], [150, 100], [0, 100]]}
    flown = looked((250, Order("look", None, (145.0, 95.0))), battery_wh=10.0, area=wide)
    assert "with the way home it takes" in flown.of_kind("safety")[0]["sentence"]
    assert flown.of_kind("looked") == []
    flown.assert_landed_at_home()


def test_a_dead_detector_is_waited_for_at_the_place_then_the_vehicle_comes_home():
    flown = looked((300, Order("look", None, PLACE)), sensor=lambda inner: LosesLooks(inner, 32.0))
    assert flown.reason == "detector silent"
    assert flown.of_kind("looked") == []
    assert flown.of_kind("unsearched") == [], "no ground was covered on the way"
    flown.assert_landed_at_home()


FENCED = {
    "geofence_enu_m": [[-15, -15], [75, -15], [75, 80], [-15, 80]],
    "safety": {"no_fly_enu_m": [[[30, 25], [36, 25], [36, 80], [30, 80]]]},
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 70], [36, 70], [36, 25], [30, 25], [30, 70], [0, 70]]},
}


def test_a_look_is_flown_round_a_no_fly_area():
    flown = looked((260, Order("look", None, (50.0, 60.0))), (600, Order("look", None, (33, 60))), **FENCED)
    assert len(flown.of_kind("looked")) == 1
    assert "in a no-fly area" in flown.of_kind("safety")[0]["sentence"]
    forbidden = shapely.Polygon(FENCED["safety"]["no_fly_enu_m"][0])
    assert not any(forbidden.contains(shapely.Point(s["p"][:2])) for s in flown.of_kind("state"))


def test_under_a_tree_it_looks_from_beside():
    tree = {"position_enu_m": [*PLACE], "height_m": 12.0, "crown_radius_m": 2.5}
    flown = looked((300, Order("look", None, (PLACE[0] + 2.5, PLACE[1]))), trees=[tree])
    (seen,) = flown.of_kind("looked")
    there = min(flown.of_kind("state"), key=lambda s: abs(s["t"] - seen["t"]))
    assert math.dist(there["p"][:2], PLACE) > 4.0
    assert flown.of_kind("clearance")[0]["collisions"] == 0


def test_a_detour_that_began_above_a_high_tree_ends_where_it_began():
    """There the vehicle was higher than the scan, which it need not be again."""
    trees = [{"position_enu_m": [x, 30.0], "height_m": 38.0, "crown_radius_m": 3.0} for x in range(2, 60, 6)]
    over_s = next(s["t"] for s in Flown(trees=trees).of_kind("state") if s["p"][2] > 35.0)
    flown = looked((round(10 * over_s), Order("look", None, PLACE)), trees=trees)
    assert len(flown.of_kind("looked")) == 1
    assert flown.reason == "completed"
    assert flown.of_kind("clearance")[0]["collisions"] == 0


def test_while_somebody_else_flies_it_and_on_the_way_home_a_look_is_refused():
    flies = []

    def taken(inner):
        flies.append(Taken(inner))
        return flies[0]

    at = {30.0: Order("look", None, PLACE), 31.0: Order("hold"), 32.0: Order("continue")}

    def operator():
        now_s = flies[0].inner.state().time_s if flies else 0.0
        due = [t for t in at if t <= now_s]
        return at.pop(due[0]) if due else None

    flown = Flown(vehicle=taken, operator=operator)
    assert "somebody else flies the vehicle" in flown.of_kind("safety")[1]["sentence"]
    assert flown.of_kind("looked") == []
    flown = flown_by(lambda line: [Order("look", None, PLACE)] if line["kind"] == "finished" else None)
    assert "on its way home" in flown.of_kind("safety")[0]["sentence"]
    flown.assert_landed_at_home()


def test_a_look_goes_on_after_somebody_else_has_flown_it():
    flown = Flown(
        vehicle=lambda inner: Taken(inner, 31.0), operator=ordering((295, Order("look", None, PLACE)))
    )
    assert len(flown.of_kind("looked")) == 1
    assert flown.reason == "completed"
    flown.assert_found()


# ---- anything ------------------------------------------------------------------------------------------

places = st.tuples(st.floats(-40, 100), st.floats(-40, 100)) | st.tuples(st.floats(), st.floats())
orders = st.one_of(
    st.sampled_from(["hold", "continue", "return", "take back"]).map(Order),
    st.builds(Order, st.sampled_from(["confirm", "reject"]), st.integers(0, 4) | st.none()),
    st.builds(Order, st.just("look"), st.none(), places | st.none()),
    st.builds(Order, st.text(max_size=3), st.integers(), places),
)


@given(
    told=st.dictionaries(st.integers(0, 2500), orders, max_size=12),
    strategy=st.sampled_from(STRATEGIES),
    fenced=st.booleans(),
)
@settings(max_examples=12, suppress_health_check=list(HealthCheck), derandomize=True)
def test_whatever_is_ordered_the_mission_stays_inside_and_comes_home(told, strategy, fenced):
    changes = FENCED if fenced else {}
    flown = looked(*told.items(), battery_wh=40.0, **changes, search=search(strategy))
    flown.assert_landed_at_home()
    assert all(can_be_gone_on_with(line) for line in flown.lines)
    heard = len(flown.of_kind("operator"))
    assert heard == sum(step < len(flown.modes) - 1 for step in told)
    if fenced:
        fence = shapely.Polygon(FENCED["geofence_enu_m"], FENCED["safety"]["no_fly_enu_m"]).buffer(0.5)
        assert all(fence.contains(shapely.Point(s["p"][:2])) for s in flown.of_kind("state"))
    story = {c.id: c for c in run_of(flown, **changes).candidates}
    newest = {line["candidate"]: line["kind"] for line in flown.lines if line.get("by") == "operator"}
    assert {k: story[k].verdict for k in newest} == newest
