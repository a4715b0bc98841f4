"""The lines that a mission writes into its journal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skysweep.arrays import F64
from skysweep.mission.journal import Journal
from skysweep.mission.mission import Mission
from skysweep.mission.orders import ORDER
from skysweep.mission.safety import BATTERY_CHANGE, OUTSIDE, OVER, Action, Alarm
from skysweep.mission.witness import Witness
from skysweep.types import (
    SETTLING,
    XY,
    Candidate,
    Event,
    EventKind,
    Mode,
    Observation,
    Tracker,
    VehicleState,
)

LOOKED = "looked"  # kind of the line that ends a look for the operator
SORTIE, NEXT_SORTIE = "sortie", "next_sortie"  # kinds of the lines that end a sortie, and begin another
OPERATOR = "operator"  # who decided, in the field ``by`` of a verdict; without it the strategy did
UNDECIDED = "the strategy did not decide on it"  # why a candidate is unchecked after a whole search
STATE_PERIOD_S = 0.5  # between lines of the state
_PASSING = (Action.CONTINUE, Action.REFUSE_CHECK, Action.HOLD, Action.KEEP_OUT)  # do not end the mission
OF_A_CANDIDATE = (
    "sighting",
    EventKind.SCANNED,
    EventKind.REASSESSED,
    *SETTLING,
)  # kinds of lines about one candidate


class Notes:
    """Writes the lines of one mission, and keeps track of unchecked candidates."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._next_state_s = 0.0
        self._listed: set[int] = set()  # scanned candidates
        self._settled: set[int] = set()
        self._believed: dict[int, float] = {}  # the last probability told of each candidate
        self._alarms: dict[str, Alarm] = {}  # by cause

    @property
    def failed(self) -> str | None:
        """Why the journal takes no more lines; None: it does."""
        return self._journal.failed

    def start(self, mission: Mission) -> None:
        """The mission's set-up, F, and what to keep in mind of both."""
        search = mission.scenario.search
        self._journal.write(
            0.0,
            "start",
            scenario=mission.scenario.name,
            strategy=search.strategy,
            n_c=search.n_c,
            d_c_m=search.d_c_m,
            seed=mission.seed,
            sensor=mission.sensor_name,
        )
        xy = mission.waypoints_xy_enu_m
        z = [mission.ground_at_m(x, y) + mission.cover_altitude_agl_m for x, y in xy.tolist()]
        self._journal.write(0.0, "plan", waypoints_enu_m=np.column_stack([xy, z]))
        if mission.caveat:
            self.safety(0.0, Alarm(Action.CONTINUE, "sensor model", mission.caveat))

    def go_on(self, before: Sequence[Mapping[str, Any]]) -> None:
        """Continue an interrupted mission; ``before`` is its journal."""
        for record in before:
            if record["kind"] in SETTLING:
                self._settled.add(record["candidate"])
            elif record["kind"] == EventKind.SCANNED:
                self._listed.add(record["candidate"])
            if "probability" in record and "candidate" in record:
                self._believed[record["candidate"]] = record["probability"]
        self._journal.write(max(r["t"] for r in before), "resumed")

    def snapshot(
        self, time_s: float, strategy: Mapping[str, Any], tracker: Tracker, operator: Mapping[str, Any]
    ) -> None:
        """The state from which a mission that cannot be replayed resumes; to be written after ``step``.

        ``strategy`` is the snapshot of it.
        """
        orders = {"operator": operator} if operator else {}
        state = {"strategy": strategy, "tracker": tracker.snapshot()}
        self._journal.write(time_s, "snapshot", **state, **orders)

    def order(self, time_s: float, word: str, of: Mapping[str, Any]) -> None:
        """What the operator ordered, ``of`` which candidate or place."""
        self._journal.write(time_s, ORDER, word=word, **of)

    def verdict(self, time_s: float, kind: EventKind, candidate: Candidate) -> None:
        """The operator's verdict on a candidate."""
        self._settled.add(candidate.id)
        self._journal.write(time_s, kind, candidate=candidate.id, **_place(candidate), by=OPERATOR)

    def looked(self, time_s: float, place_enu_m: tuple[float, float, float]) -> None:
        """A place that the operator asked for was looked at."""
        self._journal.write(time_s, LOOKED, p=place_enu_m)

    def step(self, seen: Observation, events: tuple[Event, ...]) -> None:
        """What was seen and decided in one step."""
        for s in seen.sightings:
            self._journal.write(
                s.time_s,
                "sighting",
                candidate=s.candidate_id,
                class_name=seen.candidates[s.candidate_id].class_name,
                new=s.is_new,
                p=s.position_enu_m,
                confidence=s.confidence,
                altitude_agl_m=s.camera_altitude_agl_m,
            )
        self._unsearched(seen.time_s, seen.unsearched, again=True)
        for event in events:
            fields: dict[str, object] = {}
            if event.candidate_id is not None:
                if event.kind in SETTLING:
                    self._settled.add(event.candidate_id)
                else:
                    self._listed.add(event.candidate_id)
                fields["candidate"] = event.candidate_id
                fields["p"] = event.position_enu_m
                fields["covariance_m2"] = seen.candidates[event.candidate_id].covariance_m2
            elif event.position_enu_m is not None:
                fields["p"] = event.position_enu_m
            if event.probability is not None and 0.0 <= event.probability <= 1.0:
                fields["probability"] = round(event.probability, 4)
                if event.candidate_id is not None:
                    self._believed[event.candidate_id] = round(event.probability, 4)
            if event.kind == EventKind.UNCHECKED:
                fields["reason"] = event.reason or seen.refused
            elif event.reason:
                fields["reason"] = event.reason
            alternatives = [(what, cost_s) for what, cost_s in event.alternatives if math.isfinite(cost_s)]
            if alternatives:
                fields["alternatives"] = alternatives
            self._journal.write(seen.time_s, event.kind, **fields)

    def state(self, state: VehicleState, mode: Mode) -> None:
        """The estimated state, every ``STATE_PERIOD_S``."""
        if state.time_s < self._next_state_s - 1e-6:
            return
        self._next_state_s = state.time_s + STATE_PERIOD_S
        self._journal.write(
            state.time_s,
            "state",
            p=state.position_enu_m,
            v=state.velocity_enu_mps,
            mode=mode,
            battery=state.battery_remaining,
            energy_wh=state.energy_used_wh,
            cam={"p": state.camera.position_enu_m, "R": state.camera.R_camera_to_enu.ravel()},
        )

    def alarms(self, time_s: float, alarms: tuple[Alarm, ...], not_judged: set[str]) -> None:
        """New alarms, changed actions and holders, and alarms that have cleared."""
        current = {a.cause: a for a in alarms}
        for alarm in alarms:
            before = self._alarms.get(alarm.cause)
            if before is None or (before.action, before.holder) != (alarm.action, alarm.holder):
                self.safety(time_s, alarm)
        if any(a.action is Action.KEEP_OUT for a in alarms):  # nobody looks at the others now
            current = self._alarms | current
        current = {c: a for c, a in self._alarms.items() if c in not_judged} | current
        for cause, alarm in self._alarms.items():
            if cause not in current and alarm.action in _PASSING:
                self.safety(time_s, Alarm(Action.CONTINUE, cause, OVER[cause]))
        self._alarms = current

    def safety(self, time_s: float, alarm: Alarm) -> None:
        """One alarm."""
        holder = {} if alarm.holder is None else {"holder": alarm.holder}
        self._journal.write(
            time_s, "safety", cause=alarm.cause, action=alarm.action.name, sentence=alarm.sentence, **holder
        )

    def stays_down(self, time_s: float, why: str) -> None:
        """Why the vehicle does not take off at a person's word, which has to be said again."""
        self.safety(time_s, Alarm(Action.HOLD, BATTERY_CHANGE, f"{why} Say continue when it is ready."))

    def left_behind(
        self, time_s: float, why: str, candidates: dict[int, Candidate], blind: tuple[tuple[XY, XY], ...]
    ) -> None:
        """What an early end leaves undone: candidates scanned or seen twice, legs flown blind."""
        self._unsearched(time_s, blind, again=False)
        for k, candidate in candidates.items():
            if k in self._listed or len(candidate.confidences) > 1:
                self._unchecked(time_s, candidate, f"the search ended early ({why})")

    def left_undecided(self, time_s: float, candidates: Mapping[int, Candidate]) -> None:
        """Candidates that the strategy listed and did not decide on before it finished."""
        for k in sorted(self._listed & candidates.keys()):
            self._unchecked(time_s, candidates[k], UNDECIDED)

    def left_outside(self, time_s: float, candidates: Sequence[Candidate]) -> None:
        """Candidates outside the area, which are not checked."""
        for candidate in candidates:
            self._unchecked(time_s, candidate, OUTSIDE)

    def _unchecked(self, time_s: float, candidate: Candidate, reason: str) -> None:
        if candidate.id not in self._settled:
            self._settled.add(candidate.id)
            fields: dict[str, object] = {"candidate": candidate.id, **_place(candidate), "reason": reason}
            if candidate.id in self._believed:
                fields["probability"] = self._believed[candidate.id]
            self._journal.write(time_s, EventKind.UNCHECKED, **fields)

    def end(self, time_s: float, reason: str, witness: Witness | None, landed: bool) -> None:
        """Clearance from obstacles, if simulated; whether it landed; why the mission ended."""
        if witness is not None:
            self._journal.write(time_s, "clearance", **witness.saw())
        if landed:
            self._journal.write(time_s, "landed")
        self._journal.write(time_s, "end", reason=reason)

    def sortie(self, time_s: float, battery: float, number: int, why: str, energy_wh: float) -> None:
        """A sortie, but for the last one, has landed for another battery; what it used of its own."""
        self._journal.write(time_s, SORTIE, number=number, why=why, battery=battery, energy_wh=energy_wh)

    def next_sortie(self, state: VehicleState, number: int) -> None:
        """Another sortie takes off."""
        self._journal.write(state.time_s, NEXT_SORTIE, number=number, battery=state.battery_remaining)

    def _unsearched(self, time_s: float, legs: tuple[tuple[XY, XY], ...], again: bool) -> None:
        if legs:
            length_m = sum(math.dist(a, b) for a, b in legs)
            self._journal.write(time_s, "unsearched", legs_enu_m=legs, length_m=length_m, again=again)


def _place(candidate: Candidate) -> dict[str, F64]:
    return {"p": candidate.position_enu_m, "covariance_m2": candidate.covariance_m2}
