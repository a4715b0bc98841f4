"""When a candidate is looked at: now, from a place of the scan still to come, or in the tour after it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

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
        return float(self._ends_s(np.array(scan).reshape(-1, 2))[-1])

    def visits(
        self, here: XY, above_m: float, scan: Sequence[XY], places: F64, waiting: F64, dear: float = 1.0
    ) -> Visits:
        """What a visit of each place (N, 2) costs now and later.

        ``scan`` is the way of the scan, from where it goes on. ``waiting`` (N,) is the price of a second that
        a place waits, ``dear`` that of a second of detour, while all others wait. The way back and the climb
        count only as far as they are not flown anyway.
        """
        path = np.array(scan)
        ends_s = self._ends_s(path)
        climb_s = (self._high_m - self._low_m) / self._up_mps
        down_s = max(above_m - self._low_m, 0.0) / self._down_mps
        there_s = np.maximum(np.linalg.norm(places - here, axis=1) / self._speed_mps, down_s)
        back_s = np.maximum(np.linalg.norm(places - path[0], axis=1) / self._speed_mps, climb_s)
        anyway_m = float(np.linalg.norm(path[0] - here))
        anyway_s = max(anyway_m / self._speed_mps, (self._high_m - above_m) / self._up_mps)
        leaving_s = _LEAVING_S if anyway_m == 0.0 else 0.0  # else it was left before
        now_s = there_s + back_s - anyway_s + leaving_s
        away_m, until_s = _nearest(places, *self._later(path, ends_s))
        away_s = away_m / self._speed_mps
        whole_s = (self._high_m - self._low_m) / self._down_mps
        lane_s = dear * (np.maximum(away_s, whole_s) + np.maximum(away_s, climb_s) + _LEAVING_S)
        lane_s += waiting[:, None] * until_s
        tour_s = _apart_m(np.vstack([places, path[-1]]))[:-1] / self._speed_mps + waiting * ends_s[-1]
        return Visits(dear * now_s, lane_s.min(axis=1), tour_s)

    def _later(self, path: F64, ends_s: F64) -> tuple[F64, F64]:
        """The way without its next seconds, which are now."""
        first = np.array([min(_NOW_S, ends_s[1])])
        start = np.array([np.interp(first, ends_s[:2], path[:2, k]) for k in (0, 1)]).T
        return np.vstack([start, path[1:]]), np.concatenate([first, ends_s[1:]])

    def _ends_s(self, path: F64) -> F64:
        """When each point of a path (N, 2) is reached by the scan."""
        steps_m = np.linalg.norm(np.diff(path, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps_m)]) / self._scan_mps


def _nearest(places: F64, path: F64, ends_s: F64) -> tuple[F64, F64]:
    """How near each leg of a path comes to each place, and when: (N, legs) each."""
    legs = np.diff(path, axis=0)
    squared = np.maximum((legs**2).sum(axis=1), 1e-9)
    offset = places[:, None] - path[:-1]
    share = np.clip((offset * legs).sum(axis=2) / squared, 0.0, 1.0)
    away_m = np.linalg.norm(offset - share[:, :, None] * legs, axis=2)
    return away_m, ends_s[:-1] + share * np.diff(ends_s)


def _apart_m(places: F64) -> F64:
    """Distance of each place (N, 2) to the nearest other."""
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    np.fill_diagonal(apart, np.inf)
    return np.asarray(apart.min(axis=1))
