"""The command line: one thin command per job."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal, ParamSpec, TypeVar

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
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
            errors.print(f"[bold red]error:[/] {escape(str(error))}", soft_wrap=True, highlight=False)
            raise typer.Exit(2) from None
        except KeyboardInterrupt:
            errors.print("stopped; what was finished is kept; a comparison given again goes on from there")
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
    Literal["imaging", "statistical"],
    typer.Option(help="Rendered pictures and a real detector, or fast and without pictures."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="FIELD=VALUE", help="Change any field of the scenario; may be repeated."),
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
    change: SetOption = None,
    seed: SeedOption = 0,
    sensor: SensorOption = "imaging",
    renderer: Annotated[
        Literal["auto", "gl", "embree"], typer.Option(help="OpenGL, ray casting, or what there is.")
    ] = "auto",
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
    from skysweep.scenarios.files import change_scenario, load_scenario

    named = {
        "search.strategy": strategy,
        "search.n_c": n_c,
        "search.d_c_m": d_c,
        "search.c_t": c_t,
        "search.scan_altitude_agl_m": h_s,
        "search.check_altitude_agl_m": h_c,
    }
    given = {field: value for field, value in named.items() if value is not None}
    chosen = change_scenario(load_scenario(scenario), _changes(change) | given)
    for warning in warnings_for(chosen):
        errors.print(f"[yellow]warning:[/] {escape(warning)}", soft_wrap=True, highlight=False)
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


def _changes(assignments: list[str] | None) -> dict[str, Any]:
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
    change: SetOption = None,
) -> None:
    """Fly the 8 rows of the paper's Tables 1-3 and print them beside the paper's numbers.

    An interrupted comparison goes on where it was when the same command is given again.

    Examples:

        skysweep compare paper --seeds 1

        skysweep compare paper --sensor statistical --seeds 100 --out paper-100

        skysweep compare paper --sensor statistical --seeds 30 --set camera.gimbal.lag_s=0.06 --out lag-60
    """
    from skysweep.experiments.compare import PaperJob, compare_paper
    from skysweep.results.compare_report import write_compare_report
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

        summaries = compare_paper(seeds, sensor, out, workers, _changes(change), on_done)
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
            console.print(
                f"{escape(file)}: [yellow]warning:[/] {escape(warning)}", soft_wrap=True, highlight=False
            )
        console.print(f"{escape(file)}: {'usable' if warnings else 'good'}", soft_wrap=True)


@app.command()
@friendly
def plan(
    source: Annotated[
        str,
        typer.Argument(help="Scenario (name or YAML) or area (GeoJSON, KML, KMZ, QGroundControl .plan)."),
    ],
    altitude: Annotated[float | None, typer.Option(help="Scan altitude, m above ground.")] = None,
    sidelap: Annotated[float | None, typer.Option(help="Share of the swath that neighbours share.")] = None,
    heading: Annotated[float | None, typer.Option(help="Compass heading of the transects.")] = None,
    hfov: Annotated[float | None, typer.Option(help="Horizontal field of view of the camera, rad.")] = None,
    speed: Annotated[float | None, typer.Option(help="Scan speed, m/s.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the .plan file and the picture.")] = Path("plan"),
) -> None:
    """Plan the coverage of an area: length, time, batteries, a QGroundControl plan and a picture.

    Examples:

        skysweep plan clusters

        skysweep plan my-area.kml --altitude 40 --sidelap 0.3 --out saturday
    """
    from skysweep.planning.area_files import SUFFIXES, scenario_from_area
    from skysweep.planning.flight_plan import plan_scenario
    from skysweep.planning.picture import draw_plan
    from skysweep.planning.qgc import plan_for_qgc, write_plan
    from skysweep.scenarios.advice import warnings_for
    from skysweep.scenarios.files import change_scenario, load_scenario

    is_area = Path(source).suffix.lower() in SUFFIXES
    chosen = change_scenario(
        scenario_from_area(source) if is_area else load_scenario(source),
        {
            "search.scan_altitude_agl_m": altitude,
            "search.sidelap": sidelap,
            "search.transect_heading_deg": heading,
            "search.scan_speed_mps": speed,
            "camera.hfov_rad": hfov,
        },
    )
    for warning in [] if is_area else warnings_for(chosen):
        errors.print(f"[yellow]warning:[/] {escape(warning)}", soft_wrap=True, highlight=False)
    coverage, estimate = plan_scenario(chosen)
    out.mkdir(parents=True, exist_ok=True)
    picture = draw_plan(out / f"{chosen.name}.png", chosen, coverage, estimate)
    file = write_plan(out / f"{chosen.name}.plan", plan_for_qgc(chosen, coverage))
    table = Table(show_header=False, box=None)
    table.add_row("area", f"{estimate.area_m2 / 1e4:.2f} ha")
    table.add_row("transects", f"{estimate.n_transects}, heading {coverage.heading_deg:.0f}\N{DEGREE SIGN}")
    table.add_row("path length", f"{estimate.path_length_m:.0f} m")
    table.add_row("time", f"{estimate.time_s / 60:.1f} min with take-off, return and landing")
    table.add_row("batteries", f"{estimate.batteries} ({estimate.energy_wh:.0f} Wh)")
    table.add_row("ground sample distance", f"{estimate.gsd_cm:.1f} cm")
    table.add_row("pixels on the smallest target", f"{estimate.pixels_on_target:.1f}")
    console.print(table)
    console.print(f"plan: {file}\npicture: {picture}", soft_wrap=True, highlight=False)


@app.command()
@friendly
def dataset(
    out: Annotated[Path, typer.Argument(help="A new folder.")],
    images: Annotated[int, typer.Option(min=1, help="How many pictures.")] = 6000,
    seed: SeedOption = 0,
    split: Annotated[Literal["train", "held-out"], typer.Option(help="Which assets to show.")] = "train",
    workers: Annotated[int | None, typer.Option(min=1, help="Processes. Default: one a core.")] = None,
) -> None:
    """Render labelled pictures (COCO and YOLO labels) to train or evaluate detectors.

    Examples:

        skysweep dataset training --images 6000

        skysweep dataset held-out --split held-out --images 1000 --seed 1
    """
    from skysweep.training.dataset import render_dataset

    with _bar() as progress:
        task = progress.add_task("rendering", total=images)
        render_dataset(
            out,
            images,
            seed=seed,
            split=split,
            workers=workers,
            progress=lambda done, _total: progress.update(task, completed=done),
        )
    console.print(f"data set: {out}", soft_wrap=True)


@app.command()
@friendly
def train(
    dataset: Annotated[Path, typer.Argument(help="COCO or YOLO folder.")],
    out: Annotated[Path, typer.Option(help="ONNX file to write.")] = Path("detector.onnx"),
    minutes: Annotated[float, typer.Option(min=0.01, help="How long to train.")] = 20.0,
    init: Annotated[
        str | None, typer.Option(help="Fine-tune this model: 'skysweep' or an ONNX file of this command.")
    ] = None,
    seed: SeedOption = 0,
    threads: Annotated[int, typer.Option(min=1)] = 2,
) -> None:
    """Train a detector, or fine-tune ours on your pictures (extra: train).

    Examples:

        skysweep train training --minutes 20 --out detector.onnx

        skysweep train my-labelled-flights --init skysweep --minutes 5
    """
    from skysweep.training.train import train_detector

    with _bar() as progress:
        task = progress.add_task("training", total=1000)

        def show(now: Any) -> None:
            progress.update(task, completed=int(1000 * now.share), description=f"loss {now.loss:.2f}")

        train_detector(dataset, out, minutes=minutes, init=init, seed=seed, threads=threads, progress=show)
    console.print(f"model: {out}; use it with detector.model in a scenario", soft_wrap=True)


@detect_app.command("evaluate")
@friendly
def detect_evaluate(
    dataset: Annotated[Path, typer.Argument(help="COCO or YOLO folder.")],
    model: Annotated[str, typer.Option(help="'skysweep' or the path of an ONNX file.")] = "skysweep",
    stock: Annotated[
        bool, typer.Option("--stock", help="Beside it, fetch and evaluate the COCO-trained YOLOv3-tiny.")
    ] = False,
    confidence: Annotated[float, typer.Option(min=0.01, max=0.99, help="Drops detections below.")] = 0.25,
    tiles: Annotated[int, typer.Option(min=1, max=8, help="Split each picture into tiles x tiles.")] = 1,
) -> None:
    """Recall, precision and false positives by pixels on target and altitude.

    Examples:

        skysweep detect evaluate held-out --stock

        skysweep detect evaluate my-labelled-flights --model detector.onnx
    """
    from skysweep.sensing.detector import YoloDetector
    from skysweep.training.evaluate import evaluate, tables
    from skysweep.training.labelled import read_dataset

    data = read_dataset(dataset)
    models: dict[str, Path | str] = {model: model}
    if stock:
        from skysweep.training.stock import stock_model_path

        models["YOLOv3-tiny (COCO)"] = stock_model_path()
    evaluations = {}
    with _bar() as progress:
        for name, path in models.items():
            detector = YoloDetector(path, confidence_min=confidence, tiles=tiles, threads=2)
            task = progress.add_task(name, total=len(data.images))

            def show(done: int, _total: int, task: TaskID = task) -> None:
                progress.update(task, completed=done)

            evaluations[name] = evaluate(detector, data, confidence_min=confidence, progress=show)
    for table in tables(evaluations):
        console.print(table)


@app.command()
@friendly
def calibrate(
    detector: Annotated[str, typer.Option(help="'skysweep' or the path of an ONNX file.")] = "skysweep",
    camera_of: Annotated[str, typer.Option(help="Scenario whose camera to fit.")] = "clusters",
    pictures: Annotated[int, typer.Option(min=10, help="How many to render.")] = 3000,
    seed: SeedOption = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes. Default: one a core.")] = None,
    out: Annotated[Path, typer.Option(help="YAML file to write.")] = Path("sensor.yaml"),
) -> None:
    """Fit the statistical sensor to renders and a real detector.

    Example:

        skysweep calibrate --pictures 3000 --out sensor.yaml
    """
    from skysweep.experiments.calibrate import calibrate as fit
    from skysweep.scenarios.files import load_scenario

    with _bar() as progress:
        task = progress.add_task("looking", total=pictures)
        fit(
            detector,
            load_scenario(camera_of).camera,
            out,
            pictures,
            seed,
            workers,
            lambda done, total: progress.update(task, completed=done, total=total),
        )
    console.print(f"sensor model: {out}", soft_wrap=True)


@app.command()
@friendly
def bench() -> None:
    """Measure this machine and print one JSON object: real-time factors, frames a second, milliseconds."""
    from skysweep.experiments.bench import bench as measure

    sys.stdout.write(json.dumps(measure(), indent=1) + "\n")


def _bar() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=errors,
    )


if __name__ == "__main__":
    app()
