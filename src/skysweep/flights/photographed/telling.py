"""The run folder of a photographed flight: a journal of looks and candidates, and their pictures."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from skysweep import __version__
from skysweep.detection.model_files import fingerprint
from skysweep.errors import UserError
from skysweep.files.writing import whole_files
from skysweep.flights.fly import SETUP
from skysweep.flights.photographed.places import pose_of
from skysweep.flights.photographed.shots import Problem, Reader, Shot
from skysweep.flights.pictures import PictureBook
from skysweep.geometry.camera import CameraPose
from skysweep.mission.journal import FileJournal, Journal
from skysweep.results.run_folder import (
    CLOCK,
    CONFIG,
    CONFIG_FILE,
    GROUND,
    JOURNAL_FILE,
    LEFT_OUT,
    PHOTOGRAPHED,
    PICTURES,
    PLAN,
    digest_of_config,
)
from skysweep.scenarios.files import write_scenario
from skysweep.scenarios.model import Scenario
from skysweep.tracking.tracker import GroundTracker, TrackerModel
from skysweep.types import Answer, Detections, EventKind, Frame, Mode
from skysweep.worlds.ground_files import ground_digest
from skysweep.worlds.world import World

HAVE_A_LOOK = "a detector found it in the pictures of a flight, and nobody has looked at it"
_MODEL = TrackerModel(angle_std_rad=math.radians(2.0), position_std_m=2.0, common_std_m=1.5)


class _Shown:
    """The picture that a picture book keeps candidates of."""

    last_look: tuple[Frame, Detections] | None = None


def tell(
    folder: Path,
    scenario: Scenario,
    world: World,
    shots: Sequence[Shot],
    answers: Sequence[Answer],
    problems: Sequence[Problem],
) -> int:
    """Write configuration, journal and the pictures of candidates into the folder; the number of candidates.

    An earlier journal there is replaced: it was made of fewer answers. Raises CannotWriteError.
    """
    for name in (JOURNAL_FILE, CONFIG_FILE):
        (folder / name).unlink(missing_ok=True)
    shutil.rmtree(folder / PICTURES, ignore_errors=True)
    with whole_files(folder) as unfinished:
        write_scenario(scenario, unfinished / CONFIG_FILE)
        with closing(FileJournal(unfinished / JOURNAL_FILE)) as journal, closing(Reader()) as reader:
            ground = ground_digest(scenario)
            journal.write(
                0.0,
                SETUP,
                version=__version__,
                seed=0,
                sensor="imaging",
                renderer=None,
                threads=1,
                model=fingerprint(scenario.detector.model),
                replays=False,
                truth=False,
                **{CONFIG: digest_of_config(unfinished), PLAN: PHOTOGRAPHED},
                **({} if ground is None else {GROUND: ground}),
            )
            journal.write(
                0.0, "start", scenario=scenario.name, strategy=PHOTOGRAPHED, seed=0, sensor="imaging"
            )
            if shots[0].taken.utc is not None:
                journal.write(0.0, CLOCK, utc=shots[0].taken.utc.isoformat(timespec="milliseconds"))
            for problem in problems:
                journal.write(0.0, LEFT_OUT, picture=problem.name, why=problem.why)
            n = _tell_looks(journal, unfinished / PICTURES, scenario, world, shots, answers, reader)
            if journal.failed is not None:
                raise UserError(f"{journal.failed}; make room, then give the same command again")
    return n


def _tell_looks(
    journal: Journal,
    pictures: Path,
    scenario: Scenario,
    world: World,
    shots: Sequence[Shot],
    answers: Sequence[Answer],
    reader: Reader,
) -> int:
    ground = world.terrain
    tracker = GroundTracker(ground.height_m, scenario.target_sizes_m, _MODEL)
    shown = _Shown()
    book = PictureBook(journal, pictures, shown, ground.height_at_m)
    for shot, answer in zip(shots, answers, strict=True):
        pose = pose_of(shot, scenario, world)
        _tell_state(journal, shot.time_s, pose)
        if answer.failure is not None:
            journal.write(shot.time_s, "look", failure=f"{shot.name} {answer.failure}")
            journal.write(shot.time_s, LEFT_OUT, picture=shot.name, why=answer.failure)
            continue
        look = answer.to(Frame(shot.time_s, np.empty((0, 0, 3), np.uint8), pose, shot.lens))
        journal.write(
            shot.time_s,
            "look",
            picture=shot.name,
            boxes_xyxy_px=look.boxes_xyxy_px,
            confidences=look.confidences,
            class_names=look.class_names,
        )
        sightings = tracker.update(look)
        if not sightings:
            continue
        shown.last_look = Frame(shot.time_s, reader.read(shot), pose, shot.lens), look
        for s in sightings:
            book.write(
                s.time_s,
                "sighting",
                candidate=s.candidate_id,
                class_name=tracker.candidates()[s.candidate_id].class_name,
                new=s.is_new,
                p=s.position_enu_m,
                confidence=s.confidence,
                altitude_agl_m=s.camera_altitude_agl_m,
            )
    end_s = shots[-1].time_s
    for candidate in tracker.candidates().values():
        journal.write(
            end_s,
            EventKind.UNCHECKED,
            candidate=candidate.id,
            p=candidate.position_enu_m,
            covariance_m2=candidate.covariance_m2,
            reason=HAVE_A_LOOK,
        )
    journal.write(end_s, EventKind.FINISHED)
    journal.write(end_s, "end", reason="all pictures looked at")
    return len(tracker.candidates())


def _tell_state(journal: Journal, time_s: float, pose: CameraPose) -> None:
    journal.write(
        time_s,
        "state",
        p=pose.position_enu_m,
        v=np.zeros(3),
        mode=Mode.SCAN,
        cam={"p": pose.position_enu_m, "R": pose.R_camera_to_enu.ravel()},
    )
