"""Many jobs in local processes. The results do not depend on their number."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import islice
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")

_GARBAGE = 50_000  # new objects between two searches for cycles: missions make few, and this saves 3 % time
_BREATH_S = 0.5  # of one wait for a result: some libraries hold back Ctrl-C from a wait without an end
_WINDOW = 8  # jobs handed out per worker, so that none waits while a result is written


def run_jobs(
    work: Callable[[Job], Result], jobs: Iterable[Job], workers: int | None = None
) -> Iterator[tuple[Job, Result]]:
    """Yield (job, result) as they finish, from ``workers`` fresh processes (default: one a core).

    ``jobs`` may be endless: it is read as needed, a few at a time. Each process computes on one thread, so
    that processes do not compete for cores. An exception in ``work`` ends the run.
    """
    workers = workers or os.cpu_count() or 1
    context = multiprocessing.get_context("spawn")
    waiting = iter(jobs)
    running: dict[Future[Result], Job] = {}
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker) as pool:
        try:
            while True:
                for job in islice(waiting, workers * _WINDOW - len(running)):
                    running[pool.submit(work, job)] = job
                if not running:
                    return
                for future in wait(running, _BREATH_S, FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
        except BaseException:
            own = [*(pool._processes or {}).values()]  # its shutdown forgets them
            pool.shutdown(wait=False, cancel_futures=True)
            for process in own:
                process.terminate()
            raise


def _start_worker() -> None:
    """Leave Ctrl-C to the parent, and end with it even where it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    prepare_process()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def prepare_process() -> None:
    """Compute on one thread, as each core has its own process, and collect garbage less often."""
    os.environ.update(OMP_NUM_THREADS="1", LP_NUM_THREADS="1", NUMBA_NUM_THREADS="1")
    gc.set_threshold(_GARBAGE)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
