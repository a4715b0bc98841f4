"""The definition of the suite."""

from __future__ import annotations

import math

import pytest

from skysweep.errors import UserError
from skysweep.experiments.benchmark.break_even import COMPARED, break_even_matrices
from skysweep.experiments.benchmark.suite import (
    OURS,
    VERSION,
    close_look_m,
    contenders,
    load_suite,
    scenario_for,
    suite_matrices,
)
from skysweep.experiments.tune.validate import FIRST_VALIDATION_SEED


def test_every_contender_has_a_valid_scenario_in_every_family():
    suite = load_suite()
    assert suite.version == VERSION
    matrices = suite_matrices(suite, OURS, range(2))
    assert [len(matrix) for matrix in matrices.values()] == [2 * len(suite.families)] * len(OURS)
    hashes = {job.config_hash for matrix in matrices.values() for job in matrix.jobs()}
    assert len(hashes) == 2 * len(suite.families) * len(OURS), "two contenders fly the same mission"


def test_reported_seeds_are_neither_tuned_on_nor_shared():
    suite = load_suite()
    table, pays = suite.seeds.chosen(False), suite.break_even.seeds.chosen(False)
    assert min(*table, *pays) > FIRST_VALIDATION_SEED + 100_000
    assert not set(table) & set(pays)
    assert set(suite.seeds.chosen(True)) < set(table)


def test_the_break_even_flies_ten_thousand_missions():
    suite = load_suite()
    matrices = break_even_matrices(suite, (), suite.break_even.seeds.chosen(False))
    assert sum(map(len, matrices.values())) >= 10_000
    targets = {c.scenario.generators[0].count for m in matrices.values() for c in m.configurations}
    assert targets == {8}


def test_algorithm_1_is_the_paper_s_and_the_tuned_one():
    suite = load_suite()
    family = next(f for f in suite.families if f.label == "abundance")
    by_name = {c.name: scenario_for(suite, family, c).search for c in OURS}
    paper, tuned = by_name["algorithm-1"], by_name["algorithm-1-tuned"]
    assert (paper.n_c, paper.d_c_m, paper.check_speed_mps) == (1, math.inf, 1)
    assert (tuned.n_c, tuned.d_c_m, tuned.scan_altitude_agl_m) == (3, 20, 20)


def test_in_a_close_look_the_size_of_the_smallest_target_spans_38_pixels():
    suite = load_suite()
    closely = next(c for c in OURS if c.changes == "close look")
    for family in suite.families:
        height_m = close_look_m(family.base(), suite.target_px)
        low_m = min(low for low, _ in family.base().target_sizes_m.values())
        spanned_px = family.base().camera.lens.pixels_on_target(low_m, height_m)
        assert spanned_px == pytest.approx(suite.target_px, rel=1e-3)
        assert scenario_for(suite, family, closely).search.confirm_height_max_m == height_m


def test_a_close_look_is_from_no_higher_than_the_scan():
    base = load_suite().families[0].base()
    assert close_look_m(base, target_px=1.0) == base.search.scan_altitude_agl_m


def test_added_strategies_come_before_the_oracle():
    names = [c.name for c in contenders(["skysweep.strategies.scan_check:ScanCheck"])]
    assert names[-2:] == ["skysweep.strategies.scan_check:ScanCheck", "oracle"]


def test_the_break_even_compares_what_it_has_not_with_what_is_added():
    assert [c.name for c in contenders(["low-only"], COMPARED)] == [
        "scan-only", "algorithm-1-tuned", "belief", "low-only", "oracle",
    ]  # fmt: skip
    with pytest.raises(UserError, match="belief: is in the benchmark already"):
        contenders(["belief"], COMPARED)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("belief", "--strategy belief: is in the benchmark already; leave it out"),
        ("oracle", "--strategy oracle: is in the benchmark already; leave it out"),
        ("scan-twice", "--strategy: there is no strategy 'scan-twice'"),
        ("oracle-bound", "--strategy: there is no strategy 'oracle-bound'"),
    ],
)
def test_what_cannot_be_added_is_refused(name, sentence):
    with pytest.raises(UserError, match=sentence):
        contenders([name])
