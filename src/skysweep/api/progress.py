"""Progress: a bar in a notebook, a line in a terminal, nothing elsewhere."""

from __future__ import annotations

import html
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from skysweep.text import printable

_PERIOD_S = 0.2  # between two updates of the bar


class Show(Protocol):
    """Shows progress."""

    def __call__(self, share: float, words: str) -> None:
        """``share`` is done, 0..1; ``words`` describe it."""


@contextmanager
def progress(wanted: bool) -> Iterator[Show]:
    """A bar that disappears at the end of the block; nothing if it is unwanted or nobody sees it."""
    if wanted and _in_notebook():
        with _in_cell() as show:
            yield _seldom(show)
    elif wanted and sys.stderr is not None and sys.stderr.isatty():
        with _in_terminal() as show:
            yield _seldom(show)
    else:
        yield lambda share, words: None


def _in_notebook() -> bool:
    """Whether an IPython kernel runs this; IPython is not imported to find out."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and hasattr(shell, "kernel")


@contextmanager
def _in_cell() -> Iterator[Show]:
    from IPython.display import HTML, display

    handle: Any = display(HTML(""), display_id=True)

    def show(share: float, words: str) -> None:
        handle.update(HTML(f"<progress value='{share:.3f}' max='1'></progress> {html.escape(words)}"))

    try:
        yield show
    finally:
        handle.update(HTML(""))


@contextmanager
def _in_terminal() -> Iterator[Show]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = BarColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda share, words: bar.update(task, completed=share, description=printable(words))


def _seldom(show: Show) -> Show:
    """Calls ``show`` at most a few times a second."""
    shown_s = -_PERIOD_S

    def seldom(share: float, words: str) -> None:
        nonlocal shown_s
        now_s = time.monotonic()
        if now_s >= shown_s + _PERIOD_S:
            shown_s = now_s
            show(share, words)

    return seldom
