"""The report of detectors on labelled pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from skysweep.detection.training.evaluate import Evaluation
from skysweep.detection.training.labelled import LabelledDataset
from skysweep.errors import UserError
from skysweep.experiments.pictures.curves import calibration_error, reliability
from skysweep.experiments.pictures.figures import precision_recall_png, reliability_png
from skysweep.experiments.pictures.mistakes import worst_pictures
from skysweep.experiments.pictures.paired import differences, paired_grid
from skysweep.experiments.pictures.tables import grids
from skysweep.files.writing import whole_files
from skysweep.results.reporting.html import Picture, Section, data_uri, write_page

_WORDS = (
    "A detection is right when it overlaps a label of its class by an intersection over union of at least "
    "0.5. Detections in crowds and ignored regions count neither as right nor as false. Pixels on target are "
    "the longer side of a box. A hectare is one of level ground in the pictures of which height, lens and "
    "pitch are known. "
    "Light is the mean brightness of a picture, from 0 to 255."
)


def refuse_no_page(path: Path) -> None:
    """Raises UserError where a report cannot be written, before anything is looked at."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"--report {path}: is no HTML file; write a name such as evaluation.html")


def write_report(path: Path, data: LabelledDataset, evaluations: Mapping[str, Evaluation]) -> None:
    """Write one self-contained page; of several detectors the first is compared with each other one.

    Raises CannotWriteError if it cannot be written.
    """
    tables = grids(evaluations)
    first_name, first = next(iter(evaluations.items()))
    curves = [
        Picture(
            data_uri(precision_recall_png(evaluations), "image/png"),
            "Precision over recall at all confidences. Dots are at the confidence of the tables.",
            wide=True,
        ),
        Picture(
            data_uri(reliability_png(evaluations), "image/png"),
            "How often a detection of some confidence is right, with 95 % intervals. On the line a "
            "confidence says what it means; below it, it promises too much.",
        ),
    ]
    sections = [Section("Counts", grids=tables[:1]), Section("At every confidence", pictures=curves)]
    compared = [
        paired_grid(first_name, name, differences(first, other))
        for name, other in list(evaluations.items())[1:]
    ]
    if compared:
        sections.insert(1, Section("Compared", grids=compared))
    sections.append(Section("By size, altitude and light", grids=tables[1:]))
    sections += [Section(title, pictures=shown) for title, shown in worst_pictures(evaluations.items())]
    sections.append(Section("What the words mean", [_WORDS], folded=True))
    with whole_files(path.parent) as unfinished:
        title = f"Detectors on {'/'.join(data.path.resolve().parts[-2:])}"
        write_page(
            unfinished / path.name, title, _lead(data, evaluations), sections, _tiles(first_name, first)
        )


def _lead(data: LabelledDataset, evaluations: Mapping[str, Evaluation]) -> str:
    first = next(iter(evaluations.values()))
    ground = "" if first.hectares is None else f" of {first.hectares:.1f} ha of ground"
    return (
        f"{', '.join(evaluations)} on {first.n_images} pictures{ground} with {len(first.labels)} labels "
        f"({data.layout}), at confidence {first.confidence_min:g}."
    )


def _tiles(name: str, e: Evaluation) -> list[tuple[str, str]]:
    tiles = []
    for class_name in e.classes:
        score = e.total(class_name)
        if score.n_targets:
            words = f"of {score.n_targets} {class_name} labels found by {name}"
            tiles.append((f"{score.n_found / score.n_targets:.0%}", words))
        tiles.append((f"{score.n_false / e.n_images:.2f}", f"false {class_name} a picture"))
    error = calibration_error(reliability(e))
    return tiles if error is None else [*tiles, (f"{error:.2f}", "calibration error")]
