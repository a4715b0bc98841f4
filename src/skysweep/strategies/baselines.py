"""What the paper's strategy is measured against: fly F once, at one altitude, and never turn back."""

from __future__ import annotations

import math
from typing import Any

from skysweep.errors import UserError
from skysweep.strategies.context import MissionContext
from skysweep.strategies.scan_check import SCAN_ACCEPTANCE_M
from skysweep.types import XY, Command, Event, EventKind, Mode, Observation, Waypoint


class SingleAltitude:
    """Cover F at one altitude; a candidate is confirmed by the first sighting with confidence >= c_t.

    At h_S this is ``scan-only``, the quickest search; at h_C ``low-only``, the most careful one. Both fly at
    the scan speed. Legs that were flown blind are flown again at the end. Implements ``types.Strategy``.
    """

    def __init__(self, context: MissionContext, altitude_agl_m: float) -> None:
        search = context.search
        if not search.may_confirm_from(altitude_agl_m):
            raise UserError(
                f"search.confirm_height_max_m: is {search.confirm_height_max_m:g}, and {search.strategy} "
                f"looks from {altitude_agl_m:g} m alone; write null, or take another strategy"
            )
        if search.plan is not None and altitude_agl_m != search.scan_altitude_agl_m:
            raise UserError(
                f"search.plan: is flown at search.scan_altitude_agl_m ({search.scan_altitude_agl_m:g}), and "
                f"{search.strategy} flies at {altitude_agl_m:g} m; delete it, or take another strategy"
            )
        self._c_t = search.c_t
        self._speed_mps = search.scan_speed_mps
        self._altitude_agl_m = altitude_agl_m
        self._to_scan: list[XY] = list(context.waypoints_xy_enu_m)
        self._seen: list[int] = []
        self._confirmed: list[int] = []

    def step(self, observation: Observation) -> Command:
        """Fly on, and take down what is seen."""
        events: list[Event] = []
        for sighting in observation.sightings:
            candidate = sighting.candidate_id
            if candidate in observation.verdicts:
                continue
            x, y, z = observation.candidates[candidate].position_enu_m
            place = (float(x), float(y), float(z))
            if candidate not in self._seen:
                self._seen.append(candidate)
                events.append(Event(EventKind.SCANNED, candidate, place))
            if sighting.confidence >= self._c_t and candidate not in self._confirmed:
                self._confirmed.append(candidate)
                events.append(Event(EventKind.CONFIRMED, candidate, place))
        for leg in observation.unsearched:
            self._to_scan += [xy for xy in leg if self._to_scan[-1:] != [xy]]
        vehicle = observation.vehicle.position_enu_m
        if self._to_scan and math.dist(vehicle[:2], self._to_scan[0]) <= SCAN_ACCEPTANCE_M:
            self._to_scan.pop(0)
            events.append(Event(EventKind.WAYPOINT_REACHED))
        if not self._to_scan:
            events.append(Event(EventKind.FINISHED))
            return Command(Mode.SCAN, None, tuple(events))
        waypoint = Waypoint(self._to_scan[0], self._altitude_agl_m, self._speed_mps)
        return Command(Mode.SCAN, waypoint, tuple(events))

    def snapshot(self) -> dict[str, Any]:
        """The whole state as plain data."""
        return {
            "to_scan": [list(p) for p in self._to_scan],
            "seen": list(self._seen),
            "confirmed": list(self._confirmed),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continue from a snapshot."""
        self._to_scan = [(x, y) for x, y in snapshot["to_scan"]]
        self._seen = list(snapshot["seen"])
        self._confirmed = list(snapshot["confirmed"])
