from __future__ import annotations

import io
import json

import pytest
from rich.console import Console

from skysweep.results.tables import (
    compare_json,
    compare_rows,
    markdown_tables,
    mean_ci95,
    paired_differences,
    print_tables,
)


def summary(scenario, n_c, seed, time_s, false_scans=0, recall=1.0):
    return {
        "scenario": scenario,
        "n_c": n_c,
        "seed": seed,
        "mission_time_s": time_s,
        "false_scans": false_scans,
        "false_positives": 0,
        "recall": recall,
    }


SUMMARIES = [
    summary("clusters", 5, 0, 340, 1),
    summary("clusters", 5, 1, 350),
    summary("clusters", 5, 2, 360),
    summary("clusters", 1, 0, 380, 3, 0.9),
    summary("clusters", 1, 1, 385, 3),
    summary("clusters", 1, 2, 405, 3),
    summary("clusters", "inf", 0, 345),
    summary("clusters", "inf", 1, 370),
    summary("clusters", "inf", 7, 100),
    summary("mine", 2.5, 0, 10),
]


def test_interval_is_students():
    # standard deviation 10, n = 3: 4.303 * 10 / sqrt(3)
    mean, (low, high) = mean_ci95([340, 350, 360])
    assert (mean, low, high) == pytest.approx((350, 350 - 24.84, 350 + 24.84), abs=0.01)


def test_rows_stand_beside_the_papers_in_its_order():
    rows = compare_rows(SUMMARIES)
    assert [(r.scenario, r.n_c) for r in rows] == [
        ("clusters", 1),
        ("clusters", 5),
        ("clusters", "inf"),
        ("mine", 2.5),
    ]
    assert (rows[0].paper_time_s, rows[0].paper_false_positives) == (379.66, 2)
    assert rows[0].mission_time_mean_s == pytest.approx(390)
    assert rows[0].difference == pytest.approx(390 / 379.66 - 1)
    assert rows[0].false_scans_mean == 3
    assert rows[0].recall_mean == pytest.approx(29 / 30)
    assert rows[1].n_seeds == 3
    assert rows[3].paper_time_s is None


def test_pairs_are_seeds_that_both_flew():
    first, second = paired_differences(SUMMARIES)
    assert (first.best, first.other, first.n_pairs) == (5, 1, 3)
    assert first.mean_s == pytest.approx(-40)  # -40, -35, -45
    assert first.ci95_s == pytest.approx((-40 - 12.42, -40 + 12.42), abs=0.01)
    assert first.holds
    assert (second.other, second.n_pairs) == ("inf", 2)
    assert second.mean_s == pytest.approx(-12.5)  # -5, -20; seed 7 has no partner
    assert not second.holds


def test_json_has_the_agreed_keys_and_no_infinity():
    rows = json.loads(json.dumps(compare_json(compare_rows(SUMMARIES)), allow_nan=False))
    assert set(rows[0]) == {
        "scenario",
        "n_c",
        "paper_time_s",
        "mission_time_mean_s",
        "mission_time_ci95_s",
        "paper_false_positives",
        "false_scans_mean",
        "false_positives_mean",
        "recall_mean",
        "n_seeds",
    }
    assert rows[2]["n_c"] == "inf"
    assert rows[3]["mission_time_ci95_s"] == [None, None]


def test_terminal_and_markdown_show_the_same_numbers():
    rows = compare_rows(SUMMARIES)
    console = Console(file=io.StringIO(), width=80)
    print_tables(console, rows, SUMMARIES)
    for text in (console.file.getvalue(), markdown_tables(rows, paired_differences(SUMMARIES))):
        for shown in ("Table 1", "379.66", "390.0", "+2.7%", "one seed", "-40.0", "n_c = ∞"):
            assert shown in text
