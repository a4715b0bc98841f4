"""Many jobs on few processes: all of them, once, whatever the number of workers."""

import itertools
import os

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
