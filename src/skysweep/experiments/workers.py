"""Many missions in local processes. The result does not depend on how many."""

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

_GARBAGE = 50_000  # new objects between two searches for cycles, of which missions make few: 3 % of the time
_WINDOW = 8  # jobs handed out for each worker: enough that none waits while a result is written down


def run_jobs(
    work: Callable[[Job], Result], jobs: Iterable[Job], workers: int | None = None
) -> Iterator[tuple[Job, Result]]:
    """Yield (job, result) as they finish, from ``workers`` fresh processes (default: one a core).

    ``jobs`` is read as they are needed and only a few are held at a time, so it may be endless. Every process
    computes on one thread, so that processes do not fight over cores. An exception in ``work`` ends it all.
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
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise


def _start_worker() -> None:
    """Ctrl-C is the parent's business; an end with it, even where it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    prepare_process()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def prepare_process() -> None:
    """One thread for everything, as each core has its own process; and garbage is looked for less often."""
    os.environ.update(OMP_NUM_THREADS="1", LP_NUM_THREADS="1", NUMBA_NUM_THREADS="1")
    gc.set_threshold(_GARBAGE)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
