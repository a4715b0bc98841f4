"""Where objects that move are at any time: straight legs at constant speed, one after the other."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import shapely

from skysweep.scenarios.leeway import LEEWAY, leeway_mps
from skysweep.scenarios.model import Motion, PathMotion, WalkMotion, Wind
from skysweep.types import XY

_SHORTEST_M = 1e-3  # of a leg of a path
_SHORTEST_SHARE = 0.05  # of the mean stretch of a walk
_TURNS = 24  # tries to go on without leaving the area; from half of them on in any direction


class Leg(NamedTuple):
    """One stretch; its velocity is east and north."""

    duration_s: float
    velocity_mps: XY


class Placing(NamedTuple):
    """Where an object is and which way it faces."""

    x_m: float
    y_m: float
    yaw_rad: float


class Track:
    """Legs from a place on, begun at time 0. After the last one the object stands still.

    Legs are taken from the iterator when they are first needed, in their order, so that the answers do not
    depend on the order of the questions. With ``turns`` the object faces where it goes. Where ``period_s`` is
    finite, the legs lead back to the start, and it goes round.
    """

    def __init__(
        self, start: Placing, legs: Iterator[Leg], turns: bool = True, period_s: float = math.inf
    ) -> None:
        self._legs, self._turns, self._period_s = legs, turns, period_s
        self._times_s = [0.0]
        self._starts = [start]
        self._velocities_mps: list[XY] = []

    def at(self, time_s: float) -> Placing:
        """The place at a time; before time 0 the start's."""
        time_s = max(time_s, 0.0)
        time_s = time_s % self._period_s if math.isfinite(self._period_s) else time_s
        while self._times_s[-1] <= time_s and self._take_leg():
            pass
        k = bisect_right(self._times_s, time_s) - 1
        x, y, yaw = self._starts[k]
        if k == len(self._velocities_mps):
            return self._starts[k]
        east, north = self._velocities_mps[k]
        since_s = time_s - self._times_s[k]
        return Placing(x + since_s * east, y + since_s * north, self._facing(self._velocities_mps[k], yaw))

    def _take_leg(self) -> bool:
        """Append the next leg; False after the last."""
        leg = next(self._legs, None)
        if leg is None:
            return False
        x, y, yaw = self._starts[-1]
        (east, north), duration_s = leg.velocity_mps, leg.duration_s
        ends = (x + duration_s * east, y + duration_s * north) if math.isfinite(duration_s) else (x, y)
        self._velocities_mps.append(leg.velocity_mps)
        self._times_s.append(self._times_s[-1] + duration_s)
        self._starts.append(Placing(*ends, self._facing(leg.velocity_mps, yaw)))
        return True

    def _facing(self, velocity_mps: XY, before_rad: float) -> float:
        east, north = velocity_mps
        moves = self._turns and (east != 0.0 or north != 0.0)
        return math.atan2(north, east) if moves else before_rad


def track_of(
    motion: Motion, start: Placing, wind: Wind, may_walk: shapely.Geometry, rng: np.random.Generator
) -> Track:
    """The track of an object that stands at ``start`` at time 0. A walk stays on ``may_walk``."""
    if isinstance(motion, PathMotion):
        return _along_path(motion, start)
    if isinstance(motion, WalkMotion):
        return Track(start, _Walk(motion, start, may_walk, rng))
    towards_rad = math.radians(wind.from_heading_deg + 180.0)
    blows_mps = wind.mean_speed_mps * np.array([[math.sin(towards_rad), math.cos(towards_rad)]])
    to_right, errors = rng.random(1) < 0.5, rng.normal(size=(2, 1))
    velocity = leeway_mps(LEEWAY[motion.leeway], blows_mps, to_right, errors)[0] + motion.current_mps
    east, north = velocity.tolist()
    return Track(start, iter([Leg(math.inf, (east, north))]), turns=False)


def _along_path(motion: PathMotion, start: Placing) -> Track:
    loops = motion.at_end == "loop"
    home = (start.x_m, start.y_m)
    legs = []
    for a, b in itertools.pairwise([home, *motion.waypoints_enu_m, *([home] if loops else [])]):
        length_m = math.dist(a, b)
        if length_m >= _SHORTEST_M:
            share = motion.speed_mps / length_m
            legs.append(Leg(1.0 / share, (share * (b[0] - a[0]), share * (b[1] - a[1]))))
    period_s = sum(leg.duration_s for leg in legs) if loops and legs else math.inf
    return Track(start, iter(legs), period_s=period_s)


class _Walk(Iterator[Leg]):
    """The endless legs of a random walk."""

    def __init__(
        self, motion: WalkMotion, start: Placing, may_walk: shapely.Geometry, rng: np.random.Generator
    ) -> None:
        self._motion, self._rng = motion, rng
        self._x_m, self._y_m, self._heading_rad = start
        self._may_walk = may_walk
        self._stays = motion.stays_in_area and bool(shapely.intersects_xy(may_walk, start.x_m, start.y_m))
        self._rests = False

    def __next__(self) -> Leg:
        motion, share = self._motion, self._motion.rest_share
        self._rests = not self._rests and share > 0.0
        if self._rests:
            return Leg(self._lasting_s(motion.straight_s * share / (1.0 - share)), (0.0, 0.0))
        duration_s = self._lasting_s(motion.straight_s)
        turns = np.radians(motion.turn_deg) * self._rng.normal(size=_TURNS)
        turns[_TURNS // 2 :] = self._rng.uniform(-np.pi, np.pi, _TURNS - _TURNS // 2)
        for k, turn in enumerate(turns.tolist()):
            if k >= _TURNS // 2:
                duration_s /= 2.0
            heading_rad = self._heading_rad + turn
            velocity = motion.speed_mps * math.cos(heading_rad), motion.speed_mps * math.sin(heading_rad)
            x_m, y_m = self._x_m + duration_s * velocity[0], self._y_m + duration_s * velocity[1]
            way = shapely.LineString([(self._x_m, self._y_m), (x_m, y_m)])
            if not self._stays or shapely.covers(self._may_walk, way):
                self._x_m, self._y_m, self._heading_rad = x_m, y_m, heading_rad
                return Leg(duration_s, velocity)
        return Leg(motion.straight_s, (0.0, 0.0))

    def _lasting_s(self, mean_s: float) -> float:
        return max(float(self._rng.exponential(mean_s)), _SHORTEST_SHARE * mean_s)
