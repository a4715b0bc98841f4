"""Missions without pictures against missions with them: the table, its ledger, and that the tiers agree."""

import json
import shutil
from pathlib import Path

import polars as pl
import pytest

from skysweep.experiments.calibration.tiers import (
    STATISTICAL_TIMES,
    TIER_METRICS,
    TierMeans,
    compare_tiers,
    validated_rows,
    validation_text,
)
from skysweep.experiments.flying import fly_missing
from skysweep.experiments.matrix import Matrix
from skysweep.flights.fly import fly_in_memory
from skysweep.scenarios.files import load_scenario

DOCS = Path(__file__).parents[2] / "docs"
TINY = """
name: tiny
area: {polygon_enu_m: [[0, 0], [36, 0], [36, 30], [0, 30]]}
home: {position_enu_m: [-2, -2]}
camera: {hfov_rad: 1.4}
search: {n_c: 2, scan_altitude_agl_m: 20, check_altitude_agl_m: 4}
targets:
  - {class: stop sign, position_enu_m: [12, 16], size_m: 0.9}
  - {class: stop sign, position_enu_m: [27, 19], size_m: 0.9}
"""


@pytest.fixture
def tiny(tmp_path):
    path = tmp_path / "tiny.yaml"
    path.write_text(TINY)
    return str(path)


def cell(rendered=100.0, ci=(90.0, 110.0), statistical=100.0):
    return TierMeans("tiny", "n_c inf", "mission_time_s", 5, rendered, ci, statistical)


def test_agreement_is_inside_the_interval_or_within_five_percent():
    assert cell(statistical=109.0).agrees == "inside CI"
    assert cell(ci=(99.0, 101.0), statistical=104.9).agrees == "within 5 %"
    assert cell(ci=(99.0, 101.0), statistical=94.0).agrees == "no"
    assert cell(0.0, (0.0, 0.0), 0.0).agrees == "inside CI"
    assert cell(0.0, (0.0, 0.0), 0.1).agrees == "no"


def test_the_text_counts_and_shows_every_cell():
    text = validation_text([cell(), cell(statistical=130.0)])
    assert text.startswith("1 of 2 means")
    assert "+30.0 %" in text
    assert "90.0 to 110.0" in text


def test_the_tiers_agree_on_a_small_mission(tiny):
    """One mission with pictures lies within 15 % of the mean of six without; all find both signs."""
    scenario = load_scenario(tiny)
    rendered = fly_in_memory(scenario, 0, "imaging")
    statistical = [fly_in_memory(scenario, seed, "statistical") for seed in range(6)]
    mean = sum(s["mission_time_s"] for s in statistical) / 6
    assert rendered["mission_time_s"] == pytest.approx(mean, rel=0.15)
    assert {s["recall"] for s in [rendered, *statistical]} == {1.0}


@pytest.mark.slow
def test_a_validation_is_written_and_goes_on_where_it_was(tiny, tmp_path):
    flown = []
    out = tmp_path / "out"
    rows = validated_rows([tiny], [2.0], ["belief"])
    first = compare_tiers(2, out, rows, 2, lambda job, _: flown.append(job.sensor))
    assert sorted(flown) == ["imaging"] * 4 + ["statistical"] * 4 * STATISTICAL_TIMES
    assert [c.metric for c in first] == 2 * list(TIER_METRICS)
    assert [c.strategy for c in first] == ["n_c 2"] * 3 + ["belief"] * 3
    written = json.loads((out / "validate.json").read_text())
    assert [cell["statistical_mean"] for cell in written] == [c.statistical_mean for c in first]
    assert (out / "validate.md").read_text() == validation_text(first)
    again = []
    assert compare_tiers(2, out, rows, 2, lambda job, _: again.append(job.sensor)) == first
    assert sorted(again) == sorted(flown)
    table = pl.read_parquet(out / "missions.parquet")
    assert dict(table.group_by("sensor").len().iter_rows()) == {"imaging": 4, "statistical": 16}


def test_the_kept_missions_with_pictures_are_taken_and_make_the_documented_means(tmp_path):
    """Where a key is not found: a new field of scenarios changes keys, tools/rekey_pictures.py."""
    shutil.copytree(DOCS / "data" / "missions-with-pictures", tmp_path / "validation")
    matrices = {
        (label, strategy): Matrix.of([(label, scenario)], range(30), "imaging", ["search.n_c"])
        for label, strategy, scenario in validated_rows()
    }
    taken = []
    flown = fly_missing(
        list(matrices.values()),
        lambda job: pytest.fail(f"{job.label} is flown again"),
        tmp_path / "validation",
        1,
        lambda job, _: taken.append(job),
    )
    assert len(taken) == 360
    page = (DOCS / "statistical-sensor.md").read_text()
    for (scenario, strategy), matrix in matrices.items():
        for metric in TIER_METRICS:
            values = [flown[job.config_hash][metric] for job in matrix.jobs()]
            digits = 1 if metric == "mission_time_s" else 3
            assert f"| {scenario} | {strategy} | {metric} | {sum(values) / 30:.{digits}f} |" in page
