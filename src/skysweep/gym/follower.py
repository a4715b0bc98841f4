"""The strategy that follows a learner; Algorithm 1 decides what a CHECK confirms and rejects."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from skysweep.gym.spaces import CONFIRMED, OPEN, REJECTED, UNCHECKED
from skysweep.strategies.context import MissionContext
from skysweep.strategies.scan_check import ScanCheck
from skysweep.types import XY, Command, Event, EventKind, Mode, Observation, Waypoint


class AgentOrder(NamedTuple):
    """A learner's current order."""

    mode: Mode  # SCAN or CHECK
    xy_enu_m: XY  # where to, or near which candidate
    speed_mps: float  # in SCAN
    ends: bool = False  # the search, if it scans


class Follower(ScanCheck):
    """Scans towards a place, or descends to the open candidate nearest to it.

    A candidate sighted inside the area is open until a CHECK confirms or rejects it; without open candidates
    a CHECK becomes a SCAN. The vehicle does not fly to a refused place, but waits for another order. When the
    search ends, an open candidate that was once seen with confidence c_t counts as confirmed. Implements
    ``types.Strategy``.
    """

    def __init__(self, context: MissionContext) -> None:
        super().__init__(replace(context, waypoints_xy_enu_m=()))
        self._order: AgentOrder | None = None
        self._asked: Waypoint | None = None  # newest
        self._waits: Waypoint | None = None  # here, because the order was refused
        self._chosen: int | None = None  # candidate, to check by this order
        self.seen: Observation | None = None

    @property
    def listed(self) -> dict[int, int]:
        """Status of every candidate that was sighted, in the order of their numbers."""
        known = [(self._scanned, OPEN), (self._to_check, OPEN), (self._confirmed, CONFIRMED)]
        known += [(self._rejected, REJECTED), (self._unchecked, UNCHECKED)]
        return dict(sorted((k, status) for numbers, status in known for k in numbers))

    @property
    def checks(self) -> bool:
        """Whether it descends to a candidate."""
        return self._mode == Mode.CHECK

    def follow(self, order: AgentOrder) -> None:
        """Follow an order from the next step on."""
        self._order, self._waits, self._chosen = order, None, None

    def step(self, observation: Observation) -> Command:
        """Judge checked candidates, list new ones, and follow the order."""
        self.seen, events = observation, list[Event]()
        if self._mode == Mode.CHECK:
            self._check(observation, events)
        for sighting in observation.sightings:
            if self._is_unknown(sighting.candidate_id):
                self._scanned.append(sighting.candidate_id)
                events.append(self._told(EventKind.SCANNED, sighting.candidate_id))
        order = self._order or AgentOrder(
            Mode.SCAN, self._here(observation).xy_enu_m, self._search.scan_speed_mps
        )
        self._turn_to(order, observation, events)
        if order.ends and self._mode == Mode.SCAN:
            self._close(observation, events)
            return Command(Mode.SCAN, None, (*events, Event(EventKind.FINISHED)))
        self._asked = self._waypoint(observation) if self.checks else self._scan_to(order, observation)
        return Command(self._mode, self._asked, tuple(events))

    def _scan_to(self, order: AgentOrder, seen: Observation) -> Waypoint:
        """The ordered place unless it was just refused: asking for it again would end the search."""
        to = Waypoint(order.xy_enu_m, self._search.scan_altitude_agl_m, order.speed_mps)
        if self._waits is None and seen.refused and to == self._asked:
            self._waits = self._here(seen)
        return self._waits or to

    def _turn_to(self, order: AgentOrder, seen: Observation, events: list[Event]) -> None:
        """Choose the mode, and the first candidate."""
        left = [*self._to_check, *self._scanned]
        if order.mode == Mode.SCAN or not left:
            if self.checks:
                events.append(Event(EventKind.SCAN_RESUMED))
            self._mode, self._scanned, self._to_check, self._arrived_s = Mode.SCAN, left, [], None
            return
        if self._chosen not in left:
            xy = order.xy_enu_m
            self._chosen = min(left, key=lambda k: math.dist(seen.candidates[k].position_enu_m[:2], xy))
        elif self._to_check[:1] == [self._chosen]:
            return
        if self._to_check[:1] != [self._chosen]:
            self._arrived_s = None
        if not self.checks:
            events.append(self._told(EventKind.CHECK_STARTED, self._chosen))
        left.remove(self._chosen)
        self._mode, self._scanned, self._to_check = Mode.CHECK, [], [self._chosen, *left]

    def _close(self, seen: Observation, events: list[Event]) -> None:
        """Settle the open candidates at the end of the search."""
        self._to_check, self._scanned = self._scanned, []
        for k in list(self._to_check):
            if max(seen.candidates[k].confidences) >= self._search.c_t:
                self._settle(k, self._confirmed, EventKind.CONFIRMED, seen, events)
            else:
                self._settle(k, self._unchecked, EventKind.UNCHECKED, seen, events)

    def _here(self, seen: Observation) -> Waypoint:
        x, y, _ = seen.vehicle.position_enu_m.tolist()
        return Waypoint((x, y), self._search.scan_altitude_agl_m, self._search.scan_speed_mps)

    def _told(self, kind: EventKind, candidate_id: int) -> Event:
        assert self.seen is not None
        x, y, z = self.seen.candidates[candidate_id].position_enu_m.tolist()
        return Event(kind, candidate_id, (x, y, z))
