"""A mission with orders of an operator that is killed anywhere: nothing that was ordered is lost."""

import json
import shutil
from contextlib import closing

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skysweep.flights.build import build_mission
from skysweep.flights.fly import begin, fly_in, fly_to_folder
from skysweep.flights.resume import resume_folder
from skysweep.flights.rig import Rig
from skysweep.mission.journal import FileJournal, read_journal
from skysweep.mission.orders import Order
from skysweep.results.run_folder import load_run
from skysweep.scenarios.model import Scenario
from skysweep.vehicles.embedded.at_home import embedded_vehicle

SMALL = {
    "name": "small",
    "area": {"polygon_enu_m": [[0, 0], [16, 0], [16, 10], [0, 10]]},
    "home": {"position_enu_m": [-12, -3]},
    "targets": [
        {"class": "stop sign", "position_enu_m": [4, 3], "size_m": 0.9},
        {"class": "stop sign", "position_enu_m": [13, 7], "size_m": 0.9},
    ],
    "camera": {"hfov_rad": 1.2},
    "search": {"n_c": 1, "scan_altitude_agl_m": 12},
}
ORDERS = {
    3.0: Order("look", None, (14.0, 2.00004999)),
    16.0: Order("confirm", 77),
    17.0: Order("look", None, (3.0, 8.0)),
    17.1: Order("look", None, (900.0, 8.0)),
    18.0: Order("hold"),
    20.0: Order("continue"),
    34.0: Order("reject", 1),
    36.0: Order("confirm", 1),
    39.0: Order("look", None, (8.0, 9.0)),
    58.0: Order("reject", 2),
}


class Script:
    """An operator who gives each order at its time of the mission, and is told the time by ``watch``."""

    def __init__(self, orders):
        self.orders, self.now_s = orders, None

    def watch(self, state, _mode, _new):
        self.now_s = round(state.time_s, 1)

    def __call__(self):
        return self.orders.get(self.now_s)


def scenario(**changes):
    return Scenario.model_validate(SMALL | changes)


def fly_scripted(folder, orders=ORDERS, **changes):
    script = Script(orders)
    fly_to_folder(scenario(**changes), 2, folder, Rig("statistical", watch=script.watch, operator=script))


def resume_scripted(folder, orders=ORDERS):
    script = Script(orders)
    resume_folder(folder, Rig("statistical", watch=script.watch, operator=script))


def killed(whole, folder, n_lines):
    """A copy of the mission as a kill after ``n_lines`` leaves it."""
    folder.mkdir()
    shutil.copy(whole / "config.yaml", folder)
    lines = (whole / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (folder / "journal.jsonl").write_bytes(b"".join(lines[:n_lines]))
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "run"
    fly_scripted(folder)
    return folder


def test_every_order_has_its_line_and_what_follows_from_it(whole):
    lines = read_journal(whole / "journal.jsonl")
    assert [line["word"] for line in lines if line["kind"] == "operator"] == [o.word for o in ORDERS.values()]
    assert sum(line["kind"] == "looked" for line in lines) == 3
    assert [line["kind"] for line in lines if line.get("by") == "operator"] == [
        "rejected",
        "confirmed",
        "rejected",
    ]
    verdicts = {c.id: (c.verdict, c.by_operator) for c in load_run(whole).candidates}
    assert verdicts[1] == ("confirmed", True)
    assert verdicts[2] == ("rejected", True)


def test_killed_anywhere_a_simulated_mission_repeats_the_orders(whole, tmp_path, monkeypatch):
    monkeypatch.setattr("skysweep.flights.resume.finish", lambda *_: {})
    expected = (whole / "journal.jsonl").read_bytes()
    lines = [json.loads(line) for line in expected.splitlines()]
    near = {
        k + away
        for k, line in enumerate(lines)
        for away in (0, 1)
        if line["kind"] in ("operator", "looked", "safety") or "by" in line
    }
    for k in sorted(near | set(range(1, len(lines), 25))):
        folder = killed(whole, tmp_path / f"killed-{k}", k)
        resume_scripted(folder)
        assert (folder / "journal.jsonl").read_bytes() == expected, f"killed at line {k}"


def test_while_it_is_repeated_nobody_is_asked(whole, tmp_path, monkeypatch):
    monkeypatch.setattr("skysweep.flights.resume.finish", lambda *_: {})
    n_lines = len(read_journal(whole / "journal.jsonl"))
    folder = killed(whole, tmp_path / "run", n_lines - 3)
    begun = read_journal(folder / "journal.jsonl")[-1]["t"]
    asked_at = []
    script = Script({})

    def operator():
        asked_at.append(script.now_s)

    resume_folder(folder, Rig("statistical", watch=script.watch, operator=operator))
    assert min(asked_at) >= begun - 0.2


orders = st.one_of(
    st.sampled_from(["hold", "continue", "return"]).map(Order),
    st.builds(Order, st.sampled_from(["confirm", "reject"]), st.integers(0, 3)),
    st.builds(Order, st.just("look"), st.none(), st.tuples(st.floats(-5, 20), st.floats(-5, 15))),
)
TENTHS = st.integers(1, 700).map(lambda tenths: tenths / 10)


@given(
    told=st.dictionaries(TENTHS, orders, max_size=10),
    share=st.floats(0.02, 0.98),
    strategy=st.sampled_from(["scan-check", "belief", "scan-only"]),
)
@settings(max_examples=8, suppress_health_check=list(HealthCheck), derandomize=True)
def test_whatever_is_ordered_it_is_repeated(told, share, strategy, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    search = SMALL["search"] | {"strategy": strategy}
    fly_scripted(folder / "whole", told, search=search, vehicle={"battery_wh": 20.0})
    expected = (folder / "whole" / "journal.jsonl").read_bytes()
    at = max(1, int(share * expected.count(b"\n")))
    resume_scripted(killed(folder / "whole", folder / "killed", at), told)
    assert (folder / "killed" / "journal.jsonl").read_bytes() == expected


# ---- a vehicle that cannot be flown again ----------------------------------------------------------------


class Broken(Exception):
    """Our side ends."""


def broken_off(folder, until):
    """Fly with orders until ``until(line)``; the vehicle, which is left as it is."""
    folder.mkdir()
    vehicle, script = embedded_vehicle(scenario(), 0), Script(ORDERS)
    rig = Rig("statistical", threads=1, vehicle=vehicle, watch=script.watch, operator=script)
    mission = build_mission(scenario(), 0, rig)

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


def at(kind, number=1, **fields):
    """At a line of a kind that says all of ``fields``: what ``broken_off`` needs."""
    met = []

    def until(line):
        says = line["kind"] == kind and all(line.get(key) == value for key, value in fields.items())
        met.extend([line] if says else [])
        return len(met) == number

    return until


@pytest.mark.parametrize("stays_up", [True, False])
@pytest.mark.parametrize(
    "line",
    [
        *(("operator", n, {"word": "look"}) for n in (1, 2, 3)),
        *(("state", n, {"mode": "LOOK"}) for n in (1, 12)),
        *(("looked", n, {}) for n in (1, 2, 3)),
        ("scanned", 1, {}),
    ],
)
def test_places_that_were_asked_for_are_looked_at_after_all(tmp_path, line, stays_up):
    folder = tmp_path / "run"
    kind, number, says = line
    vehicle = broken_off(folder, at(kind, number, **says))
    before = read_journal(folder / "journal.jsonl")
    asked = [line["p"] for line in before if line["kind"] == "operator" and line["word"] == "look"]
    resume_folder(folder, Rig(vehicle=vehicle if stays_up else embedded_vehicle(scenario(), 1)))
    after = read_journal(folder / "journal.jsonl")
    seen = [line["p"] for line in after if line["kind"] == "looked"]
    assert [p for p in asked if p[0] < 100.0 and p not in seen] == []
    assert load_run(folder).finished_s is not None
    assert after[-1]["reason"] == "completed"


@pytest.mark.parametrize(
    "line",
    [
        ("operator", 1, {"word": "reject"}),
        ("rejected", 1, {"by": "operator"}),
        ("operator", 2, {"word": "confirm"}),
        ("confirmed", 1, {"by": "operator"}),
        ("operator", 2, {"word": "reject"}),
        ("rejected", 2, {"by": "operator"}),
        ("waypoint_reached", 2, {}),
        ("end", 1, {}),
    ],
)
def test_verdicts_outlive_a_kill(tmp_path, line):
    folder = tmp_path / "run"
    kind, number, says = line
    vehicle = broken_off(folder, at(kind, number, **says))
    before = read_journal(folder / "journal.jsonl")
    resume_folder(folder, Rig(vehicle=vehicle))
    words = {"confirm": "confirmed", "reject": "rejected"}
    ordered = {
        line["candidate"]: words[line["word"]]
        for line in before
        if line["kind"] == "operator" and line["word"] in words and line["candidate"] < 9
    }
    decided = {c.id: c.verdict for c in load_run(folder).candidates if c.by_operator}
    assert ordered.items() <= decided.items()
    after = read_journal(folder / "journal.jsonl")
    later = after[len(before) :]
    strategys = [line for line in later if line["kind"] in words.values() and "by" not in line]
    assert not {line["candidate"] for line in strategys} & set(ordered)


def test_the_scan_goes_on_where_it_was_left_for_the_look(tmp_path):
    folder = tmp_path / "run"
    broken_off(folder, at("looked", 3))
    before = [line for line in read_journal(folder / "journal.jsonl") if line["kind"] == "state"]
    left = [line["p"] for line in before if line["mode"] == "SCAN"][-1]
    resume_folder(folder, Rig(vehicle=embedded_vehicle(scenario(), 1)))
    run = load_run(folder)
    after = run.states.position_enu_m[run.states.time_s > run.events("resumed")[0]["t"]]
    scanning = after[after[:, 2] > 0.8 * 12.0, :2]
    assert np.linalg.norm(scanning - left[:2], axis=1).min() < 3.0
