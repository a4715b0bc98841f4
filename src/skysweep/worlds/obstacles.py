"""Known obstacles: trees, buildings and the ground itself.

A solid is an upright prism whose outline is a rectangle with round corners: a crown is a disc, a building its
walls and eaves. The space below a crown counts as solid. A gable may rise by half the width of its house.
A row of ``solids`` is ``x, y`` of the centre, cosine and sine of the yaw, the half sides ``a, b``, the radius
``r`` around them, the height ENU below which it can be seen through, and the height ENU of its top.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F64, I64
from skysweep.geometry.areas import turned_boxes
from skysweep.scenarios.model import Scenario
from skysweep.types import XY, Mode
from skysweep.worlds.grid import Grid, around
from skysweep.worlds.world import (
    TerrainSurface,
    WorldBuilding,
    WorldTree,
    bilinear,
    build_buildings,
    build_terrain,
    build_trees,
)

_SIGMAS = 3.0  # of the position error, added to the clearance
BODY_RADIUS_M = 0.3  # of the vehicle: anything nearer to its centre is touched
_EAVES_M = 0.4
_CROWN_FROM = 0.35  # of a tree's height
_STATION_M = 0.5  # between two samples of a leg
_GROUND_STATION_M = 1.0
_GROUND_PLACES = 9  # in each row of the ground samples around a place
_TRACK_STEP_M = 0.1
_BLOCK = 64  # steps of a track
_ABOUT_A_PLACE = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)]) * 0.7  # m
_NEAR_PLACE_M = 1.5  # from the place; its position is not known better, so nothing nearer hides it


class Obstacles:
    """All solids of a scenario, and its ground."""

    def __init__(
        self, terrain: TerrainSurface, trees: Sequence[WorldTree], buildings: Sequence[WorldBuilding]
    ) -> None:
        self.terrain = terrain
        rows = []
        for t in trees:
            x, y, z = t.position_enu_m.tolist()
            crown = z + _CROWN_FROM * t.height_m
            rows.append((x, y, 1.0, 0.0, 0.0, 0.0, t.crown_radius_m, crown, z + t.height_m))
        for b in buildings:
            x, y, z = b.position_enu_m.tolist()
            yaw = math.cos(b.yaw_rad), math.sin(b.yaw_rad)
            length, width = b.size_m
            top = z + b.height_m + (0.0 if b.flat_roof else width / 2)
            rows.append((x, y, *yaw, length / 2, width / 2, _EAVES_M, z, top))
        self.solids = np.array(rows, dtype=float).reshape(-1, 9)
        self._grid = Grid.of(self.solids[:, :2], self.solids[:, 4:7].sum(axis=1))
        self._relief_m = float(np.ptp(terrain.heights_m))

    @property
    def exist(self) -> bool:
        """Whether there is anything but flat ground."""
        return len(self.solids) > 0 or not self.terrain.is_flat

    def top_m(self) -> float:
        """Height ENU of the highest point."""
        return float(self.solids[:, 8].max(initial=self.terrain.heights_m.max()))

    def outlines(self) -> NDArray[np.object_]:
        """Polygons (N,) of the solids, seen from above."""
        x, y, cos, sin, a, b, r = self.solids[:, :7].T
        cores = shapely.points(x, y)
        walls = a > 0.0
        sizes, yaws = 2.0 * np.column_stack([a, b]), np.arctan2(sin, cos)
        cores[walls] = turned_boxes(np.column_stack([x, y])[walls], sizes[walls], yaws[walls])
        return np.asarray(shapely.buffer(cores, r), dtype=object)

    def top_within_m(self, xy_enu_m: F64, distance_m: float) -> F64:
        """Height ENU of the highest top (N,) within a horizontal distance of places (N, 2); -inf if none."""
        return _top_within(self.solids, *self._grid, xy_enu_m, distance_m)

    def heights_within_m(self, xy_enu_m: XY, distance_m: float) -> tuple[float, float]:
        """Heights ENU of the lowest ground and the highest top or ground within a horizontal distance."""
        here = np.array([xy_enu_m])
        steps_m = np.linspace(-distance_m, distance_m, _GROUND_PLACES)
        around = here + np.stack(np.meshgrid(steps_m, steps_m), axis=-1).reshape(-1, 2)
        ground_m = self.terrain.height_m(around)
        top_m = self.top_within_m(here, distance_m).item()
        return float(ground_m.min()), max(float(ground_m.max()), top_m)

    def heights_along(
        self, here: XY, to: XY, keep_m: float, keep_ground_m: float, near_m: float, slope: float
    ) -> tuple[float, float]:
        """Heights ENU that keep a straight leg ``keep_m`` above, or beside, all solids.

        The first is needed now if the vehicle climbs ``slope`` metres a metre from ``near_m`` on; the second
        is needed within the next ``near_m``. Both are -inf if nothing is in the way. A negative ``near_m`` is
        that of a leg which begins so far behind it. The ground within
        ``keep_m`` beside the leg stays ``keep_ground_m`` below.
        """
        terrain = self.terrain
        aim_m, least_m = _solids_along(self.solids, *self._grid, *here, *to, keep_m, near_m, slope)
        if terrain.is_flat:
            return aim_m, least_m
        farthest_m = max(near_m + self._relief_m / slope, 0.0)
        ground_aim_m, ground_least_m = _ground_along(
            terrain.heights_m, terrain.bounds_enu_m, *here, *to, keep_m, near_m, slope, farthest_m
        )
        return max(aim_m, ground_aim_m + keep_ground_m), max(least_m, ground_least_m + keep_ground_m)

    def hide(self, place_enu_m: F64, eye_enu_m: F64) -> bool:
        """Whether a crown or building hides a place (3,), known to a metre or so, from an eye (3,)."""
        return bool(_hides(self.solids, *self._grid, place_enu_m, eye_enu_m))

    def shown_share(self, place_enu_m: F64, eye_enu_m: F64) -> float:
        """Share of a place (3,) and of four beside it that no crown or building hides from an eye (3,)."""
        return float(_shown_share(self.solids, *self._grid, place_enu_m, eye_enu_m))

    def clearances_m(self, track_enu_m: F64, over_ground: NDArray[np.bool_]) -> F64:
        """Smallest distances (N + 1,) between a track (K, 3), straight from point to point, and each solid.

        The last one is the distance to the ground, taken where ``over_ground`` (K,) is true; inf if nowhere.
        """
        clearances = np.full(len(self.solids) + 1, np.inf)
        _write_clearances(clearances, self.solids, track_enu_m)
        above_m = track_enu_m[over_ground, 2] - self.terrain.height_m(track_enu_m[over_ground, :2])
        clearances[-1] = above_m.min(initial=np.inf)
        return clearances


def keep_m(scenario: Scenario) -> float:
    """Distance to keep by the believed position, so that the true one keeps the clearance."""
    return scenario.safety.clearance_m + _SIGMAS * scenario.vehicle.position_noise_m


def known_obstacles(scenario: Scenario) -> Obstacles:
    """The trees, buildings and ground of a scenario."""
    terrain = build_terrain(scenario)
    return Obstacles(terrain, build_trees(scenario, terrain), build_buildings(scenario, terrain))


def came_near(obstacles: Obstacles, track_enu_m: F64, modes: Sequence[str]) -> dict[str, Any]:
    """``collisions`` and ``min_clearance_m`` of a track (K, 3) flown in these modes (K,).

    The ground does not count during take-off and landing, and between two sorties. ``min_clearance_m`` is
    measured from the vehicle's centre; it is None without a track.
    """
    over_ground = np.array([mode not in (Mode.TAKEOFF, Mode.LAND, Mode.SWAP) for mode in modes], dtype=bool)
    clearances_m = obstacles.clearances_m(track_enu_m, over_ground)
    nearest_m = float(clearances_m.min())
    return {
        "collisions": int((clearances_m < BODY_RADIUS_M).sum()),
        "min_clearance_m": round(nearest_m, 3) if math.isfinite(nearest_m) else None,
    }


@njit(cache=True)
def _beside(solid: F64, x: float, y: float) -> float:
    """Horizontal distance from a place to a solid; 0 inside."""
    dx, dy = x - solid[0], y - solid[1]
    u = abs(solid[2] * dx + solid[3] * dy) - solid[4]
    v = abs(solid[2] * dy - solid[3] * dx) - solid[5]
    return float(max(math.hypot(max(u, 0.0), max(v, 0.0)) - solid[6], 0.0))


@njit(cache=True)
def _reach(solid: F64) -> float:
    """Largest horizontal distance from a solid's centre to its outline."""
    return float(solid[4] + solid[5] + solid[6])


@njit(cache=True)
def _is_far(solid: F64, x: float, y: float, to_x: float, to_y: float, margin: float) -> bool:
    """Whether a solid lies beyond the margin around the bounding box of a line."""
    reach = _reach(solid) + margin
    return bool(
        solid[0] < min(x, to_x) - reach
        or solid[0] > max(x, to_x) + reach
        or solid[1] < min(y, to_y) - reach
        or solid[1] > max(y, to_y) + reach
    )


@njit(cache=True)
def _top_within(solids: F64, frame: F64, starts: I64, order: I64, xy: F64, distance: float) -> F64:
    tops, found = np.full(len(xy), -np.inf), np.empty(len(order), dtype=np.int64)
    for k in range(len(xy)):
        x, y = xy[k]
        for n in found[: around(found, frame, starts, order, x, y, x, y, distance)]:
            solid = solids[n]
            near = not _is_far(solid, x, y, x, y, distance) and _beside(solid, x, y) <= distance
            if near and solid[8] > tops[k]:
                tops[k] = solid[8]
    return tops


@njit(cache=True)
def _solids_along(
    solids: F64,
    frame: F64,
    starts: I64,
    order: I64,
    x: float,
    y: float,
    to_x: float,
    to_y: float,
    keep: float,
    near: float,
    slope: float,
) -> tuple[float, float]:
    aim, least = -np.inf, -np.inf
    length = math.hypot(to_x - x, to_y - y)
    east, north = (to_x - x) / max(length, 1e-9), (to_y - y) / max(length, 1e-9)
    found = np.empty(len(order), dtype=np.int64)
    for n in found[: around(found, frame, starts, order, x, y, to_x, to_y, keep)]:
        solid = solids[n]
        dx, dy = solid[0] - x, solid[1] - y
        reach, along = _reach(solid) + keep, dx * east + dy * north
        if abs(dx * north - dy * east) > reach or along < -reach or along > length + reach:
            continue
        s, end = max(along - reach, 0.0), min(along + reach, length)
        while _beside(solid, x + s * east, y + s * north) > keep and s < end:
            s = min(s + _STATION_M, end)
        if _beside(solid, x + s * east, y + s * north) <= keep:
            aim = max(aim, solid[8] + keep - slope * max(s - near, 0.0))
            if s <= near:
                least = max(least, solid[8] + keep)
    return aim, least


@njit(cache=True)
def _ground_along(
    heights: F64,
    bounds: tuple[float, float, float, float],
    x: float,
    y: float,
    to_x: float,
    to_y: float,
    beside: float,
    near: float,
    slope: float,
    farthest: float,
) -> tuple[float, float]:
    length = math.hypot(to_x - x, to_y - y)
    east, north = (to_x - x) / max(length, 1e-9), (to_y - y) / max(length, 1e-9)
    stations = int(min(length, farthest) / _GROUND_STATION_M) + 2
    step = min(length / (stations - 1), _GROUND_STATION_M)
    points = np.empty((3 * stations, 2))
    for k in range(stations):
        for i in range(3):
            points[3 * k + i, 0] = x + k * step * east - (i - 1) * beside * north
            points[3 * k + i, 1] = y + k * step * north + (i - 1) * beside * east
    ground = bilinear(heights, bounds, points)
    aim, least = -np.inf, -np.inf
    for k in range(stations):
        highest = ground[3 * k : 3 * k + 3].max()
        aim = max(aim, highest - slope * max(k * step - near, 0.0))
        if k * step <= near:
            least = max(least, highest)
    return aim, least


@njit(cache=True)
def _hides(solids: F64, frame: F64, starts: I64, order: I64, place: F64, eye: F64) -> bool:
    ray = eye - place
    length = math.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
    found = np.empty(len(order), dtype=np.int64)
    for n in found[: around(found, frame, starts, order, place[0], place[1], eye[0], eye[1], 0.0)]:
        solid = solids[n]
        if _is_far(solid, place[0], place[1], eye[0], eye[1], 0.0):
            continue
        s = _NEAR_PLACE_M
        while s < length:
            x, y, z = place + ray * (s / length)
            if solid[7] < z < solid[8] and _beside(solid, x, y) <= 0.0:
                return True
            s += _TRACK_STEP_M
    return False


@njit(cache=True)
def _shown_share(solids: F64, frame: F64, starts: I64, order: I64, place: F64, eye: F64) -> float:
    shown = 0
    for k in range(len(_ABOUT_A_PLACE)):
        if not _hides(solids, frame, starts, order, place + _ABOUT_A_PLACE[k], eye):
            shown += 1
    return shown / len(_ABOUT_A_PLACE)


@njit(cache=True)
def _write_clearances(clearances: F64, solids: F64, track: F64) -> None:
    """Clearance of each solid. Blocks of the track that cannot come nearer than others are left out."""
    last = len(track) - 1
    boxes = _boxes(track)
    for n in range(len(solids)):
        solid, best, reach = solids[n], np.inf, _reach(solids[n])
        nearest, nearest_m = 0, np.inf
        for i in range(len(boxes)):
            away_m = _from_box(boxes[i], solid[0], solid[1])
            if away_m < nearest_m:
                nearest, nearest_m = i, away_m
        for j in range(-1, len(boxes)):
            i = nearest if j < 0 else j
            if j == nearest or _from_box(boxes[i], solid[0], solid[1]) > best + reach:
                continue
            for k in range(i * _BLOCK, min((i + 1) * _BLOCK, len(track))):
                best = min(best, _clearance_of_step(solid, track[k], track[min(k + 1, last)], best, reach))
        clearances[n] = best


@njit(cache=True)
def _clearance_of_step(solid: F64, here: F64, to: F64, best: float, reach: float) -> float:
    """Clearance of a straight step, or a larger one where it cannot be below ``best``."""
    x, y, z = here
    dx, dy, dz = to[0] - x, to[1] - y, to[2] - z
    step = math.sqrt(dx * dx + dy * dy + dz * dz)
    far = best + reach + step
    if (x - solid[0]) ** 2 + (y - solid[1]) ** 2 > far * far:
        return best
    distance = math.hypot(_beside(solid, x, y), max(z - solid[8], 0.0))
    best = min(best, distance)
    s = _TRACK_STEP_M
    while distance - step < best and s < step:
        f = s / step
        above = max(z + f * dz - solid[8], 0.0)
        best = min(best, math.hypot(_beside(solid, x + f * dx, y + f * dy), above))
        s += _TRACK_STEP_M
    return best


@njit(cache=True)
def _boxes(track: F64) -> F64:
    """West, south, east and north of each block of steps, with the end of the last step."""
    n = (len(track) + _BLOCK - 1) // _BLOCK
    boxes = np.empty((n, 4))
    for i in range(n):
        points = track[i * _BLOCK : min((i + 1) * _BLOCK + 1, len(track))]
        boxes[i] = points[:, 0].min(), points[:, 1].min(), points[:, 0].max(), points[:, 1].max()
    return boxes


@njit(cache=True)
def _from_box(box: F64, x: float, y: float) -> float:
    return math.hypot(max(box[0] - x, 0.0, x - box[2]), max(box[1] - y, 0.0, y - box[3]))
