"""Many jobs on few processes: all of them, once, whatever the number of workers."""

import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import time

import pytest

from skysweep.experiments.workers import run_jobs


def squared_by(job):
    return job * job, os.getpid()


def refuse_seven(job):
    if job == 7:
        raise ValueError("seven")
    return job


@pytest.mark.parametrize("workers", [1, 3])
def test_every_job_is_done_once_and_keeps_its_result(workers):
    done = list(run_jobs(squared_by, range(100), workers))
    assert sorted((job, result) for job, (result, _) in done) == [(k, k * k) for k in range(100)]
    assert len({pid for _, (_, pid) in done}) <= workers


SLOW = """\
import time
import polars  # holds back SIGINT from waits without an end
from skysweep.experiments.workers import run_jobs
if __name__ == "__main__":
    print("begun", flush=True)
    list(run_jobs(time.sleep, [60.0], 1))
"""


def test_ctrl_c_does_not_wait_for_a_result(tmp_path):
    (tmp_path / "slow.py").write_text(SLOW)
    with subprocess.Popen(
        [sys.executable, "slow.py"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as program:
        assert program.stdout.readline() == b"begun\n"
        time.sleep(2.0)
        started = time.monotonic()
        program.send_signal(signal.SIGINT)
        assert program.wait(30) != 0
    assert time.monotonic() - started < 20.0


def test_jobs_are_read_only_as_they_are_needed():
    given = itertools.count()
    results = run_jobs(abs, given, 1)
    assert len(list(itertools.islice(results, 30))) == 30
    results.close()
    assert next(given) < 60


def test_no_jobs_are_no_work():
    assert list(run_jobs(abs, [], 2)) == []


def test_what_goes_wrong_in_a_job_is_told():
    with pytest.raises(ValueError, match="seven"):
        list(run_jobs(refuse_seven, range(20), 2))


def test_what_goes_wrong_ends_no_process_of_the_caller():
    """Neither those from before, nor those that it starts meanwhile."""
    before, meanwhile = (
        multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60,)) for _ in range(2)
    )
    before.start()
    results = run_jobs(refuse_seven, range(20), 2)
    next(results)
    meanwhile.start()
    with pytest.raises(ValueError, match="seven"):
        list(results)
    before.join(1)
    assert before.is_alive()
    assert meanwhile.is_alive()
    before.kill()
    meanwhile.kill()
