"""The comparison with the paper: complete, resumable, the same for any number of workers."""

import json
import signal
import subprocess
import sys
import time

import psutil
import pytest

COMMAND = [
    sys.executable,
    "-m",
    "skysweep.cli",
    "compare",
    "paper",
    "--sensor",
    "statistical",
    "--seeds",
    "1",
]


def rows(folder):
    return json.loads((folder / "compare.json").read_text())


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "out"
    result = subprocess.run([*COMMAND, "--workers", "2", "--out", str(out)], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return out, result.stdout


@pytest.mark.slow
def test_eight_rows_three_tables_and_a_report(whole):
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
    assert (out / "report.html").stat().st_size > 10_000
    assert (out / "trajectories.png").exists()


@pytest.mark.slow
def test_killed_and_continued_it_ends_with_the_same_rows(whole, tmp_path):
    out = tmp_path / "out"
    process = subprocess.Popen([*COMMAND, "--workers", "1", "--out", str(out)], stderr=subprocess.DEVNULL)
    ledger = out / "missions.jsonl"
    deadline = time.monotonic() + 120
    while not (ledger.exists() and ledger.read_text().count("\n") >= 2):
        assert process.poll() is None, "it ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.05)
    children = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not _alive_after(children, 20.0), "workers end with the command that was killed"
    before = ledger.read_text().splitlines()[:2]
    subprocess.run([*COMMAND, "--workers", "1", "--out", str(out)], check=True, capture_output=True)
    assert ledger.read_text().splitlines()[:2] == before, "finished missions are not flown again"
    assert rows(out) == rows(whole[0])


def _alive_after(processes, seconds):
    return psutil.wait_procs(processes, timeout=seconds)[1]
