"""What the shell offers for names that it does not know.

Nothing of the package is imported here, so that the shell never waits. Where nothing is offered, it completes
file names by itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import wraps
from importlib.metadata import entry_points
from importlib.resources import files
from pathlib import Path

STRATEGIES = ("scan-check", "scan-only", "low-only", "belief")
_PLAIN = re.compile(r"[\w./@%+=:,-]+")
_JOURNAL = "journal.jsonl"
_RUNS = "runs"  # where missions are written by default
_SCENARIO_SUFFIXES = (".yaml", ".yml")


def _where_readable(offer: Callable[[str], list[str]]) -> Callable[[str], list[str]]:
    """Offers nothing where a folder cannot be read."""

    @wraps(offer)
    def offered(incomplete: str) -> list[str]:
        try:
            return offer(incomplete)
        except OSError:
            return []

    return offered


@_where_readable
def scenarios(incomplete: str) -> list[str]:
    """Shipped scenarios, and YAML files that are named like them."""
    beside_code = (Path(f.name) for f in files("skysweep.scenarios").joinpath("shipped").iterdir())
    shipped = (path.stem for path in beside_code if path.suffix in _SCENARIO_SUFFIXES)
    names = _begun(shipped, incomplete)
    if not names:
        return []
    beside = (p.name for p in Path().iterdir() if p.suffix in _SCENARIO_SUFFIXES and p.stem[0] != ".")
    return names + _begun(beside, incomplete)


def strategies(incomplete: str) -> list[str]:
    """Strategies that are built in or installed."""
    return _begun((*STRATEGIES, *(e.name for e in entry_points(group="skysweep.strategies"))), incomplete)


@_where_readable
def runs(incomplete: str) -> list[str]:
    """Run folders beside what is typed, and those in ``runs``."""
    typed = Path(incomplete)
    parent = typed if incomplete.endswith("/") else typed.parent
    parents = {parent, Path(_RUNS)} if _RUNS.startswith(incomplete) else {parent}
    folders = (folder for each in parents if each.is_dir() for folder in each.iterdir())
    return _begun((str(folder) for folder in folders if (folder / _JOURNAL).is_file()), incomplete)


def scenarios_and_runs(incomplete: str) -> list[str]:
    """Scenarios, and missions that may be continued."""
    return scenarios(incomplete) + runs(incomplete)


def _begun(names: Iterable[str], incomplete: str) -> list[str]:
    """Those that begin so, without names that a shell would read as more than a name."""
    return sorted(name for name in names if name.startswith(incomplete) and _PLAIN.fullmatch(name))
