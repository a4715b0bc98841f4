"""Slows a simulated mission down, so that a person can watch it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from skysweep.flights.rig import Rig
from skysweep.types import Detections, Mode, VehicleState

_SLACK_S = 0.2  # that is made up for after a slow tick


class Pace:
    """Lets a mission's time pass at most ``speed`` times as fast as real time.

    ``watch`` is to be called at every tick, ``hear`` with every new line of the journal: what is flown again
    to resume a mission writes none, and is not slowed down.
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._is_new = False
        self._time_s = 0.0
        self._due_s = time.monotonic()

    def hear(self, _line: Mapping[str, Any]) -> None:
        """A line was written."""
        self._is_new = True

    def watch(self, state: VehicleState, _mode: Mode, _new: Detections | None) -> None:
        """Wait until this tick is due."""
        now_s = time.monotonic()
        lasted_s, self._time_s = state.time_s - self._time_s, state.time_s
        self._due_s = max(self._due_s + lasted_s / self._speed, now_s - _SLACK_S)
        if not self._is_new:
            self._due_s = now_s
        time.sleep(max(0.0, self._due_s - now_s))


def paced(rig: Rig, speed: float | None) -> Rig:
    """The rig of a mission that lasts at least its time over ``speed``; None: as long as it takes."""
    if speed is None:
        return rig
    pace = Pace(speed)

    def watch(state: VehicleState, mode: Mode, new: Detections | None) -> None:
        rig.watch(state, mode, new)
        pace.watch(state, mode, new)

    def hear(line: Mapping[str, Any]) -> None:
        rig.hear(line)
        pace.hear(line)

    return replace(rig, watch=watch, hear=hear)
