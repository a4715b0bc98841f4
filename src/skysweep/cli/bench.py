"""Measure this machine."""

from __future__ import annotations

import json
import sys

from skysweep.cli.common import bar, friendly
from skysweep.errors import MissingExtraError


@friendly
def bench() -> None:
    """Measure this machine and print one JSON object: real-time factors, frames a second, milliseconds.

    Example:

        skysweep bench > this-machine.json
    """
    from skysweep.experiments.bench import MEASUREMENTS
    from skysweep.experiments.bench import bench as measure

    with bar() as progress:
        task = progress.add_task("measurements", total=MEASUREMENTS + 1)
        done = iter(range(MEASUREMENTS + 1))

        def doing(what: str) -> None:
            progress.update(task, completed=next(done, MEASUREMENTS), description=what)

        measured = measure(doing)
        doing("the live page")
        measured |= {"live_view_cost": _live_view_cost()}
        progress.update(task, completed=MEASUREMENTS + 1)
    sys.stdout.write(json.dumps(measured, indent=1) + "\n")


def _live_view_cost() -> float | None:
    """None without the extra."""
    try:
        from skysweep.web.cost import live_view_cost
    except MissingExtraError:
        return None
    return float(f"{live_view_cost():.3g}")
