"""What the detector says of each picture, kept so that an interrupted run goes on where it was."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from skysweep.detection.training.class_map import with_our_names
from skysweep.errors import UserError
from skysweep.files.line_file import LineFile
from skysweep.flights.photographed.shots import Reader, Shot
from skysweep.geometry.camera import CameraPose
from skysweep.types import Answer, Detector, Frame

ANSWERS_FILE = "answers.jsonl"
_NOWHERE = CameraPose(np.zeros(3), np.eye(3))


def answers_of(
    shots: Sequence[Shot],
    detector: Detector,
    classes: Sequence[str],
    folder: Path,
    setup: Mapping[str, Any],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Answer]:
    """The answer to each shot with our ``classes``, by our names; one that is damaged has a failure.

    Each answer is kept in the folder at once. Those of an earlier run are taken from there.
    Raises UserError if that was made with another ``setup``, or nothing can be written.
    """
    path = folder / ANSWERS_FILE
    with (
        closing(LineFile(path, "delete it, and all pictures are looked at again")) as kept,
        closing(Reader()) as reader,
    ):
        if not kept.records:
            kept.append({"setup": dict(setup)}, sync=True)
        elif kept.records[0].get("setup") != setup:
            raise UserError(
                f"{folder}: was begun with other pictures, another detector or other options; "
                "choose another --out"
            )
        known = {(record.get("name"), record.get("file")): record for record in kept.records[1:]}
        found = []
        for number, shot in enumerate(shots, start=1):
            file = _file(shot.path)
            record = known.get((shot.name, file))
            if record is None:
                record = {"name": shot.name, "file": file, **_look(shot, detector, classes, reader)}
                kept.append(record, sync=False)
            found.append(_answer(record))
            progress(number, len(shots))
    return found


def _file(path: Path) -> str:
    """What changes when a file is replaced by another one of its name: its size and time."""
    status = path.stat()
    return f"{status.st_size} {status.st_mtime_ns}"


def _look(shot: Shot, detector: Detector, classes: Sequence[str], reader: Reader) -> dict[str, Any]:
    try:
        image = reader.read(shot)
    except UserError as error:
        return {"failure": str(error).removeprefix(f"{shot.path}: ")}
    found = detector.detect(Frame(shot.time_s, image, _NOWHERE, shot.lens))
    found = with_our_names(found)
    wanted = [k for k, name in enumerate(found.class_names) if name in classes]
    return {
        "boxes_xyxy_px": found.boxes_xyxy_px[wanted].tolist(),
        "confidences": found.confidences[wanted].tolist(),
        "class_names": [found.class_names[k] for k in wanted],
    }


def _answer(record: Mapping[str, Any]) -> Answer:
    if "failure" in record:
        return Answer(np.empty((0, 4)), np.empty(0), (), str(record["failure"]))
    boxes = np.array(record["boxes_xyxy_px"], dtype=float).reshape(-1, 4)
    return Answer(boxes, np.array(record["confidences"], dtype=float), tuple(record["class_names"]))
