"""Measure this machine."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from skysweep.cli.answers import JsonOption, answer
from skysweep.cli.common import bar, friendly
from skysweep.errors import MissingExtraError, UserError

_COLUMNS = {
    "hectares": "ha",
    "planned_km": "planned [km]",
    "plan_s": "plan [s]",
    "plan_mb": "[MB]",
    "flown_km": "flown [km]",
    "statistical_s": "statistical [s]",
    "statistical_mb": "[MB]",
    "rendered_ready_s": "ready for pictures [s]",
    "rendered_look_s": "look [s]",
    "rendered_s": "whole scan [s]",
    "rendered_mb": "[MB]",
}


@friendly
def bench(
    scale: Annotated[
        bool, typer.Option("--scale", help="Measure how plans and missions grow from 2 to 2000 hectares.")
    ] = False,
    yolox_nano: Annotated[
        Path | None,
        typer.Option(help="Public yolox_nano.onnx that you have: compare the detector's time with its."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Measure this machine and print one JSON object: real-time factors, frames a second, milliseconds.

    That takes about six minutes on two cores. Other work at the same time spoils it.

    Examples:

        skysweep bench > this-machine.json

        skysweep bench --yolox-nano yolox_nano.onnx

        skysweep bench --scale
    """
    if scale and yolox_nano is not None:
        raise UserError("--yolox-nano: is not measured with --scale; leave one of them out")
    if scale:
        _scale(as_json)
    else:
        _bench(yolox_nano)


def _bench(yolox_nano: Path | None) -> None:
    from skysweep.experiments.bench import MEASUREMENTS
    from skysweep.experiments.bench import bench as measure

    with bar() as progress:
        task = progress.add_task("measurements", total=MEASUREMENTS + 1)
        done = iter(range(MEASUREMENTS + 1))

        def doing(what: str) -> None:
            progress.update(task, completed=next(done, MEASUREMENTS), description=what)

        measured = measure(doing, yolox_nano)
        doing("the live page")
        measured |= {"live_view_cost": _live_view_cost()}
        progress.update(task, completed=MEASUREMENTS + 1)
    sys.stdout.write(json.dumps(measured, indent=1) + "\n")


def _scale(as_json: bool) -> None:
    from skysweep.experiments.scale import HECTARES, PARTS
    from skysweep.experiments.scale import scale as measure

    with bar() as progress:
        task = progress.add_task("sizes", total=len(HECTARES) * len(PARTS))
        done = iter(range(len(HECTARES) * len(PARTS)))
        measured = measure(report=lambda what: progress.update(task, completed=next(done), description=what))
    table = Table(*_COLUMNS.values())
    for row in measured["rows"]:
        table.add_row(
            *(f"{row[name]:.3g}" if name.endswith(("_s", "_km")) else f"{row[name]:.0f}" for name in _COLUMNS)
        )
    slopes = ", ".join(f"{part} {slope:.2f}" for part, slope in measured["slopes"].items())
    answer(as_json, measured, table, f"slope of the time over the path, both as logarithms: {slopes}")


def _live_view_cost() -> float | None:
    """None without the extra."""
    try:
        from skysweep.web.cost import live_view_cost
    except MissingExtraError:
        return None
    return float(f"{live_view_cost():.3g}")
