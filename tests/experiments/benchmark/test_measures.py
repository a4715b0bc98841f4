"""What is measured, and where strategies break even."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skysweep.experiments.benchmark.break_even import price_from
from skysweep.experiments.benchmark.measures import half_found_s, standings, values_of
from skysweep.experiments.benchmark.report import CUT, OF_ORACLE, family_grid, overview
from skysweep.experiments.benchmark.suite import OURS

PRICES_S = (10.0, 30.0, 100.0, 300.0)


def mission(**numbers):
    usual = {
        "area_m2": 20_000.0,
        "mission_time_s": 200.0,
        "recall": 1.0,
        "false_positives": 3,
        "duplicates": 1,
        "n_checks": 4,
        "completed": True,
        "time_to_confirm_s": [50.0, 90.0, 70.0, None],
    }
    return usual | numbers


def test_measures_are_per_mission_per_hectare_and_above_scan_only():
    scans = [mission(mission_time_s=150.0), mission(mission_time_s=140.0)]
    values = values_of([mission(), mission(mission_time_s=190.0, completed=False)], scans)
    assert values["above_scan_only_s"].tolist() == [50.0, 50.0]
    assert values["false_positives_per_ha"].tolist() == [1.5, 1.5]
    assert values["completed"].tolist() == [1.0, 0.0]


@pytest.mark.parametrize(
    ("times_s", "half_s"),
    [
        ([50.0, 90.0, 70.0, None], 70.0),
        ([50.0, None, 70.0], 70.0),
        ([None, None, 70.0], 200.0),  # never half: the end of the search
        ([], 200.0),
    ],
)
def test_half_found(times_s, half_s):
    assert half_found_s(mission(time_to_confirm_s=times_s)) == half_s


def test_the_oracle_has_times_only_and_is_what_others_are_divided_by():
    times_s = dict(zip([c.name for c in OURS], (140, 800, 340, 280, 150, 190, 180), strict=True))
    flown = {name: [mission(mission_time_s=float(t + k)) for k in (0, 3)] for name, t in times_s.items()}
    found = {s.contender.name: s for s in standings(flown, OURS, "belief")}
    assert found["oracle"].mean("recall") is None
    assert found["oracle"].mean("mission_time_s").mean == 181.5
    assert found["belief-close"].of_oracle.mean == pytest.approx(50 / 40)
    assert found["oracle"].of_oracle is None
    assert found["scan-only"].of_oracle is None
    assert found["low-only"].differences["mission_time_s"].mean == pytest.approx(650.0)


def test_times_that_a_battery_cut_short_are_marked():
    flown = {c.name: [mission(mission_time_s=200.0 + k) for k in (0, 3)] for c in OURS}
    flown["low-only"][1] = mission(mission_time_s=120.0, completed=False)
    found = {"family": standings(flown, OURS, "belief")}
    grid = family_grid("family", found["family"])
    cells = {row[0]: dict(zip(grid.header, row, strict=True)) for row in grid.rows}
    cut = [title for title, cell in cells["low-only"].items() if CUT in cell]
    assert cut == ["Mission time (s)", "Above scan-only (s)", "Half found (s)", OF_ORACLE][: len(cut)]
    assert len(cut) >= 3
    assert not any(CUT in cell for cell in cells["algorithm-1"].values())
    times, *_ = overview(found, with_intervals=False)
    assert [row[0] for row in times.rows] == ["family"]
    assert [CUT in cell for cell in times.rows[0][1:]] == [c.name == "low-only" for c in OURS]


def test_break_even_is_where_the_gain_turns_positive():
    gains = np.tile([-5.0, -1.0, 1.0, 4.0], (40, 1))
    found = price_from(PRICES_S, gains)
    assert found.mean == found.low == found.high == pytest.approx(math.sqrt(30 * 100))


def test_break_even_counts_the_last_turn():
    assert price_from(PRICES_S, np.tile([1.0, -1.0, 1.0, 4.0], (5, 1))).mean > 30.0


@pytest.mark.parametrize(("gain", "price_s"), [(1.0, 10.0), (-1.0, math.inf)])
def test_break_even_at_all_prices_or_at_none(gain, price_s):
    found = price_from(PRICES_S, np.full((5, 4), gain))
    assert (found.mean, found.low, found.high) == (price_s,) * 3


def test_an_uncertain_gain_has_a_wide_break_even():
    rng = np.random.default_rng(0)
    gains = np.log(PRICES_S) - np.log(60.0) + rng.normal(0.0, 2.0, (30, 1))
    found = price_from(PRICES_S, gains)
    assert 10.0 < found.low < found.mean < found.high < 300.0
