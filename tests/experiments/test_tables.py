from __future__ import annotations

import io
import json

import pytest
from rich.console import Console

from skysweep.experiments.paper.tables import (
    baselines_json,
    check_effects,
    compare_json,
    compare_rows,
    comparison_tables,
    markdown_tables,
    paired_differences,
)
from skysweep.results.reporting.statistics import mean_ci95


def summary(scenario, n_c, seed, time_s, false_scans=0, recall=1.0, strategy="scan-check", false_positives=0):
    return {
        "scenario": scenario,
        "strategy": strategy,
        "n_c": n_c,
        "seed": seed,
        "completed": True,
        "mission_time_s": time_s,
        "false_scans": false_scans,
        "false_positives": false_positives,
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
SCAN_ONLY = [
    summary("clusters", 5, seed, 140 + seed, recall=recall, strategy="scan-only", false_positives=fp)
    for seed, recall, fp in ((0, 0.8, 0), (1, 0.9, 2), (2, 0.85, 1), (9, 0.1, 50))
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
        "n_unfinished",
    }
    assert rows[2]["n_c"] == "inf"
    assert rows[3]["mission_time_ci95_s"] == [None, None]


def test_scan_only_has_rows_of_its_own_and_leaves_the_papers_as_they_are():
    alone, both = compare_rows(SUMMARIES), compare_rows(SUMMARIES + SCAN_ONLY)
    assert [(r.scenario, r.n_c) for r in both[-1:]] == [("clusters", "scan-only")]
    assert both[:-1] == alone
    assert compare_json(both) == compare_json(alone)
    assert paired_differences(SUMMARIES + SCAN_ONLY) == paired_differences(SUMMARIES)
    (row,) = json.loads(json.dumps(baselines_json(both), allow_nan=False))
    assert set(row) == {
        "scenario",
        "strategy",
        "mission_time_mean_s",
        "mission_time_ci95_s",
        "recall_mean",
        "false_positives_mean",
        "n_seeds",
        "n_unfinished",
    }
    assert (row["scenario"], row["strategy"], row["n_seeds"]) == ("clusters", "scan-only", 4)
    assert row["mission_time_mean_s"] == pytest.approx(143)
    assert row["recall_mean"] == pytest.approx(2.65 / 4)
    assert row["false_positives_mean"] == pytest.approx(53 / 4)
    low, high = row["mission_time_ci95_s"]
    assert low < 143 < high


def test_what_check_costs_and_brings_is_over_common_seeds():
    (effect,) = check_effects(SUMMARIES + SCAN_ONLY)
    assert (effect.scenario, effect.choice, effect.n_pairs) == ("clusters", 5, 3)
    assert effect.mission_time_s[0] == pytest.approx(209)  # 200, 209, 218; seed 9 has no partner
    assert effect.recall[0] == pytest.approx(0.15)  # 0.2, 0.1, 0.15: interval 0.026 to 0.274
    assert effect.false_positives[0] == pytest.approx(-1)  # 0, -2, -1: interval -3.5 to 1.5
    assert effect.brings == "more recall"


@pytest.mark.parametrize(
    ("seeds", "brings"), [(1, "one seed"), (3, "nothing clear")], ids=["one seed", "ties"]
)
def test_check_brings_nothing_where_nothing_differs(seeds, brings):
    flown = [summary("sparse", "inf", seed, 318) for seed in range(seeds)]
    flown += [summary("sparse", "inf", seed, 142, strategy="scan-only") for seed in range(seeds)]
    (effect,) = check_effects(flown)
    assert effect.brings == brings
    fewer = [s | {"false_positives": 2 + s["seed"]} if s["strategy"] == "scan-only" else s for s in flown]
    (effect,) = check_effects(fewer)
    assert effect.brings == ("one seed" if seeds == 1 else "fewer false pos.")


def test_terminal_and_markdown_show_the_same_numbers():
    summaries = SUMMARIES + SCAN_ONLY
    rows = compare_rows(summaries)
    console = Console(file=io.StringIO(), width=80)
    for table in comparison_tables(rows, summaries):
        console.print(table)
    for text in (console.file.getvalue(), markdown_tables(rows, summaries)):
        for shown in ("Table 1", "379.66", "390.0", "+2.7%", "one seed", "-40.0", "n_c = ∞"):
            assert shown in text
        for shown in ("scan-only", "143.0", "136.5 to 149.5", "13.25", "+209.0", "186.6 to 231.4", "+0.150"):
            assert shown in text
        assert "…" not in text
