"""Measure this machine."""

from __future__ import annotations

import json
import sys

from skysweep.cli.common import bar, friendly


@friendly
def bench() -> None:
    """Measure this machine and print one JSON object: real-time factors, frames a second, milliseconds.

    Example:

        skysweep bench > this-machine.json
    """
    from skysweep.experiments.bench import MEASUREMENTS
    from skysweep.experiments.bench import bench as measure

    with bar() as progress:
        task = progress.add_task("measurements", total=MEASUREMENTS)
        done = iter(range(MEASUREMENTS))
        measured = measure(
            lambda doing: progress.update(task, completed=next(done, MEASUREMENTS), description=doing)
        )
        progress.update(task, completed=MEASUREMENTS)
    sys.stdout.write(json.dumps(measured, indent=1) + "\n")
