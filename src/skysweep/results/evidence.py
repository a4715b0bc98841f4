"""The pictures that a mission kept as evidence, the newest of each candidate, with their captions."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from skysweep.results.crops import crop_of
from skysweep.results.exports import found_targets, unchecked_targets
from skysweep.results.picture_files import SAME_LOOK_S, told_by_name
from skysweep.results.reporting.html import Picture, data_uri
from skysweep.results.reporting.wording import clock
from skysweep.results.run_folder import CandidateStory, Run
from skysweep.types import EventKind

SHOWN_WIDTH_PX = 640  # in a report; the folder has the originals
CROPPED_FROM_PX = 1920  # wide: four times as many pixels as are shown, and more
VERDICTS = ("Confirmed", "Rejected", "Unchecked")


def evidence(run: Run) -> dict[str, list[Picture]]:
    """The pictures in the run's folder by verdict, each group in the order of its candidates' verdicts.

    Candidates that were seen once and never listed are left out. Pictures of an older skysweep are ``Other``.
    """
    titles = titles_of(run)
    pictures: dict[int, Path] = {}
    other = []
    for path in sorted(run.pictures, key=lambda path: (told_by_name(path) or (0, 0.0))[1]):
        told = told_by_name(path)
        if told is None:
            other.append((path, path.stem.replace("_", " ").replace("-", " ")))
        else:
            pictures[told[0]] = path
    groups: dict[str, list[tuple[Path, str]]] = {verdict: [] for verdict in VERDICTS}
    shown_of = {path: candidate for candidate, path in pictures.items()}
    for story in run.candidates:
        title = titles.get(story.id)
        if title is not None and story.id in pictures:
            path = pictures[story.id]
            groups[title.partition(" ")[0]].append((path, f"{title}: {_view(run, story, path)}"))
    return {
        verdict: [
            Picture(uri, caption) for path, caption in shown if (uri := _small(run, path, shown_of.get(path)))
        ]
        for verdict, shown in (groups | {"Other": other}).items()
    }


def titles_of(run: Run) -> dict[int, str]:
    """Verdict and name of every candidate that was listed, beginning with one of ``VERDICTS``."""
    by = {story.id: " by the operator" * story.by_operator for story in run.candidates}
    titles = {t.candidate: f"Confirmed{by[t.candidate]} {t.name}" for t in found_targets(run)}
    titles |= {target.candidate: target.name.capitalize() for target in unchecked_targets(run)}
    rejected = (story for story in run.candidates if story.verdict == EventKind.REJECTED)
    return titles | {
        s.id: f"Rejected{by[s.id]} {s.class_name or 'candidate'} (candidate {s.id})" for s in rejected
    }


def _view(run: Run, story: CandidateStory, path: Path) -> str:
    """The detector's confidence, the height and the time of a picture."""
    time_s = float(path.stem.rpartition("-")[2].removesuffix("s"))
    looks = (r for r in run.events("sighting") if r["candidate"] == story.id)
    seen = next((r for r in looks if abs(r["t"] - time_s) < SAME_LOOK_S), None)
    sure = "not detected" if seen is None else f"confidence {seen['confidence']:.2f}"
    since_start_s = time_s - float(run.start["t"])
    if seen is None:
        height_m = float(np.interp(since_start_s, run.states.time_s, run.altitudes_agl_m))
    else:
        height_m = seen["altitude_agl_m"]
    return f"{sure}, from {height_m:.1f} m above ground, at {clock(since_start_s)}"


def _small(run: Run, path: Path, candidate: int | None) -> str | None:
    """The picture as a data URI, at most ``SHOWN_WIDTH_PX`` wide; None where the file is damaged.

    Of a picture so wide that a candidate would no longer be seen, only what is around the candidate is shown.
    """
    image = cv2.imread(str(path))
    if image is not None and candidate is not None and image.shape[1] > CROPPED_FROM_PX:
        crop = crop_of(run, candidate)
        image = image if crop is None else cv2.imdecode(np.frombuffer(crop, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        return None
    height, width = image.shape[:2]
    scale = min(1.0, SHOWN_WIDTH_PX / width)
    small = cv2.resize(image, (round(width * scale), round(height * scale)), interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])
    return data_uri(jpeg.tobytes(), "image/jpeg")
