"""Measure this machine."""

from __future__ import annotations

import json
import sys

from skysweep.cli.common import friendly
from skysweep.errors import MissingExtraError


@friendly
def bench() -> None:
    """Measure this machine and print one JSON object: real-time factors, frames a second, milliseconds."""
    from skysweep.experiments.bench import bench as measure

    figures = measure() | {"live_view_cost": _live_view_cost()}
    sys.stdout.write(json.dumps(figures, indent=1) + "\n")


def _live_view_cost() -> float | None:
    """None without the extra."""
    try:
        from skysweep.web.cost import live_view_cost
    except MissingExtraError:
        return None
    return float(f"{live_view_cost():.3g}")
