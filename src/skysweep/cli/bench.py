"""Measure this machine."""

from __future__ import annotations

import json
import sys

from skysweep.cli.common import friendly


@friendly
def bench() -> None:
    """Measure this machine and print one JSON object: real-time factors, frames a second, milliseconds."""
    from skysweep.experiments.bench import bench as measure

    sys.stdout.write(json.dumps(measure(), indent=1) + "\n")
