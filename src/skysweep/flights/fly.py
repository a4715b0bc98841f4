"""Flies one mission into one run folder."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skysweep import __version__
from skysweep.detection.model_files import fingerprint
from skysweep.errors import CannotWriteError, UserError
from skysweep.files.writing import make_folder
from skysweep.flights.build import DEFAULT_RIG, build_mission
from skysweep.flights.replay import RecordedOperator, RecordedSensor, ReplayJournal
from skysweep.flights.rig import Rig
from skysweep.mission.journal import FileJournal, Journal, MemoryJournal, read_journal, resume_command
from skysweep.mission.loop import fly
from skysweep.mission.mission import Mission
from skysweep.planning.flight_plan import plan_scenario
from skysweep.results.announcements import Announcer
from skysweep.results.metrics import compute_summary
from skysweep.results.run_folder import (
    CLOCK,
    CONFIG,
    CONFIG_FILE,
    FILM,
    GROUND,
    JOURNAL_FILE,
    PICTURES,
    PLAN,
    SPEC_FILE,
    TABLE_FILE,
    Run,
    digest_of_config,
    digest_of_plan,
    load_flown,
    refuse_links,
)
from skysweep.results.summary import RunSummary, Summary
from skysweep.scenarios.files import with_paths_beside, write_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.statistical.model import model_for
from skysweep.strategies import StrategySpec, fingerprint_of
from skysweep.strategies.covering import as_covered
from skysweep.worlds.ground_files import ground_digest

if TYPE_CHECKING:
    from skysweep.flights.pictures import PictureBook

SETUP = "setup"  # kind of a journal's first line
GIVEN_DETECTOR = {"model": "of another process"}  # in that line: no resumed mission has it


def fly_to_folder(scenario: Scenario, seed: int, out: Path, rig: Rig = DEFAULT_RIG) -> RunSummary:
    """Fly one mission, write its run folder and return its summary.

    Raises UserError if ``out`` already holds a mission (nothing is ever overwritten), or the disk was full:
    the vehicle has come home then, and ``resume_folder`` continues once there is room.
    """
    started = time.perf_counter()
    refuse_other_mission(out)
    scenario = with_paths_beside(scenario, Path.cwd())
    mission = build_mission(scenario, seed, rig)
    with closing(mission.sensor):
        make_folder(out)
        with closing(FileJournal(out / JOURNAL_FILE)) as journal:
            _refuse_flown(out, journal.records)
            journal.listeners.append(rig.hear)
            begin(out, mission, journal, rig)
            asked = time.perf_counter()
            rig.prepare(mission)
            started += time.perf_counter() - asked  # waiting for a person is not flying
            fly_in(out, mission, journal, rig)
            return finish(out, started, rig)


def begin(folder: Path, mission: Mission, journal: FileJournal, rig: Rig) -> None:
    """Write the configuration of a mission and the first line of its journal.

    Raises UserError if they cannot be written.
    """
    write_scenario(mission.scenario, folder / CONFIG_FILE)
    journal.replays = mission.replays
    journal.write(0.0, SETUP, **_begun_with(mission, rig), **{CONFIG: digest_of_config(folder)})
    if journal.failed is not None:
        raise UserError(
            f"{journal.failed}, and nothing was flown; make room, then give the same command again"
        )


def _begun_with(mission: Mission, rig: Rig) -> dict[str, Any]:
    return setup_of(mission, rig.threads) | (GIVEN_DETECTOR if rig.detector is not None else {})


def fly_in_memory(
    scenario: Scenario, seed: int, sensor_name: str = "statistical", strategy: StrategySpec | None = None
) -> Summary:
    """Fly one mission and return its summary; nothing is written. ``strategy`` is as in ``Rig``."""
    started = time.perf_counter()
    mission = build_mission(scenario, seed, Rig(sensor_name, threads=1, strategy=strategy))
    journal = MemoryJournal()
    with closing(mission.sensor):
        fly(mission, journal)
    run = Run(scenario, tuple(journal.lines))
    return compute_summary(
        run,
        scan_only_time_s=plan_scenario(as_covered(scenario, strategy))[1].search_time_s,
        wall_time_s=time.perf_counter() - started,
    )


def fly_unwritten(scenario: Scenario, seed: int, rig: Rig, pictures: Path) -> Run:
    """Fly one mission as ``fly_to_folder`` does, but with its journal in memory; the run.

    ``pictures`` is a folder for the best picture of every candidate. Raises UserError as ``build_mission``.
    """
    scenario = with_paths_beside(scenario, Path.cwd())
    mission = build_mission(scenario, seed, rig)
    journal = MemoryJournal()
    with closing(mission.sensor):
        journal.write(0.0, SETUP, **_begun_with(mission, rig))
        rig.prepare(mission)
        mission, notes, _ = _with_pictures(mission, journal, pictures)
        fly(mission, notes, rig.watch, rig.operator)
    return Run(scenario, tuple(journal.lines), pictures=tuple(sorted(pictures.glob("*.jpg"))))


def _with_pictures(
    mission: Mission,
    notes: Journal,
    folder: Path,
    before: Sequence[Mapping[str, Any]] = (),
    film: Path | None = None,
) -> tuple[Mission, Journal, PictureBook | None]:
    """Mission and journal that record the detector's answers and keep pictures in these folders."""
    if mission.pictures is None:
        return mission, notes, None
    from skysweep.flights.pictures import PictureBook

    book = PictureBook(notes, folder, mission.pictures, mission.ground_at_m, before)
    kept: Journal = book
    if film is not None:
        from skysweep.flights.film import Film

        kept = Film(book, film, mission.pictures)
    return replace(mission, sensor=RecordedSensor(mission.sensor, kept)), kept, book


def fly_in(
    folder: Path,
    mission: Mission,
    journal: FileJournal,
    rig: Rig,
    before: Sequence[Mapping[str, Any]] = (),
    again: Sequence[Mapping[str, Any]] = (),
) -> None:
    """Fly a mission in its existing run folder; ``before`` is as in ``Flight``.

    ``again`` are the lines of the journal that a mission flown again writes first. Raises UserError if the
    disk was full; the vehicle has come home then.
    """
    notes: Journal = journal
    operator = rig.operator
    if again:
        notes = replayed = ReplayJournal(journal, again)
        operator = RecordedOperator(replayed, again, mission.vehicle, operator)
    film = folder / FILM if rig.film else None
    mission, notes, book = _with_pictures(mission, notes, folder / PICTURES, before, film)
    picture_of = {} if book is None else {"picture_of": book.picture_of}
    announcer = Announcer(mission.scenario, journal.records, rig.say, **picture_of)
    journal.listeners.append(announcer.hear)
    if rig.vehicle is not None and not rig.vehicle_waits:
        utc = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
        journal.write(max((r["t"] for r in journal.records), default=0.0), CLOCK, utc=utc)
    fly(mission, notes, rig.watch, operator, before)
    if journal.failed is not None:
        raise UserError(
            f"{journal.failed}, and the vehicle has come home; make room, then  "
            f"{resume_command(folder, mission.replays)}  continues"
        )


def setup_of(mission: Mission, threads: int) -> dict[str, Any]:
    """The settings of a flight beside its scenario; a mission can only resume with the same ones."""
    strategy = fingerprint_of(mission.scenario.search.strategy)
    return {
        "version": __version__,
        "seed": mission.seed,
        "sensor": mission.sensor_name,
        "renderer": mission.pictures.camera.renderer if mission.pictures is not None else None,
        "threads": threads,
        **digests_of_files(mission.scenario, mission.sensor_name),
        **({} if strategy is None else {"strategy": strategy}),
        "replays": mission.replays,
        **({} if _is_simulated(mission) else {"truth": False}),
    }


def digests_of_files(scenario: Scenario, sensor_name: str) -> dict[str, str | None]:
    """Digests of the files beside the configuration that influence a mission.

    ``model``: of the detector, or of the sensor's numbers; ``plan``: as ``digest_of_plan``; ``ground``: as
    ``ground_digest``, if there are such files. Raises UserError as ``model_for`` and ``ground_digest``.
    """
    if sensor_name == "imaging":
        model = fingerprint(scenario.detector.model)
    else:
        model = hashlib.sha256(model_for(scenario).model_dump_json().encode()).hexdigest()
    ground = ground_digest(scenario)
    return {
        "model": model,
        PLAN: digest_of_plan(scenario),
        **({} if ground is None else {GROUND: ground}),
    }


def _is_simulated(mission: Mission) -> bool:
    """Whether the sensor sees the scenario's world, unlike an external camera."""
    pictures = mission.pictures
    return pictures is None or pictures.camera.renderer is not None or mission.vehicle.truth is not None


def finish(folder: Path, started: float | None, rig: Rig) -> RunSummary:
    """Write the results of a flown mission; its summary.

    ``started`` is the beginning of the flight by ``time.perf_counter``; None: unknown. Raises UserError if
    they cannot be written.
    """
    from skysweep.results.writing import write_results

    try:
        wall_time_s = None if started is None else time.perf_counter() - started
        return write_results(load_flown(folder), folder, wall_time_s, rig.on_results)
    except CannotWriteError as error:
        raise UserError(
            f"{folder}: the results cannot be written ({error.strerror}), but the journal is complete; "
            f"make room, then  {resume_command(folder)}  writes them"
        ) from None


def refuse_other_mission(folder: Path) -> None:
    """Raises UserError if a folder holds a mission, or links that lead elsewhere."""
    refuse_links(folder)
    if (folder / SPEC_FILE).exists() or (folder / TABLE_FILE).exists():
        raise UserError(f"{folder}: holds the missions of a sweep or a comparison; write another --out")
    if (folder / JOURNAL_FILE).exists():
        _refuse_flown(folder, read_journal(folder / JOURNAL_FILE))


def _refuse_flown(folder: Path, records: list[dict[str, Any]]) -> None:
    if records:
        raise UserError(
            f"{folder}: already holds a mission; write another --out, or resume it with  "
            f"{resume_command(folder, records[0].get('replays', True))}"
        )
