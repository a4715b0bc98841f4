"""How a report shows what a strategy believed of each candidate."""

import base64

import pytest
from results_data import event, sighting, tiny_records, write_run

from skysweep.results.announcements import Announcer
from skysweep.results.beliefs import beliefs
from skysweep.results.exports import found_targets
from skysweep.results.metrics import compute_summary
from skysweep.results.reporting.wording import probability_of
from skysweep.results.run_folder import load_run
from skysweep.results.run_report import write_run_report

COSTS = [["look from 4 m", 19.0], ["confirm", 106.6], ["reject", 1466.8]]
FOUND = "found with 0.40 from 10 m"


def believed(t, kind, candidate, probability, reason, **more):
    told = {"probability": probability, "reason": reason} | more
    return event(t, kind, candidate, [5.5, 10, 0]) | told


@pytest.fixture
def run(tmp_path):
    records = [
        *tiny_records()[:4],
        sighting(11, 1, [5.5, 10, 0], 0.4, new=True),
        believed(11, "scanned", 1, 0.55, FOUND),
        believed(12, "reassessed", 1, 0.9, "found in 3 of 3 looks from 10 m, at best with 0.60"),
        sighting(12, 2, [30, 4, 0], 0.3, new=True),
        believed(12, "scanned", 2, 0.2, FOUND),
        believed(13, "check_started", 1, 0.9, "a verdict now costs 40 s on average", alternatives=COSTS),
        sighting(15, 1, [5.5, 10, 0], 0.8) | {"altitude_agl_m": 2.2},
        believed(16, "check_started", 2, 0.2, "a verdict now costs 80 s on average"),
        believed(17, "confirmed", 1, 0.9993, "found from 2 m and higher", alternatives=COSTS),
        believed(18, "rejected", 2, 0.002, "a mistake costs 4 s on average", alternatives=COSTS),
        *(sighting(20, k, [k, 8, 0], 0.3, new=True) for k in (3, 4, 5)),
        *(believed(60, "rejected", k, 0.01, "a mistake costs 9 s on average") for k in (3, 4, 5)),
        event(60, "finished"),
        {"t": 80, "kind": "end", "reason": "completed"},
    ]
    return load_run(write_run(tmp_path / "run", records))


def test_every_candidate_has_a_chart_with_its_story(run):
    one, other, *_ = beliefs(run)
    assert one.caption == "Confirmed stop sign 1: probability over 0.99, seen from 2 m and higher, checked."
    assert other.caption.startswith("Rejected stop sign (candidate 2): probability under 0.01")
    costs = "(look from 4 m: 19\u00a0s, confirm: 107\u00a0s, reject: 1467\u00a0s)"
    assert one.steps == [
        ("0:11", f"0.55: {FOUND}"),
        ("0:12", "0.90: found in 3 of 3 looks from 10 m, at best with 0.60"),
        ("0:13", f"Check begins: a verdict now costs 40 s on average {costs}"),
        ("0:17", f"Confirmed: found from 2 m and higher {costs}"),
    ]
    for chart in (one, other):
        svg = base64.b64decode(chart.data_uri.removeprefix("data:image/svg+xml;base64,"))
        assert svg.lstrip().startswith(b"<?xml")
    assert beliefs(run)[0].data_uri == one.data_uri, "the same bytes every time"


def test_the_page_tells_each_check_and_each_probability(run, tmp_path):
    (tmp_path / "map.png").write_bytes(b"")
    text = write_run_report(run, compute_summary(run), tmp_path).read_text("utf-8")
    for told in (
        "A closer look at stop sign 1: a verdict now costs 40 s on average. Not decided there.",
        "A closer look at candidate 2: a verdict now costs 80 s on average. Rejected 1 candidate.",
        "<span>Confirmed stop sign 1.</span>",
        "<span>Rejected 3 candidates.</span>",
        "all candidates decided",
        "How sure it was of each candidate, and why",
        "<td>over 0.99</td><td>0.80</td><td>2</td>",
    ):
        assert told in text
    assert "Down to" not in text
    assert text.index("Rejected 3 candidates.") < text.index("all candidates decided")


def test_a_strategy_without_probabilities_has_confidences_alone(tiny_run, tmp_path):
    assert beliefs(tiny_run) == []
    (tmp_path / "map.png").write_bytes(b"")
    text = write_run_report(tiny_run, compute_summary(tiny_run), tmp_path).read_text("utf-8")
    assert "How sure it was" not in text
    assert '<th scope="col">Probability</th>' not in text
    assert '<th scope="col">Best confidence</th>' in text


def test_what_was_confirmed_says_how_surely_and_from_where(run):
    (found,) = found_targets(run)
    assert (found.probability, found.seen_from_m) == (0.9993, 2.2)
    said = []
    announcer = Announcer(run.scenario, (), said.append)
    for record in run.records:
        announcer.hear(record)
    (found_words,) = [words for words in said if words.startswith("found")]
    assert ", probability over 0.99, seen from 2 m and higher, confidence up to 0.80, " in found_words


def test_an_unchecked_candidate_gives_the_strategys_own_reason(tmp_path):
    refused = {
        "t": 12,
        "kind": "safety",
        "cause": "geofence",
        "action": "REFUSE_CHECK",
        "sentence": "A fence.",
    }
    left = believed(59, "unchecked", 6, 0.8, "likely, but not found from 8 m or lower")
    run = load_run(write_run(tmp_path / "run", [*tiny_records()[:-3], refused, left, *tiny_records()[-3:]]))
    (tmp_path / "map.png").write_bytes(b"")
    text = write_run_report(run, compute_summary(run), tmp_path).read_text("utf-8")
    assert "(unchecked stop sign 1): Likely, but not found from 8 m or lower." in text


@pytest.mark.parametrize(
    ("p", "words"),
    [(0.0, "under 0.01"), (0.01, "0.01"), (0.5, "0.50"), (0.99, "0.99"), (0.9999, "over 0.99")],
)
def test_no_probability_is_told_as_certain(p, words):
    assert probability_of(p) == words


def test_a_check_that_names_no_candidate_is_told_without_one(tmp_path):
    start = {"t": 13, "kind": "check_started", "probability": 0.5, "reason": "many at once"}
    run = load_run(write_run(tmp_path / "run", [*tiny_records()[:4], start, *tiny_records()[-3:]]))
    assert beliefs(run) == []
    (tmp_path / "map.png").write_bytes(b"")
    assert "to check." in write_run_report(run, compute_summary(run), tmp_path).read_text("utf-8")


def test_words_from_outside_stay_words(tmp_path):
    hostile = "<script>alert(1)</script>\x1b[31m"
    records = [
        *tiny_records()[:4],
        sighting(11, 1, [5.5, 10, 0], 0.4, new=True),
        believed(11, "scanned", 1, 0.55, hostile, alternatives=[[hostile, 5.0]]),
        believed(13, "check_started", 1, 0.9, hostile),
        {"t": 14, "kind": "misfit", "reason": hostile},
        {"t": 14, "kind": "finished", "reason": hostile},
        *tiny_records()[-3:],
    ]
    run = load_run(write_run(tmp_path / "run", records))
    (tmp_path / "map.png").write_bytes(b"")
    text = write_run_report(run, compute_summary(run), tmp_path).read_text("utf-8")
    assert text.count("&lt;script&gt;alert(1)&lt;/script&gt;\\x1b[31m") >= 5
    assert "<script>" not in text
    assert "\x1b" not in text
