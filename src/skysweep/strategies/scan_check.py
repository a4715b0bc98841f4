"""Algorithm 1 of the paper: SCAN from h_S, come down to h_C to CHECK.

Where the paper is silent, this is how we read it (each line has a test):

- ``n_c`` or ``d_c`` may be infinite. A CHECK never starts with an empty S.
- S is emptied when it becomes C.
- ``d_c`` is measured from where the vehicle was when it last saw a new candidate. Seeing a known candidate
  again is not a new target and does not reset it.
- A candidate that was confirmed or rejected is never scanned again.
- In CHECK nothing joins S: a candidate first seen then joins when a SCAN sees it again. The step that ends
  a CHECK is already a SCAN step.
- When F is empty the vehicle checks all that is left, candidates first seen during a CHECK included if they
  were seen at least twice: nobody is left behind because of the order of things, and a single sighting in a
  hard manoeuvre that the scan never confirmed is no candidate. Only then does the search end.
- C is visited in the order in which S was filled.
- After a CHECK the vehicle climbs back to where the scan was left before it flies on to F[0], so that
  nothing stays unseen behind the detour. A CHECK on that way back does not change the place. It and the
  waypoints of F count as reached at h_S only.
- In CHECK a candidate of C is confirmed when it is detected at h_C (within ``ALTITUDE_TOLERANCE_M``) with
  confidence >= c_t, on the way to another one too. It is rejected when the vehicle was above it at h_C
  for ``look_s``, two looks from there were answered, and it was not confirmed.
- Where a candidate is looked at from elsewhere (``Observation.lookout``), that place counts instead: it is
  confirmed by a sighting from there, rejected when the vehicle was there for as long.
- The operator's verdict (``Observation.verdicts``) takes a candidate out of S and C for good. Looks that were
  taken where the operator had sent the vehicle do not count as looks from above a candidate.
- A candidate that must not be flown to (``Observation.refused``) leaves C as unchecked: it is reported, and
  it is not scanned again. Legs that were flown blind are put at the end of F.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from skysweep.scenarios.model import ALTITUDE_TOLERANCE_M
from skysweep.strategies.context import MissionContext
from skysweep.types import XY, Command, Event, EventKind, Mode, Observation, Sighting, Waypoint

SCAN_ACCEPTANCE_M = 2.0  # PX4 NAV_ACC_RAD
CHECK_ACCEPTANCE_M = 0.7
LOOKS_TO_REJECT = 2


class ScanCheck:
    """The paper's state machine. Implements ``types.Strategy``."""

    def __init__(self, context: MissionContext) -> None:
        self._search = context.search
        self._look_s = context.look_s
        self._mode = Mode.SCAN
        self._to_scan: list[XY] = list(context.waypoints_xy_enu_m)  # F
        self._left_xy: XY | None = None  # where the scan was left and has to go on
        self._scanned: list[int] = []  # S
        self._to_check: list[int] = []  # C
        self._confirmed: list[int] = []  # R
        self._rejected: list[int] = []
        self._unchecked: list[int] = []
        self._last_target_xy: XY | None = None
        self._arrived_s: float | None = None
        self._looks_there = 0

    def step(self, observation: Observation) -> Command:
        """One pass of the algorithm's loop."""
        events: list[Event] = []
        for leg in observation.unsearched:
            self._to_scan += [xy for xy in leg if self._to_scan[-1:] != [xy]]
        if self._mode == Mode.CHECK:
            self._check(observation, events)
        if self._mode == Mode.SCAN:
            self._scan(observation, events)
        return Command(self._mode, self._waypoint(observation), tuple(events))

    def _scan(self, seen: Observation, events: list[Event]) -> None:
        self._heed(seen)
        x, y, _ = seen.vehicle.position_enu_m.tolist()
        for sighting in seen.sightings:
            if self._is_unknown(sighting.candidate_id):
                self._scanned.append(sighting.candidate_id)
                self._last_target_xy = (x, y)
                events.append(_event(EventKind.SCANNED, seen, sighting.candidate_id))
        up = seen.altitude_agl_m >= self._search.scan_altitude_agl_m - ALTITUDE_TOLERANCE_M
        if up and self._left_xy and math.dist((x, y), self._left_xy) <= SCAN_ACCEPTANCE_M:
            self._left_xy = None
        on_course = up and not self._left_xy and bool(self._to_scan)
        if on_course and math.dist((x, y), self._to_scan[0]) <= SCAN_ACCEPTANCE_M:
            self._to_scan.pop(0)
            events.append(Event(EventKind.WAYPOINT_REACHED))
        if not self._to_scan:
            self._scanned += [
                k for k, c in seen.candidates.items() if self._is_unknown(k) and len(c.confidences) > 1
            ]
        if self._scanned and (self._check_is_due((x, y)) or not self._to_scan):
            self._mode = Mode.CHECK
            self._to_check, self._scanned = self._scanned, []
            self._left_xy = self._left_xy or (x, y)
            self._last_target_xy = None
            self._arrived_s = None
            events.append(_event(EventKind.CHECK_STARTED, seen, self._to_check[0]))
        elif not self._to_scan:
            events.append(Event(EventKind.FINISHED))

    def _check_is_due(self, xy: XY) -> bool:
        enough = len(self._scanned) >= self._search.n_c
        far = self._last_target_xy is not None and math.dist(self._last_target_xy, xy) >= self._search.d_c_m
        return enough or far

    def _check(self, seen: Observation, events: list[Event]) -> None:
        asked = self._to_check[0]
        self._heed(seen)
        for sighting in seen.sightings:
            sure = sighting.confidence >= self._search.c_t
            near = self._is_near_enough(seen, sighting, asked)
            if sure and near and sighting.candidate_id in self._to_check:
                self._settle(sighting.candidate_id, self._confirmed, EventKind.CONFIRMED, seen, events)
        if seen.refused and self._to_check[:1] == [asked]:
            self._settle(asked, self._unchecked, EventKind.UNCHECKED, seen, events)
        lookout = seen.lookout if self._to_check[:1] == [asked] else None
        above = bool(self._to_check) and self._is_there(seen, self._to_check[0], lookout)
        if above and self._arrived_s is None:
            self._arrived_s, self._looks_there = seen.time_s, 0
        if self._arrived_s is not None:
            self._looks_there += bool(seen.looks) and seen.looks[-1].time_s >= self._arrived_s
            if (
                above
                and seen.time_s - self._arrived_s >= self._look_s
                and self._looks_there >= LOOKS_TO_REJECT
            ):
                self._settle(self._to_check[0], self._rejected, EventKind.REJECTED, seen, events)
        if not self._to_check:
            self._mode = Mode.SCAN
            events.append(Event(EventKind.SCAN_RESUMED))

    def _heed(self, seen: Observation) -> None:
        """Take over the operator's verdicts, and forget an arrival from which the vehicle was sent away."""
        goal = self._to_check[:1]
        for k, verdict in seen.verdicts.items():
            decided = self._confirmed if verdict == EventKind.CONFIRMED else self._rejected
            if k not in decided:
                for listed in (self._scanned, self._to_check, *self._settled):
                    listed[:] = [other for other in listed if other != k]
                decided.append(k)
        if seen.elsewhere or self._to_check[:1] != goal:
            self._arrived_s = None

    def _is_near_enough(self, seen: Observation, sighting: Sighting, asked: int) -> bool:
        """Whether a sighting may confirm: from h_C, or from where its candidate is looked at from."""
        if sighting.camera_altitude_agl_m <= self._search.check_altitude_agl_m + ALTITUDE_TOLERANCE_M:
            return True
        from_lookout = seen.lookout is not None and sighting.candidate_id == asked
        from_lookout &= self._search.may_confirm_from(sighting.camera_altitude_agl_m)
        return from_lookout and self._arrived_s is not None and sighting.time_s >= self._arrived_s

    def _is_there(self, seen: Observation, candidate_id: int, lookout: Waypoint | None) -> bool:
        """Whether the vehicle is above a candidate at h_C, or at the place that it is looked at from."""
        if lookout is not None:
            (x, y), altitude_agl_m = lookout.xy_enu_m, lookout.altitude_agl_m
        else:
            x, y, _ = seen.candidates[candidate_id].position_enu_m.tolist()
            altitude_agl_m = self._search.check_altitude_agl_m
        vehicle_x, vehicle_y, _ = seen.vehicle.position_enu_m.tolist()
        return (
            math.hypot(vehicle_x - x, vehicle_y - y) <= CHECK_ACCEPTANCE_M
            and seen.altitude_agl_m <= altitude_agl_m + ALTITUDE_TOLERANCE_M
        )

    def _settle(
        self,
        candidate_id: int,
        verdict: list[int],
        kind: EventKind,
        seen: Observation,
        events: list[Event],
    ) -> None:
        if candidate_id == self._to_check[0]:
            self._arrived_s = None
        self._to_check.remove(candidate_id)
        verdict.append(candidate_id)
        events.append(_event(kind, seen, candidate_id))

    def _is_unknown(self, candidate_id: int) -> bool:
        return not any(candidate_id in known for known in (self._scanned, self._to_check, *self._settled))

    @property
    def _settled(self) -> tuple[list[int], ...]:
        return self._confirmed, self._rejected, self._unchecked

    def _waypoint(self, seen: Observation) -> Waypoint | None:
        s = self._search
        if self._mode == Mode.CHECK:
            x, y, _ = seen.candidates[self._to_check[0]].position_enu_m.tolist()
            return Waypoint((x, y), s.check_altitude_agl_m, s.check_speed_mps, to_look=True)
        if self._to_scan:
            return Waypoint(self._left_xy or self._to_scan[0], s.scan_altitude_agl_m, s.scan_speed_mps)
        return None

    def snapshot(self) -> dict[str, Any]:
        """The whole state as plain data."""
        return {
            "mode": self._mode,
            "to_scan": [list(p) for p in self._to_scan],
            "left_xy": list(self._left_xy) if self._left_xy else None,
            "scanned": list(self._scanned),
            "to_check": list(self._to_check),
            "confirmed": list(self._confirmed),
            "rejected": list(self._rejected),
            "unchecked": list(self._unchecked),
            "last_target_xy": list(self._last_target_xy) if self._last_target_xy else None,
            "arrived_s": self._arrived_s,
            "looks_there": self._looks_there,
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continue from a snapshot."""
        self._mode = Mode(snapshot["mode"])
        self._to_scan = [(x, y) for x, y in snapshot["to_scan"]]
        self._scanned = list(snapshot["scanned"])
        self._to_check = list(snapshot["to_check"])
        self._confirmed = list(snapshot["confirmed"])
        self._rejected = list(snapshot["rejected"])
        self._unchecked = list(snapshot["unchecked"])
        self._left_xy = _pair(snapshot["left_xy"])
        self._last_target_xy = _pair(snapshot["last_target_xy"])
        self._arrived_s = snapshot["arrived_s"]
        self._looks_there = snapshot["looks_there"]


def _pair(xy: Sequence[float] | None) -> XY | None:
    return (xy[0], xy[1]) if xy else None


def _event(kind: EventKind, seen: Observation, candidate_id: int) -> Event:
    x, y, z = seen.candidates[candidate_id].position_enu_m.tolist()
    return Event(kind, candidate_id, (x, y, z))
