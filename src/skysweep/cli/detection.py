"""Render data sets, train and evaluate detectors."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from skysweep.cli.answers import JsonOption, answer
from skysweep.cli.common import (
    SeedOption,
    WorkersOption,
    bar,
    counting,
    friendly,
    refuse_to_replace,
    tell,
    warn,
    working,
)
from skysweep.errors import UserError

RenamesOption = Annotated[
    list[str] | None,
    typer.Option(
        "--class",
        metavar="NAME=OURS",
        help="Our name of a class, or 'ignored'; may be repeated (docs/detector.md).",
    ),
]


_NOTHING_WRITTEN = "stopped; nothing was written, and the same command starts again"


@contextmanager
def by_options() -> Iterator[None]:
    """Errors name the options --boxes, --pixels and --channels instead of the fields of a scenario."""
    try:
        yield
    except UserError as error:
        raise UserError(re.sub(r"\bdetector\.(boxes|pixels|channels)\b:?", r"--\1", str(error))) from error


@friendly
def dataset(
    out: Annotated[Path, typer.Argument(help="A new folder.")],
    images: Annotated[
        int, typer.Option("--pictures", "--images", min=1, max=1_000_000, help="How many to make.")
    ] = 6000,
    seed: SeedOption = 0,
    split: Annotated[Literal["train", "held-out"], typer.Option(help="Which assets to show.")] = "train",
    clutter: Annotated[
        bool,
        typer.Option(
            "--clutter",
            help="Add roads, houses, rubbish, and cars and animals as classes; vary tones as cameras do.",
        ),
    ] = False,
    photos: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FOLDER",
            help="Make half of the pictures of your photos; may be repeated. A photo without a label counts "
            "as a picture without targets: some are rendered into it.",
        ),
    ] = None,
    renames: RenamesOption = None,
    camera: Annotated[
        Literal["visible", "thermal"], typer.Option(help="thermal: persons and animals, white hot.")
    ] = "visible",
    workers: WorkersOption = None,
) -> None:
    """Render labelled pictures (COCO and YOLO labels) to train or evaluate detectors.

    Photos may have labels that detect evaluate reads; COCO, YOLO or VisDrone.

    Examples:

        skysweep dataset training --pictures 6000 --clutter

        skysweep dataset held-out --split held-out --pictures 1000 --seed 1

        skysweep dataset training --photos DCIM/100MEDIA --photos my-labelled-flights

        skysweep dataset nights --camera thermal --pictures 6000
    """
    from skysweep.detection.training.class_map import parse_renames
    from skysweep.detection.training.dataset import render_dataset

    if renames and not photos:
        raise UserError("--class: counts with --photos only; write the folder of the photos, or leave it out")
    with bar() as progress:
        task = progress.add_task("rendering", total=images)

        def show(done: int) -> None:
            progress.update(task, completed=done)

        try:
            render_dataset(
                out,
                images,
                seed=seed,
                split=split,
                camera=camera,
                clutter=clutter,
                photos=photos or (),
                renames=parse_renames(renames or []),
                workers=workers,
                progress=show,
            )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(_NOTHING_WRITTEN) from None
    tell(f"data set: {out}")


@friendly
def train(
    dataset: Annotated[Path, typer.Argument(help="COCO or YOLO folder.")],
    out: Annotated[Path, typer.Option(help="ONNX file to write.")] = Path("detector.onnx"),
    minutes: Annotated[float, typer.Option(min=0.01, help="How long to train.")] = 20.0,
    init: Annotated[
        str | None,
        typer.Option(help="Fine-tune this model: 'skysweep', one of this command, or a YOLOX .pth or .onnx."),
    ] = None,
    learning_rate: Annotated[
        float | None,
        typer.Option(min=1e-6, max=0.1, help="Its peak. Default: 0.002, or 0.0005 to fine-tune."),
    ] = None,
    seed: SeedOption = 0,
    threads: Annotated[int, typer.Option(min=1, max=256, help="CPU cores to train on.")] = 2,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the model.")] = False,
) -> None:
    """Train a detector, or fine-tune ours on your pictures (extra: train).

    Ctrl-C ends the training early and writes the model as it is by then.

    Examples:

        skysweep train training --minutes 20 --out detector.onnx

        skysweep train my-labelled-flights --init skysweep --minutes 5

        skysweep train my-labelled-flights --init yolox_nano.pth --minutes 30
    """
    from skysweep.detection.training.train import train_detector

    if out.exists() and not overwrite:
        raise UserError(f"--out {out}: exists; write another, or --overwrite to replace it")
    reached = 0.0
    with bar() as progress:
        task = progress.add_task("training", total=1000)

        def show(share: float, loss: float) -> None:
            nonlocal reached
            reached = share
            progress.update(task, completed=int(1000 * share), description=f"loss {loss:.2f}")

        try:
            train_detector(
                dataset,
                out,
                minutes=minutes,
                init=init,
                learning_rate=learning_rate,
                seed=seed,
                threads=threads,
                progress=show,
            )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(_NOTHING_WRITTEN) from None
    if reached < 1.0:
        raise KeyboardInterrupt(f"stopped after {reached:.0%} of the time; {out} is the model as it was then")
    tell(f"model: {out}; use it with detector.model in a scenario")


BoxesOption = Annotated[
    Literal["pixels", "normalised"] | None,
    typer.Option(help="What the model's boxes are measured in, where its file leaves that open."),
]
PixelsOption = Annotated[
    Literal["0..255", "0..1", "imagenet"] | None,
    typer.Option(help="What pixel values the model takes, where its file leaves that open."),
]
ChannelsOption = Annotated[
    Literal["rgb", "bgr"] | None,
    typer.Option(help="The order of the pixels' channels, where the model's file leaves that open."),
]


@friendly
@by_options()
def detect_inspect(
    model: Annotated[str, typer.Argument(help="'skysweep' or the path of an ONNX file.")],
    picture: Annotated[Path | None, typer.Argument(help="A picture to look for objects in.")] = None,
    out: Annotated[Path, typer.Option(help="The picture with boxes, a .png.")] = Path("boxes.png"),
    confidence: Annotated[
        float, typer.Option(min=0.01, max=0.99, help="Detections below are dropped.")
    ] = 0.25,
    boxes: BoxesOption = None,
    pixels: PixelsOption = None,
    channels: ChannelsOption = None,
    as_json: JsonOption = False,
) -> None:
    """What is understood of a model: its input, pixels, outputs and classes; draws what it finds.

    Examples:

        skysweep detect inspect yolo11n.onnx

        skysweep detect inspect yolo11n.onnx beach.jpg --out found.png
    """
    from skysweep.api.detection import ImageDetector
    from skysweep.detection.inspection import describe, save_drawn
    from skysweep.detection.photos.pixels import read_picture
    from skysweep.detection.yolo import YoloDetector

    refuse_to_replace([picture], out)
    with working(f"trying {model}"):
        detector = YoloDetector(
            model, confidence_min=confidence, threads=2, boxes=boxes, pixels=pixels, channels=channels
        )
    understood = describe(detector.network)
    lines = [f"{name}: {words}" for name, words in understood.items()]
    record: dict[str, Any] = {"model": understood, "found": None, "picture": None}
    if picture is not None:
        image = read_picture(picture)
        found = ImageDetector(detector).detect(image)
        save_drawn(out, image, found)
        boxes_found = zip(found.class_names, found.boxes_xyxy_px, found.confidences, strict=True)
        listed: list[dict[str, Any]] = [
            {"class": name, "confidence": float(sure), "box_xyxy_px": [float(side) for side in box]}
            for name, box, sure in boxes_found
        ]
        record |= {"found": listed, "picture": str(out)}
        for each in listed:
            sides = ", ".join(f"{side:.0f}" for side in each["box_xyxy_px"])
            lines.append(f"found: {each['class']} {each['confidence']:.2f} at {sides}")
        lines.append(f"{len(found)} boxes drawn: {out}")
    answer(as_json, record, *lines)


PosesOption = Annotated[
    Path | None, typer.Option("--poses", help="CSV: how each picture was taken, before what its file says.")
]
TilesOption = Annotated[int, typer.Option(min=1, max=8, help="Split each picture into tiles x tiles.")]


@friendly
@by_options()
def detect_evaluate(
    dataset: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="COCO, SeaDronesSee, YOLO or VisDrone folder.")
    ],
    model: Annotated[str, typer.Option(help="'skysweep' or the path of an ONNX file.")] = "skysweep",
    against: Annotated[
        str | None, typer.Option(help="Another model, to compare with on the same pictures.")
    ] = None,
    stock: Annotated[
        bool, typer.Option("--stock", help="Also fetch and evaluate the COCO-trained YOLOv3-tiny.")
    ] = False,
    confidence: Annotated[
        float, typer.Option(min=0.05, max=0.99, help="Detections below are not counted.")
    ] = 0.25,
    tiles: TilesOption = 1,
    boxes: BoxesOption = None,
    pixels: PixelsOption = None,
    channels: ChannelsOption = None,
    renames: RenamesOption = None,
    poses: PosesOption = None,
    report: Annotated[Path | None, typer.Option(help="HTML file to write, with curves and mistakes.")] = None,
    as_json: JsonOption = False,
) -> None:
    """How good a detector is on labelled pictures: recall, precision and false reports.

    By class, pixels on target, altitude and light; a picture and, where height and lens are known, a hectare.

    Examples:

        skysweep detect evaluate held-out --stock

        skysweep detect evaluate VisDrone2019-DET-val --report visdrone.html

        skysweep detect evaluate my-labelled-flights --model old.onnx --against new.onnx --json
    """
    from skysweep.detection.layouts import Told
    from skysweep.detection.model_files import OWN_MODEL, existing_model_file, sha256_of
    from skysweep.detection.photos.pose_table import read_poses
    from skysweep.detection.training.class_map import parse_renames, refuse_unused
    from skysweep.detection.training.evaluate import CONFIDENCE_FLOOR, evaluate
    from skysweep.detection.training.reading import read_dataset, with_our_classes, with_poses
    from skysweep.detection.yolo import YoloDetector
    from skysweep.experiments.pictures.paired import differences, paired_grid, paired_json
    from skysweep.experiments.pictures.report import refuse_no_page, write_report
    from skysweep.experiments.pictures.tables import classes_json, grids, scores_json

    if report is not None:
        refuse_no_page(report)
    named = parse_renames(renames or [])
    table = None if poses is None else read_poses(poses)
    labelled = read_dataset(dataset)
    if labelled.camera == "thermal" and model == OWN_MODEL:
        warn(f"--model {model}: knows visible pictures only, and these are thermal; write skysweep-thermal")
    data = with_our_classes(labelled, named)
    with counting("reading") as reading:
        data = with_poses(data, table, reading)
    models: dict[str, Path | str] = {model: model}
    if against is not None:
        if sha256_of(existing_model_file(against)) == sha256_of(existing_model_file(model)):
            raise UserError(f"--against {against}: is the same model as {model}; write another one")
        models[against] = against
    if stock:
        from skysweep.detection.training.stock import stock_model_path

        models["YOLOv3-tiny (COCO)"] = stock_model_path()
    told = Told(boxes, pixels, channels)

    def opened(path: Path | str, told: Told) -> YoloDetector:
        return YoloDetector(path, confidence_min=CONFIDENCE_FLOOR, tiles=tiles, threads=2, **told._asdict())

    detectors = {model: opened(model, told)}
    for name, path in models.items():
        if name != model:
            try:
                detectors[name] = opened(path, Told())
            except UserError:
                if told == Told():
                    raise
                detectors[name] = opened(path, told)  # what its file leaves open, it shares with the model
    known = [name for detector in detectors.values() for name in detector.class_names]
    refuse_unused(named, [*labelled.class_names, *known])
    evaluations = {}
    for name, detector in detectors.items():
        with counting(name) as looking:
            evaluations[name] = evaluate(
                detector, data, confidence_min=confidence, renames=named, progress=looking
            )
    first = evaluations[model]
    others = {name: differences(first, other) for name, other in evaluations.items() if name != model}
    if report is not None:
        write_report(report, data, evaluations)
    record = {
        "layout": data.layout,
        "classes": classes_json(first),
        "detectors": {name: scores_json(evaluation) for name, evaluation in evaluations.items()},
        "paired": {name: paired_json(found) for name, found in others.items()},
        "report": None if report is None else str(report),
    }
    shown = [paired_grid(model, name, found) for name, found in others.items()]
    written = [] if report is None else [f"report: {report}"]
    answer(as_json, record, f"{data.layout} labels: {data.path}", *grids(evaluations), *shown, *written)


@friendly
@by_options()
def detect_run(
    source: Annotated[Path, typer.Argument(metavar="FOLDER_OR_VIDEO", help="The pictures of a flight.")],
    out: Annotated[Path, typer.Option(help="Run folder to write, or to go on with.")] = Path("looked-at"),
    model: Annotated[str, typer.Option(help="'skysweep' or the path of an ONNX file.")] = "skysweep",
    find: Annotated[
        list[str] | None,
        typer.Option(help="Class to report; may be repeated. Default: person, boat, stop sign."),
    ] = None,
    confidence: Annotated[
        float, typer.Option(min=0.05, max=0.99, help="Detections below are dropped.")
    ] = 0.25,
    tiles: TilesOption = 1,
    boxes: BoxesOption = None,
    pixels: PixelsOption = None,
    channels: ChannelsOption = None,
    poses: PosesOption = None,
    dem: Annotated[
        Path | None, typer.Option(help="Elevation model (GeoTIFF) of the ground; without one it is level.")
    ] = None,
    hfov_deg: Annotated[
        float | None,
        typer.Option(min=1.0, max=150.0, help="Horizontal field of view, where the pictures do not say it."),
    ] = None,
    every: Annotated[
        float, typer.Option(min=0.02, max=3600.0, help="Seconds between frames of a video.")
    ] = 1.0,
    as_json: JsonOption = False,
) -> None:
    """Put what a detector finds in the pictures of a flight on the map, with the exports of a mission.

    Place, height, direction and lens come from EXIF and XMP (DJI, Autel, Parrot, Skydio, FLIR) or --poses.
    The same command goes on where it was interrupted.

    Examples:

        skysweep detect run DCIM/100MEDIA --out runs/search-1

        skysweep detect run flight.mp4 --poses flight.csv --every 0.5 --dem hills.tif

        skysweep export runs/search-1 --format kmz
    """
    from skysweep.flights.photographed.run import Options, look_at_flight
    from skysweep.results.pictures_report import left_out_words

    classes = tuple(find or ())
    options = Options(model, classes, confidence, tiles, boxes, pixels, channels, poses, dem, hfov_deg, every)
    with counting("looking") as looking:
        looked = look_at_flight(source, out, options, looking)
    for problem in looked.left_out:
        warn(f"{problem.name} {problem.why}")
    record = {
        "folder": str(out),
        "pictures": looked.n_pictures,
        "candidates": looked.n_candidates,
        "left_out": [problem._asdict() for problem in looked.left_out],
        "detections_left_out": looked.detections_left_out,
    }
    lines = [f"candidates: {looked.n_candidates}, pictures: {looked.n_pictures}; {out / 'report.html'}"]
    if looked.left_out:
        lines.append(f"pictures left out: {len(looked.left_out)}")
    if looked.detections_left_out:
        lines.append(left_out_words(looked.detections_left_out))
    answer(as_json, record, *lines)
