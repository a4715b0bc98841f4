"""A file of finished missions, a JSON line each, from which interrupted work goes on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from skysweep.experiments.workers import run_jobs
from skysweep.files.line_file import LineFile

Job = TypeVar("Job")

_REMEDY = "delete that line and give the command again: what it held is done anew"


def fly_missing(
    work: Callable[[Job], Any],
    jobs: Mapping[str, Job],
    ledger: Path,
    workers: int | None,
    on_done: Callable[[Job, Any], None],
) -> dict[str, Any]:
    """Do the jobs whose keys the ledger lacks; it grows by a line a job. All results by key.

    ``on_done`` hears of every job: first of those that the ledger holds, then of each that finishes.

    Raises UserError when another process works with the ledger, or a line in it is damaged.
    """
    with closing(LineFile(ledger, _REMEDY)) as file:
        known = {line["key"]: line["summary"] for line in file.records}
        results = {key: known[key] for key in jobs if key in known}
        for key, result in results.items():
            on_done(jobs[key], result)
        todo = [(key, job) for key, job in jobs.items() if key not in results]
        for (key, job), result in run_jobs(partial(_on_job, work), todo, workers) if todo else ():
            results[key] = result
            file.append({"key": key, "summary": result}, sync=False)
            on_done(job, result)
    return results


def _on_job(work: Callable[[Job], Any], keyed: tuple[str, Job]) -> Any:
    return work(keyed[1])
