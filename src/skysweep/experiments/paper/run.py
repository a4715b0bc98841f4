"""The paper's Tables 1-3 and scan-only beside them: many seeds, one set of parameters."""

from __future__ import annotations

import hashlib
import math
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skysweep.detection.model_files import fingerprint
from skysweep.errors import UserError
from skysweep.experiments.ledger import fly_missing
from skysweep.experiments.paper.tables import BASELINE, CAPTIONS, PAPER
from skysweep.files.writing import make_folder
from skysweep.flights.fly import fly_in_memory, fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.results.metrics import finite_or_inf
from skysweep.results.run_folder import UNFINISHED, digest_of_plan
from skysweep.scenarios.files import change_scenario, dump_scenario, load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.statistical.model import model_for

MISSIONS_FILE = "missions.jsonl"
ROWS: tuple[tuple[str, float | None], ...] = (
    *((row.scenario, row.n_c) for row in PAPER),
    *((scenario, None) for scenario in CAPTIONS),
)  # scenario and n_c, None: scan-only


@dataclass(frozen=True, slots=True)
class PaperJob:
    """One mission of the comparison. ``folder`` is None for a mission that leaves no files."""

    scenario: str
    n_c: float | None  # None: scan-only
    seed: int
    sensor: str
    folder: Path | None
    changes: tuple[tuple[str, Any], ...] = ()  # dotted field of the scenario, value

    @property
    def config(self) -> Scenario:
        """The scenario with the row's n_c; d_c is infinite in all rows of the paper."""
        row: dict[str, Any] = {"search.strategy": BASELINE}
        if self.n_c is not None:
            row = {"search.strategy": "scan-check", "search.n_c": self.n_c, "search.d_c_m": math.inf}
        return change_scenario(load_scenario(self.scenario), dict(self.changes) | row)

    @property
    def key(self) -> str:
        """Tells apart missions that may end differently, by the files too that decide how they see."""
        config = self.config
        text = f"{dump_scenario(config)}|{self.seed}|{self.sensor}|{fingerprint(config.detector.model)}"
        if self.sensor == "statistical":
            text += model_for(config).model_dump_json()
        text += digest_of_plan(config) or ""
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def paper_jobs(
    seeds: int, sensor: str, out: Path, changes: Mapping[str, Any] | None = None
) -> list[PaperJob]:
    """Every row for every seed. With pictures each mission gets a folder; without, those of seed 0 do."""

    def folder(scenario: str, n_c: float | None, seed: int) -> Path | None:
        if sensor == "statistical" and seed > 0:
            return None
        how = BASELINE if n_c is None else f"nc{finite_or_inf(n_c)}"
        return out / "runs" / f"{scenario}-{how}-seed{seed}"

    return [
        PaperJob(scenario, n_c, seed, sensor, folder(scenario, n_c, seed), tuple((changes or {}).items()))
        for seed in range(seeds)
        for scenario, n_c in ROWS
    ]


def fly_paper_job(job: PaperJob) -> dict[str, Any]:
    """Fly one mission of the comparison; its folder appears when it is complete.

    Raises UserError, with nothing left behind, where the disk is full.
    """
    if job.folder is None:
        return fly_in_memory(job.config, job.seed, job.sensor)
    job.folder.parent.mkdir(parents=True, exist_ok=True)
    for stale in job.folder.parent.glob(f"{job.folder.name}-*{UNFINISHED}"):
        shutil.rmtree(stale, ignore_errors=True)
    unfinished = Path(
        tempfile.mkdtemp(prefix=f"{job.folder.name}-", suffix=UNFINISHED, dir=job.folder.parent)
    )
    try:
        summary = fly_to_folder(job.config, job.seed, unfinished, Rig(job.sensor, threads=1))
    except BaseException as error:
        shutil.rmtree(unfinished, ignore_errors=True)
        if str(unfinished) in str(error):  # told how to go on with what is removed
            raise UserError(
                f"{job.folder}: cannot be written whole; make room, then give the same command again"
            ) from None
        raise
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

    ``changes`` (dotted field -> value) apply to all rows alike.

    Finished missions are kept in ``missions.jsonl``, so that an interrupted comparison goes on. Missions
    flown with other parameters are flown again.
    """
    jobs = paper_jobs(seeds, sensor, out, changes)
    make_folder(out)
    summaries = fly_missing(
        fly_paper_job, {job.key: job for job in jobs}, out / MISSIONS_FILE, workers, on_done
    )
    return [summaries[job.key] for job in jobs]
