"""Shared by the commands: output, errors, progress, options."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, ParamSpec, TypeVar

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from skysweep.cli import completion
from skysweep.errors import UserError
from skysweep.text import printable

if TYPE_CHECKING:
    from skysweep.scenarios.model import Scenario

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

MOST_SEEDS = 10_000  # of one comparison: every mission's result is held until its end
_MOST_PER_CORE = 8  # processes


class PlainConsole(Console):
    """Prints text verbatim: nothing in it is markup or controls the terminal."""

    def __init__(self, **options: Any) -> None:
        super().__init__(emoji=False, markup=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Render a ``str``, also one in a table's cell."""
        return super().render_str("\n".join(map(printable, text.split("\n"))), **options)


class _Description(ProgressColumn):
    """A task's description."""

    def render(self, task: Task) -> Text:
        """The description, verbatim."""
        return Text(printable(task.description))


console = PlainConsole()
errors = PlainConsole(stderr=True)
description = _Description()


def friendly(command: Callable[P, R]) -> Callable[P, R]:
    """A user's error ends the command with one sentence and exit code 2, Ctrl-C with exit code 130.

    A KeyboardInterrupt that a command raises anew has its own sentence.
    """

    @wraps(command)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except UserError as error:
            sentence = str(error)
        except BrokenPipeError:  # the reader of our output is gone
            raise
        except OSError as error:
            where, why = error.filename or "a file or device", error.strerror or str(error)
            sentence = f"{where}: cannot be read or written ({why}); check name, permissions and free space"
        except KeyboardInterrupt as stop:
            say(str(stop) or "stopped; finished work is kept, and the same command continues it if it can")
            raise typer.Exit(130) from None
        _label("error", "bold red", sentence)
        raise typer.Exit(2)

    return wrapped


def warn(sentence: str) -> None:
    """Warn of something that is no error, but may be unintended."""
    _label("warning", "yellow", sentence)


def _label(kind: str, style: str, sentence: str) -> None:
    line = Text.assemble((f"{kind}:", style), " ", printable(sentence))
    errors.print(line, soft_wrap=True, highlight=False)


def tell(text: str) -> None:
    """A result on standard output."""
    console.print(text, soft_wrap=True, highlight=False)


def say(words: str) -> None:
    """A line on standard error, above any progress."""
    errors.print(printable(words), soft_wrap=True, highlight=False)


def duration(seconds: float) -> str:
    """A time for people."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} minutes"
    return f"{seconds / 3600:,.1f} hours"


def number_or_inf(text: str) -> float:
    """An option's number, which may be infinite. Raises typer.BadParameter for anything else, also nan."""
    try:
        value = float(text)
    except ValueError:
        raise typer.BadParameter(f"'{text}' is no number; write a number or inf") from None
    if math.isnan(value):
        raise typer.BadParameter("nan is no number; write a number or inf")
    return value


ScenarioArg = Annotated[
    str,
    typer.Argument(
        help="Name of a shipped scenario or path of a YAML file.", autocompletion=completion.scenarios
    ),
]
SensorOption = Annotated[
    Literal["imaging", "statistical"],
    typer.Option(help="Rendered pictures and a real detector, or fast without pictures."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="FIELD=VALUE", help="Change any field of the scenario; may be repeated."),
]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
FromSoundLinesOption = Annotated[
    bool, typer.Option("--from-sound-lines", help="Continue a damaged journal from before the damage.")
]


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
    from skysweep.scenarios.files import NULL

    changes: dict[str, Any] = {}
    for text in assignments or []:
        field, equals, value = text.partition("=")
        if not (equals and value.strip()):
            raise UserError(f"--set {text}: write FIELD=VALUE, such as search.n_c=3")
        read = parse_yaml(value, f"--set {text}")
        changes[field.strip()] = NULL if read is None else read
    return changes


def chosen_scenario(name_or_path: str, assignments: list[str] | None) -> Scenario:
    """The scenario of a command, changed as ``--set`` says."""
    from skysweep.scenarios.files import change_scenario, load_scenario

    return change_scenario(load_scenario(name_or_path), changes_of(assignments))


def scenario_or_area(source: str) -> Scenario:
    """A scenario by name or file, or one over the area in a file."""
    from skysweep.planning.area_files import SUFFIXES, scenario_from_area
    from skysweep.scenarios.files import load_scenario

    return (scenario_from_area if Path(source).suffix.lower() in SUFFIXES else load_scenario)(source)


def lon_lat_of(text: str, option: str) -> tuple[float, float]:
    """Longitude and latitude in degrees of an option's LON,LAT."""
    try:
        longitude, latitude = (float(part) for part in text.split(","))
    except ValueError:
        longitude = latitude = math.nan
    if not (abs(longitude) <= 180.0 and abs(latitude) <= 90.0):
        raise UserError(f"{option} {text}: is no place; write LON,LAT in degrees")
    return longitude, latitude


def lat_lon_of(text: str, option: str) -> tuple[float, float]:
    """Latitude and longitude in degrees of an option's LAT,LON."""
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError:
        latitude = longitude = math.nan
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        raise UserError(f"{option} {text}: is no place; write LAT,LON in degrees")
    return latitude, longitude


def refuse_to_replace(read: Iterable[Path | str | None], *written: Path) -> None:
    """Raises UserError where a file that a command is about to write is one that it was given."""
    given = [Path(path) for path in read if path is not None]
    for path in written:
        if path.is_file() and any(other.is_file() and path.samefile(other) for other in given):
            raise UserError(f"{path}: was given, and would be replaced; write another place with --out")


def local_folder(address: str) -> Path | None:
    """The folder of a path or an fsspec URL, or None if it is not on this computer."""
    if "://" in address and not address.startswith(("file://", "local://")):
        return None
    return Path(address.partition("://")[2] or address)


def refuse_unused_eye(sensor: str, camera: str) -> None:
    """Raises UserError if a camera is given to a sensor that takes no pictures."""
    if sensor == "statistical" and camera != "rendered":
        raise UserError(f"--camera {camera}: the statistical sensor takes no pictures; leave one of them out")


def bar() -> Progress:
    """A progress bar on standard error that counts and estimates the time left."""
    times = TimeElapsedColumn(), TextColumn("left:"), TimeRemainingColumn()
    return Progress(description, BarColumn(), MofNCompleteColumn(), *times, console=errors)


@contextmanager
def counting(name: str) -> Iterator[Callable[[int, int], None]]:
    """A bar that is told how many steps are done, and of how many; nothing where nobody sees it."""
    with bar() as progress:
        progress.disable = not errors.is_terminal
        task = progress.add_task(name, total=None)
        yield lambda done, of: progress.update(task, completed=done, total=of)


@contextmanager
def working(words: str) -> Iterator[None]:
    """Show on a terminal what is going on for some seconds that nothing counts."""
    if not errors.is_terminal:
        yield
        return
    with spinner() as progress:
        progress.add_task(words)
        yield


def bar_over(jobs: Iterable[T], name: str, total: int) -> Iterator[T]:
    """The same, with a bar that counts them."""
    with bar() as progress:
        yield from progress.track(jobs, total=total, description=name)


def status() -> Progress:
    """A status line on standard error: a task's description, its field ``doing``, and the time."""
    return Progress(description, TextColumn("{task.fields[doing]}"), TimeElapsedColumn(), console=errors)


def spinner() -> Progress:
    """A line on standard error that says what is going on, and disappears at the end."""
    return Progress(SpinnerColumn(), description, console=errors, transient=True)
