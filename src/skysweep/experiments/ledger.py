"""A file of finished missions, a JSON line each, from which interrupted work goes on."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from skysweep.experiments.workers import run_jobs
from skysweep.mission.journal import read_journal

Job = TypeVar("Job")


def fly_missing(
    work: Callable[[Job], Any],
    jobs: Mapping[str, Job],
    ledger: Path,
    workers: int | None,
    on_done: Callable[[Job, Any], None],
) -> dict[str, Any]:
    """Do the jobs whose keys the ledger lacks; it grows by a line a job. All results by key.

    ``on_done`` hears of every job: first of those that the ledger holds, then of each that finishes.
    """
    known = _read(ledger)
    results = {key: known[key] for key in jobs if key in known}
    for key, result in results.items():
        on_done(jobs[key], result)
    todo = [(key, job) for key, job in jobs.items() if key not in results]
    if todo:
        with ledger.open("a", encoding="utf-8") as file:
            for (key, job), result in run_jobs(partial(_on_job, work), todo, workers):
                results[key] = result
                file.write(json.dumps({"key": key, "summary": result}) + "\n")
                file.flush()
                on_done(job, result)
    return results


def _on_job(work: Callable[[Job], Any], keyed: tuple[str, Job]) -> Any:
    return work(keyed[1])


def _read(path: Path) -> dict[str, Any]:
    """Results by key. A line that a kill tore is cut off, so that the next one starts on its own."""
    if not path.exists():
        return {}
    lines = list(read_journal(path))
    whole = path.with_suffix(".tmp")
    whole.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    whole.replace(path)
    return {line["key"]: line["summary"] for line in lines}
