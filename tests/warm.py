"""The command line in a process of its own that starts at once: a fork of one that has imported everything.

A fresh process imports for four seconds what a command needs; some hundred tests run one.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any, NamedTuple

from skysweep.experiments.workers import _start_worker

FAILED = 70  # exit code after an exception
_PR_SET_PDEATHSIG = 1  # of prctl, linux/prctl.h


class Ended(NamedTuple):
    """How a fork ended; a negative ``code`` is a signal's number."""

    code: int
    output: str
    errors: str
    cpu_s: float
    peak_bytes: int  # of memory


def run_skysweep(*words: Any, cwd: Path | str = ".", timeout_s: int = 300) -> CompletedProcess[str]:
    """Run a command as a shell would: its exit code and what it wrote."""
    arguments = [str(word) for word in words]
    call = forked, arguments, os.path.abspath(cwd), dict(os.environ), timeout_s
    parent = _parent()
    try:
        ended = parent.submit(*call).result()
    except BaseException:  # Ctrl-C, or it was killed: the next command gets another
        for process in [*(parent._processes or {}).values()]:
            process.kill()
        _parent.cache_clear()
        raise
    return CompletedProcess(["skysweep", *arguments], ended.code, ended.output, ended.errors)


@cache
def _parent() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, get_context("spawn"), _start)


def _start() -> None:
    _start_worker()
    import_all()


def import_all() -> None:
    """What commands import, once for all forks."""
    import skysweep.cli
    import skysweep.detection.training.evaluate
    import skysweep.detection.yolo
    import skysweep.experiments.paper.report
    import skysweep.experiments.paper.run
    import skysweep.experiments.sweep.report
    import skysweep.experiments.sweep.run
    import skysweep.experiments.tune.report
    import skysweep.experiments.tune.run
    import skysweep.flights.resume
    import skysweep.planning.picture
    import skysweep.results.writing  # noqa: F401


def forked(
    words: Sequence[str],
    folder: Path | str,
    environment: Mapping[str, str],
    timeout_s: int,
    limit: Callable[[], None] = lambda: None,
) -> Ended:
    """Run a command in a fork of this process, after it has limited itself; it ends with this process.

    Whatever threads this process has sleep: none holds a lock that the fork may need.
    """
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        child = os.fork()
        if child == 0:
            with contextlib.suppress(BaseException):
                ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
                signal.signal(signal.SIGINT, signal.default_int_handler)
                os.setsid()
                os.chdir(folder)
                os.environ.clear()
                os.environ.update(environment)
                _redirect(output.fileno(), errors.fileno())
                limit()
                signal.signal(signal.SIGALRM, signal.SIG_DFL)
                signal.alarm(timeout_s)
                os._exit(_run(words))
            os._exit(FAILED)
        _, status, used = os.wait4(child, 0)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        texts = []
        for file in (output, errors):
            file.seek(0)
            texts.append(file.read().decode(errors="replace"))
    code = os.waitstatus_to_exitcode(status)
    return Ended(code, *texts, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024)


def _redirect(output: int, errors: int) -> None:
    for source, target in ((os.open(os.devnull, os.O_RDONLY), 0), (output, 1), (errors, 2)):
        os.dup2(source, target)
    sys.stdin = os.fdopen(0, closefd=False)
    sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
    sys.stderr = os.fdopen(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)


def _run(words: Sequence[str]) -> int:
    from skysweep.cli import app

    code: Any = 0
    try:
        app(args=list(words), prog_name="skysweep")
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
        code = FAILED
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()
    return code or 0
