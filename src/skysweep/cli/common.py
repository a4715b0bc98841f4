"""What the commands share: output, errors, progress, options."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated, Any, Literal, ParamSpec, TypeVar

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from skysweep.errors import UserError

P = ParamSpec("P")
R = TypeVar("R")

MOST_SEEDS = 10_000  # of one comparison: every mission's result is held until its end
_MOST_PER_CORE = 8  # processes
_WIDEST = 10_000  # characters of a table in a file

console = Console(emoji=False)
errors = Console(stderr=True, emoji=False)


def friendly(command: Callable[P, R]) -> Callable[P, R]:
    """User errors are one sentence and exit code 2; Ctrl-C is exit code 130."""

    @wraps(command)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except UserError as error:
            errors.print(f"[bold red]error:[/] {escape(str(error))}", soft_wrap=True, highlight=False)
            raise typer.Exit(2) from None
        except KeyboardInterrupt:
            errors.print("stopped; what was finished is kept, and the same command goes on where it can")
            raise typer.Exit(130) from None

    return wrapped


def number_or_inf(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise typer.BadParameter(f"'{text}' is no number; write a number or inf") from None
    if math.isnan(value):
        raise typer.BadParameter("nan is no number; write a number or inf")
    return value


ScenarioArg = Annotated[str, typer.Argument(help="Name of a shipped scenario or path of a YAML file.")]
SensorOption = Annotated[
    Literal["imaging", "statistical"],
    typer.Option(help="Rendered pictures and a real detector, or fast and without pictures."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="FIELD=VALUE", help="Change any field of the scenario; may be repeated."),
]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]


def _fit_this_machine(workers: int | None) -> int | None:
    most = _MOST_PER_CORE * (os.cpu_count() or 1)
    if workers is not None and workers > most:
        raise typer.BadParameter(f"{workers} are too many for this machine's cores; write at most {most}")
    return workers


WorkersOption = Annotated[
    int | None,
    typer.Option(min=1, callback=_fit_this_machine, help="Processes. Default: one a core."),
]


def changes_of(assignments: list[str] | None) -> dict[str, Any]:
    """FIELD=VALUE texts as a mapping; values are YAML."""
    from skysweep.files.plain_yaml import parse_yaml

    changes = {}
    for text in assignments or []:
        field, equals, value = text.partition("=")
        changes[field.strip()] = parse_yaml(value, f"--set {text}")
        if not equals or changes[field.strip()] is None:
            raise UserError(f"--set {text}: write FIELD=VALUE, such as search.n_c=3")
    return changes


def show(table: Table) -> None:
    """Print a table with every character: a terminal folds what is wider than itself, a file takes it all."""
    for column in table.columns:
        column.overflow = "fold"
    if console.is_terminal:
        console.print(table)
    else:
        wide = Console(emoji=False, width=_WIDEST)
        Console(emoji=False, width=wide.measure(table).maximum).print(table)


def local_folder(address: str) -> Path | None:
    """The folder that a path or an fsspec URL means; None where it is not on this computer."""
    if "://" in address and not address.startswith(("file://", "local://")):
        return None
    return Path(address.partition("://")[2] or address)


def make_folder(out: Path) -> None:
    """Raises UserError where it cannot be made or written to."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=out):
            return
    except OSError as error:
        raise UserError(
            f"--out {out}: cannot be made or written to ({error.strerror}); choose another"
        ) from None


def refuse_unused_eye(sensor: str, camera: str) -> None:
    """Raises UserError where a camera is given to a sensor that takes no pictures."""
    if sensor == "statistical" and camera != "rendered":
        raise UserError(f"--camera {camera}: the statistical sensor takes no pictures; leave one of them out")


def bar() -> Progress:
    """A progress bar that counts and says how long it will take, on standard error."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left:"),
        TimeRemainingColumn(),
        console=errors,
    )
