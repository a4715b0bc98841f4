"""Reads a mission, finished or broken off, back from its run folder."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta, timezone
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from skysweep.detection.model_files import sha256_of
from skysweep.errors import UserError
from skysweep.files.line_file import read_sound_lines
from skysweep.mission.journal import journal_remedy
from skysweep.mission.notes import NEXT_SORTIE, OF_A_CANDIDATE, OPERATOR, SORTIE
from skysweep.results.journal_lines import can_be_told
from skysweep.results.picture_files import read_picture
from skysweep.results.summary_file import read_summary
from skysweep.scenarios.files import ground_files, load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.text import printable
from skysweep.types import F64, EventKind, Mode
from skysweep.worlds.ground_files import ground_digest
from skysweep.worlds.world import World, WorldObject, build_world

Record = Mapping[str, Any]

CONFIG_FILE = "config.yaml"
JOURNAL_FILE = "journal.jsonl"
SUMMARY_FILE = "summary.json"
SPEC_FILE = "spec.yaml"  # of a sweep
TABLE_FILE = "missions.parquet"  # of a folder of many missions
PICTURES = "pictures"
FILM = "film"  # pictures for the live page and the video, by the time of their look
UNFINISHED = ".part"  # ends the name of a comparison's run folder until its mission is complete
CONFIG = "config"  # field of the journal's first line: SHA-256 of the configuration
PLAN = "plan"  # and of ``search.plan``
GROUND = "ground"  # and of the files of the ground, where there are some
PHOTOGRAPHED = "pictures"  # instead of a strategy and a plan, where the pictures of a flight were looked at
LEFT_OUT = "left_out"  # kind of a line that tells a picture of which nothing was made, and why
CLOCK = "clock"  # kind of a line that tells the UTC of a mission in real time
_ROUNDED_S = 1e-3
_COUNTER_WH = 0.01  # by which a counter of energy falls where it begins again


@dataclass(frozen=True, slots=True)
class States:
    """The vehicle's believed states, oldest first, N rows."""

    time_s: F64  # (N,) since the take-off command
    position_enu_m: F64  # (N, 3)
    mode: tuple[str, ...]  # (N,) as ``types.Mode``
    battery: F64  # (N,) 0..1
    energy_wh: F64  # (N,) used so far
    camera_position_enu_m: F64  # (N, 3)
    R_camera_to_enu: F64  # (N, 3, 3)

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True, slots=True)
class CandidateStory:
    """The history of one candidate. ``verdict`` is confirmed, rejected, or None (never checked)."""

    id: int
    class_name: str | None  # None where the journal does not say and the scenario has several classes
    position_enu_m: F64  # (3,) newest estimate
    n_sightings: int
    first_seen_s: float
    scanned_s: float | None
    verdict: str | None
    verdict_s: float | None
    looked_s: float  # when the last look at it was taken, of those up to the verdict
    confidence: float | None  # best of the sightings up to the verdict
    probability: float | None  # that it is a target, as the strategy last said; None: it says none
    seen_from_m: float | None  # lowest height above it of the sightings up to the verdict
    covariance_m2: F64 | None  # (2, 2) horizontal
    by_operator: bool = False  # the verdict

    @property
    def radius_95_m(self) -> float | None:
        """Radius of the circle around the 95 % error ellipse (chi-square, 2 degrees of freedom: 5.991)."""
        if self.covariance_m2 is None:
            return None
        return float(np.sqrt(5.991 * np.linalg.eigvalsh(self.covariance_m2)[-1]))


@dataclass(frozen=True, slots=True)
class Sortie:
    """One flight of a mission, with one battery. Times count from the mission's first take-off."""

    number: int  # from 1
    took_off_s: float
    landed_s: float | None  # None: it has not landed, as far as the journal says
    why: str  # it landed: a cause, or the end of the mission; empty: it has not
    battery: float  # share left at landing, or in its last state; NaN: not known
    energy_wh: float  # used until then


@dataclass(frozen=True)
class Run:
    """One mission from its journal. Times count from the take-off command."""

    scenario: Scenario
    records: tuple[Record, ...]
    folder: Path | None = None
    known_world: World | None = field(default=None, repr=False)
    seal: int = 0  # checksum of the journal's last line, which covers all of them
    pictures: tuple[Path, ...] = ()  # kept in flight
    summary: Record | None = None  # as written, of a mission that has ended
    left_out: tuple[str, ...] = ()  # damaged parts

    @cached_property
    def start(self) -> Record:
        return self._first("start") or {"t": 0.0, "seed": 0}

    @property
    def seed(self) -> int:
        return int(self.start["seed"])

    @property
    def strategy(self) -> str:
        return str(self.start.get("strategy", self.scenario.search.strategy))

    @cached_property
    def world(self) -> World:
        """The truth, rebuilt from scenario and seed. Raises UserError if the ground has changed."""
        if self.known_world is not None:
            return self.known_world
        if self.folder is not None and ground_digest(self.scenario) != self._setup.get(GROUND):
            files = ", ".join(map(str, ground_files(self.scenario).values()))
            raise UserError(
                f"{files}: are not the files of the ground that the mission was flown over; put those back"
            )
        return build_world(self.scenario, self.seed)

    @cached_property
    def has_truth(self) -> bool:
        """Whether the sensor saw the scenario's world, with targets in it. Else nothing can be judged."""
        return self.is_simulated and bool(self.world.targets)

    @property
    def movers(self) -> list[tuple[int, WorldObject]]:
        """Number and beginning of the world's objects that move; none where the world is not the truth."""
        things = self.world.objects if self.has_truth else ()
        return [(k, thing) for k, thing in enumerate(things) if thing.track is not None]

    @property
    def is_simulated(self) -> bool:
        """Whether the sensor saw the scenario's world, and no camera a real one."""
        return bool(self._setup.get("truth", True))

    @cached_property
    def has_its_plan(self) -> bool:
        """Whether the file of ``search.plan``, if any, is the one that was flown."""
        return digest_of_plan(self.scenario) == self._setup.get(PLAN)

    @property
    def is_photographed(self) -> bool:
        """Whether it tells the pictures of somebody's flight, and no mission."""
        return self.strategy == PHOTOGRAPHED

    @cached_property
    def keeps_looks(self) -> bool:
        """Whether the journal has all looks of the detector."""
        return self._setup.get("sensor") == "imaging"

    @cached_property
    def states(self) -> States:
        """Believed states of the vehicle, without those that lack a position."""
        told = [r for r in self.records if r["kind"] == "state"]
        known = np.isfinite(np.array([r["p"] for r in told], dtype=float).reshape(-1, 3)).all(axis=1)
        rows = [r for r, is_known in zip(told, known.tolist(), strict=True) if is_known]
        n = len(rows)
        cameras = [r.get("cam") or {"p": r["p"], "R": [0, 1, 0, 1, 0, 0, 0, 0, -1]} for r in rows]
        return States(
            np.array([self.since_start(r) for r in rows], dtype=float),
            np.array([r["p"] for r in rows], dtype=float).reshape(n, 3),
            tuple(str(r.get("mode", Mode.SCAN)) for r in rows),
            np.array([r.get("battery", np.nan) for r in rows], dtype=float),
            _added_up(np.array([r.get("energy_wh", np.nan) for r in rows], dtype=float)),
            np.array([c["p"] for c in cameras], dtype=float).reshape(n, 3),
            np.array([c["R"] for c in cameras], dtype=float).reshape(n, 3, 3),
        )

    @cached_property
    def altitudes_agl_m(self) -> F64:
        """(N,) heights of ``states`` above ground."""
        position = self.states.position_enu_m
        return position[:, 2] - self.world.terrain.height_m(position[:, :2]) if len(position) else np.zeros(0)

    @cached_property
    def plan_enu_m(self) -> F64:
        """The waypoints F (K, 3)."""
        record = self._first("plan")
        return np.array(record["waypoints_enu_m"] if record else [], dtype=float).reshape(-1, 3)

    @cached_property
    def candidates(self) -> tuple[CandidateStory, ...]:
        """All candidates in the order of their verdicts, those without one last."""
        told: dict[int, list[Record]] = {}
        for record in self.events(*OF_A_CANDIDATE):
            if record.get("candidate") is not None:
                told.setdefault(int(record["candidate"]), []).append(record)
        stories = [self._story(identity, records) for identity, records in told.items()]
        stories.sort(key=lambda s: (s.verdict_s is None, s.verdict_s or s.first_seen_s, s.id))
        return tuple(stories)

    @cached_property
    def tells_probabilities(self) -> bool:
        """Whether the strategy said how probably a candidate is a target."""
        return any(c.probability is not None for c in self.candidates)

    @cached_property
    def unchecked(self) -> tuple[CandidateStory, ...]:
        """Candidates without a verdict that deserve a look, in the order in which they were first seen.

        These are the mission's own list where it ended, else all that were scanned or seen at least twice.
        """
        left = {record["candidate"] for record in self.events(EventKind.UNCHECKED)}
        if not self.ended:
            left |= {c.id for c in self.candidates if c.scanned_s is not None or c.n_sightings > 1}
        return tuple(c for c in self.candidates if c.verdict is None and c.id in left)

    @property
    def ended(self) -> bool:
        """Whether the journal has its end. Without it the mission was broken off, or still flies."""
        return self._first("end") is not None

    @property
    def finished_s(self) -> float | None:
        """When the last candidate had its verdict and F was empty; None for an unfinished search."""
        return self._time_of(EventKind.FINISHED)

    @property
    def search_end_s(self) -> float:
        """When the search ended: it was finished, or left for the way home, or the journal ends."""
        if self.finished_s is not None:
            return self.finished_s
        taken_off = [k for k, r in enumerate(self.records) if r["kind"] == NEXT_SORTIE]
        of_last = self.records[taken_off[-1] :] if taken_off else self.records
        homeward = (r for r in of_last if r.get("mode") in (Mode.RETURN, Mode.LAND))
        return next((self.since_start(r) for r in homeward), self.last_s)

    @property
    def n_sorties(self) -> int:
        """Number of flights: one more than batteries were changed."""
        return 1 + len(self.events(NEXT_SORTIE))

    @cached_property
    def sorties(self) -> tuple[Sortie, ...]:
        """The flights of the mission, oldest first."""
        begun_s = [0.0, *map(self.since_start, self.events(NEXT_SORTIE))]
        landings = self.events(SORTIE)
        sorties = [
            Sortie(
                k,
                began_s,
                self.since_start(r),
                printable(str(r["why"])),
                math.nan if r["battery"] is None else float(r["battery"]),
                self._used_wh(began_s, r),
            )
            for k, (began_s, r) in enumerate(zip(begun_s, landings, strict=False), start=1)
        ]
        if len(sorties) < len(begun_s):
            states, why = self.states, self.end_reason if self.ended else ""
            before_wh = sum(sortie.energy_wh for sortie in sorties)
            battery, used_wh = (
                v[-1] if len(states) else math.nan for v in (states.battery, states.energy_wh)
            )
            sorties.append(
                Sortie(len(begun_s), begun_s[-1], self.landed_s, why, battery, float(used_wh) - before_wh)
            )
        return tuple(sorties)

    def _used_wh(self, began_s: float, landing: Record) -> float:
        """The energy of a flight. A resumed one knows no more what it had used before."""
        if not self.events("resumed") or not len(self.states):
            return float(landing["energy_wh"])
        used, time_s = self.states.energy_wh, self.states.time_s
        ends = np.searchsorted(time_s, [began_s, self.since_start(landing)], side="right") - 1
        return float(used[ends[1]] - (used[ends[0]] if began_s > 0.0 else 0.0))

    @property
    def landed_s(self) -> float | None:
        return self._time_of("landed")

    @property
    def resumed_s(self) -> float:
        """When the mission was last resumed; 0 for one in one piece."""
        return max((self.since_start(r) for r in self.events("resumed")), default=0.0)

    @property
    def last_s(self) -> float:
        return max((self.since_start(r) for r in self.records), default=0.0)

    @property
    def end_reason(self) -> str:
        record = self._first("end")
        return str(record["reason"]) if record else "broken off"

    def events(self, *kinds: str) -> tuple[Record, ...]:
        return tuple(r for r in self.records if r["kind"] in kinds)

    def utc_of(self, time_s: float) -> datetime | None:
        """The UTC at a mission time; None of a simulated mission, which has a clock of its own."""
        told = [r for r in self.events(CLOCK) if self.since_start(r) <= time_s + _ROUNDED_S]
        if not told:
            return None
        since_s = time_s - self.since_start(told[-1])
        return datetime.fromisoformat(told[-1]["utc"]).astimezone(timezone.utc) + timedelta(seconds=since_s)

    def since_start(self, record: Record) -> float:
        return float(record["t"]) - float(self.start["t"])

    @cached_property
    def _setup(self) -> Record:
        return self._first("setup") or {}

    def _first(self, kind: str) -> Record | None:
        return next((r for r in self.records if r["kind"] == kind), None)

    def _time_of(self, kind: str) -> float | None:
        record = self._first(kind)
        return None if record is None else self.since_start(record)

    def _story(self, identity: int, records: list[Record]) -> CandidateStory:
        verdicts = [r for r in records if r["kind"] in (EventKind.CONFIRMED, EventKind.REJECTED)]
        by_operator = [r for r in verdicts if r.get("by") == OPERATOR]
        verdict = _standing(verdicts)
        known = records if verdict is None else records[: records.index(verdict) + 1]
        scanned = next((r for r in known if r["kind"] == EventKind.SCANNED), None)
        sightings = [r for r in known if r["kind"] == "sighting"]
        named, classes = _newest(known, "class_name"), self.scenario.target_classes
        return CandidateStory(
            id=identity,
            class_name=printable(str(named)) if named else (classes[0] if len(classes) == 1 else None),
            position_enu_m=np.asarray(_newest(known, "p"), dtype=float),
            n_sightings=len(sightings),
            first_seen_s=self.since_start(known[0]),
            scanned_s=None if scanned is None else self.since_start(scanned),
            verdict=None if verdict is None else str(verdict["kind"]),
            verdict_s=None if verdict is None else self.since_start(verdict),
            looked_s=self.since_start((sightings or known)[-1]),
            confidence=max((float(r["confidence"]) for r in known if "confidence" in r), default=None),
            probability=_newest(known, "probability"),
            seen_from_m=min(
                (h for s in sightings if (h := s.get("altitude_agl_m")) is not None), default=None
            ),
            covariance_m2=_matrix(_newest(known, "covariance_m2")),
            by_operator=bool(by_operator),
        )


def _added_up(used: F64) -> F64:
    """Energy used so far (N,), of a counter that begins again at 0 when a flight is resumed."""
    begins_again = np.flatnonzero(used[1:] < used[:-1] - _COUNTER_WH)
    added = used.copy()
    for k in begins_again.tolist():
        added[k + 1 :] += used[k]
    return added


def _standing(verdicts: Sequence[Record]) -> Record | None:
    """The verdict that counts, as of when it was first given: the operator's newest, else the strategy's."""
    standing: Record | None = None
    for verdict in verdicts:
        counts = standing is None or verdict.get("by") == OPERATOR
        if counts and (standing is None or verdict["kind"] != standing["kind"]):
            standing = verdict
    return standing


def load_run(folder: str | Path, from_sound_lines: bool = False) -> Run:
    """Read the mission of a run folder, also one that was broken off or still flies. Nothing is written.

    A last line cut short by a crash is left out. With ``from_sound_lines``, so is all that is damaged or
    contradicts the rest, and ``left_out`` names it. Raises UserError where a file is missing, damaged, a
    link, or of another mission than the others, or where the mission had not begun.
    """
    try:
        run = load_flown(folder, from_sound_lines)
        try:
            return replace(run, summary=_summary_of(run))
        except UserError:
            if not from_sound_lines:
                raise
            return replace(run, left_out=(*run.left_out, f"{SUMMARY_FILE} with the wall time"))
    except OSError as error:
        where = error.filename or folder
        raise UserError(f"{where}: cannot be read ({error.strerror}); check its rights") from None


def _is_spoilt(picture: Path) -> bool:
    try:
        return read_picture(picture) is None
    except FileNotFoundError:  # a mission that flies has a better one by now
        return False


def load_flown(folder: str | Path, from_sound_lines: bool = False) -> Run:
    """The same from configuration, journal and pictures alone, without the results."""
    folder = Path(folder)
    path = folder / JOURNAL_FILE
    for needed in (folder / CONFIG_FILE, path):
        if not needed.is_file():
            raise UserError(f"{folder}: has no {needed.name}; give a folder that 'skysweep run' wrote")
    refuse_links(folder)
    lines = read_sound_lines(path)
    foreign = next((k for k, r in enumerate(lines.records) if not can_be_told(r)), None)
    if foreign is not None:
        lines = replace(lines.first(foreign), damaged=foreign + 1)
    if all(record["kind"] != "start" for record in lines.records):
        why = "the mission had not taken off" if lines.damaged is None else f"line {lines.damaged} is damaged"
        raise UserError(f"{path}: {why}, so there are no results; fly the mission into a new folder")
    left_out = []
    if lines.damaged is not None:
        left_out.append(f"line {lines.damaged} of {JOURNAL_FILE} and all lines after it")
    pictures = sorted(folder.glob(f"{PICTURES}/*.jpg"))
    spoilt = [] if is_older(lines.records) else [picture for picture in pictures if _is_spoilt(picture)]
    left_out += [f"{PICTURES}/{picture.name}" for picture in spoilt]
    if not from_sound_lines:
        lines.refuse_damaged(path, journal_remedy(path))
        if spoilt:
            raise UserError(f"{spoilt[0]}: is damaged; delete it, the mission's results need no pictures")
    scenario, records = flown_scenario(folder, lines.records), tuple(lines.records)
    sound = tuple(picture for picture in pictures if picture not in spoilt and picture.exists())
    return Run(scenario, records, folder, seal=lines.seal, pictures=sound, left_out=tuple(left_out))


def summary_of_complete(folder: Path, from_sound_lines: bool = False) -> Record | None:
    """The summary of a mission that has ended and whose results are written, else None.

    Raises UserError where its folder is damaged. With ``from_sound_lines`` such a mission is not complete.
    """
    if not (folder / SUMMARY_FILE).is_file():
        return None
    try:
        return load_run(folder).summary
    except UserError:
        if from_sound_lines:
            return None
        raise


def flown_scenario(folder: Path, records: Sequence[Record]) -> Scenario:
    """The scenario at the start of a mission with these lines. Raises UserError where it was changed."""
    path = folder / CONFIG_FILE
    if not is_older(records) and digest_of_config(folder) != records[0][CONFIG]:
        raise UserError(
            f"{path}: is not the file that the mission began with (SHA-256 {records[0][CONFIG]}); restore "
            "the original"
        )
    return load_scenario(path)


def digest_of_config(folder: Path) -> str:
    """SHA-256 of a run folder's ``config.yaml``, in hexadecimal. Raises OSError."""
    return hashlib.sha256((folder / CONFIG_FILE).read_bytes()).hexdigest()


def digest_of_plan(scenario: Scenario) -> str | None:
    """SHA-256 of the file of ``search.plan`` in hexadecimal, if there is one."""
    path = Path(scenario.search.plan or "")
    return sha256_of(path) if path.is_file() else None


def is_older(records: Sequence[Record]) -> bool:
    """Whether they are of an older skysweep, which did not protect configuration, summary and pictures."""
    return not records or CONFIG not in records[0]


def refuse_links(folder: Path) -> None:
    """Raises UserError where a run folder has a link, through which writing would leave the folder."""
    held = (path for pattern in ("*", f"{PICTURES}/*", f"{FILM}/*") for path in folder.glob(pattern))
    link = next((path for path in held if path.is_symlink()), None)
    if link is not None:
        raise UserError(f"{link}: is a link; put the file itself there, or delete it")


def _summary_of(run: Run) -> Record | None:
    """The written summary of a mission that has ended. Raises UserError where it is of another journal."""
    assert run.folder is not None
    path = run.folder / SUMMARY_FILE
    if not path.is_file():
        return None
    if is_older(run.records):
        try:
            summary = json.loads(path.read_bytes())
        except ValueError:
            return None
        is_whole = isinstance(summary, dict) and "mission_time_s" in summary
        return summary if is_whole and summary.get("ended", True) else None
    summary, journal = read_summary(path)
    if summary["ended"] and journal != run.seal:
        held = run.folder / JOURNAL_FILE
        raise UserError(
            f"{held}: has {len(run.records)} sound lines, but {SUMMARY_FILE} was made from others; "
            f"{journal_remedy(held)}"
        )
    return summary if summary["ended"] else None


def _newest(records: list[Record], key: str) -> Any:
    return next((r[key] for r in reversed(records) if r.get(key) is not None), None)


def _matrix(value: Any) -> F64 | None:
    return None if value is None else np.asarray(value, dtype=float).reshape(2, 2)
