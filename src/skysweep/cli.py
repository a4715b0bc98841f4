"""The command line: one thin command per job."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from skysweep.errors import UserError

P = ParamSpec("P")
R = TypeVar("R")

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Plan, simulate, compare and fly UAV search-and-rescue missions.",
)
scenarios_app = typer.Typer(no_args_is_help=True, help="List, show and check scenarios.")
compare_app = typer.Typer(no_args_is_help=True, help="Compare strategies.")
detect_app = typer.Typer(no_args_is_help=True, help="Evaluate detectors.")
app.add_typer(scenarios_app, name="scenarios")
app.add_typer(compare_app, name="compare")
app.add_typer(detect_app, name="detect")

console = Console()
errors = Console(stderr=True)


def friendly(command: Callable[P, R]) -> Callable[P, R]:
    """User errors are one sentence and exit code 2; Ctrl-C is exit code 130."""

    @wraps(command)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except UserError as error:
            errors.print(f"[bold red]error:[/] {error}", soft_wrap=True, highlight=False)
            raise typer.Exit(2) from None
        except KeyboardInterrupt:
            errors.print("stopped; what was finished is kept, the same command goes on from there")
            raise typer.Exit(130) from None

    return wrapped


def _number_or_inf(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise typer.BadParameter(f"'{text}' is no number; write a number or inf") from None
    if math.isnan(value):
        raise typer.BadParameter("nan is no number; write a number or inf")
    return value


ScenarioArg = Annotated[str, typer.Argument(help="Name of a shipped scenario or path of a YAML file.")]
SensorOption = Annotated[
    str, typer.Option(help="imaging (rendered pictures, real detector) or statistical (fast, no pictures).")
]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]


@app.callback()
def main() -> None:
    """Plan, simulate, compare and fly UAV search-and-rescue missions."""


@app.command()
@friendly
def run(
    scenario: ScenarioArg,
    strategy: Annotated[str | None, typer.Option(help="scan-check, scan-only, low-only, ...")] = None,
    n_c: Annotated[
        float | None, typer.Option("--n-c", parser=_number_or_inf, help="Check after this many; inf = never.")
    ] = None,
    d_c: Annotated[
        float | None,
        typer.Option("--d-c", parser=_number_or_inf, help="Check this far (m) after the last one; or inf."),
    ] = None,
    c_t: Annotated[float | None, typer.Option("--c-t", help="Confidence that confirms.")] = None,
    h_s: Annotated[float | None, typer.Option("--h-s", help="Scan altitude, m above ground.")] = None,
    h_c: Annotated[float | None, typer.Option("--h-c", help="Check altitude, m above ground.")] = None,
    seed: SeedOption = 0,
    sensor: SensorOption = "imaging",
    renderer: Annotated[str, typer.Option(help="auto, gl (OpenGL) or embree (ray casting).")] = "auto",
    out: Annotated[Path | None, typer.Option(help="Run folder. Default: runs/<scenario>-...")] = None,
) -> None:
    """Fly one mission and write its run folder with report.html.

    Examples:

        skysweep run clusters

        skysweep run person-wilderness --n-c 3 --d-c 60 --seed 7 --out my-run

        skysweep run my-scenario.yaml --strategy low-only --sensor statistical
    """
    from skysweep.experiments.single import fly_to_folder
    from skysweep.scenarios.advice import warnings_for
    from skysweep.scenarios.files import load_scenario

    changes = {
        "strategy": strategy,
        "n_c": n_c,
        "d_c_m": d_c,
        "c_t": c_t,
        "scan_altitude_agl_m": h_s,
        "check_altitude_agl_m": h_c,
    }
    chosen = load_scenario(scenario).with_search(**{k: v for k, v in changes.items() if v is not None})
    for warning in warnings_for(chosen):
        errors.print(f"[yellow]warning:[/] {warning}", soft_wrap=True, highlight=False)
    folder = out or _free_folder(Path("runs"), f"{chosen.name}-{chosen.search.strategy}-seed{seed}")
    with Progress(
        TextColumn("{task.description}"),
        TextColumn("{task.fields[doing]}"),
        TimeElapsedColumn(),
        console=errors,
    ) as progress:
        task = progress.add_task(chosen.name, doing="preparing", total=None)

        def watch(state: Any, mode: str, _new: Any) -> None:
            progress.update(
                task,
                doing=f"{mode:8s} t = {state.time_s:6.1f} s   {state.position_enu_m[2]:5.1f} m up   "
                f"battery {state.battery_remaining:4.0%}",
            )

        summary = fly_to_folder(chosen, seed, folder, sensor, renderer, watch=watch)
    _print_summary(summary)
    console.print(f"report: {folder / 'report.html'}", soft_wrap=True)


def _free_folder(parent: Path, name: str) -> Path:
    candidates = [parent / name] + [parent / f"{name}-{k}" for k in range(2, 10_000)]
    return next(c for c in candidates if not c.exists())


def _print_summary(summary: dict[str, Any]) -> None:
    table = Table(show_header=False, box=None)
    for key in (
        "mission_time_s",
        "scan_only_time_s",
        "n_targets",
        "n_confirmed",
        "recall",
        "false_scans",
        "false_positives",
        "path_length_m",
        "energy_wh",
        "real_time_factor",
    ):
        table.add_row(key, str(summary[key]))
    console.print(table)


@compare_app.command("paper")
@friendly
def compare_paper_command(
    seeds: Annotated[int, typer.Option(min=1, help="Missions for each of the 8 rows.")] = 5,
    sensor: SensorOption = "imaging",
    out: Annotated[Path, typer.Option(help="Folder for compare.json, figures, report and runs.")] = Path(
        "paper-run"
    ),
    workers: Annotated[int | None, typer.Option(min=1, help="Processes. Default: one a core.")] = None,
) -> None:
    """Fly the 8 rows of the paper's Tables 1-3 and print them beside the paper's numbers.

    An interrupted comparison goes on where it was when the same command is given again.

    Examples:

        skysweep compare paper --seeds 1

        skysweep compare paper --sensor statistical --seeds 100 --out paper-100
    """
    from skysweep.experiments.compare import PaperJob, compare_paper
    from skysweep.results.report import write_compare_report
    from skysweep.results.tables import PAPER, print_tables

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=errors,
    ) as progress:
        task = progress.add_task("missions", total=seeds * len(PAPER))

        def on_done(job: PaperJob, summary: dict[str, Any]) -> None:
            progress.advance(task)
            if job.folder is not None:
                progress.console.print(
                    f"{job.scenario} n_c={job.n_c:g} seed {job.seed}: {summary['mission_time_s']:.0f} s, "
                    f"recall {summary['recall']:.2f}, picture {job.folder / 'map.png'}",
                    soft_wrap=True,
                    highlight=False,
                )

        summaries = compare_paper(seeds, sensor, out, workers, on_done)
    rows = write_compare_report(out, summaries)
    print_tables(console, rows, summaries)
    console.print(f"report: {out / 'report.html'}", soft_wrap=True)


@scenarios_app.command("list")
@friendly
def scenarios_list() -> None:
    """The shipped scenarios."""
    from skysweep.scenarios.files import list_scenarios, load_scenario

    table = Table("name", "area", "targets", "description")
    for name in list_scenarios():
        s = load_scenario(name)
        generated = sum(g.count for g in s.generators if g.kind in s.target_classes)
        table.add_row(
            name, f"{s.area_enu_m.area / 1e4:.1f} ha", str(len(s.targets) + generated), s.description.strip()
        )
    console.print(table)


@scenarios_app.command("show")
@friendly
def scenarios_show(
    scenario: ScenarioArg,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema instead.")] = False,
) -> None:
    """The whole scenario, every default filled in.

    Example:

        skysweep scenarios show clusters > my-scenario.yaml
    """
    from skysweep.scenarios.files import dump_scenario, json_schema, load_scenario

    text = json.dumps(json_schema(), indent=2) if schema else dump_scenario(load_scenario(scenario))
    sys.stdout.write(text.rstrip() + "\n")


@scenarios_app.command("validate")
@friendly
def scenarios_validate(files: Annotated[list[str], typer.Argument(help="Scenario files.")]) -> None:
    """Check scenario files; exit code 2 at the first that is wrong."""
    from skysweep.scenarios.advice import warnings_for
    from skysweep.scenarios.files import load_scenario

    for file in files:
        warnings = warnings_for(load_scenario(file))
        for warning in warnings:
            console.print(f"{file}: [yellow]warning:[/] {warning}", soft_wrap=True, highlight=False)
        console.print(f"{file}: {'usable' if warnings else 'good'}", soft_wrap=True)


if __name__ == "__main__":
    app()
