"""Flies the missions of the suite that a folder lacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from skysweep.errors import UserError
from skysweep.experiments.benchmark.oracle import oracle_spec
from skysweep.experiments.benchmark.suite import ORACLE, Contender, Suite, close_look_m, matrix_of
from skysweep.experiments.flying import fly_missing
from skysweep.experiments.matrix import Matrix, MissionJob
from skysweep.flights.fly import fly_in_memory
from skysweep.results.summary import Summary

Flown = dict[str, dict[str, list[Summary]]]  # family -> contender -> missions by seed


def fly_suite(
    suite: Suite,
    chosen: Sequence[Contender],
    seeds: Sequence[int],
    out: Path,
    workers: int | None = None,
    on_done: Callable[[], None] = lambda: None,
) -> Flown:
    """The missions of all families; those that ``out`` holds are not flown again.

    ``on_done`` is called for each mission. Raises UserError where a strategy fails, and as ``fly_missing``.
    """
    matrices = {c.name: matrix_of(suite, c, seeds) for c in chosen}
    return fly_matrices(matrices, suite.target_px, out, workers, on_done)


def fly_matrices(
    matrices: Mapping[str, Matrix],
    target_px: float,
    out: Path,
    workers: int | None = None,
    on_done: Callable[[], None] = lambda: None,
) -> Flown:
    """The missions of matrices by label and by the matrix's name, each in the order of the seeds."""
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
        reason = " ".join(str(error).split())
        kind = "" if isinstance(error, UserError) else f"{type(error).__name__}: "
        raise UserError(
            f"{strategy}: fails in {job.label} with seed {job.seed} ({kind}{reason}); mend it, then give the same "
            "command again"
        ) from error
