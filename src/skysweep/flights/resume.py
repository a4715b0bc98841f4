"""Resumes the interrupted mission of a run folder."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from skysweep import __version__
from skysweep.errors import UserError
from skysweep.files.line_file import Lines, read_sound_lines
from skysweep.flights.build import DEFAULT_RIG, build_mission
from skysweep.flights.fly import SETUP, finish, fly_in, setup_of
from skysweep.flights.replay import recorded_answers, restored
from skysweep.flights.rig import Rig, Say, nothing
from skysweep.mission.journal import FileJournal, journal_remedy
from skysweep.mission.mission import Mission
from skysweep.mission.orders import ORDER
from skysweep.results.journal_lines import can_be_gone_on_with
from skysweep.results.run_folder import (
    CONFIG_FILE,
    JOURNAL_FILE,
    PLAN,
    SUMMARY_FILE,
    Record,
    digest_of_plan,
    flown_scenario,
    is_older,
    refuse_links,
    summary_of_complete,
)
from skysweep.results.summary import RunSummary
from skysweep.results.summary_file import read_summary
from skysweep.scenarios.model import Scenario
from skysweep.text import printable
from skysweep.types import EventKind

_END = "end"  # kind of a whole journal's last line
_OTHER_COMMAND = {
    False: (
        "its vehicle, camera or detector is not part of skysweep and cannot be replayed; resume a flight of "
        "'skysweep fly' with  skysweep fly {}, fly any other again into a new folder"
    ),
    True: "the mission was simulated; resume it with  skysweep resume {}",
}


def resume_folder(folder: Path, rig: Rig = DEFAULT_RIG, from_sound_lines: bool = False) -> RunSummary:
    """Resume the interrupted mission of a run folder; its summary.

    A simulated mission ends as if it had never been interrupted, except for the wall time. A mission of an
    external vehicle continues with that of the ``rig``, from where it is now, and with the sensor, renderer
    and threads it was begun with. Only new finds are announced. A complete mission is left alone. With
    ``from_sound_lines`` a damaged journal is set aside, and the mission continues from the lines before the
    damage; a real vehicle flies the rest again.

    Raises UserError if there is no mission, it still flies, its folder is damaged, or its parts or settings
    have changed; nothing is written then.
    """
    started = time.perf_counter()
    summary = summary_of_complete(folder, from_sound_lines)
    if summary is not None:
        return cast("RunSummary", dict(summary))
    path = _begun_journal(folder)
    if from_sound_lines:
        _tell_lost_orders(path, rig.say)
    with closing(FileJournal(path, _free_name(path) if from_sound_lines else None)) as journal:
        journal.listeners.append(rig.hear)
        begun = _begun(folder, journal.records)
        if journal.records[-1].get("kind") == _END:
            flown_scenario(folder, journal.records)
            journal.mend()
            return finish(folder, None, rig)
        scenario = _scenario_to_go_on_with(folder, journal.records)
        journal.replays = begun["replays"]
        if begun["replays"] == (rig.vehicle is not None):
            raise UserError(f"{folder}: {_OTHER_COMMAND[rig.vehicle is not None].format(folder)}")
        if from_sound_lines and rig.vehicle is not None:
            _refuse_ended_flight(folder)
        rig = replace(
            rig, sensor=begun["sensor"], renderer=begun["renderer"] or "auto", threads=begun["threads"]
        )
        mission = build_mission(scenario, begun["seed"], rig)
        with closing(mission.sensor):
            _refuse_other_parts(folder, begun, setup_of(mission, begun["threads"]))
            rig.prepare(mission)
            if rig.vehicle is not None:
                _fly_on(folder, mission, journal, rig)
            else:
                if mission.pictures is not None:
                    mission.pictures.recall(recorded_answers(journal.records))
                fly_in(folder, mission, journal, rig, again=journal.records[1:])
        return finish(folder, started, rig)


def begun_scenario(folder: Path, from_sound_lines: bool = False, say: Say = nothing) -> Scenario:
    """The scenario of a flight that can be resumed; ``say`` gets what is left out of a damaged journal.

    Raises UserError as ``resume_folder`` does.
    """
    path = _begun_journal(folder)
    lines = read_sound_lines(path)
    if not from_sound_lines:
        lines.refuse_damaged(path, journal_remedy(path))
    _refuse_damaged_begin(path, lines)
    begun = _begun(folder, lines.records)
    scenario = _scenario_to_go_on_with(folder, lines.records)
    if begun["replays"]:
        raise UserError(f"{folder}: {_OTHER_COMMAND[True].format(folder)}")
    if from_sound_lines:
        _refuse_ended_flight(folder)
    if lines.damaged is not None:
        say(
            f"{path}: line {lines.damaged} is damaged and left out with all lines after it; the flight after "
            f"{lines.records[-1]['t']:.0f} s is unknown, and its area is searched again"
        )
    return scenario


def _begun_journal(folder: Path) -> Path:
    path = folder / JOURNAL_FILE
    if not (folder / CONFIG_FILE).is_file() or not path.is_file():
        raise UserError(f"{folder}: {_nothing_begun(folder)}")
    refuse_links(folder)
    return path


def _tell_lost_orders(path: Path, say: Say) -> None:
    """Say which orders stand behind the damage of a journal: a mission that goes on does not know of them."""
    lines = read_sound_lines(path)
    _refuse_damaged_begin(path, lines)
    if lines.damaged is None:
        return
    lost = []
    for line in path.read_bytes().splitlines()[lines.damaged - 1 :]:
        try:
            record = json.loads(line)
        except ValueError:
            continue
        if isinstance(record, dict) and record.get("kind") == ORDER:
            of = "" if record.get("candidate") is None else f" {record['candidate']}"
            lost.append(printable(f"{record.get('word')}{of}"))
    if lost:
        say(
            f"{path}: line {lines.damaged} is damaged, and what the operator said after it is left out: "
            f"{', '.join(lost)}; say it again"
        )


def _refuse_damaged_begin(path: Path, lines: Lines) -> None:
    if lines.damaged == 1:
        raise UserError(
            f"{path}: line 1 is damaged, without which the flight cannot be gone on with; if it had ended, "
            "what it found is in the folder's targets files"
        )


def _begun(folder: Path, records: Sequence[Record]) -> Record:
    if not records:
        raise UserError(f"{folder}: {_nothing_begun(folder)}")
    return records[0]


def _scenario_to_go_on_with(folder: Path, records: Sequence[Record]) -> Scenario:
    begun = records[0]
    if begun.get("kind") != SETUP or begun.get("version") != __version__ or is_older(records):
        version = begun.get("version", "0.1.0")
        other = f"skysweep {version}" if version != __version__ else f"an older skysweep {version}"
        raise UserError(
            f"{folder}: the mission was begun by {other}, and this is {__version__}; install that one to "
            "resume it, or fly it again into a new folder"
        )
    odd = next((k for k, record in enumerate(records, start=1) if not can_be_gone_on_with(record)), None)
    if odd is not None:
        raise UserError(
            f"{folder / JOURNAL_FILE}: line {odd} was not written by a mission; fly it into a new folder"
        )
    scenario = flown_scenario(folder, records)
    if digest_of_plan(scenario) != begun.get(PLAN):
        raise UserError(
            f"{scenario.search.plan}: is not the plan that the mission was begun with "
            f"(SHA-256 {begun.get(PLAN)}); put that back, or fly it again into a new folder"
        )
    return scenario


def _refuse_ended_flight(folder: Path) -> None:
    """The lines that are left out may contain its end, and the vehicle would take off again."""
    path = folder / SUMMARY_FILE
    if path.is_file() and read_summary(path)[0]["ended"]:
        raise UserError(
            f"{folder}: its flight had ended; 'skysweep report {shlex.quote(str(folder))} --from-sound-lines "
            "--out NEW_FOLDER' reports its undamaged part"
        )


def _refuse_other_parts(folder: Path, begun: Mapping[str, Any], setup: Mapping[str, Any]) -> None:
    for field, now in setup.items():
        if begun.get(field) != now:
            raise UserError(
                f"{folder}: the mission was begun with {field} {begun.get(field)}, and now it is {now}; "
                "put back what it was, or fly it again into a new folder"
            )


def _fly_on(folder: Path, mission: Mission, journal: FileJournal, rig: Rig) -> None:
    mission = restored(mission, journal)
    last_s = float(journal.records[-1]["t"])
    kinds = {r["kind"] for r in journal.records}
    if "landed" in kinds or (EventKind.FINISHED in kinds and not mission.vehicle.state().airborne):
        if "landed" not in kinds:
            journal.write(last_s, "landed")
        journal.write(last_s, _END, reason="completed" if EventKind.FINISHED in kinds else "broken off")
    else:
        fly_in(folder, mission, journal, rig, journal.records)


def _nothing_begun(folder: Path) -> str:
    if (folder / CONFIG_FILE).is_file():
        config = shlex.quote(str(folder / CONFIG_FILE))
        return (
            "its mission was broken off before take-off; fly it with  "
            f"skysweep run {config} --out NEW_FOLDER  and the options of before"
        )
    return f"has no {CONFIG_FILE}; give a folder that 'skysweep run' wrote"


def _free_name(path: Path) -> Path:
    names = (path.with_name(f"{path.name}.damaged{k or ''}") for k in range(10_000))
    return next(name for name in names if not name.exists())
