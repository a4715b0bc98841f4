"""Going on with a mission that was broken off.

A simulated mission is flown again from the start, a thousand times faster than real time: it is deterministic
but for what the detector said to the pictures, and that is in the journal. What it writes is compared with
what is there, line for line; where the journal ends, the mission goes on.

What a real vehicle did cannot be done again. Its missions write a snapshot of strategy and tracker after
every step that changed them, and go on from the last one, from where the vehicle is then.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from skysweep.errors import DetectorError, UserError
from skysweep.mission.journal import FileJournal, Journal, line_of
from skysweep.mission.mission import Mission
from skysweep.types import Answer, Detections, Doubt, Mode, Sensor, Vehicle, VehicleState

Record = Mapping[str, Any]

LOOK = "look"  # kind of the lines with the detector's answers
SNAPSHOT = "snapshot"
_PASSING = {"setup", "start", "plan", "state", "safety", "resumed", LOOK, SNAPSHOT}  # of no step
_UNSEEN_S = 1.0  # of a scan: may not have been looked at when the mission was broken off


class ReplayJournal:
    """Takes down only what its file does not hold yet: not ``recorded``, which it ends with.

    Raises UserError in ``write`` when the mission does not do again what the file says that it did.
    """

    def __init__(self, journal: FileJournal, recorded: Sequence[Record]) -> None:
        self._journal = journal
        self._expected = deque(enumerate(recorded, start=len(journal.records) - len(recorded) + 1))

    @property
    def failed(self) -> str | None:
        """As of the file."""
        return self._journal.failed

    def write(self, time_s: float, kind: str, **fields: Any) -> None:
        """Compare one line, or append it when all that were there have been compared."""
        if not self._expected:
            self._journal.write(time_s, kind, **fields)
            return
        number, recorded = self._expected.popleft()
        if line_of(time_s, kind, fields) != recorded:
            raise UserError(
                f"{self._journal.path}: flown again, the mission differs in line {number} "
                f"('{recorded['kind']}' at {recorded['t']:.1f} s), so it cannot go on: it was flown by other "
                "code or on another machine; fly it again into a new folder"
            )


class RecordedSensor:
    """Takes down every answer of a sensor. Implements ``types.Sensor``."""

    def __init__(self, sensor: Sensor, journal: Journal) -> None:
        self._sensor, self._journal = sensor, journal

    def sense(self, state: VehicleState) -> Detections | None:
        """What the sensor answers, and raises."""
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

    def close(self) -> None:
        """Close the sensor."""
        self._sensor.close()


def recorded_answers(records: Iterable[Record]) -> list[Answer]:
    """What the detector said to the pictures of a flight, from its journal, oldest first."""
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
    """A vehicle in a mission that has lasted ``earlier_s`` already: time stands still until it takes off."""

    def __init__(self, vehicle: Vehicle, earlier_s: float) -> None:
        self._vehicle, self._earlier_s, self._flies = vehicle, earlier_s, False
        self.command, self.advance, self.hold = vehicle.command, vehicle.advance, vehicle.hold
        self.land, self.truth = vehicle.land, vehicle.truth

    def takeoff(self, altitude_agl_m: float) -> None:
        """The vehicle's own time begins with that."""
        self._vehicle.takeoff(altitude_agl_m)
        self._flies = True

    def state(self) -> VehicleState:
        """The vehicle's, in the mission's time."""
        state = self._vehicle.state()
        return state._replace(time_s=self._earlier_s + (state.time_s if self._flies else 0.0))


def restored(mission: Mission, journal: FileJournal) -> Mission:
    """A mission just built, as it was when the journal's was broken off; what a broken step wrote is cut off.

    A SCAN goes on from where it was left.
    """
    journal.cut(_n_whole(journal.records))
    records = journal.records
    last = next((r for r in reversed(records) if r["kind"] == SNAPSHOT), None)
    if last is not None:
        strategy = dict(last["strategy"])
        left_xy = _left_at(records)
        if left_xy and strategy.get("to_scan") and not strategy.get("left_xy"):
            strategy["to_scan"] = [left_xy, *strategy["to_scan"]]
        try:
            mission.strategy.restore(strategy)
            mission.tracker.restore(last["tracker"])
        except (LookupError, TypeError, ValueError, AttributeError):
            raise UserError(
                f"{journal.path}: its snapshot at {last['t']:.0f} s is not of this strategy and tracker; "
                "fly the mission into a new folder"
            ) from None
    earlier_s = max((r["t"] for r in records), default=0.0)
    return replace(mission, vehicle=LaterVehicle(mission.vehicle, earlier_s))


def _n_whole(records: Sequence[Record]) -> int:
    """How many lines there are before a last step whose snapshot is missing."""
    n = len(records)
    while n and records[n - 1]["kind"] not in _PASSING:
        n -= 1
    return n


def _left_at(records: Sequence[Record]) -> list[float] | None:
    """Up to where a SCAN was surely looked at; None when the mission was in a CHECK, or had not begun."""
    states = [r for r in records if r["kind"] == "state" and r["mode"] in (Mode.SCAN, Mode.CHECK)]
    if not states or states[-1]["mode"] != Mode.SCAN:
        return None
    sure = [r for r in states if r["mode"] == Mode.SCAN and r["t"] <= states[-1]["t"] - _UNSEEN_S]
    x, y, _ = (sure or states)[-1]["p"]
    return [x, y]
