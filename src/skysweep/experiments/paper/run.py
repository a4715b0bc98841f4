"""Flies the paper's Tables 1-3, and scan-only and belief beside them: many seeds, one set of parameters."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from skysweep.errors import UserError
from skysweep.experiments.flying import OnDone, fly_job, fly_missing
from skysweep.experiments.matrix import Matrix, MissionJob
from skysweep.experiments.paper.tables import CAPTIONS, OTHERS, PAPER, Choice
from skysweep.flights.build import refuse_unseeable
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.results.run_folder import UNFINISHED
from skysweep.results.summary import Summary, finite_or_inf
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.statistical.model import model_for
from skysweep.strategies import strategy_spec

SWEPT = "search.n_c"


def row_scenario(name: str, n_c: Choice, changes: Mapping[str, Any]) -> tuple[str, Scenario]:
    """A row's label and scenario. d_c is infinite in all rows of the paper."""
    row: dict[str, Any] = {"search.strategy": n_c}
    if n_c not in OTHERS:
        row = {"search.strategy": "scan-check", SWEPT: n_c, "search.d_c_m": math.inf}
    scenario = change_scenario(load_scenario(name), {**changes, **row})
    return scenario.name, scenario


def paper_matrices(seeds: int, sensor: str, changes: Mapping[str, Any] | None = None) -> list[Matrix]:
    """The paper's rows and those of the other strategies, which have no n_c, with each seed.

    belief is left out where the detector has no sensor model. Raises UserError where the changes rename the
    scenarios, which tell the rows apart.
    """
    if "name" in (changes or {}):
        raise UserError("--set name: the tables tell their rows apart by it; leave it out")
    papers = [row_scenario(row.scenario, row.n_c, changes or {}) for row in PAPER]
    matrices = [Matrix.of(papers, range(seeds), sensor, [SWEPT])]
    for strategy in OTHERS:
        rows = [row_scenario(name, strategy, changes or {}) for name in CAPTIONS]
        if all(_can_fly(scenario) for _, scenario in rows):
            matrices.append(Matrix.of(rows, range(seeds), sensor, []))
    return matrices


def _can_fly(scenario: Scenario) -> bool:
    if not strategy_spec(scenario.search.strategy).needs_sensor_model:
        return True
    try:
        model_for(scenario)
    except UserError:
        return False
    return True


def folder_of(job: MissionJob, out: Path) -> Path | None:
    """The folder of a mission's files: missions with pictures have one, and all missions of seed 0."""
    if job.sensor == "statistical" and job.seed > 0:
        return None
    search = job.scenario.search
    how = search.strategy if search.strategy in OTHERS else f"nc{finite_or_inf(search.n_c)}"
    return out / "runs" / f"{job.label}-{how}-seed{job.seed}-{job.config_hash[:8]}"


def fly_paper_job(job: MissionJob, out: Path) -> Summary:
    """Fly one mission of the comparison. Its folder appears when it is complete.

    Raises UserError, and leaves nothing behind, where the disk is full.
    """
    folder = folder_of(job, out)
    if folder is None:
        return fly_job(job)
    folder.parent.mkdir(parents=True, exist_ok=True)
    for stale in folder.parent.glob(f"{folder.name}-*{UNFINISHED}"):
        shutil.rmtree(stale, ignore_errors=True)
    unfinished = Path(tempfile.mkdtemp(prefix=f"{folder.name}-", suffix=UNFINISHED, dir=folder.parent))
    try:
        summary = fly_to_folder(job.scenario, job.seed, unfinished, Rig(job.sensor, threads=1))
    except BaseException as error:
        shutil.rmtree(unfinished, ignore_errors=True)
        if str(unfinished) in str(error):  # the message says how to resume in a folder that is gone now
            raise UserError(
                f"{folder}: cannot be written whole; make room, then give the same command again"
            ) from None
        raise
    shutil.rmtree(folder, ignore_errors=True)
    unfinished.chmod(0o755)
    unfinished.rename(folder)
    return summary


def compare_paper(
    seeds: int,
    sensor: str,
    out: Path,
    workers: int | None = None,
    changes: Mapping[str, Any] | None = None,
    on_done: OnDone = lambda _job, _summary: None,
) -> list[Summary]:
    """Fly what ``out`` lacks, so that an interrupted comparison continues, and return all summaries.

    ``changes`` (dotted field -> value) apply to all rows. Raises UserError as ``refuse_unseeable``.
    """
    matrices = paper_matrices(seeds, sensor, changes)
    for matrix in matrices:
        for configuration in matrix.configurations:
            refuse_unseeable(configuration.scenario, sensor)
    summaries = fly_missing(matrices, partial(fly_paper_job, out=out), out, workers, on_done)
    return [summaries[job.config_hash] for matrix in matrices for job in matrix.jobs()]
