"""What a command answers on standard output: tables and sentences, or one JSON document."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from skysweep.cli.common import PlainConsole, console, duration, tell

if TYPE_CHECKING:
    from skysweep.planning.flight_plan import FlightEstimate
    from skysweep.results.reporting.html import Grid
    from skysweep.scenarios.model import Scenario

_WIDEST = 10_000  # characters of a table in a file
_MARKS = {True: Text("ok", "green"), None: Text("note", "yellow"), False: Text("no", "bold red")}

JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON document instead (docs/command-line.md).")
]


def answer(as_json: bool, record: Mapping[str, Any], *shown: Table | Grid | str) -> None:
    """Print a command's result: ``record`` as one JSON document, or ``shown`` for people.

    A number that is infinite is the string "inf" in JSON, an unknown one null.
    """
    if as_json:
        from skysweep.results.summary import plain

        sys.stdout.write(json.dumps(plain(dict(record)), indent=1, allow_nan=False) + "\n")
        return
    for part in shown:
        if isinstance(part, str):
            tell(part)
        else:
            print_table(part if isinstance(part, Table) else _table_of(part))


def print_table(table: Table, on: PlainConsole = console) -> None:
    """Print a table without losing a character: a terminal folds wide cells, a file gets the full width."""
    for column in table.columns:
        column.overflow = "fold"
    if on.is_terminal:
        on.print(table)
    else:
        wide = PlainConsole(width=_WIDEST)
        PlainConsole(stderr=on.stderr, width=wide.measure(table).maximum).print(table)


def figures_table() -> Table:
    """An empty table for the name of a figure and its value in each row."""
    return Table(show_header=False, box=None)


def add_cost(table: Table, scenario: Scenario, estimate: FlightEstimate) -> None:
    """Add what it takes to fly a plan of the scenario, and where the vehicle stays."""
    from skysweep.planning.surroundings import fence_words

    n = estimate.batteries
    in_sorties = f", in {n} sorties, changed in {duration(scenario.vehicle.swap_s)}" if n > 1 else ""
    table.add_row("path length", f"{estimate.path_length_m:.0f} m")
    table.add_row("time", f"{estimate.time_s / 60:.1f} min with take-off, return and landing, without checks")
    table.add_row("batteries", f"{n} ({estimate.energy_wh:.0f} Wh) without checks{in_sorties}")
    table.add_row("fence", fence_words(scenario))


def mark(passed: bool | None) -> Text:
    """The mark of a check: ok, note or no."""
    return _MARKS[passed]


def _table_of(grid: Grid) -> Table:
    from rich.box import SIMPLE_HEAD

    table = Table(title=grid.caption, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
    for k, column in enumerate(grid.header):
        table.add_column(column, justify="left" if grid.words or k == 0 else "right")
    for k, row in enumerate(grid.rows):
        table.add_row(*row, style="bold" if k in grid.best else None)
    return table
