"""Flies the missions of a comparison that its store lacks, in local processes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import polars as pl

from skysweep.errors import UserError
from skysweep.experiments.engines import LocalEngine
from skysweep.experiments.matrix import Matrix, MissionJob
from skysweep.experiments.store import OLDER_FILE, MissionStore, row_of
from skysweep.files.folder import Folder
from skysweep.files.locking import locked
from skysweep.files.writing import make_folder
from skysweep.flights.fly import fly_in_memory
from skysweep.results.summary import Summary

OnDone = Callable[[MissionJob, Summary], None]


def fly_job(job: MissionJob) -> Summary:
    """Fly one mission and leave no files."""
    return fly_in_memory(job.scenario, job.seed, job.sensor)


def fly_missing(
    matrices: Sequence[Matrix],
    fly: Callable[[MissionJob], Summary],
    out: Path,
    workers: int | None = None,
    on_done: OnDone = lambda _job, _summary: None,
) -> dict[str, Summary]:
    """Fly what ``out`` lacks of the matrices and return all summaries in it by ``config_hash``.

    ``on_done`` is called with each mission of the matrices: first those that ``out`` holds, then each as it
    finishes. An exception in ``fly`` ends the run; finished missions are kept. Raises UserError when ``out``
    is damaged, belongs to a sweep or an older skysweep, or another process flies into it.
    """
    make_folder(out)
    if (out / OLDER_FILE).exists():
        raise UserError(
            f"{out}: holds the missions of an older skysweep ({OLDER_FILE}), which this one does not read; "
            "write another --out"
        )
    store = MissionStore(Folder(out))
    store.refuse_run()
    with locked(out):
        summaries = store.summaries()
        jobs = {job.config_hash: job for matrix in matrices for job in matrix.jobs()}
        todo = sorted((job for key, job in jobs.items() if key not in summaries), key=lambda job: job.seed)
        for key, job in jobs.items():
            if key in summaries:
                on_done(job, summaries[key])
        if todo:
            asked = pl.concat([matrix.table() for matrix in matrices], how="diagonal")
            with (
                closing(LocalEngine(workers).run(fly, todo)) as results,
                store.parts(time.monotonic(), matrix=asked) as take,
            ):
                for job, summary in results:
                    take(row_of(job.label, job.config_hash, summary))
                    summaries[job.config_hash] = summary
                    on_done(job, summary)
        if not store.is_complete():
            store.finish_all()
    return summaries
