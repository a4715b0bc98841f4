"""The operator's orders in what is told of a mission."""

import csv
import json
from xml.etree import ElementTree as ET

import pytest
from mcap.reader import make_reader
from results_data import event, tiny_records, write_run

from skysweep.results.metrics import compute_summary, whole_summary
from skysweep.results.run_folder import load_run
from skysweep.results.writing import write_results
from skysweep.ros.interfaces import from_cdr

OPERATOR = {"by": "operator"}


def order(t, word, candidate=None, p=None):
    of = {"candidate": candidate, "p": p}
    return {"t": t, "kind": "operator", "word": word} | {k: v for k, v in of.items() if v is not None}


def ordered():
    """The bucket (5) is rejected by hand, the second candidate of a sign (2) confirmed, one (6) twice."""
    more = [
        order(51, "reject", 5),
        event(51, "rejected", 5, [28, 4, 0]) | OPERATOR,
        order(52, "look", p=[38, 18, 0]),
        {"t": 54, "kind": "looked", "p": [38, 18, 0]},
        order(56, "reject", 6),
        event(56, "rejected", 6, [38, 18, 0]) | OPERATOR,
        order(57, "confirm", 6),
        event(57, "confirmed", 6, [35, 11, 0]) | OPERATOR,
    ]
    return sorted([*tiny_records(), *more], key=lambda record: record["t"])


@pytest.fixture
def run(tmp_path):
    return load_run(write_run(tmp_path / "run", ordered()))


def test_the_operators_newest_verdict_counts(run):
    verdicts = {c.id: (c.verdict, c.verdict_s, c.by_operator) for c in run.candidates}
    assert verdicts == {
        1: ("confirmed", 16, False),
        2: ("rejected", 20, False),
        3: ("confirmed", 40, False),
        4: ("confirmed", 44, False),
        5: ("rejected", 51, True),
        6: ("confirmed", 57, True),
    }


def candidate_1(folder, records):
    return next(c for c in load_run(write_run(folder, records)).candidates if c.id == 1)


def test_who_agrees_moves_no_verdict(tmp_path):
    """Confirmed at 16 s: as of then, also where the operator says so again, with another place."""
    agreed = [order(55, "confirm", 1), event(55, "confirmed", 1, [9, 9, 0]) | OPERATOR]
    records = sorted([*tiny_records(), *agreed], key=lambda record: record["t"])
    one = candidate_1(tmp_path / "agreed", records)
    before = candidate_1(tmp_path / "before", tiny_records())
    assert (one.verdict, one.verdict_s, one.by_operator) == ("confirmed", 16, True)
    assert one.position_enu_m.tolist() == before.position_enu_m.tolist()
    back = [order(56, "reject", 1), event(56, "rejected", 1, [9, 9, 0]) | OPERATOR]
    again = [order(57, "confirm", 1), event(57, "confirmed", 1, [9, 9, 0]) | OPERATOR]
    records = sorted([*records, *back, *again], key=lambda record: record["t"])
    one = candidate_1(tmp_path / "again", records)
    assert (one.verdict, one.verdict_s) == ("confirmed", 57)


def test_the_teams_figures_hold_them(run, tmp_path):
    before = compute_summary(load_run(write_run(tmp_path / "before", tiny_records())))
    after = whole_summary(run)
    assert (before["n_confirmed"], before["false_positives"]) == (2, 2)
    assert (after["n_confirmed"], after["false_positives"]) == (3, 1)
    assert after["time_to_confirm_s"] == [16, 40, 57]
    assert after["n_by_operator"] == 2


def test_a_verdict_on_the_way_home_is_in_the_curve_when_it_was_said(tmp_path):
    late = [order(75, "confirm", 6), event(75, "confirmed", 6, [35, 11, 0]) | OPERATOR]
    records = tiny_records()
    summary = compute_summary(load_run(write_run(tmp_path, [*records[:-3], *late, *records[-3:]])))
    assert summary["mission_time_s"] == 60
    assert summary["pos_curve"][-2:] == [[75, 1.0], [75, 1.0]]


def test_report_and_exports_say_by_the_operator(run):
    summary = write_results(run, run.folder)
    assert summary["n_by_operator"] == 2
    page = (run.folder / "report.html").read_text(encoding="utf-8")
    for text in (
        "2 verdicts by the operator",
        "stop sign 5 (by the operator)",
        "The operator orders: look at 38 m east, 18 m north.",
        "Looked at 38 m east, 18 m north for the operator.",
        "Rejected 1 candidate by the operator.",
        "Confirmed stop sign 5 by the operator.",
    ):
        assert text in page
    with (run.folder / "targets.csv").open(encoding="utf-8") as file:
        assert [row["by_operator"] for row in csv.DictReader(file)] == ["False", "False", "False", "True"]
    features = json.loads((run.folder / "targets.geojson").read_text(encoding="utf-8"))["features"]
    assert [f["properties"]["by_operator"] for f in features] == [False, False, False, True]
    for name in ("targets.kml", "targets.gpx"):
        texts = [node.text for node in ET.parse(run.folder / name).iter() if node.text]
        assert sum("confirmed by the operator 57 s after take-off" in text for text in texts) == 1


def test_the_recording_says_it(run):
    write_results(run, run.folder)
    with (run.folder / "mission.mcap").open("rb") as file:
        messages = [(c.topic, from_cdr(m.data, s.name)) for s, c, m in make_reader(file).iter_messages()]
    said = [message.msg for topic, message in messages if topic == "/rosout"]
    assert "The operator orders: reject candidate 5." in said
    assert "rejected candidate 5 by the operator" in said
    assert "Looked at 38 m east, 18 m north for the operator." in said
    marks = [message for topic, message in messages if topic == "/skysweep/targets"][-1].markers
    labels = {mark.text for mark in marks if mark.text}
    assert {"1 target confirmed", "6 target confirmed by the operator"} <= labels


@pytest.mark.parametrize(
    "line",
    [
        {"t": 1, "kind": "operator", "word": 7},
        {"t": 1, "kind": "operator", "word": "look", "p": [1, 2]},
        {"t": 1, "kind": "looked"},
        {"t": 1, "kind": "confirmed", "candidate": 1, "p": [1, 2, 3], "by": "<script>"},
    ],
)
def test_lines_that_no_mission_wrote_are_refused(tmp_path, line):
    records = tiny_records()
    with pytest.raises(Exception, match="line 4 is damaged"):
        load_run(write_run(tmp_path, [*records[:3], line, *records[3:]]))
