"""Missions of a comparison: each is flown once, whatever ends the command, and its folder says what it is."""

import shutil
import subprocess
import sys

import polars as pl
import pytest
from sweep_data import tiny_scenario

from skysweep.errors import UserError
from skysweep.experiments.calibration.tiers import TIER_METRICS
from skysweep.experiments.flying import fly_missing
from skysweep.experiments.matrix import Matrix
from skysweep.experiments.store import MissionStore, row_of, summary_of
from skysweep.experiments.sweep.missions import METRICS
from skysweep.experiments.tune.race import outcome_of
from skysweep.files.folder import Folder
from skysweep.files.locking import locked
from skysweep.flights.fly import fly_in_memory
from skysweep.results.summary import Summary
from skysweep.scenarios.files import load_scenario


def matrix(seeds=3, **changes):
    searches = [{"n_c": n_c, "scan_altitude_agl_m": 14} for n_c in (1, 3)]
    rows = [("tiny", tiny_scenario(search=search, **changes)) for search in searches]
    return Matrix.of(rows, range(seeds), "statistical", ["search.n_c"])


def fly(job):
    return fly_in_memory(job.scenario, job.seed, job.sensor)


def fly_nothing(job):
    pytest.fail(f"{job} is flown again")


def table_of(out):
    return (out / "missions.parquet").read_bytes()


def held_in(out):
    return {row["config_hash"]: row for row in MissionStore(Folder(out)).outcomes().iter_rows(named=True)}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    return out, fly_missing([matrix()], fly, out, 2)


def test_a_mission_is_told_as_it_was_flown(whole):
    out, flown = whole
    held = {key: summary_of(row) for key, row in held_in(out).items()}
    assert held == flown
    assert len(held) == 6
    summary = next(iter(held.values()))
    assert set(summary) == set(Summary.__annotations__)
    for n_c in ("inf", 5, 2.5):
        row = row_of("tiny", "", {**summary, "n_c": n_c, "pos_curve": None})
        told = summary_of(row | {"strategy": "scan-check", "seed": 1, "sensor": None})
        assert (told["n_c"], type(told["n_c"]), told["pos_curve"]) == (n_c, type(n_c), None)


def test_what_is_compared_and_tuned_is_in_every_summary(whole):
    summary = next(iter(whole[1].values()))
    assert {*TIER_METRICS, *(metric.key for metric in METRICS), *outcome_of(summary)} <= set(summary)


def test_stopped_and_continued_nothing_is_flown_twice_and_the_table_has_the_same_bytes(whole, tmp_path):
    flown = []

    def stop(job, _summary):
        flown.append(job.config_hash)
        if len(flown) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fly_missing([matrix()], fly, tmp_path, 1, stop)
    assert not (tmp_path / "missions.parquet").exists()
    assert held_in(tmp_path).keys() == set(flown)
    heard = []
    fly_missing([matrix()], fly, tmp_path, 2, lambda job, _: heard.append(job.config_hash))
    assert set(heard[:2]) == set(flown)
    assert len(heard) == len(set(heard)) == 6
    assert table_of(tmp_path) == table_of(whole[0])
    assert not (tmp_path / "parts").exists()


def test_what_was_flown_with_other_parameters_or_more_seeds_is_kept(whole, tmp_path):
    shutil.copytree(whole[0], tmp_path, dirs_exist_ok=True)
    others = matrix(1, wind={"mean_speed_mps": 5.0})
    rows = [row_of(job.label, job.config_hash, fly(job)) for job in others.jobs()]
    MissionStore(Folder(tmp_path)).append(rows, others.table())
    flown = fly_missing([matrix(2)], fly_nothing, tmp_path, 1)
    kept = {job.config_hash for some in (others, matrix()) for job in some.jobs()}
    table = pl.read_parquet(tmp_path / "missions.parquet")
    assert set(table["config_hash"]) == set(flown) == kept
    assert table["job"].to_list() == list(range(8))
    assert flown.items() >= whole[1].items()


def test_missions_of_an_older_skysweep_that_counted_less_are_kept_as_they_are(whole, tmp_path):
    older = pl.read_parquet(whole[0] / "missions.parquet").drop("sorties", "n_unchecked")
    older.write_parquet(tmp_path / "missions.parquet")
    shutil.copy(whole[0] / "timings.parquet", tmp_path)
    flown = fly_missing([matrix(4)], fly, tmp_path, 1)
    counted = {summary["seed"]: summary["sorties"] for summary in flown.values()}
    assert counted == {0: None, 1: None, 2: None, 3: 1}
    assert MissionStore(Folder(tmp_path)).summaries() == flown


def test_a_mission_that_fails_ends_it_with_its_sentence(tmp_path):
    with pytest.raises(UserError, match=r"gone\.onnx: there is no such model file"):
        fly_missing([matrix(1, detector={"model": "gone.onnx"})], fly, tmp_path, 1)
    assert not list(tmp_path.iterdir())


HOLD = """
import sys
from pathlib import Path
from skysweep.files.locking import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_second_comparison_into_the_same_folder_is_refused(tmp_path):
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as first:
        assert first.stdout.readline() == "held\n"
        with pytest.raises(UserError, match="another skysweep is writing it; wait until that one has ended"):
            fly_missing([matrix()], fly_nothing, tmp_path, 1)
        first.kill()
    with locked(tmp_path):
        pass


@pytest.mark.parametrize(
    ("name", "said"),
    [("missions.jsonl", "the missions of an older skysweep"), ("spec.yaml", "a sweep")],
)
def test_a_folder_that_holds_something_else_is_refused_and_stays(tmp_path, name, said):
    (tmp_path / name).write_text('{"key": "1", "summary": {}}\n')
    with pytest.raises(UserError, match=f"{tmp_path}: holds {said}.*; write another --out"):
        fly_missing([matrix()], fly_nothing, tmp_path, 1)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_parts_of_a_sweep_that_lost_its_spec_are_refused(tmp_path):
    job = matrix(1).job(0)
    for rows in ([row_of(job.label, job.config_hash, None, "no")], [row_of(job.label, "other", fly(job))]):
        MissionStore(Folder(tmp_path)).append(rows)
        with pytest.raises(UserError, match="holds a sweep"):
            fly_missing([matrix()], fly_nothing, tmp_path, 1)


def test_a_parameter_written_at_its_default_is_no_other_configuration():
    """They were flown twice, and the report refused the table that had both."""
    plain = load_scenario("clusters").with_search(strategy="belief")
    written = plain.with_search(parameters={"alarm_cost_s": 400.0})
    other = plain.with_search(parameters={"alarm_cost_s": 500.0})
    matrix = Matrix.of([("it", s) for s in (plain, written, other)], [0], "statistical", [])
    assert len(matrix.configurations) == 2
