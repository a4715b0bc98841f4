"""The comparison with the paper: complete, resumable, the same for any number of workers."""

import json
import resource
import shutil
import signal
import subprocess
import sys
import time

import psutil
import pytest

from skysweep.errors import UserError
from skysweep.experiments.paper.report import drawn_runs, write_compare_report
from skysweep.experiments.paper.run import fly_paper_job, folder_of, paper_matrices
from skysweep.experiments.paper.tables import PAPER, compare_rows, markdown_tables, paired_differences
from skysweep.experiments.store import MissionStore
from skysweep.files.folder import Folder
from skysweep.results.run_folder import load_run
from warm import run_skysweep

WORDS = ("compare", "paper", "--sensor", "statistical", "--seeds", "1", "--set", "camera.rate_hz=1")


SCENARIOS = ["clusters", "abundance", "sparse"]


def rows(folder, name="compare"):
    return json.loads((folder / f"{name}.json").read_text())


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "out"
    result = run_skysweep(*WORDS, "--workers", 2, "--out", out)
    assert result.returncode == 0, result.stderr
    return out, result.stdout


@pytest.mark.slow
def test_eight_rows_scan_only_three_tables_and_a_report(whole):
    out, stdout = whole
    table = rows(out)
    assert [(r["scenario"], r["n_c"]) for r in table] == [
        ("clusters", 1),
        ("clusters", 5),
        ("clusters", "inf"),
        ("abundance", 1),
        ("abundance", 5),
        ("abundance", "inf"),
        ("sparse", 1),
        ("sparse", "inf"),
    ]
    wanted = (
        "paper_time_s mission_time_mean_s mission_time_ci95_s paper_false_positives false_scans_mean "
        "false_positives_mean recall_mean n_seeds"
    )
    assert set(wanted.split()) <= set(table[0])
    assert "379.66" in stdout.replace(" ", "") or "379.7" in stdout
    baselines = rows(out, "baselines")
    assert [(r["scenario"], r["strategy"], r["n_seeds"]) for r in baselines] == [
        (scenario, strategy, 1) for strategy in ("scan-only", "belief") for scenario in SCENARIOS
    ]
    for scenario, row in zip(SCENARIOS, baselines[:3], strict=True):
        assert (
            0.0
            < row["mission_time_mean_s"]
            < min(r["mission_time_mean_s"] for r in table if r["scenario"] == scenario)
        )
        assert 0.0 < row["recall_mean"] <= 1.0
        assert len(list(out.glob(f"runs/{scenario}-scan-only-seed0-*/map.png"))) == 1
    assert stdout.count("scan-only") >= 3
    assert (out / "report.html").stat().st_size > 10_000
    assert (out / "trajectories.png").exists()


@pytest.mark.slow
def test_as_json_bounds_that_are_open_are_null(whole):
    out, _ = whole
    flown = wall_times_s(out)
    told = run_skysweep(*WORDS, "--out", out, "--json")
    compared = json.loads(told.stdout)
    assert len(compared["rows"]) == 8
    assert compared["rows"][0]["mission_time_ci95_s"] == [None, None]
    assert len(compared["baselines"]) == 6  # scan-only and belief in three scenarios
    assert wall_times_s(out) == flown, "nothing is flown again"


@pytest.mark.slow
@pytest.mark.exhaustive
def test_killed_and_continued_it_ends_with_the_same_rows(whole, tmp_path):
    out = tmp_path / "out"
    command = [sys.executable, "-m", "skysweep.cli", *WORDS, "--workers", "1", "--out", str(out)]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not list(out.glob("parts/[0-9a-f]*.parquet")):  # whole ones
        assert process.poll() is None, "it ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    children = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not _alive_after(children, 20.0), "workers end with the command that was killed"
    before = wall_times_s(out)
    subprocess.run(command, check=True, capture_output=True)
    after = wall_times_s(out)
    assert 0 < len(before) < len(after) == 14
    assert before.items() <= after.items(), "finished missions are not flown again"
    assert rows(out) == rows(whole[0])
    assert rows(out, "baselines") == rows(whole[0], "baselines")
    assert (out / "missions.parquet").read_bytes() == (whole[0] / "missions.parquet").read_bytes()


def wall_times_s(out):
    held = MissionStore(Folder(out)).outcomes()
    return dict(zip(held["config_hash"], held["wall_time_s"], strict=True))


def jobs_of(seeds, changes=None):
    return [job for matrix in paper_matrices(seeds, "statistical", changes) for job in matrix.jobs()]


def scan_only_in_sparse(changes=None):
    return [job for job in jobs_of(1, changes) if job.scenario.search.strategy == "scan-only"][-1]


def test_belief_is_left_out_where_the_detector_has_no_sensor_model(tmp_path):
    model = tmp_path / "mine.onnx"
    model.write_bytes(b"its content is read in flight only")
    flown = {job.scenario.search.strategy for job in jobs_of(1, {"detector.model": str(model)})}
    assert flown == {"scan-check", "scan-only"}


def test_missions_with_pictures_stand_in_the_report_beside_the_mean_of_their_row(whole, tmp_path):
    shutil.copytree(whole[0], tmp_path / "out")
    (flown,) = whole[0].glob("runs/sparse-ncinf-seed0-*")
    shutil.copytree(flown, tmp_path / "out" / "pictures" / "sparse")
    summaries = [*MissionStore(Folder(tmp_path / "out")).summaries().values()]
    write_compare_report(tmp_path / "out", summaries, [flown])
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Missions with pictures" in page
    assert "pictures/sparse/report.html" in page
    assert "Missions with pictures" not in (whole[0] / "report.html").read_text()


def test_scan_only_keeps_the_rows_settings_and_the_keys_of_the_others():
    jobs = jobs_of(2, {"wind.mean_speed_mps": 4.0})
    assert len(jobs) == len({job.config_hash for job in jobs}) == 28
    only = [job.scenario for job in jobs if job.scenario.search.strategy == "scan-only"]
    assert [scenario.name for scenario in only] == 2 * SCENARIOS
    assert {scenario.wind.mean_speed_mps for scenario in only} == {4.0}
    others = [job for job in jobs if job.scenario.search.strategy == "scan-check" and job.seed == 0]
    assert [(job.label, job.scenario.search.n_c) for job in others] == [(r.scenario, r.n_c) for r in PAPER]


def test_missions_along_another_plan_are_flown_again(tmp_path):
    keys = set()
    for drawn in ("one", "another"):
        (tmp_path / "field.plan").write_text(drawn)
        jobs = jobs_of(1, {"search.plan": str(tmp_path / "field.plan")})
        keys |= {job.config_hash for job in jobs}
    assert len(keys) == 2 * len(jobs)


def test_on_a_full_disk_nothing_is_left_of_a_mission(tmp_path):
    """A limit on the size of files is what a full disk looks like to one process."""
    job = scan_only_in_sparse()
    folder = folder_of(job, tmp_path)
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, unlimited[1]))
    try:
        with pytest.raises(UserError, match=rf"{folder}: cannot be written whole; make room, then give the"):
            fly_paper_job(job, tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
    assert list((tmp_path / "runs").iterdir()) == []


def test_what_a_kill_leaves_of_a_mission_is_not_drawn(tmp_path):
    summary = fly_paper_job(job := scan_only_in_sparse(), tmp_path)
    flown = folder_of(job, tmp_path)
    drawn = drawn_runs([tmp_path / "runs" / "removed", flown], compare_rows([summary]))
    assert [run.folder for run in drawn] == [flown]


def test_missions_with_other_settings_take_no_run_folder_from_each_other(tmp_path):
    jobs = [scan_only_in_sparse(), scan_only_in_sparse({"vehicle.battery_wh": 12})]
    for job in jobs:
        fly_paper_job(job, tmp_path)
    for job in jobs:
        assert load_run(folder_of(job, tmp_path)).scenario == job.scenario


def test_a_search_that_was_cut_is_no_fast_one(whole):
    summaries = [*MissionStore(Folder(whole[0])).summaries().values()]
    best = [s for s in summaries if (s["scenario"], s["n_c"]) == ("abundance", 1)]
    cut = [s if s not in best else {**s, "completed": False, "mission_time_s": 100.0} for s in summaries]
    assert any(d.scenario == "abundance" for d in paired_differences(summaries))
    assert not any(d.scenario == "abundance" for d in paired_differences(cut))
    row = next(r for r in compare_rows(cut) if (r.scenario, r.n_c) == ("abundance", 1))
    assert row.n_unfinished == len(best)
    assert f"{len(best)} ({len(best)} cut)" in markdown_tables(compare_rows(cut), cut)


def test_renamed_scenarios_are_refused():
    with pytest.raises(UserError, match=r"--set name: the tables tell their rows apart"):
        jobs_of(1, {"name": "mine"})


def _alive_after(processes, seconds):
    return psutil.wait_procs(processes, timeout=seconds)[1]
