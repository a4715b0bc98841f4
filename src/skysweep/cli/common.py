"""What the commands share: output, errors, progress, options."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
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

from skysweep.errors import UserError

P = ParamSpec("P")
R = TypeVar("R")

console = Console()
errors = Console(stderr=True)


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


def changes_of(assignments: list[str] | None) -> dict[str, Any]:
    """FIELD=VALUE texts as a mapping; values are YAML."""
    import yaml

    changes = {}
    for text in assignments or []:
        field, equals, value = text.partition("=")
        try:
            changes[field.strip()] = yaml.safe_load(value)
        except yaml.YAMLError:
            equals = ""
        if not equals or changes[field.strip()] is None:
            raise UserError(f"--set {text}: write FIELD=VALUE, such as search.n_c=3")
    return changes


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
