"""The paper's claims: yes and no where the seeds say so, and "not shown" where they do not."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.experiments.paper.claims import claims

INF = "inf"
PAPER_S = {1: 379.66, 5: 348.78, INF: 384.23}


def missions(n_c, values, key, **others):
    """Missions of clusters, a seed for each value of ``key``; the times are the paper's."""
    base = {"scenario": "clusters", "strategy": "scan-check", "n_c": n_c, "mission_time_s": PAPER_S[n_c]}
    base |= {"completed": True, "false_scans": 1, "false_positives": 0, "recall": 1.0} | others
    return [base | {"seed": seed, key: value} for seed, value in enumerate(values)]


def verdict(summaries, words):
    (row,) = [row for row in claims(summaries).rows if words in row[0]]
    return row[2]


def most(one, five, inf):
    rows = zip((1, 5, INF), (one, five, inf), strict=True)
    summaries = [s for n_c, counts in rows for s in missions(n_c, counts, "false_scans")]
    return verdict(summaries, "clusters: n_c = 1 has the most false scans")


@pytest.mark.parametrize(
    ("one", "five", "inf", "holds"),
    [
        ([1] * 10, [1] * 10, [1] * 10, "not shown"),  # a tie
        ([3], [1], [0], "not shown"),  # one seed, however large the difference
        ([3, 2, 3, 2, 3], [1, 0, 1, 1, 0], [0, 0, 1, 0, 1], "yes"),
        ([3, 2, 3, 2, 3], [1, 0, 1, 1, 0], [3, 2, 3, 2, 3], "not shown"),  # a tie with one of them
        ([1, 0, 1, 1, 0], [3, 2, 3, 2, 3], [0, 0, 0, 0, 0], "no"),
        ([1, 2, 1], [1, 1, 1], [1, 1, 2], "not shown"),  # the mean is the largest, its interval holds zero
    ],
)
def test_most_false_scans(one, five, inf, holds):
    assert most(one, five, inf) == holds


@given(st.lists(st.integers(0, 5), min_size=1, max_size=20))
def test_what_all_rows_share_is_never_the_most(counts):
    assert most(counts, counts, counts) == "not shown"


def test_one_seed_shows_none_of_the_claims():
    summaries = [s for n_c in PAPER_S for s in missions(n_c, [1], "false_scans")]
    rows = claims(summaries).rows
    assert len(rows) == 5
    assert {holds for _, _, holds in rows} == {"not shown"}
    assert all("one seed: no interval" in measured for _, measured, _ in rows)


@pytest.mark.parametrize(
    ("times_s", "holds"),
    [([345, 350, 355], "yes"), ([300, 350, 400], "not shown"), ([250, 251, 252], "no")],
)
def test_times_near_the_papers(times_s, holds):
    assert verdict(missions(5, times_s, "mission_time_s"), "within 15%") == holds


@pytest.mark.parametrize(
    ("recalls", "holds"),
    [([1.0] * 3, "yes"), ([1.0, 0.9, 1.0], "not shown"), ([0.5, 0.6, 0.5], "no")],
)
def test_recall(recalls, holds):
    assert verdict(missions(5, recalls, "recall"), "Recall is at least 0.95") == holds


def test_scan_only_is_none_of_the_papers_rows():
    rows = [s for n_c in PAPER_S for s in missions(n_c, [2, 3, 2], "false_scans")]
    only = missions(5, [9, 9, 9], "false_scans", strategy="scan-only", recall=0.1, mission_time_s=10.0)
    assert claims(rows + only) == claims(rows)
