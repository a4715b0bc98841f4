"""The command: complete, resumable, with a strategy of one's own."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import polars as pl
import pytest
from benchmark_data import small_suite
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.experiments.benchmark import suite as suites
from skysweep.experiments.benchmark.run import fly_matrices
from skysweep.experiments.benchmark.suite import OURS, contenders, suite_matrices

DOCS = Path(__file__).parents[3] / "docs/tutorials/strategy.md"
OWN = "my_strategy:SeenTwice"


@pytest.fixture(scope="module")
def in_folder(tmp_path_factory):
    """A working folder with the strategy of the docs, and the small suite in place of the whole one."""
    folder = tmp_path_factory.mktemp("own")
    code = re.search(r'```python title="my_strategy.py"\n(.*?)```', DOCS.read_text("utf-8"), flags=re.DOTALL)[
        1
    ]
    (folder / "my_strategy.py").write_text(code)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.syspath_prepend(str(folder))
        patch.setattr(suites, "load_suite", small_suite)
        yield folder


def command(*words):
    return CliRunner().invoke(app, ["benchmark", *words])


@pytest.fixture(scope="module")
def benchmarked(in_folder):
    result = command("--quick", "--strategy", OWN, "--out", "out", "--workers", "2")
    assert result.exit_code == 0, result.output
    return in_folder / "out", result.stdout


def test_the_strategy_of_the_docs_has_twenty_lines(in_folder):
    lines = [line for line in (in_folder / "my_strategy.py").read_text().splitlines() if line.strip()]
    assert len(lines) <= 20


def test_every_contender_is_in_the_tables_and_in_the_json(benchmarked):
    out, stdout = benchmarked
    record = json.loads((out / "benchmark.json").read_text())
    assert record["suite"] == "sar-1"
    assert record["seeds"] == {"first": 100, "count": 2}
    family = record["families"]["clusters"]
    assert list(family["contenders"]) == [c.name for c in contenders([OWN])]
    found = family["contenders"][OWN]["measures"]
    assert found["recall"]["mean"] > 0.9
    assert found["completed"]["mean"] == 1.0
    scanned = family["contenders"]["scan-only"]["measures"]["mission_time_s"]["mean"]
    assert found["mission_time_s"]["mean"] == pytest.approx(scanned, rel=0.05)
    for text in (stdout, (out / "benchmark.md").read_text(), (out / "benchmark.html").read_text()):
        assert OWN in text
        assert "oracle" in text


def test_the_oracle_cannot_be_taken_for_a_strategy(benchmarked):
    out, _ = benchmarked
    record = json.loads((out / "benchmark.json").read_text())["families"]["clusters"]["contenders"]
    assert [name for name, c in record.items() if c["is_bound"]] == ["oracle"]
    assert "recall" not in record["oracle"]["measures"]
    assert record["belief-close"]["above_scan_only_of_oracle"]["mean"] > 0.9
    table = pl.read_parquet(out / "missions.parquet")
    assert set(table["strategy"]) == {"scan-only", "low-only", "scan-check", "belief", "oracle-bound", OWN}


def test_the_same_command_flies_nothing_again_and_more_seeds_only_what_is_missing(benchmarked):
    out, _ = benchmarked
    before = (out / "missions.parquet").read_bytes()
    result = command("--quick", "--strategy", OWN, "--out", "out", "--json")
    assert result.exit_code == 0, result.output
    assert (out / "missions.parquet").read_bytes() == before
    assert json.loads(result.stdout) == json.loads((out / "benchmark.json").read_text())


def test_belief_is_told_the_price_of_a_false_alarm(in_folder):
    result = command("--break-even", "--quick", "--out", "pays")
    assert result.exit_code == 0, result.output
    record = json.loads((in_folder / "pays/break-even.json").read_text())
    assert [(c["look_alikes_per_ha"], c["price_s"]) for c in record["cells"]] == [
        (0.0, 10.0),
        (0.0, 1000.0),
        (3.85, 10.0),
        (3.85, 1000.0),
    ]
    assert record["cells"][3]["cheapest"] == "belief"
    assert {c["saved_s"]["mean"] >= 0 for c in record["cells"]} == {True}
    assert (in_folder / "pays/break-even.svg").read_text().startswith("<?xml")
    assert "data:image/svg+xml" in (in_folder / "pays/break-even.html").read_text()
    table = pl.read_parquet(in_folder / "pays/missions.parquet")
    assert table.group_by("scenario", "strategy").len().sort("len")["len"].to_list() == [2, 2, 2, 2, 4, 4]
    again = CliRunner().invoke(app, ["report", "pays"])
    assert again.exit_code == 2
    assert "pays: is of a benchmark, which writes its own report; open" in again.stderr


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--strategy", "scan-twice"], "--strategy: there is no strategy 'scan-twice'"),
        (["--strategy", "belief"], "--strategy belief: is in the benchmark already"),
        (["--reference", "best"], "--reference best: is not compared; write one of scan-only, low-only"),
        (
            ["--reference", "belief", "--break-even"],
            "--reference: the break-even compares all with scan-only",
        ),
        (["--reference", "oracle"], "--reference oracle: is not compared"),
        (["--out", "s3://bucket/x"], "--out s3:/bucket/x: is a URL"),
    ],
)
def test_a_wrong_option_is_one_sentence_and_writes_nothing(in_folder, words, sentence):
    before = sorted(in_folder.iterdir())
    result = command("--quick", *words)
    assert result.exit_code == 2, result.output
    assert sentence in " ".join(result.stderr.split())
    assert sorted(in_folder.iterdir()) == before


def test_a_strategy_that_fails_ends_it_with_family_and_seed(in_folder):
    (in_folder / "broken.py").write_text(
        "class Broken:\n"
        "    def __init__(self, context): pass\n"
        "    def step(self, seen): raise KeyError('left')\n"
        "    def snapshot(self): return {}\n"
        "    def restore(self, snapshot): pass\n"
    )
    result = command("--quick", "--strategy", "broken:Broken", "--out", "broken", "--workers", "1")
    assert result.exit_code == 2, result.output
    sentence = (
        "error: broken:Broken: fails in clusters with seed 100 "
        "(step raises KeyError: 'left' at broken.py:3); mend it, then give"
    )
    assert sentence in " ".join(result.stderr.split())


def test_another_seed_is_another_mission_and_the_number_of_workers_does_not_matter(tmp_path):
    suite = small_suite()
    matrices = suite_matrices(suite, OURS[-1:], [5, 6])
    one = fly_matrices(matrices, suite.target_px, tmp_path / "1", workers=1)["clusters"]["oracle"]
    two = fly_matrices(matrices, suite.target_px, tmp_path / "2", workers=2)["clusters"]["oracle"]
    assert [m["mission_time_s"] for m in one] == [m["mission_time_s"] for m in two]
    assert not math.isclose(one[0]["mission_time_s"], one[1]["mission_time_s"])
    assert (tmp_path / "1/missions.parquet").read_bytes() == (tmp_path / "2/missions.parquet").read_bytes()
