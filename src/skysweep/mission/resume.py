"""Going on with a mission that was broken off.

A simulated mission is flown again from the start, a thousand times faster than real time: it is deterministic
but for what the detector said to the pictures, and that is in the journal. What it writes is compared with
what is there, line for line; where the journal ends, the mission goes on.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from skysweep.errors import UserError
from skysweep.mission.journal import FileJournal, Journal, line_of
from skysweep.sensing.imaging import Answer, DetectorError, ImagingSensor
from skysweep.types import Detections, VehicleState

Record = Mapping[str, Any]

LOOK = "look"  # kind of the lines with the detector's answers


class ReplayJournal:
    """Takes down only what its file does not hold yet.

    Raises UserError in ``write`` when the mission does not do again what the file says that it did.
    """

    def __init__(self, journal: FileJournal) -> None:
        self._journal = journal
        self._expected = deque(enumerate(journal.records, start=1))

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
    """Takes down every answer of an imaging sensor. Implements ``types.Sensor``."""

    def __init__(self, sensor: ImagingSensor, journal: Journal) -> None:
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
        )
        for r in records
        if r["kind"] == LOOK
    ]
