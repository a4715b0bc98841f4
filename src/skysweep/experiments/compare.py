"""The paper's Tables 1-3: eight rows, many seeds, one set of parameters."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skysweep.experiments.single import fly_in_memory, fly_to_folder
from skysweep.experiments.workers import run_jobs
from skysweep.mission.journal import read_journal
from skysweep.results.tables import PAPER
from skysweep.scenarios.files import change_scenario, dump_scenario, load_scenario
from skysweep.scenarios.model import Scenario

MISSIONS_FILE = "missions.jsonl"
UNFINISHED = ".part"


@dataclass(frozen=True, slots=True)
class PaperJob:
    """One mission of the comparison. ``folder`` is None for a mission that leaves no files."""

    scenario: str
    n_c: float
    seed: int
    sensor: str
    folder: Path | None
    changes: tuple[tuple[str, Any], ...] = ()  # dotted field of the scenario, value

    @property
    def config(self) -> Scenario:
        """The scenario with the row's n_c; d_c is infinite in all rows of the paper."""
        row = {"search.strategy": "scan-check", "search.n_c": self.n_c, "search.d_c_m": math.inf}
        return change_scenario(load_scenario(self.scenario), dict(self.changes) | row)

    @property
    def key(self) -> str:
        """Tells apart missions that may end differently."""
        text = f"{dump_scenario(self.config)}|{self.seed}|{self.sensor}"
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def paper_jobs(
    seeds: int, sensor: str, out: Path, changes: Mapping[str, Any] | None = None
) -> list[PaperJob]:
    """Every row for every seed. With pictures each mission gets a folder; without, those of seed 0 do."""

    def folder(scenario: str, n_c: float, seed: int) -> Path | None:
        if sensor == "statistical" and seed > 0:
            return None
        return out / "runs" / f"{scenario}-nc{'inf' if math.isinf(n_c) else int(n_c)}-seed{seed}"

    return [
        PaperJob(
            row.scenario,
            row.n_c,
            seed,
            sensor,
            folder(row.scenario, row.n_c, seed),
            tuple((changes or {}).items()),
        )
        for seed in range(seeds)
        for row in PAPER
    ]


def fly_paper_job(job: PaperJob) -> dict[str, Any]:
    """Fly one mission of the comparison; its folder appears when it is complete."""
    if job.folder is None:
        return fly_in_memory(job.config, job.seed, job.sensor)
    job.folder.parent.mkdir(parents=True, exist_ok=True)
    unfinished = Path(
        tempfile.mkdtemp(prefix=f"{job.folder.name}-", suffix=UNFINISHED, dir=job.folder.parent)
    )
    summary = fly_to_folder(job.config, job.seed, unfinished, job.sensor, threads=1)
    shutil.rmtree(job.folder, ignore_errors=True)
    unfinished.chmod(0o755)
    unfinished.rename(job.folder)
    return summary


def compare_paper(
    seeds: int,
    sensor: str,
    out: Path,
    workers: int | None = None,
    changes: Mapping[str, Any] | None = None,
    on_done: Callable[[PaperJob, dict[str, Any]], None] = lambda _job, _summary: None,
) -> list[dict[str, Any]]:
    """Fly everything that ``out`` does not hold yet; return the summaries in the order of the jobs.

    ``changes`` (dotted field -> value) apply to all eight rows alike.

    Finished missions are kept in ``missions.jsonl``, so that an interrupted comparison goes on. Missions
    flown with other parameters are flown again.
    """
    jobs = paper_jobs(seeds, sensor, out, changes)
    out.mkdir(parents=True, exist_ok=True)
    for stale in (out / "runs").glob(f"*{UNFINISHED}"):
        shutil.rmtree(stale, ignore_errors=True)
    return fly_missing(jobs, [job.key for job in jobs], out / MISSIONS_FILE, workers, on_done)


def fly_missing(
    jobs: Sequence[PaperJob],
    keys: Sequence[str],
    ledger: Path,
    workers: int | None,
    on_done: Callable[[PaperJob, dict[str, Any]], None],
) -> list[dict[str, Any]]:
    """Fly the jobs whose keys the ledger lacks; it grows by a line a mission. All summaries in order."""
    known, key_of = _read_ledger(ledger), dict(zip(jobs, keys, strict=True))
    summaries = {job: known[key] for job, key in key_of.items() if key in known}
    for job, summary in summaries.items():
        on_done(job, summary)
    todo = [job for job in jobs if job not in summaries]
    if todo:
        with ledger.open("a", encoding="utf-8") as file:
            for job, summary in run_jobs(fly_paper_job, todo, workers):
                summaries[job] = summary
                file.write(json.dumps({"key": key_of[job], "summary": summary}) + "\n")
                file.flush()
                on_done(job, summary)
    return [summaries[job] for job in jobs]


def _read_ledger(path: Path) -> dict[str, dict[str, Any]]:
    """Summaries by key. A line that a kill tore is cut off, so that the next one starts on its own."""
    if not path.exists():
        return {}
    lines = list(read_journal(path))
    whole = path.with_suffix(".tmp")
    whole.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    whole.replace(path)
    return {line["key"]: line["summary"] for line in lines}
