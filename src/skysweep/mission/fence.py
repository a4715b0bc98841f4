"""Where the vehicle may be, and the ways inside."""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence

import numpy as np
import shapely

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.planning.advice import localisation_std_m
from skysweep.planning.surroundings import surroundings
from skysweep.scenarios.model import Scenario
from skysweep.types import XY

_MARGIN_M = 2.0  # from fence and no-fly areas, on a way round
_SLACK_M = 0.05
_REACHED_M = 2.0  # PX4 NAV_ACC_RAD
ELSEWHERE_M = 10.0  # no vehicle flies so far from one setpoint to the next: it was not heard, or taken there
_NO_PATH = np.zeros((0, 2))
_MAX_CORNERS = 20_000


class Fence:
    """The geofence less the no-fly areas and obstacles too high to fly over.

    Without a geofence: the surroundings of area, home and the path (N, 2); without those, everywhere.
    """

    def __init__(
        self,
        scenario: Scenario,
        too_high: Sequence[shapely.Polygon] = (),
        path_xy_enu_m: F64 = _NO_PATH,
    ) -> None:
        no_fly = [shapely.Polygon(corners) for corners in scenario.safety.no_fly_enu_m]
        forbidden = shapely.union_all([*no_fly, *too_high])
        if scenario.geofence_enu_m is not None:
            inside = shapely.Polygon(scenario.geofence_enu_m)
        else:
            inside = surroundings(scenario, path_xy_enu_m, list(shapely.get_parts(forbidden)))
        self.exists = inside is not None or not forbidden.is_empty
        self.is_straight = scenario.geofence_enu_m is None and forbidden.is_empty  # all ways are
        if not self.exists:
            return
        if inside is None:
            everything = shapely.union_all([scenario.area_enu_m, shapely.Point(scenario.home.position_enu_m)])
            inside = shapely.union(everything, forbidden).envelope.buffer(1e5)
        self._free = shapely.difference(inside, forbidden).buffer(_SLACK_M)
        self._edge = shapely.boundary(self._free)
        shapely.prepare(self._free)
        self._roomy = shapely.difference(
            inside.buffer(-_MARGIN_M), forbidden.buffer(_MARGIN_M, join_style="mitre")
        )
        corners = shapely.get_coordinates(self._roomy)
        self._corners = corners[shapely.contains_xy(self._free, corners)]
        if len(self._corners) > _MAX_CORNERS:
            raise UserError(
                f"safety.altitude_max_agl_m: what is too high to be flown over has {len(self._corners):,} "
                "corners with fence and no-fly areas, too many to find ways round; raise it"
            )
        self._graph: dict[int, list[tuple[int, float]]] = {}

    def allows(self, xy: XY) -> bool:
        """Whether a place is inside."""
        return not self.exists or bool(shapely.intersects_xy(self._free, *xy))

    def reached_from(self, xy: XY) -> shapely.Geometry:
        """The part of the inside in which a place lies; nothing where it lies in none."""
        parts = shapely.get_parts(self._free)
        return shapely.union_all(parts[shapely.intersects_xy(parts, *xy)])

    def outside_m(self, xy: XY) -> float:
        """Distance of a place from the inside; 0 inside."""
        return 0.0 if self.allows(xy) else float(shapely.distance(self._free, shapely.Point(xy)))

    def room_m(self, xy: XY) -> float:
        """Distance of a place from the edge; 0 outside."""
        if not self.exists:
            return math.inf
        place = shapely.Point(xy)
        return float(self._edge.distance(place)) if self._free.intersects(place) else 0.0

    def way(self, start: XY, goal: XY) -> list[XY]:
        """Places to fly to in turn, ``goal`` last. From outside it leads inside first. Empty: no way."""
        if self.is_straight:
            return [goal] if self.allows(goal) else []
        if self.sees(start, goal):
            return [goal]
        if not self.allows(goal):
            return []
        if not self.allows(start):
            entry = self._entry(start)
            return [entry, *([goal] if self.sees(entry, goal) else self._way_round(entry, goal))]
        return self._way_round(start, goal)

    def _entry(self, start: XY) -> XY:
        """Where to fly inside from outside: to the nearest place, and beyond its edge where there is room."""
        roomy = self._free if self._roomy.is_empty else self._roomy
        x, y = shapely.get_coordinates(shapely.shortest_line(roomy, shapely.Point(start)))[0]
        return float(x), float(y)

    def sees(self, a: XY, b: XY) -> bool:
        """Whether the straight line between two places stays inside."""
        return bool(shapely.covers(self._free, shapely.LineString([a, b])))

    def _visible(self, xy: XY) -> list[tuple[int, float]]:
        """Corners in sight, with their distances."""
        ends = np.broadcast_to(np.array(xy), self._corners.shape)
        clear = shapely.covers(self._free, shapely.linestrings(np.stack([ends, self._corners], axis=1)))
        distances = np.linalg.norm(self._corners - ends, axis=1)
        return [(int(k), float(distances[k])) for k in np.flatnonzero(clear)]

    def _way_round(self, start: XY, goal: XY) -> list[XY]:
        """Shortest way over the corners: A* (Hart, Nilsson & Raphael 1968) on the visibility graph.

        Visibility, the costly part in a wood, is computed only for corners that the search reaches.
        """
        ahead_m = np.linalg.norm(self._corners - goal, axis=1)
        sees_goal = {k for k, _ in self._visible(goal)}
        queue: list[tuple[float, tuple[int, ...], float]] = [
            (length + ahead_m[k], (k,), length) for k, length in self._visible(start)
        ]
        heapq.heapify(queue)
        done: set[int] = set()
        while queue:
            _, path, length = heapq.heappop(queue)
            k = path[-1]
            if k in sees_goal:
                return [*((float(x), float(y)) for x, y in self._corners[list(path)]), goal]
            if k in done:
                continue
            done.add(k)
            if k not in self._graph:
                self._graph[k] = self._visible((self._corners[k, 0], self._corners[k, 1]))
            for other, step in self._graph[k]:
                if other not in done:
                    heapq.heappush(queue, (length + step + ahead_m[other], (*path, other), length + step))
        return []


class SearchedArea:
    """Where candidates are checked: the area less its holes, widened by the localisation error."""

    def __init__(self, scenario: Scenario) -> None:
        misplaced_m = 2.0 * localisation_std_m(scenario, scenario.search.scan_altitude_agl_m)
        self._everywhere = scenario.safety.check_outside_area
        self._area = scenario.area_enu_m.buffer(misplaced_m)
        shapely.prepare(self._area)

    def covers(self, xy: XY) -> bool:
        """Whether a candidate there is checked."""
        return self._everywhere or bool(shapely.intersects_xy(self._area, *xy))


class Router:
    """The next place on the way to a goal."""

    def __init__(self, fence: Fence) -> None:
        self._fence = fence
        self._goal: XY | None = None
        self._here: XY = (math.inf, math.inf)  # when it was asked last
        self._way: list[XY] = []

    def is_straight(self, here: XY, goal: XY) -> bool:
        """Whether nothing is in the way."""
        return self._fence.is_straight or self._fence.sees(here, goal)

    def next_xy(self, here: XY, goal: XY) -> XY:
        """The next corner, or the goal if there is none or no way."""
        if self._fence.is_straight:
            return goal
        if goal != self._goal or math.dist(here, self._here) > ELSEWHERE_M:
            self._goal, self._way = goal, self._fence.way(here, goal) or [goal]
        self._here = here
        while len(self._way) > 1 and math.dist(here, self._way[0]) <= _REACHED_M:
            self._way.pop(0)
        return self._way[0]
