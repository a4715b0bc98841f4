"""Coverage as probability: how probably a target in each cell of the area would have been reported by now."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraMotion, CameraPose, pose_between
from skysweep.results.run_folder import Run
from skysweep.scenarios.model import Light, Scenario
from skysweep.sensing.statistical.model import StatisticalModel, model_for
from skysweep.sensing.statistical.searched_area import SearchedArea, motion_between
from skysweep.types import SEARCHING, Doubt, Mode

_CELLS_ACROSS = 12  # the shorter side of a picture from the scan's height
_MAX_CELLS = 40_000
_LATEST_S = 1.0  # by which an answer may be later than usual
_FARTHEST_M = 1e6
_LONGEST_AXIS = 1.01  # of a rotation, rounded
LONGEST_GAP_S = 2.0  # between two states: beyond, nobody knows where the camera was
_STILL = CameraMotion(np.zeros(3), np.zeros(3))


class _State(NamedTuple):
    time_s: float
    searches: bool
    camera: CameraPose


class CoverageMap:
    """Probability of detection (POD) of square cells over a mission's area, from the lines of its journal.

    A cell's POD is the chance that a target in its middle was reported at least once, by the sensor model: it
    grows with every look that was answered in a search. Poses between the journal's states are interpolated.
    Looks that turn out later not to be trusted are taken back. ``bounds_enu_m`` are west, south, east and
    north; ``inside`` (R, C) are the cells that touch the area. Row 0 is the southernmost.
    """

    def __init__(self, scenario: Scenario, model: StatisticalModel) -> None:
        area = SearchedArea(scenario, model, _CELLS_ACROSS, _MAX_CELLS)
        self.cell_m, self.bounds_enu_m = area.cell_m, area.bounds_enu_m
        self.inside, self._cells = area.inside, area.cells
        self._latency_s = scenario.camera.latency_s
        self._period_s = 1.0 / min(scenario.detector.rate_hz, scenario.camera.rate_hz)
        self._keeps_looks = False
        self._states: deque[_State] = deque()  # the newest, as many as answers may still be about
        self._due_s: deque[float] = deque()  # exposures that were answered and not looked at yet
        self._looks: list[tuple[float, CameraPose, CameraMotion]] = []  # all that count, by exposure
        self._light = scenario.light
        self._looks_before: list[tuple[Light, CameraPose, CameraMotion]] = []  # of other journals

    @classmethod
    def of(cls, scenario: Scenario) -> CoverageMap | None:
        """The empty map of a scenario; None where its detector and camera have no sensor model."""
        try:
            return cls(scenario, model_for(scenario))
        except UserError:
            return None

    def pod(self) -> F64:
        """(R, C) 0..1; 0 outside the area."""
        return self._cells.pod

    def add(self, line: Mapping[str, Any]) -> None:
        """Take in the next line of the journal; those of kinds that tell of no look are ignored."""
        kind = line["kind"]
        if kind == "state":
            self._state(line)
        elif kind == "look":
            self._answer(line)
        elif kind == "setup":
            self._keeps_looks = line.get("sensor") == "imaging"

    def begin_journal(self, light: Light) -> None:
        """The next lines are of another flight under this sun, which adds to what was seen."""
        self._states.clear()
        self._due_s.clear()
        self._keeps_looks = False
        self._looks_before += [(self._light, pose, motion) for _, pose, motion in self._looks]
        self._looks, self._light = [], light
        self._cells.light_by(light)

    def _state(self, line: Mapping[str, Any]) -> None:
        camera = line.get("cam")
        if camera is None:
            return
        position, R = (np.array(camera[key], dtype=float) for key in ("p", "R"))
        if not ((np.abs(position) <= _FARTHEST_M).all() and (np.abs(R) <= _LONGEST_AXIS).all()):
            return  # no position, or no camera's
        searches = line.get("mode", Mode.SCAN) in SEARCHING
        state = _State(float(line["t"]), searches, CameraPose(position, R.reshape(3, 3)))
        if not self._keeps_looks and self._states:
            self._due_s += _multiples(self._period_s, self._states[-1].time_s, state.time_s)
        self._states.append(state)
        while len(self._states) > 2 and self._states[1].time_s < state.time_s - self._latency_s - _LATEST_S:
            self._states.popleft()
        self._look()

    def _answer(self, line: Mapping[str, Any]) -> None:
        if "doubt" in line:
            self._take_back(Doubt(*line["doubt"]).since_s)
        elif "failure" not in line:
            self._due_s.append(float(line["t"]) - self._latency_s)
            self._look()

    def _look(self) -> None:
        """Look from where the camera was at every exposure that is due and lies between two states."""
        while self._due_s and self._states and self._due_s[0] <= self._states[-1].time_s:
            exposed_s = self._due_s.popleft()
            for before, after in pairwise((self._states[0], *self._states)):
                if before.time_s <= exposed_s <= after.time_s:
                    self._look_between(before, after, exposed_s)
                    break

    def _look_between(self, before: _State, after: _State, exposed_s: float) -> None:
        lasted_s = after.time_s - before.time_s
        if 0.0 < lasted_s <= LONGEST_GAP_S:
            if not before.searches:
                return
            pose = pose_between(before.camera, after.camera, (exposed_s - before.time_s) / lasted_s)
            motion = motion_between(before.camera, after.camera, pose.R_camera_to_enu, lasted_s)
        else:  # a photo's pose is told, its motion is not
            photo = next((s for s in (before, after) if s.searches and s.time_s == exposed_s), None)
            if photo is None:
                return
            pose, motion = photo.camera, _STILL
        self._looks.append((exposed_s, pose, motion))
        self._cells.look(pose, motion)

    def _take_back(self, since_s: float) -> None:
        """Forget the looks from an exposure on."""
        self._due_s = deque(t for t in self._due_s if t < since_s)
        kept = [look for look in self._looks if look[0] < since_s]
        if len(kept) < len(self._looks):
            self._looks = kept
            self._cells.clear()
            now = [(self._light, pose, motion) for _, pose, motion in kept]
            for light, pose, motion in (*self._looks_before, *now):
                self._cells.light_by(light)
                self._cells.look(pose, motion)
            self._cells.light_by(self._light)


def coverage_of(run: Run, instead: str = "do without the coverage") -> CoverageMap:
    """The map of a mission so far.

    Raises UserError, which says what to do ``instead``, where its detector and camera have no sensor model.
    """
    coverage = CoverageMap(run.scenario, model_for(run.scenario, instead))
    for line in run.records:
        coverage.add(line)
    return coverage


def coverage_of_flights(runs: Sequence[Run], instead: str = "do without the coverage") -> CoverageMap:
    """What flights over one area found together, as one map: a target hard to see is so in all of them.

    Raises UserError where two are the same flight, or differ in what the map is made of; and as
    ``coverage_of``.
    """
    refuse_twice(runs)
    first = runs[0]
    coverage = coverage_of(first, instead)
    for run in runs[1:]:
        other = other_than(first, run)
        if other is not None:
            raise UserError(
                f"{run.folder}: was flown with another {other} than {first.folder}; name flights that share "
                "area, ground, targets, camera and detector"
            )
        coverage.begin_journal(run.scenario.light)
        for line in run.records:
            coverage.add(line)
    return coverage


def refuse_twice(runs: Sequence[Run]) -> None:
    """Raise UserError where two are the same flight, one perhaps copied while it flew."""
    for k, run in enumerate(runs):
        for before in runs[:k]:
            if all(a == b for a, b in zip(before.records, run.records, strict=False)):
                raise UserError(f"{run.folder}: is the same flight as {before.folder}; name each once")


def other_than(one: Run, other: Run) -> str | None:
    """What a map of the coverage depends on that differs between two flights; None if they share one."""
    parts, others = _seen_with(one.scenario), _seen_with(other.scenario)
    return next((name for name in parts if parts[name] != others[name]), None)


def _seen_with(scenario: Scenario) -> dict[str, Any]:
    """What a map of the coverage depends on, beside the flight."""
    s = scenario
    return {
        "frame (home)": s.frame,
        "area": s.area_enu_m,
        "ground": (s.terrain, s.trees, s.forests, s.buildings, s.buildings_file, s.roads_file),
        "kind of target": (s.target_sizes_m, s.target_poses),
        "camera": s.camera,
        "detector": s.detector,
    }


def _multiples(period_s: float, after_s: float, until_s: float) -> list[float]:
    """Those of a period after one time and up to another that is not long after it."""
    if until_s - after_s > LONGEST_GAP_S:
        return []
    first, last = (math.floor(t / period_s + 1e-6) for t in (after_s, until_s))
    return [k * period_s for k in range(first + 1, last + 1)]
