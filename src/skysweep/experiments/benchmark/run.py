"""Flies the missions of the suite that a folder lacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from skysweep.errors import UserError
from skysweep.experiments.benchmark.oracle import oracle_spec
from skysweep.experiments.benchmark.suite import ORACLE, close_look_m
from skysweep.experiments.flying import fly_missing
from skysweep.experiments.matrix import Matrix, MissionJob
from skysweep.flights.fly import fly_in_memory
from skysweep.results.summary import Summary

Flown = dict[str, dict[str, list[Summary]]]  # family -> contender -> missions by seed


def fly_matrices(
    matrices: Mapping[str, Matrix],
    target_px: float,
    out: Path,
    workers: int | None = None,
    on_done: Callable[[], None] = lambda: None,
) -> Flown:
    """The missions of matrices by label and by the matrix's name, each in the order of the seeds.

    Missions that ``out`` holds are not flown again; ``on_done`` is called for each. Raises UserError where a
    strategy fails, and as ``fly_missing``.
    """
    fly = partial(fly_benchmark_job, target_px=target_px)
    summaries = fly_missing(list(matrices.values()), fly, out, workers, lambda _job, _summary: on_done())
    flown: Flown = {}
    for name, matrix in matrices.items():
        for job in matrix.jobs():
            flown.setdefault(job.label, {}).setdefault(name, []).append(summaries[job.config_hash])
    return flown


def fly_benchmark_job(job: MissionJob, target_px: float) -> Summary:
    """Fly one mission and leave no files. Raises UserError, naming the mission, where the strategy fails."""
    strategy = job.scenario.search.strategy
    try:
        spec = None
        if strategy == ORACLE:
            spec = oracle_spec(job.scenario, job.seed, close_look_m(job.scenario, target_px))
        return fly_in_memory(job.scenario, job.seed, job.sensor, spec)
    except Exception as error:
        reason = " ".join(str(error).split()).removeprefix(f"search.strategy: {strategy}: ")
        reason = reason.removesuffix("; mend it")
        kind = "" if isinstance(error, UserError) else f"{type(error).__name__}: "
        raise UserError(
            f"{strategy}: fails in {job.label} with seed {job.seed} ({kind}{reason}); mend it, then give the "
            "same command again"
        ) from error
