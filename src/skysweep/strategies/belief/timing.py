"""When a candidate is looked at: now, from a place of the scan still to come, or in the tour after it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from skysweep.arrays import F64
from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.strategies.context import MissionContext
from skysweep.types import XY

_LEAVING_S = 8.0  # that braking, turning and coming back to the scan's way take
_NOW_S = 5.0  # of the scan, during which a visit is one from here


class Visits(NamedTuple):
    """What a visit of each place costs in seconds (N,), by when it is made."""

    now_s: F64
    nearest_s: F64  # when the scan comes nearest to it
    after_s: F64  # in the tour after the scan

    @property
    def saved_s(self) -> F64:
        """(N,) by a visit now against one later."""
        return np.minimum(self.nearest_s, self.after_s) - self.now_s


class Timing:
    """Prices a visit in seconds: the detour, the way down and up again, and what waiting costs until then."""

    def __init__(self, context: MissionContext, parameters: BeliefParameters) -> None:
        search, vehicle = context.search, context.vehicle
        self._speed_mps, self._scan_mps = parameters.check_speed_mps, search.scan_speed_mps
        self._down_mps, self._up_mps = vehicle.descent_speed_mps, vehicle.climb_speed_mps
        self._high_m, self._low_m = search.scan_altitude_agl_m, search.check_altitude_agl_m

    def scan_s(self, scan: Sequence[XY]) -> float:
        """How long it takes to fly the way of the scan."""
        return sum(map(math.dist, scan, scan[1:])) / self._scan_mps

    def visits(
        self, here: XY, above_m: float, scan: Sequence[XY], places: F64, waiting: F64, dear: float = 1.0
    ) -> Visits:
        """What a visit of each place (N, 2) costs now and later.

        ``scan`` is the way of the scan, from where it goes on. ``waiting`` (N,) is the price of a second that
        a place waits, ``dear`` that of a second of detour, while all others wait. The way back and the climb
        count only as far as they are not flown anyway.
        """
        climb_s = (self._high_m - self._low_m) / self._up_mps
        down_s = max(above_m - self._low_m, 0.0) / self._down_mps
        anyway_m = math.dist(scan[0], here)
        anyway_s = max(anyway_m / self._speed_mps, (self._high_m - above_m) / self._up_mps)
        leaving_s = _LEAVING_S if anyway_m == 0.0 else 0.0  # else it was left before
        whole_s = (self._high_m - self._low_m) / self._down_mps
        path, x, y = np.array(scan), *here
        return Visits(
            *_visits(
                (x, y), path, places, waiting, dear, self._speed_mps, self._scan_mps,
                down_s, whole_s, climb_s, leaving_s - anyway_s,
            )
        )  # fmt: skip


@njit(cache=True)
def _visits(
    here: XY,
    path: F64,
    places: F64,
    waiting: F64,
    dear: float,
    speed_mps: float,
    scan_mps: float,
    down_s: float,  # to the height of a check, from here
    whole_s: float,  # the same, from the height of the scan
    climb_s: float,  # back to it
    more_s: float,  # that a visit takes now
) -> tuple[F64, F64, F64]:
    n, legs = len(places), len(path) - 1
    now_s, nearest_s, after_s = np.empty(n), np.full(n, np.inf), np.empty(n)
    ends_s = np.zeros(legs + 1)
    for k in range(legs):
        ends_s[k + 1] = ends_s[k] + _apart_m(path[k], path[k + 1]) / scan_mps
    later, later_s = path.copy(), ends_s.copy()  # without its next seconds, which are now
    later_s[0] = min(_NOW_S, ends_s[1])
    share = later_s[0] / ends_s[1] if ends_s[1] > 0.0 else 1.0
    later[0] = path[0] + share * (path[1] - path[0])
    for i in range(n):
        there_s = max(math.hypot(places[i, 0] - here[0], places[i, 1] - here[1]) / speed_mps, down_s)
        back_s = max(_apart_m(places[i], path[0]) / speed_mps, climb_s)
        now_s[i] = dear * (there_s + back_s + more_s)
        for k in range(legs):
            away_m, along = _nearest(places[i], later[k], later[k + 1])
            away_s, until_s = away_m / speed_mps, later_s[k] + along * (later_s[k + 1] - later_s[k])
            lane_s = dear * (max(away_s, whole_s) + max(away_s, climb_s) + _LEAVING_S) + waiting[i] * until_s
            nearest_s[i] = min(nearest_s[i], lane_s)
        other_m = _apart_m(places[i], path[legs])
        for j in range(n):
            if j != i:
                other_m = min(other_m, _apart_m(places[i], places[j]))
        after_s[i] = other_m / speed_mps + waiting[i] * ends_s[legs]
    return now_s, nearest_s, after_s


@njit(cache=True)
def _nearest(place: F64, start: F64, end: F64) -> tuple[float, float]:
    """How near a leg comes to a place, and at which share of it."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    x, y = place[0] - start[0], place[1] - start[1]
    share = min(max((x * dx + y * dy) / max(dx * dx + dy * dy, 1e-9), 0.0), 1.0)
    return math.hypot(x - share * dx, y - share * dy), share


@njit(cache=True)
def _apart_m(a: F64, b: F64) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])
