"""The journal of a belief mission says why everything was decided, and what it would have cost otherwise."""

import json
import math
import shutil

import pytest

from skysweep.flights.build import build_mission
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.resume import resume_folder
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal, read_journal
from skysweep.mission.loop import Flight
from skysweep.results.journal_lines import can_be_told
from skysweep.results.reporting.wording import safety_words
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.strategies.belief.account import MOVED, within_clear
from skysweep.types import SETTLING, EventKind

ROUNDED = 0.02  # of log odds, by the journal's four digits of a probability


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("explained") / "run"
    scenario = load_scenario("maritime").with_search(strategy="belief")
    fly_to_folder(scenario, 5, folder, Rig("statistical"))
    return folder


@pytest.fixture(scope="module")
def records(folder):
    return read_journal(folder / "journal.jsonl")


def flown_until(name, changes, seed=0):
    journal = MemoryJournal()
    scenario = change_scenario(load_scenario(name), {"search.strategy": "belief", **changes})
    with Flight(build_mission(scenario, seed, Rig("statistical")), journal) as flight:
        for _ in flight:
            pass
    return journal.lines


def of_kind(records, *kinds):
    return [r for r in records if r["kind"] in kinds]


def log_odds(record):
    p = record["probability"]
    return within_clear(math.log(max(p, 1e-4) / max(1.0 - p, 1e-4)))


def test_what_is_told_of_a_probability_is_a_step_and_says_what_moved_it(records):
    told = of_kind(records, EventKind.SCANNED, EventKind.REASSESSED)
    assert 10 < len(told) < 100, "tens of lines a mission"
    last = {}
    for record in told:
        stays_open = record["reason"].endswith(("may show more", "is a target"))
        if record["kind"] == EventKind.REASSESSED and not stays_open:
            assert abs(log_odds(record) - last[record["candidate"]]) >= MOVED - ROUNDED
        assert stays_open or record["reason"].startswith(("found", "missed", "more or fewer are targets"))
        last[record["candidate"]] = log_odds(record)


def test_between_two_lines_a_probability_moves_by_less_than_a_step(records):
    """A verdict or a check is never a surprise: what moved the probability there has been told."""
    last = {}
    for record in of_kind(
        records, EventKind.SCANNED, EventKind.REASSESSED, EventKind.CHECK_STARTED, *SETTLING
    ):
        if "probability" not in record:
            continue
        if record["kind"] in (EventKind.SCANNED, EventKind.REASSESSED):
            last[record["candidate"]] = log_odds(record)
        else:
            assert abs(log_odds(record) - last[record["candidate"]]) < MOVED + ROUNDED


def test_every_decision_says_what_else_could_have_been_decided(records):
    decisions = of_kind(records, EventKind.CHECK_STARTED, EventKind.CONFIRMED, EventKind.REJECTED)
    assert {r["kind"] for r in decisions} == {"check_started", "confirmed", "rejected"}
    for record in decisions:
        if record["reason"].startswith("the same thing as"):
            continue
        costs_s = dict(record["alternatives"])
        assert list(costs_s.values()) == sorted(costs_s.values())
        p = record["probability"]
        assert costs_s["reject"] == pytest.approx(1000 * p, abs=0.1)
        assert costs_s["confirm"] == pytest.approx(400 * (1 - p), abs=0.1)
        assert any(what.startswith("look from") for what in costs_s)
        if record["kind"] == EventKind.REJECTED:
            assert costs_s["reject"] < costs_s["confirm"]


def test_a_journal_without_alternatives_can_be_told(records):
    assert all(map(can_be_told, records))
    decisions = of_kind(records, EventKind.CHECK_STARTED, EventKind.CONFIRMED, EventKind.REJECTED)
    for record in decisions:
        assert can_be_told({k: v for k, v in record.items() if k not in ("alternatives", "reason")})


@pytest.mark.parametrize("kind", ["scanned", "reassessed", "check_started", "rejected"])
def test_broken_off_after_any_decision_it_repeats_every_line(folder, records, tmp_path, kind):
    again = tmp_path / "again"
    again.mkdir()
    shutil.copy(folder / "config.yaml", again)
    n = 1 + max(k for k, r in enumerate(records) if r["kind"] == kind)
    lines = (folder / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (again / "journal.jsonl").write_bytes(b"".join(lines[:n]))
    resume_folder(again)
    assert (again / "journal.jsonl").read_bytes() == b"".join(lines)


def test_the_exports_say_how_sure_it_was_and_from_how_near(folder, records):
    features = json.loads((folder / "targets.geojson").read_text())["features"]
    verdicts = {r["candidate"]: r for r in of_kind(records, EventKind.CONFIRMED)}
    confirmed = [f["properties"] for f in features if f["properties"]["status"] == "confirmed"]
    assert len(confirmed) == len(verdicts)
    for told in confirmed:
        verdict = verdicts[told["candidate"]]
        assert told["probability"] == verdict["probability"]
        assert f"found from {told['seen_from_m']:.0f} m and higher" in verdict["reason"]


def test_a_check_in_the_tour_is_the_cheapest_of_what_could_be_done(records):
    """Its price is by how much it lengthens the way; leaving the scan has its three prices."""
    scanned = max(r["t"] for r in of_kind(records, EventKind.WAYPOINT_REACHED))
    tour = [r for r in of_kind(records, EventKind.CHECK_STARTED) if r["t"] > scanned]
    assert len(tour) >= 2
    for record in tour:
        assert record["alternatives"][0][0].startswith("look from"), record


def test_an_early_end_leaves_candidates_with_their_probability():
    records = flown_until("clusters", {"vehicle.battery_wh": 12.0})
    left = of_kind(records, EventKind.UNCHECKED)
    assert left
    assert all("the search ended early (" in r["reason"] for r in left)
    told = {r["candidate"]: r["probability"] for r in records if "probability" in r}
    assert [r["probability"] for r in left] == [told[r["candidate"]] for r in left]


def test_where_ground_is_looked_at_again_is_told():
    records = flown_until("maritime", {"search.scan_altitude_agl_m": 40.0, "scatter_m": 5.0}, seed=70104)
    (line, *_) = of_kind(records, EventKind.LOOKS_AGAIN)
    assert [what for what, _ in line["alternatives"]] == ["look again", "go home"]
    east_m, north_m, _ = line["p"]
    assert f"weakly at {east_m:.0f} m east, {north_m:.0f} m north: another look" in safety_words(line)
