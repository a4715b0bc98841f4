"""Fit the statistical sensor, and compare its missions with missions with pictures."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from skysweep.cli import completion
from skysweep.cli.answers import JsonOption, answer
from skysweep.cli.common import (
    MOST_SEEDS,
    SeedOption,
    WorkersOption,
    bar,
    counting,
    friendly,
    number_or_inf,
    say,
    warn,
)
from skysweep.cli.detection import BoxesOption, ChannelsOption, PixelsOption, RenamesOption, by_options
from skysweep.errors import UserError
from skysweep.files.writing import make_folder

if TYPE_CHECKING:
    from skysweep.experiments.matrix import MissionJob
    from skysweep.results.summary import Summary
    from skysweep.scenarios.model import DetectorModel
    from skysweep.sensing.statistical.model import HeldOut

app = typer.Typer()

LEAST_PICTURES, MOST_PICTURES = 10, 1_000_000  # to render
_OF_A_FOLDER = ("rendered", "poses", "tiles", "boxes", "pixels", "channels", "renames")
ON_RENDERS, ON_SCENARIO = 27_000, 800  # unless asked for others
FIRST_LOOK = 6000  # pictures below which a fit is rough


@app.callback(invoke_without_command=True)
@friendly
def calibrate(
    context: typer.Context,
    detector: Annotated[
        str | None,
        typer.Option(
            "--model",
            "--detector",
            help="One of ours or the path of an ONNX file; default: ours for the camera.",
        ),
    ] = None,
    camera: Annotated[
        str,
        typer.Option(
            "--camera",
            "--camera-of",
            help="Scenario with the camera to fit: a name or a file.",
            autocompletion=completion.scenarios,
        ),
    ] = "clusters",
    scenario: Annotated[
        str | None,
        typer.Option(
            help="Adapt the sensor model to this scenario's own worlds: a name or a file.",
            autocompletion=completion.scenarios,
        ),
    ] = None,
    add_to: Annotated[
        Path | None,
        typer.Option("--add-to", help="Sensor model: measure only the kinds and poses that it lacks."),
    ] = None,
    pictures: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER|FOLDER",
            help="How many to render (default 27000; 800 with --scenario), or a folder of labelled ones.",
            show_default=False,
        ),
    ] = None,
    rendered: Annotated[
        Path | None,
        typer.Option(
            help="With a FOLDER: sensor model of the same detector, fitted to renders. Default: ours."
        ),
    ] = None,
    poses: Annotated[
        Path | None, typer.Option(help="With a FOLDER: CSV that says how each picture was taken.")
    ] = None,
    tiles: Annotated[
        int | None, typer.Option(min=1, max=8, help="With a FOLDER: split each picture into tiles x tiles.")
    ] = None,
    boxes: BoxesOption = None,
    pixels: PixelsOption = None,
    channels: ChannelsOption = None,
    renames: RenamesOption = None,
    seed: SeedOption = 0,
    workers: WorkersOption = None,
    out: Annotated[Path, typer.Option(help="YAML file to write, with a picture beside it.")] = Path(
        "sensor.yaml"
    ),
    as_json: JsonOption = False,
) -> None:
    """Fit the statistical sensor to renders and a real detector, and print how well it fits.

    Use it with detector.statistical_model in a scenario.

    Examples:

        skysweep calibrate --pictures 6000 --out sensor.yaml  # coarser

        skysweep calibrate --model mine.onnx --camera my-scenario.yaml

        skysweep calibrate --add-to sensor.yaml --pictures 4000 --out more.yaml

        skysweep calibrate --scenario my-search.yaml --out my-sensor.yaml

        skysweep calibrate --pictures my-labelled-flights --out ours.yaml

        skysweep calibrate validate --seeds 30
    """
    if context.invoked_subcommand is not None:
        return
    from skysweep.detection.training.class_map import parse_renames
    from skysweep.experiments.calibration.run import calibrate as fit
    from skysweep.scenarios.files import load_scenario
    from skysweep.scenarios.model import OWN_DETECTORS, DetectorModel
    from skysweep.sensing.statistical.model import StatisticalModel

    _refuse_unwritable(out)
    if scenario is not None:
        _refuse_given(
            context,
            ("detector", "camera", "add_to", *_OF_A_FOLDER),
            "does not count with --scenario; leave it out",
        )
        _calibrate_on_scenario(scenario, _number(pictures or str(ON_SCENARIO)), seed, workers, out, as_json)
        return
    pictures = pictures or str(ON_RENDERS)
    if Path(pictures).is_dir() or not pictures.isdecimal():
        _refuse_given(
            context,
            ("camera", "add_to", "seed", "workers"),
            "counts with rendered pictures only; leave it out",
        )
        looked_at_with = DetectorModel(
            model=detector or OWN_DETECTORS["visible"],
            tiles=tiles or 1,
            boxes=boxes,
            pixels=pixels,
            channels=channels,
        )
        with by_options():
            _calibrate_on_pictures(
                looked_at_with, Path(pictures), parse_renames(renames or []), rendered, poses, out, as_json
            )
        return
    _refuse_given(context, _OF_A_FOLDER, "counts with real pictures only; write their folder as --pictures")
    n = _number(pictures)
    known = None if add_to is None else StatisticalModel.load(add_to)
    seeing = load_scenario(camera).camera
    with _looking(n) as on_look:
        model = fit(detector or OWN_DETECTORS[seeing.kind], seeing, out, n, seed, workers, on_look, known)
    if n < FIRST_LOOK:
        warn(
            f"{n} pictures are few: rarely seen cases are left out; {FIRST_LOOK} are enough for a first look"
        )
    picture = out.with_suffix(".png")
    held_out = [h.model_dump() for h in model.held_out]
    record = {
        "sensor_model": str(out),
        "picture": str(picture),
        "holds_for": model.holds_for,
        "held_out": held_out,
    }
    written = f"sensor model: {out}, picture: {picture}"
    answer(as_json, record, *_fit_tables(model.held_out), f"It holds for {model.holds_for}.", written)


@contextmanager
def _looking(n: int) -> Iterator[Callable[[int, int], None]]:
    """A bar of the pictures, and a word where Ctrl-C ends it."""
    try:
        with bar() as progress:
            task = progress.add_task("looking", total=n)

            def on_look(done: int, total: int) -> None:
                doing = "fitting" if done == total else "looking"
                progress.update(task, completed=done, total=total, description=doing)

            yield on_look
    except KeyboardInterrupt:
        say("stopped; nothing was written, and the same command starts again")
        raise typer.Exit(130) from None


def _refuse_given(context: typer.Context, names: Iterable[str], why: str) -> None:
    """Raises UserError if one of these options was written."""
    for option in context.command.params:
        source = context.get_parameter_source(option.name or "")
        if option.name in names and source is not None and source.name == "COMMANDLINE":
            raise UserError(f"{option.opts[0]}: {why}")


def _number(pictures: str) -> int:
    if not pictures.isdecimal() or not LEAST_PICTURES <= int(pictures) <= MOST_PICTURES:
        raise UserError(f"--pictures {pictures}: write {LEAST_PICTURES} to {MOST_PICTURES}, or a folder")
    return int(pictures)


def _calibrate_on_scenario(
    scenario: str, pictures: int, seed: int, workers: int | None, out: Path, as_json: bool
) -> None:
    from skysweep.experiments.calibration.of_scenario import calibrate_on_scenario
    from skysweep.scenarios.files import load_scenario

    chosen = load_scenario(scenario)
    with _looking(pictures) as on_look:
        model = calibrate_on_scenario(chosen, out, pictures, seed, workers, on_look)
    told = model.scenario
    assert told is not None
    table = Table("reports of", "as", "looks", "measured", "drawn before", "drawn now")
    for part in told.parts:
        table.add_row(
            part.part,
            part.reported_as,
            str(part.looks),
            str(part.measured),
            f"{part.before:.1f}",
            f"{part.now:.1f}",
        )
    record = {"sensor_model": str(out), "holds_for": model.holds_for, "scenario": told.model_dump()}
    answer(
        as_json,
        record,
        table,
        "Drawn now: each half of the worlds by the fit to the other half.",
        f"sensor model: {out}; fly with  --set detector.statistical_model={out}",
    )


def _calibrate_on_pictures(
    detector: DetectorModel,
    folder: Path,
    renames: Mapping[str, str],
    rendered: Path | None,
    poses: Path | None,
    out: Path,
    as_json: bool,
) -> None:
    from skysweep.detection.photos.pose_table import read_poses
    from skysweep.detection.training.reading import read_dataset, with_poses
    from skysweep.experiments.calibration.from_pictures import calibrate_on_pictures
    from skysweep.scenarios.model import OWN_DETECTORS, CameraKind
    from skysweep.sensing.statistical.model import StatisticalModel

    kinds: dict[str, CameraKind] = {own: kind for kind, own in OWN_DETECTORS.items()}
    base = StatisticalModel.load(rendered, kinds.get(detector.model, "visible"))
    table = None if poses is None else read_poses(poses)
    data = read_dataset(folder)
    with counting("reading") as reading:
        data = with_poses(data, table, reading)
    with counting("looking") as looking:
        model = calibrate_on_pictures(detector, data, base, out, renames, looking)
    told = model.pictures
    assert told is not None
    picture = out.with_suffix(".png")
    record = {
        "sensor_model": str(out),
        "picture": str(picture),
        "holds_for": model.holds_for,
        "held_out": [h.model_dump() for h in model.held_out],
        "pictures": told.model_dump(),
    }
    answer(
        as_json,
        record,
        *_fit_tables(model.held_out),
        f"From {told.pictures} pictures: {'; '.join(told.measured)}.",
        f"From renders, because pictures do not tell them: {'; '.join(told.from_renders)}.",
        f"sensor model: {out}, picture: {picture}",
    )


def _refuse_unwritable(out: Path) -> None:
    """Raises UserError if the results cannot be written, before anything is rendered."""
    if out.suffix not in (".yaml", ".yml"):
        raise UserError(f"--out {out}: is no YAML file; write a name such as sensor.yaml")
    make_folder(out.parent)
    for path in (out, out.with_suffix(".png")):
        if path.exists() and not (path.is_file() and os.access(path, os.W_OK)):
            raise UserError(f"--out {out}: {path} is there and cannot be replaced; choose another name")


def _fit_tables(held_out: list[HeldOut]) -> list[Table]:
    scores = Table("confidence ≥", "Brier", "of rates alone", "deviance explained", "calibration error")
    for h in held_out:
        brier = f"{h.brier:.4f}", f"{h.brier_of_rates:.4f}"
        rest = f"{h.deviance_explained:.0%}", f"{h.calibration_error:.3f}"
        scores.add_row(f"{h.confidence:g}", *brier, *rest)
    parts = Table("looks not seen by the fit", "looks", "reported", "drawn")
    for part in [part for h in held_out for part in h.parts]:
        parts.add_row(part.part, str(part.looks), f"{part.measured:.3f}", f"{part.drawn:.3f}")
    return [table for table in (parts, scores) if table.row_count]


@app.command()
@friendly
def validate(
    seeds: Annotated[
        int, typer.Option(min=2, max=MOST_SEEDS, help="Missions with pictures per scenario and strategy.")
    ] = 30,
    scenario: Annotated[
        list[str] | None,
        typer.Option(
            help="A name or a file; may be repeated. Default: clusters, abundance, sparse.",
            autocompletion=completion.scenarios,
        ),
    ] = None,
    n_c: Annotated[
        list[float] | None,
        typer.Option(
            "--n-c", parser=number_or_inf, help="Of Algorithm 1; may be repeated. Default: 1, 5, inf."
        ),
    ] = None,
    strategy: Annotated[
        list[str] | None,
        typer.Option(
            help="A strategy beside Algorithm 1; may be repeated. Default: belief.",
            autocompletion=completion.strategies,
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for missions, validate.json and validate.md.")] = Path(
        "validation"
    ),
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fly the same missions with pictures and without, and compare their means.

    The same command continues an interrupted validation.

    Examples:

        skysweep calibrate validate --seeds 30

        skysweep calibrate validate --seeds 5 --scenario clusters --n-c 5 --out quick
    """
    from skysweep.experiments.calibration import tiers

    rows = tiers.validated_rows(
        scenario or tiers.SCENARIOS, n_c or tiers.N_C, tiers.STRATEGIES if strategy is None else strategy
    )
    missions = len(rows) * seeds
    with bar() as progress:
        tasks = {
            "statistical": progress.add_task("without pictures", total=missions * tiers.STATISTICAL_TIMES),
            "imaging": progress.add_task("with pictures", total=missions),
        }

        def on_done(job: MissionJob, _summary: Summary) -> None:
            progress.advance(tasks[job.sensor])

        cells = tiers.compare_tiers(seeds, out, rows, workers, on_done)
    table = Table(*tiers.TIER_HEADER)
    for cell in cells:
        table.add_row(*cell.row)
    verdict = tiers.validation_text(cells).splitlines()[0]
    written = f"written: {out / 'validate.json'}, {out / 'validate.md'}"
    answer(as_json, {"means": tiers.tiers_json(cells), "verdict": verdict}, table, verdict, written)
