"""The parts of a resumed mission.

A simulated mission is flown again from the start, a thousand times faster than real time. It is deterministic
except for the detector's answers, which are in the journal. Every line that it writes is compared with the
recorded one; where the journal ends, the mission continues.

A real flight cannot be repeated. Its mission writes a snapshot of strategy and tracker after every step that
changed them, and resumes from the last one and from where the vehicle is then.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from skysweep.errors import DetectorError, UserError
from skysweep.mission.journal import FileJournal, Journal, line_of
from skysweep.mission.looks import Looks, legs_along
from skysweep.mission.mission import Mission
from skysweep.mission.notes import LOOKED, NEXT_SORTIE, SORTIE
from skysweep.mission.orders import ORDER, Operator, Order
from skysweep.mission.safety import OVER, SILENT
from skysweep.results.run_folder import CLOCK, Record
from skysweep.types import SEARCHING, XY, Answer, Detections, Doubt, Sensor, Vehicle, VehicleState

LOOK = "look"  # kind of the lines with the detector's answers
SNAPSHOT = "snapshot"
_PASSING = {  # not part of a step
    *("setup", "start", "plan", "state", "safety", "resumed", CLOCK, ORDER, LOOKED, LOOK, SNAPSHOT),
    *(SORTIE, NEXT_SORTIE, "landed"),
}
_UNSEEN_S = 1.0  # of a scan before the interruption: perhaps not looked at


class ReplayJournal:
    """Compares the first lines with ``recorded``, the end of its file, and appends those that follow.

    Raises UserError in ``write`` if the mission does not repeat what is recorded.
    """

    def __init__(self, journal: FileJournal, recorded: Sequence[Record]) -> None:
        self._journal = journal
        self._expected = deque(enumerate(recorded, start=len(journal.records) - len(recorded) + 1))

    @property
    def failed(self) -> str | None:
        return self._journal.failed

    @property
    def is_over(self) -> bool:
        """Whether everything that is recorded has been repeated."""
        return not self._expected

    def write(self, time_s: float, kind: str, **fields: Any) -> None:
        if not self._expected:
            self._journal.write(time_s, kind, **fields)
            return
        number, recorded = self._expected.popleft()
        if line_of(time_s, kind, fields) != recorded:
            raise UserError(
                f"{self._journal.path}: flown again, the mission differs in line {number} "
                f"('{recorded['kind']}' at {recorded['t']:.1f} s), so it cannot be resumed: it was flown by "
                "other code or on another machine; fly it again into a new folder"
            )


class RecordedOperator:
    """Repeats the recorded orders, each at its tick of the vehicle's time; then ``operator`` is asked."""

    def __init__(
        self, journal: ReplayJournal, recorded: Iterable[Record], vehicle: Vehicle, operator: Operator
    ) -> None:
        self._journal, self._vehicle, self._operator = journal, vehicle, operator
        self._orders = deque(record for record in recorded if record["kind"] == ORDER)

    def __call__(self) -> Order | None:
        if self._orders and self._orders[0]["t"] <= round(self._vehicle.state().time_s, 4):
            return Order.of_line(self._orders.popleft())
        return self._operator() if self._journal.is_over else None


class RecordedSensor:
    """Records every answer of a sensor. Implements ``types.Sensor``."""

    def __init__(self, sensor: Sensor, journal: Journal) -> None:
        self._sensor, self._journal = sensor, journal
        self.close = sensor.close

    def sense(self, state: VehicleState) -> Detections | None:
        try:
            found = self._sensor.sense(state)
        except DetectorError as error:
            self._journal.write(state.time_s, LOOK, failure=str(error))
            raise
        if found is not None:
            self._journal.write(
                state.time_s,
                LOOK,
                boxes_xyxy_px=found.boxes_xyxy_px,
                confidences=found.confidences,
                class_names=found.class_names,
                **({} if found.doubt is None else {"doubt": found.doubt}),
            )
        return found


def recorded_answers(records: Iterable[Record]) -> list[Answer]:
    """The detector's answers in the journal of a flight, oldest first."""
    return [
        Answer(
            np.array(r.get("boxes_xyxy_px", []), dtype=float).reshape(-1, 4),
            np.array(r.get("confidences", []), dtype=float),
            tuple(r.get("class_names", ())),
            r.get("failure"),
            Doubt(*r["doubt"]) if "doubt" in r else None,
        )
        for r in records
        if r["kind"] == LOOK
    ]


class LaterVehicle:
    """A vehicle in a mission that has lasted ``earlier_s``; time stands still until it takes off."""

    def __init__(self, vehicle: Vehicle, earlier_s: float) -> None:
        self._vehicle, self._earlier_s, self._flies = vehicle, earlier_s, False
        self.command, self.advance, self.hold = vehicle.command, vehicle.advance, vehicle.hold
        self.land, self.truth = vehicle.land, vehicle.truth

    def takeoff(self, altitude_agl_m: float) -> None:
        self._vehicle.takeoff(altitude_agl_m)
        self._flies = True

    def state(self) -> VehicleState:
        state = self._vehicle.state()
        return state._replace(time_s=self._earlier_s + (state.time_s if self._flies else 0.0))


def restored(mission: Mission, journal: FileJournal) -> Mission:
    """A newly built mission in the state of the interrupted one; an incomplete step is cut off the journal.

    The scan continues where it was left; what had been flown blind until then is scanned again.
    """
    journal.cut(_n_whole(journal.records))
    records = journal.records
    last = next((r for r in reversed(records) if r["kind"] == SNAPSHOT), None)
    if last is not None:
        strategy = dict(last["strategy"])
        left_xy = _left_at(mission, records)
        if left_xy and strategy.get("to_scan") and not strategy.get("left_xy"):
            strategy["to_scan"] = [left_xy, *strategy["to_scan"]]
        try:
            mission.strategy.restore(strategy)
            mission.tracker.restore(last["tracker"])
        except (LookupError, TypeError, ValueError, AttributeError):
            raise UserError(
                f"{journal.path}: its snapshot at {last['t']:.0f} s is not from this strategy and tracker; "
                "fly the mission into a new folder"
            ) from None
    earlier_s = max((r["t"] for r in records), default=0.0)
    legs = _blind_legs(mission, records)
    return replace(mission, vehicle=LaterVehicle(mission.vehicle, earlier_s), blind_legs=legs)


def _n_whole(records: Sequence[Record]) -> int:
    """The number of lines before a last step without its snapshot."""
    n = len(records)
    while n and records[n - 1]["kind"] not in _PASSING:
        n -= 1
    return n


def _left_at(mission: Mission, records: Sequence[Record]) -> list[float] | None:
    """The place up to which ground was surely looked at; None where none was being covered."""
    states = [r for r in records if r["kind"] == "state" and r["mode"] in SEARCHING]
    if not states or not _covers(mission, states[-1]):
        return None
    sure = [r for r in states if r["t"] <= states[-1]["t"] - _UNSEEN_S and _covers(mission, r)]
    x, y, _ = (sure or states)[-1]["p"]
    return [x, y]


def _covers(mission: Mission, state: Record) -> bool:
    x, y, z = state["p"]
    return mission.covers_from(z - mission.ground_at_m(x, y))


def _blind_legs(mission: Mission, records: Sequence[Record]) -> tuple[tuple[XY, XY], ...]:
    """What covered ground at the end, while no look was answered for so long that it counts as blind."""
    looks = Looks(mission.scenario, mission.look_period, mission.cover_altitude_agl_m)
    states = [r for r in records if r["kind"] == "state" and r["mode"] in SEARCHING]
    seen_s = _seen_until_s(records, looks)
    if not states or states[-1]["t"] - seen_s <= looks.silent_age_s:
        return ()
    blind = [r for r in states if r["t"] >= seen_s and _covers(mission, r)]
    return tuple(legs_along([(r["p"][0], r["p"][1]) for r in blind]))


def _seen_until_s(records: Sequence[Record], looks: Looks) -> float:
    """When the newest trusted look was taken, by the detector's answers or, without any, by its silence."""
    answers, seen_s, silent_s = False, -math.inf, math.inf
    for record in records:
        if record["kind"] == LOOK:
            answers = True
            if "doubt" in record:
                seen_s = min(seen_s, Doubt(*record["doubt"]).since_s)
            elif "failure" not in record:
                seen_s = max(seen_s, record["t"] - looks.usual_age_s)
        elif record["kind"] == "safety" and record["cause"] == SILENT:
            is_over = record["sentence"] == OVER[SILENT]
            silent_s = math.inf if is_over else min(silent_s, record["t"] - looks.silent_age_s)
    return seen_s if answers else silent_s
