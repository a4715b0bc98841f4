"""Engines that fly many missions: local processes, or a Ray cluster. The results do not depend on them."""

from __future__ import annotations

import logging
import os
import re
import socket
import time
from collections.abc import Callable, Generator, Iterable
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from typing import Any, Protocol, TypeVar

from skysweep.errors import MissingExtraError, UserError
from skysweep.experiments.workers import prepare_process, run_jobs

Job = TypeVar("Job")
Result = TypeVar("Result")

ENGINES = ("local", "ray")

_BATCH_S = 1.0  # of work in one Ray task, against which the cost of a task is negligible
_MAX_BATCH = 64
_TASKS_PER_CPU = 2  # one runs while the other waits
_MAX_RETRIES = 10  # of a task whose node or worker was lost
_CONNECT_S = 5.0


class Engine(Protocol):
    """Runs jobs. As a context manager it frees its resources at the end."""

    def __enter__(self) -> Engine: ...

    def __exit__(self, *error: object) -> None: ...

    @property
    def workers(self) -> int: ...

    def run(
        self, work: Callable[[Job], Result], jobs: Iterable[Job]
    ) -> Generator[tuple[Job, Result], None, None]:
        """Yield (job, work(job)) as they finish, in any order. ``jobs`` is read as needed.

        ``work`` and jobs are pickled. An exception in ``work`` ends the run.
        """
        ...


def make_engine(name: str, address: str | None = None, workers: int | None = None) -> Engine:
    """The engine ``local`` or ``ray``.

    ``address`` is Ray's: ``auto``, ``host:port`` or ``ray://host:port``; None starts a Ray on this machine.
    ``workers`` limits a local engine, or the Ray that is started here. The default is one per core. Raises
    UserError for an unknown engine or options of the other one, MissingExtraError without Ray.
    """
    if name not in ENGINES:
        raise UserError(f"--engine {name}: there is no such engine; write one of {', '.join(ENGINES)}")
    if name == "local":
        if address is not None:
            raise UserError(f"--address {address}: belongs to Ray; add --engine ray")
        return LocalEngine(workers)
    if address is not None and workers is not None:
        raise UserError("--workers: the cluster at --address sets the number; leave one of the two out")
    return RayEngine(address, workers)


class LocalEngine:
    """Processes on this machine. Implements ``Engine``."""

    def __init__(self, workers: int | None = None) -> None:
        self.workers = workers or os.cpu_count() or 1

    def __enter__(self) -> LocalEngine:
        return self

    def __exit__(self, *error: object) -> None: ...

    def run(
        self, work: Callable[[Job], Result], jobs: Iterable[Job]
    ) -> Generator[tuple[Job, Result], None, None]:
        """See ``Engine.run``. Raises UserError where a process dies, for example out of memory."""
        try:
            yield from run_jobs(work, jobs, self.workers)
        except BrokenProcessPool:
            raise UserError(
                "a worker process was killed (out of memory?); give the same command again to go on, "
                "with fewer --workers where memory is short"
            ) from None


class RayEngine:
    """A Ray cluster, or a Ray started on this machine. Implements ``Engine``.

    Jobs travel in batches of about a second, twice as many as there are CPUs, so that the driver's memory
    does not grow with the number of jobs. Batches of a lost node run again elsewhere.
    """

    def __init__(self, address: str | None = None, workers: int | None = None) -> None:
        self._ray = _import_ray()
        self._address, self._workers = address, workers

    def __enter__(self) -> RayEngine:
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
        if self._address is None:
            options |= {"num_cpus": self._workers, "include_dashboard": False}
        else:
            _check_reachable(self._address)
        try:
            self._ray.init(address=self._address or "local", **options)
        except Exception as error:
            reason = _first_line(error)
            if self._address is None:
                raise UserError(f"Ray cannot be started here ({reason}); try --engine local") from None
            raise UserError(
                f"--address {self._address}: Ray cannot be reached there ({reason}); start one with "
                "'ray start --head', or leave --address out"
            ) from None
        return self

    def __exit__(self, *error: object) -> None:
        self._ray.shutdown()

    @property
    def workers(self) -> int:
        return max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def run(
        self, work: Callable[[Job], Result], jobs: Iterable[Job]
    ) -> Generator[tuple[Job, Result], None, None]:
        """See ``Engine.run``. Raises UserError where the cluster is lost."""
        ray = self._ray
        remote = ray.remote(num_cpus=1, max_retries=_MAX_RETRIES)(_run_batch)
        todo = iter(jobs)
        size = 1
        running: dict[Any, list[Job]] = {}
        try:
            while True:
                while len(running) < _TASKS_PER_CPU * self.workers and (batch := list(islice(todo, size))):
                    running[remote.remote(work, batch)] = batch
                if not running:
                    return
                for done in ray.wait(list(running), fetch_local=True)[0]:
                    results, seconds = ray.get(done)
                    batch = running.pop(done)
                    size = max(1, min(_MAX_BATCH, round(_BATCH_S * len(batch) / max(seconds, 1e-6))))
                    yield from zip(batch, results, strict=True)
        except (ray.exceptions.RaySystemError, ray.exceptions.WorkerCrashedError, ConnectionError) as error:
            reason = f"the connection to Ray was lost ({_first_line(error)})"
            raise UserError(f"{reason}; give the same command again to go on") from None
        finally:
            for task in running:
                ray.cancel(task, force=True)


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n")[0].rstrip(".")


def _run_batch(work: Callable[[Job], Result], batch: list[Job]) -> tuple[list[Result], float]:
    """The results of a batch and its seconds. It computes on one thread, as each CPU has its own task."""
    prepare_process()
    started = time.perf_counter()
    return [work(job) for job in batch], time.perf_counter() - started


def _import_ray() -> Any:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # silences a warning
    try:
        import ray
    except ImportError:
        raise MissingExtraError("--engine ray", "ray") from None
    return ray


def _check_reachable(address: str) -> None:
    """Raises UserError where nothing answers. Ray would try for minutes, then end the process."""
    if address == "auto":
        return
    match = re.fullmatch(r"(?:ray://)?\[?([^/\]]+?)\]?:(\d{1,5})", address)
    if match is None:
        raise UserError(f"--address {address}: write auto, host:port or ray://host:port")
    try:
        socket.create_connection((match[1], int(match[2])), timeout=_CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise UserError(
            f"--address {address}: no Ray answers there ({error}); start one with 'ray start --head', "
            "or leave --address out"
        ) from None
