"""Going on with the mission of a run folder that was broken off."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from skysweep import __version__
from skysweep.errors import UserError
from skysweep.experiments.single import SETUP, Say, Watch, finish, fly_in, setup_of
from skysweep.mission.build import build_mission
from skysweep.mission.journal import FileJournal
from skysweep.mission.loop import Mission, Operator
from skysweep.mission.resume import recorded_answers, restored
from skysweep.results.run_folder import CONFIG_FILE, JOURNAL_FILE, SUMMARY_FILE
from skysweep.scenarios.files import load_scenario
from skysweep.sensing.imaging import ImagingSensor
from skysweep.types import Camera, Vehicle

_END = "end"  # kind of a whole journal's last line
_OTHER_COMMAND = {
    False: (
        "its vehicle, camera or detector was outside of skysweep and cannot be replayed; a flight of "
        "'skysweep fly' goes on with  skysweep fly {}, any other is flown again into a new folder"
    ),
    True: "the mission was simulated; go on with  skysweep resume {}",
}


def resume_folder(
    folder: Path,
    watch: Watch | None = None,
    from_sound_lines: bool = False,
    vehicle: Vehicle | None = None,
    camera: Camera | None = None,
    operator: Operator = lambda: None,
    say: Say = lambda _words: None,
) -> dict[str, Any]:
    """Go on with the mission of a run folder where it was broken off; its summary.

    A simulated mission ends as if it had never been broken off, but for the wall time. One that a ``vehicle``
    from outside flew goes on with that, from where it is now; ``camera``, ``operator`` and ``say`` are as in
    ``fly_to_folder``, and only what is new is said. A complete mission is left alone. With
    ``from_sound_lines`` a journal that is damaged in the middle is set aside and the lines before the damage
    are gone on from.

    Raises UserError when there is no mission, it still flies, its journal is damaged, or what it was begun
    with is not what there is now.
    """
    started = time.perf_counter()
    summary = summary_of_complete(folder)
    if summary is not None:
        return summary
    path = folder / JOURNAL_FILE
    if not (folder / CONFIG_FILE).is_file() or not path.is_file():
        raise UserError(f"{folder}: {_nothing_begun(folder)}")
    with closing(FileJournal(path, _free_name(path) if from_sound_lines else None)) as journal:
        if not journal.records:
            raise UserError(f"{folder}: {_nothing_begun(folder)}")
        if journal.records[-1]["kind"] == _END:
            return finish(folder, None)
        begun = _begun(folder, journal)
        if begun["replays"] == (vehicle is not None):
            raise UserError(f"{folder}: {_OTHER_COMMAND[vehicle is not None].format(folder)}")
        mission = build_mission(
            load_scenario(folder / CONFIG_FILE),
            begun["seed"],
            begun["sensor"],
            begun["renderer"] or "auto",
            begun["threads"],
            vehicle,
            camera,
        )
        with closing(mission.sensor):
            _refuse_other_parts(folder, begun, setup_of(mission, begun["threads"]))
            if vehicle is None:
                _fly_again(folder, mission, journal, watch, say)
            else:
                _fly_on(folder, mission, journal, watch, operator, say)
        return finish(folder, started)


def summary_of_complete(folder: Path) -> dict[str, Any] | None:
    """The summary of a mission that has ended and whose results are written, else None."""
    try:
        summary: dict[str, Any] = json.loads((folder / SUMMARY_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return summary if summary.get("ended", True) else None


def _begun(folder: Path, journal: FileJournal) -> dict[str, Any]:
    """With what the mission was begun."""
    begun = journal.records[0]
    if begun["kind"] != SETUP or begun["version"] != __version__:
        version = begun.get("version", "0.1.0")
        raise UserError(
            f"{folder}: the mission was begun by skysweep {version}, and this is {__version__}; install that "
            "one to go on, or fly it again into a new folder"
        )
    return begun


def _refuse_other_parts(folder: Path, begun: Mapping[str, Any], setup: Mapping[str, Any]) -> None:
    for field, now in setup.items():
        if begun.get(field) != now:
            raise UserError(
                f"{folder}: the mission was begun with {field} {begun.get(field)}, and now it is {now}; "
                "put back what it was, or fly it again into a new folder"
            )


def _fly_again(folder: Path, mission: Mission, journal: FileJournal, watch: Watch | None, say: Say) -> None:
    if isinstance(mission.sensor, ImagingSensor):
        mission.sensor.recall(recorded_answers(journal.records))
    fly_in(folder, mission, journal, watch, again=journal.records[1:], say=say)


def _fly_on(
    folder: Path,
    mission: Mission,
    journal: FileJournal,
    watch: Watch | None,
    operator: Operator,
    say: Say,
) -> None:
    mission = restored(mission, journal)
    last_s = float(journal.records[-1]["t"])
    kinds = {r["kind"] for r in journal.records}
    if "landed" in kinds or ("finished" in kinds and not mission.vehicle.state().airborne):
        if "landed" not in kinds:
            journal.write(last_s, "landed")
        journal.write(last_s, _END, reason="completed" if "finished" in kinds else "broken off")
    else:
        fly_in(folder, mission, journal, watch, operator, journal.records, say=say)


def _nothing_begun(folder: Path) -> str:
    if (folder / CONFIG_FILE).is_file():
        config = shlex.quote(str(folder / CONFIG_FILE))
        return (
            f"its mission was broken off before take-off; fly it with  skysweep run {config} --out NEW_FOLDER"
        )
    return f"has no {CONFIG_FILE}; give a folder that 'skysweep run' wrote"


def _free_name(path: Path) -> Path:
    names = (path.with_name(f"{path.name}.damaged{k or ''}") for k in range(10_000))
    return next(name for name in names if not name.exists())
