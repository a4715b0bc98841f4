"""Which candidates are worth a closer look, in which order, and from which side."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.planning.routing import tour_from
from skysweep.scenarios.model import ALTITUDE_TOLERANCE_M
from skysweep.strategies.belief.goal import View
from skysweep.strategies.belief.hypotheses import Hypotheses
from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.strategies.context import MissionContext
from skysweep.types import XY

_LEAST_S = 1.0  # a doubt that costs less is no reason to fly
_IN_VIEW = 0.4  # of the picture's height: from so far before it a place is in view
_SIDES = ((0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (1, 1), (-1, 1), (1, -1))  # opposites follow each other
_BESIDE = [(0.0, 0.0), *((s * u, s * v) for s in (0.4, 0.8) for u, v in _SIDES)]  # of half the picture
_PLACES_M = 0.5  # nearer to each other, places are taken for one
_FAR_ABOVE_M = 100.0  # all that may hide a place
_HIGHER = (1.0, 1.5, 2.2)  # times the check's height: from there, too, a place is looked at again
_APART_RAD, _APART_OF_SCALE = 0.2, 0.3  # two views of one place that tell more than one, by either
_AT_A_PLACE_S = 1.5  # that one more place takes at least, beside the way there
VIEW_S = 20.0  # of doubt are a reason for another view
LOOKS_THERE = 5  # that tell something; then another view is due, or a verdict by the odds
_IN_PASSING = 3  # looks for which a place stays in view at least
_BRAKES_MPS2 = 4.0
_STOP_S = 3.0  # that braking and speeding up take, where a candidate is not in view for so many looks
_AGAIN_S = 4.0  # that another look takes


class Checks:
    """Prices closer looks against what deciding without them would cost."""

    def __init__(self, context: MissionContext, parameters: BeliefParameters) -> None:
        self._lens, search = context.lens, context.search
        self._speed_mps = parameters.check_speed_mps
        self._looks_hz = context.looks_hz
        self._looks_s = LOOKS_THERE / context.looks_hz
        self._at_a_place_s = max(_AT_A_PLACE_S, self._looks_s)
        self._sinks_mps = context.vehicle.descent_speed_mps
        self._climbs_mps = context.vehicle.climb_speed_mps
        self._R = rotation_camera_to_enu(context.yaw_rad, context.gimbal_pitch_rad)
        self._height_m = low_m = search.check_altitude_agl_m
        self._heights_m = [h for k in _HIGHER if (h := k * low_m) <= search.scan_altitude_agl_m]
        self._first_heights_m = self._heights_m
        if search.confirm_height_max_m is not None:
            demanded_m = max(low_m, search.confirm_height_max_m - ALTITUDE_TOLERANCE_M)
            self._first_heights_m = [*(h for h in self._heights_m if h < demanded_m), demanded_m]
        self._obstacles, self._keep_m = context.obstacles, context.keep_m
        self._area = context.area_enu_m
        shapely.prepare(self._area)
        self._shows = context.shown
        self._shown: dict[tuple[int, int, int], float] = {}

    def route(self, here: XY, places: F64, losses_s: Sequence[float]) -> list[int]:
        """Indices of the ``places`` (N, 2) that are worth a visit, in the order of a short way.

        ``losses_s`` is what deciding each candidate without another look costs on average. The open tour is
        exact for few places, else nearest neighbour with 2-opt: tens of places take well below a millisecond,
        which a general routing solver does not reach, and its tour is planned anew after every look.
        """
        losses = np.array(losses_s, dtype=float)
        return [int(k) for k in _route(here, places, losses, self._speed_mps, self._at_a_place_s)]

    def visits_s(self, here: XY, places: F64) -> F64:
        """By how much each of the places (N, 2) lengthens the way from here through all of them, in s."""
        return np.asarray(self._at_a_place_s + _spared_m(here, places) / self._speed_mps)

    def look_costs_s(
        self,
        hypotheses: Hypotheses,
        belief: F64,
        nothing: float,
        loss_s: float,
        place_enu_m: F64,
        away_m: float,
        above_m: float,
        height_m: float,
        ways: int,
    ) -> float:
        """Price of a look from ``height_m``: the time until it, and what the doubt that it leaves costs.

        The vehicle is ``away_m`` from the place and ``above_m`` above it; it flies there and, in two
        ``ways``, back. Where another look is cheaper than the doubt, that counts.
        """
        takes_s = self._takes_s(away_m, above_m, height_m)
        in_view_s = 2.0 * self._reach_m(height_m) / self._speed_mps
        takes_s += in_view_s if in_view_s >= self._looks_s else self._looks_s + _STOP_S
        doubt = self._doubt_left(hypotheses, belief, nothing, place_enu_m, height_m)
        return ways * takes_s + doubt * min(loss_s, _AGAIN_S)

    def height_m(
        self,
        hypotheses: Hypotheses,
        belief: F64,
        nothing: float,
        doubt_s: float,
        place_enu_m: F64,
        away_m: float,
        above_m: float,
    ) -> float:
        """Height above a place (3,) from which it is looked at first.

        That is the check's or a higher one: the one from where the time until the look, and what the doubt
        that it leaves costs, are least. A target may be so near that the detector sees it worse. Where a
        close look is demanded, none is above those that will do for one. The vehicle is ``away_m`` from the
        place and ``above_m`` above it. ``doubt_s`` is what deciding without a look costs on average; none is
        left of it where only the close look is lacking.
        """
        best_m, least_s = self._height_m, math.inf
        for height_m in reversed(self._first_heights_m):
            takes_s = self._takes_s(away_m, above_m, height_m)
            if doubt_s > 0.0 and takes_s <= least_s:
                doubt = self._doubt_left(hypotheses, belief, nothing, place_enu_m, height_m)
                takes_s += doubt * min(doubt_s, VIEW_S)
            if takes_s <= least_s:
                best_m, least_s = height_m, takes_s
        return best_m

    def _takes_s(self, away_m: float, above_m: float, height_m: float) -> float:
        """Until a place is in view from a height: from higher up it is from farther away."""
        flown_s = max(away_m - self._reach_m(height_m), 0.0) / self._speed_mps
        return max(flown_s, self._vertical_s(above_m, height_m))

    def _reach_m(self, height_m: float) -> float:
        """From so far before it a place is in view."""
        return _IN_VIEW * self._lens.footprint_m(height_m)[1]

    def _vertical_s(self, from_m: float, to_m: float) -> float:
        return (from_m - to_m) / self._sinks_mps if from_m > to_m else (to_m - from_m) / self._climbs_mps

    def _doubt_left(
        self, hypotheses: Hypotheses, belief: F64, nothing: float, place_enu_m: F64, height_m: float
    ) -> float:
        """Share of today's doubt that looks from so high above a place leave."""
        return self._doubt_of(hypotheses, belief, nothing, place_enu_m, View(0.0, 0.0, height_m))

    def _doubt_of(
        self, hypotheses: Hypotheses, belief: F64, nothing: float, place_enu_m: F64, view: View
    ) -> float:
        eye = CameraPose(place_enu_m + np.array(view), self._R)
        return hypotheses.confusion(belief, eye, place_enu_m, nothing)

    def speed_mps(self, away_m: float, height_m: float) -> float:
        """How fast to fly, so far from a place that is looked at in passing from a height."""
        reach_m = self._reach_m(height_m)
        passing_mps = 2.0 * reach_m * self._looks_hz / _IN_PASSING
        brakes_m = max(away_m - reach_m, 0.0)
        return min(self._speed_mps, math.sqrt(passing_mps**2 + 2.0 * _BRAKES_MPS2 * brakes_m))

    def first_view(self, place_enu_m: F64, height_m: float) -> View:
        """From straight above a place (3,) or, where a tree or a wall hides it, from the nearest clear side.

        It is straight above, too, where nothing shows it.
        """
        return next(self._views(place_enu_m, height_m), View(0.0, 0.0, height_m))

    def next_view(
        self,
        hypotheses: Hypotheses,
        belief: F64,
        nothing: float,
        loss_s: float,
        place_enu_m: F64,
        here_enu_m: F64,
        tried: Sequence[View],
    ) -> View | None:
        """From where else a place (3,) is looked at, from where that costs least; None: a verdict does.

        Another view is so far from those ``tried`` that it shows the place from another direction, or in
        another size. It costs the way there from ``here_enu_m`` (3,), the looks, and what the doubt that it
        leaves of ``loss_s`` costs. Where the vehicle does not come because of obstacles is no view.
        """
        best, least_s = None, loss_s - self._looks_s
        for height_m in self._heights_m:
            for view in self._views(place_enu_m, height_m):
                if any(_is_alike(view, other) for other in tried):
                    continue
                x, y, z = (place_enu_m + np.array(view) - here_enu_m).tolist()
                takes_s = max(math.hypot(x, y) / self._speed_mps, self._vertical_s(0.0, z))
                doubt = self._doubt_of(hypotheses, belief, nothing, place_enu_m, view)
                if takes_s + doubt * loss_s < least_s:
                    best, least_s = view, takes_s + doubt * loss_s
        return best

    def _views(self, place_enu_m: F64, height_m: float) -> Iterator[View]:
        """From a height, those that the camera has of a place (3,): straight above and from the sides.

        None is outside the area but straight above: the vehicle is not let out to look at something.
        """
        across_m, along_m = self._lens.footprint_m(height_m)
        right, down = self._R[:, 0] * across_m / 2.0, self._R[:, 1] * along_m / 2.0
        for u, v in _BESIDE:
            east_m, north_m, _ = (u * right + v * down).tolist()
            view = View(east_m, north_m, height_m)
            eye = place_enu_m + np.array(view)
            is_within = (u, v) == _BESIDE[0] or shapely.intersects_xy(self._area, eye[0], eye[1])
            if is_within and self._is_clear(eye) and not self._obstacles.hide(place_enu_m, eye):
                yield view

    def shown(self, place_enu_m: F64) -> float:
        """How probably a look from the best side shows what is at a place (3,)."""
        if not len(self._obstacles.solids):
            return 1.0
        x, y, z = place_enu_m.tolist()
        near = round(x / _PLACES_M), round(y / _PLACES_M), round(z / _PLACES_M)
        if near not in self._shown:
            place = np.array(near) * _PLACES_M
            view = next(self._views(place, self._height_m), View(0.0, 0.0, _FAR_ABOVE_M))
            self._shown[near] = self._shows(place, place + np.array(view))
        return self._shown[near]

    def _is_clear(self, eye_enu_m: F64) -> bool:
        """Whether no tree or building is nearer than the vehicle goes."""
        top_m = self._obstacles.top_within_m(eye_enu_m[None, :2], self._keep_m).item()
        return bool(top_m + self._keep_m <= eye_enu_m[2])


def _is_alike(one: View, other: View) -> bool:
    """Whether both show a place in about the same size, from about the same direction."""
    far_m, other_m = math.hypot(*one), math.hypot(*other)
    turned = math.dist([x / far_m for x in one], [x / other_m for x in other])
    return turned < _APART_RAD and abs(math.log(far_m / other_m)) < _APART_OF_SCALE


@njit(cache=True)
def _route(here: XY, places: F64, losses_s: F64, speed_mps: float, at_a_place_s: float) -> NDArray[np.int64]:
    chosen = np.nonzero(losses_s > _LEAST_S)[0]
    route = chosen[tour_from(here, places[chosen])]
    planned = len(route)
    while len(route):
        gains_s = losses_s[route] - (at_a_place_s + _spared_m(here, places[route]) / speed_mps)
        worst = int(np.argmin(gains_s))
        if gains_s[worst] >= 0.0:
            break
        route = np.concatenate((route[:worst], route[worst + 1 :]))
    if len(route) < planned:
        route = route[tour_from(here, places[route])]
    return route[: _worth(here, places[route], losses_s[route], speed_mps, at_a_place_s)]


@njit(cache=True)
def _worth(here: XY, places: F64, losses_s: F64, speed_mps: float, at_a_place_s: float) -> int:
    """How many places of a route (N, 2), from its start, buy most: a far group may not pay as a whole."""
    x, y = here
    n, total_s, most_s = 0, 0.0, 0.0
    for i in range(len(places)):
        total_s += losses_s[i] - at_a_place_s - _apart_m(x, y, places[i]) / speed_mps
        if total_s > most_s:
            n, most_s = i + 1, total_s
        x, y = places[i, 0], places[i, 1]
    return n


@njit(cache=True)
def _spared_m(here: XY, places: F64) -> F64:
    """By how much leaving out each of the places (N, 2) shortens the way from here through all of them."""
    x, y = here
    n = len(places)
    spared = np.empty(n)
    for i in range(n):
        spared[i] = _apart_m(x, y, places[i])
        if i + 1 < n:
            spared[i] += _apart_m(places[i, 0], places[i, 1], places[i + 1]) - _apart_m(x, y, places[i + 1])
        x, y = places[i, 0], places[i, 1]
    return spared


@njit(cache=True)
def _apart_m(x: float, y: float, place: F64) -> float:
    dx, dy = place[0] - x, place[1] - y
    return math.sqrt(dx * dx + dy * dy)
