"""The oracle: how fast a search could be that looks closely at every true target and at nothing else.

It is no strategy: it is told where the targets are. It flies in the same loop with the same vehicle, so that
what it takes can be compared with what strategies take. It confirms nothing; only its times mean something.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from skysweep.arrays import F64
from skysweep.geometry.camera import project
from skysweep.planning.routing import EXACT_MAX, shortest_tour
from skysweep.scenarios.model import ALTITUDE_TOLERANCE_M, Scenario
from skysweep.strategies import StrategySpec
from skysweep.strategies.context import MissionContext
from skysweep.strategies.passing import is_past
from skysweep.types import XY, Command, Event, EventKind, Look, Mode, Observation, Waypoint
from skysweep.worlds.world import build_world


def oracle_spec(scenario: Scenario, seed: int, look_m: float) -> StrategySpec:
    """How to make the oracle of one mission, which looks from ``look_m`` above a target or lower."""
    targets = build_world(scenario, seed).targets
    places = np.array([t.position_enu_m for t in targets]).reshape(-1, 3)
    return StrategySpec(lambda context: Oracle(context, places, look_m))


class Oracle:
    """Scans F, then flies past every target (N, 3) on a shortest way, without a stop.

    A target is done with once a picture shows it from ``look_m`` above it or lower; the search ends with the
    answer to the last of these pictures. Implements ``types.Strategy``, without being one.
    """

    def __init__(self, context: MissionContext, targets_enu_m: F64, look_m: float) -> None:
        self._search, self._speed_mps = context.search, context.vehicle.cruise_speed_mps
        self._targets, self._look_m = targets_enu_m, look_m
        self._to_scan: list[XY] = list(context.waypoints_xy_enu_m)
        self._to_see = list(range(len(targets_enu_m)))
        self._is_ordered = False
        self._stops = False  # at the next target, because it was flown past unseen

    def step(self, observation: Observation) -> Command:
        """Fly on, with the scan first."""
        seen, events = observation, list[Event]()
        for leg in seen.unsearched:
            self._to_scan += [xy for xy in leg if self._to_scan[-1:] != [xy]]
        goal = self._to_see[:1]
        self._to_see = [k for k in self._to_see if not any(self._shows(look, k, seen) for look in seen.looks)]
        if self._to_scan and is_past(seen, self._to_scan[0]):
            self._to_scan.pop(0)
            events.append(Event(EventKind.WAYPOINT_REACHED))
        if self._to_scan:
            search, then = self._search, next(iter(self._to_scan[1:]), None)
            waypoint = Waypoint(
                self._to_scan[0], search.scan_altitude_agl_m, search.scan_speed_mps, then_xy_enu_m=then
            )
            return Command(Mode.SCAN, waypoint, tuple(events))
        return self._visit(seen, goal, events)

    def _visit(self, seen: Observation, goal: list[int], events: list[Event]) -> Command:
        if not self._is_ordered:
            x, y, _ = seen.vehicle.position_enu_m.tolist()
            order = shortest_order((x, y), self._targets[self._to_see, :2])
            self._to_see, self._is_ordered, goal = [self._to_see[k] for k in order], True, []
        elif seen.refused and goal == self._to_see[:1]:
            self._to_see = self._to_see[1:]
        if not self._to_see:
            return Command(Mode.CHECK, None, (*events, Event(EventKind.FINISHED)))
        if goal != self._to_see[:1]:
            self._stops = False
            events.append(Event(EventKind.CHECK_STARTED))
        to, *others = (self._xy(k) for k in self._to_see[:2])
        self._stops |= is_past(seen, to)
        then = None if self._stops else next(iter(others), None)
        height_m = max(self._look_m - ALTITUDE_TOLERANCE_M, self._search.check_altitude_agl_m)
        waypoint = Waypoint(to, height_m, self._speed_mps, to_look=True, then_xy_enu_m=then)
        return Command(Mode.CHECK, waypoint, tuple(events))

    def _shows(self, look: Look, k: int, seen: Observation) -> bool:
        """Whether a picture shows target ``k`` from near enough. Leaves and roofs hide nothing from it.

        Where obstacles keep the vehicle away from the next target, a picture from its lookout will do.
        """
        limit_m = self._look_m
        if seen.lookout is not None and k == self._to_see[0]:
            limit_m = max(limit_m, seen.lookout.altitude_agl_m + ALTITUDE_TOLERANCE_M)
        if look.camera.position_enu_m[2] - self._targets[k, 2] > limit_m:
            return False
        ((u, v),), (depth_m,) = project(look.lens, look.camera, self._targets[[k]])
        return bool(depth_m > 0.0 and 0.0 <= u <= look.lens.width_px and 0.0 <= v <= look.lens.height_px)

    def _xy(self, k: int) -> XY:
        x, y = self._targets[k, :2].tolist()
        return x, y

    def snapshot(self) -> dict[str, Any]:
        """The whole state as plain data."""
        return {
            "to_scan": [list(p) for p in self._to_scan],
            "to_see": list(self._to_see),
            "is_ordered": self._is_ordered,
            "stops": self._stops,
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continue from a snapshot."""
        self._to_scan = [(x, y) for x, y in snapshot["to_scan"]]
        self._to_see, self._is_ordered = list(snapshot["to_see"]), snapshot["is_ordered"]
        self._stops = snapshot["stops"]


def shortest_order(here: XY, places: F64) -> list[int]:
    """Indices of ``places`` (N, 2) in the order of a shortest open way from ``here``.

    It is exact up to ``EXACT_MAX`` places and one more. Beyond, it is the best of N ways, each of which
    begins at another place and is improved by 2-opt.
    """
    n = len(places)
    if n <= EXACT_MAX:
        return shortest_tour(here, places)
    ways = []
    for first in range(n):
        others = [k for k in range(n) if k != first]
        rest = shortest_tour((places[first, 0], places[first, 1]), places[others])
        ways.append([first, *(others[k] for k in rest)])
    return min(ways, key=lambda way: _length_m(here, places, way))


def _length_m(here: XY, places: F64, way: list[int]) -> float:
    return float(np.linalg.norm(np.diff(np.vstack([[here], places[way]]), axis=0), axis=1).sum())
