"""How much of an object a camera sees past simple solids: crowns and buildings.

The solids of a world are one array for compiled code. A row is ``x, y, z`` of the centre, the half axes
``a, b, c``, cosine and sine of the yaw, the height of the top, the reach (largest horizontal extent from the
centre) and 1 for a box, 0 for an ellipsoid.
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from numba import njit

from skysweep.arrays import F64, I64
from skysweep.scenarios.model import SHARE_FROM_ABOVE, Scenario
from skysweep.worlds.grid import Grid, around
from skysweep.worlds.world import (
    STANDING_SIGN_EDGE_M,
    TerrainSurface,
    World,
    WorldObject,
    bilinear_at,
    build_buildings,
    build_trees,
)

FLAT, STANDING, FLOATING, SITTING, CROUCHING = range(5)
SHAPES = {  # of poses; all others are flat
    **dict.fromkeys(("standing", "walking", "waving"), STANDING),
    "floating": FLOATING,
    "sitting": SITTING,
    "crouching": CROUCHING,
}

_STANDING_SHARE, _FLOATING_SHARE, _SITTING_SHARE, _CROUCHING_SHARE = (
    SHARE_FROM_ABOVE[pose] for pose in ("standing", "floating", "sitting", "crouching")
)
_LOW_MIDDLE_SHARE = 0.2  # height of the middle of one who sits or crouches
_POINT_HEIGHT_M = 0.1
_POINTS = np.array([(x, y) for x in (-0.3, 0, 0.3) for y in (-0.3, 0, 0.3)])  # of the object's size


def shape_of(thing: WorldObject) -> int:
    """FLAT, STANDING, ...: how the object's apparent size depends on the viewing direction."""
    return SHAPES.get(thing.pose, FLAT)


@njit(cache=True)
def pixels_on_target(
    focal_px: float, shape: int, size_m: float, east_m: float, north_m: float, up_m: float, depth_m: float
) -> float:
    """Pixels that the longest visible extent of an object spans at ``depth_m`` along the optical axis.

    ``east_m``, ``north_m`` and ``up_m`` lead from the camera to the object's middle (:func:`middle_enu_m`).
    """
    extent_m = size_m
    if shape == FLOATING:
        extent_m = size_m * _FLOATING_SHARE
    elif shape == SITTING:
        extent_m = size_m * _SITTING_SHARE
    elif shape == CROUCHING:
        extent_m = size_m * _CROUCHING_SHARE
    elif shape == STANDING:
        across = east_m * east_m + north_m * north_m
        off_nadir_sine = math.sqrt(across / max(across + up_m * up_m, 1e-9))
        extent_m = size_m * max(off_nadir_sine, _STANDING_SHARE)
    return focal_px * extent_m / depth_m


def middle_enu_m(thing: WorldObject) -> F64:
    """The middle (3,) of an object's visible part; that of a standing object is well above the ground."""
    above_m = middle_above_ground_m(thing.kind, thing.pose, thing.size_m)
    if above_m == 0.0:
        return thing.position_enu_m
    return np.asarray(thing.position_enu_m + np.array([0.0, 0.0, above_m]))


def middle_above_ground_m(kind: str, pose: str, size_m: float) -> float:
    """Height of the middle of an object's visible part above the ground."""
    shape = SHAPES.get(pose, FLAT)
    if shape == STANDING:
        return 0.5 * size_m + (0.0 if kind == "person" else STANDING_SIGN_EDGE_M)
    return _LOW_MIDDLE_SHARE * size_m if shape in (SITTING, CROUCHING) else 0.0


class Occluders:
    """The trees and buildings of one world; the module describes ``solids`` (S, 11).

    ``grid`` finds those around a place without a look at the others (:func:`around`).
    """

    def __init__(self, world: World) -> None:
        self.solids = np.concatenate([_crowns(world), _walls(world)])
        self.grid = Grid.of(self.solids[:, :2], self.solids[:, 9])
        self._to_sun = np.array(world.light.to_sun_enu)

    def around(self, middle_enu_m: F64, size_m: float) -> tuple[bool, float]:
        """Whether a crown is beside an object with its middle there, and what share of it is in the shade."""
        return self.is_beside_a_crown(middle_enu_m, size_m), self.shade(middle_enu_m, size_m)

    def is_beside_a_crown(self, place_enu_m: F64, size_m: float) -> bool:
        """Whether a crown's edge is closer to the middle of an object than its size."""
        away_m, radii_m = self.crowns_near(place_enu_m, size_m)
        return bool((away_m <= radii_m + size_m).any())

    def crowns_near(self, place_enu_m: F64, within_m: float) -> tuple[F64, F64]:
        """Distances (N,) to the axes of crowns of which an edge is so near, maybe of more; radii (N,)."""
        x, y = place_enu_m[:2].tolist()
        s = self.solids[self._around(x, y, x, y, within_m)]
        s = s[s[:, 10] == 0.0]
        return np.hypot(s[:, 0] - x, s[:, 1] - y), s[:, 9]

    def crowns_in(self, area_enu_m: shapely.Polygon) -> int:
        """How many trees stand in an area."""
        crowns = self.solids[self.solids[:, 10] == 0.0]
        return int(shapely.contains_xy(area_enu_m, crowns[:, :2]).sum())

    def visible_fraction(self, camera_enu_m: F64, thing: WorldObject) -> float:
        """Share (0..1) of nine points of the object that the camera sees."""
        place = middle_enu_m(thing)
        (x0, y0), (x1, y1) = place[:2].tolist(), camera_enu_m[:2].tolist()
        near = self._around(x0, y0, x1, y1, thing.size_m)
        return float(visible_share(camera_enu_m, place, thing.size_m, self.solids, near))

    def shade(self, middle_enu_m: F64, size_m: float) -> float:
        """Share (0..1) of nine points of an object on which the shadow of a solid falls; 0 at night."""
        return float(shades(middle_enu_m[None], size_m, self._to_sun, self.solids, *self.grid)[0])

    def _around(self, x0: float, y0: float, x1: float, y1: float, margin_m: float) -> I64:
        found = np.empty(len(self.solids), dtype=np.int64)
        return found[: around(found, *self.grid, x0, y0, x1, y1, margin_m)]


def known_occluders(scenario: Scenario, terrain: TerrainSurface) -> Occluders:
    """Those of a scenario, which a mission knows before take-off."""
    trees, buildings = build_trees(scenario, terrain), build_buildings(scenario, terrain)
    return Occluders(World(terrain, (), trees, buildings, scenario.light, seed=0))


def _crowns(world: World) -> F64:
    """The upper 65 % of each tree is its crown."""
    trees = world.trees
    x, y, z = np.array([t.position_enu_m for t in trees]).reshape(-1, 3).T
    height, r = np.array([(t.height_m, t.crown_radius_m) for t in trees]).reshape(-1, 2).T
    half, one, zero = 0.325 * height, np.ones(len(trees)), np.zeros(len(trees))
    return np.column_stack([x, y, z + height - half, r, r, half, one, zero, z + height, r, zero])


def _walls(world: World) -> F64:
    rows = []
    for b in world.buildings:
        x, y, z = b.position_enu_m
        half = b.height_m / 2
        a, c = b.size_m[0] / 2, b.size_m[1] / 2
        yaw = (math.cos(b.yaw_rad), math.sin(b.yaw_rad))
        rows.append((x, y, z + half, a, c, half, *yaw, z + b.height_m, math.hypot(a, c), 1.0))
    return np.array(rows, dtype=float).reshape(-1, 11)


def relief(terrain: TerrainSurface) -> tuple[F64, F64]:
    """Heights (R, C) and bounds (4,) of the ground as plain arrays for compiled code."""
    return np.ascontiguousarray(terrain.heights_m, dtype=float), np.array(terrain.bounds_enu_m, dtype=float)


@njit(cache=True)
def visible_share(camera: F64, place: F64, size_m: float, solids: F64, near: I64) -> float:
    """Share (0..1) of the points of an object at ``place`` that none of the ``near`` solids hides."""
    dx, dy = camera[0] - place[0], camera[1] - place[1]
    along = dx * dx + dy * dy
    hidden = np.zeros(len(_POINTS), dtype=np.bool_)
    for k in near:
        solid = solids[k]
        gx, gy = solid[0] - place[0], solid[1] - place[1]
        share = min(max((gx * dx + gy * dy) / max(along, 1e-9), 0.0), 1.0)
        away_x, away_y = gx - share * dx, gy - share * dy
        if away_x * away_x + away_y * away_y > (solid[9] + size_m) ** 2:
            continue
        for i in range(len(_POINTS)):
            if not hidden[i]:
                hidden[i] = _hides(
                    solid,
                    camera,
                    place[0] + _POINTS[i, 0] * size_m,
                    place[1] + _POINTS[i, 1] * size_m,
                    place[2] + _POINT_HEIGHT_M,
                )
    return float(1.0 - hidden.mean())


@njit(cache=True)
def shades(places: F64, size_m: float, to_sun: F64, solids: F64, frame: F64, starts: I64, order: I64) -> F64:
    """Shares (N,) of the points of objects at ``places`` (N, 3) on which the shadow of a solid falls.

    ``frame``, ``starts`` and ``order`` are the ``Grid`` of the solids; ``to_sun`` is of length 1.
    """
    found = np.zeros(len(places))
    if not len(solids) or to_sun[2] <= 0.0:
        return found
    near, top = np.empty(len(solids), dtype=np.int64), solids[:, 8].max()
    for k in range(len(places)):
        place = places[k]
        above = place + max(top - place[2], 0.0) / to_sun[2] * to_sun
        n = around(near, frame, starts, order, place[0], place[1], above[0], above[1], size_m)
        if n:
            found[k] = 1.0 - visible_share(above, place, size_m, solids, near[:n])
    return found


@njit(cache=True)
def is_behind_a_hill(camera: F64, place: F64, heights: F64, bounds: F64) -> bool:
    """Whether the ground (R, C) over ``bounds`` rises above the line from the camera to a place on it.

    The line is sampled as finely as the ground's posts.
    """
    dx, dy = camera[0] - place[0], camera[1] - place[1]
    post_m = min(
        (bounds[2] - bounds[0]) / (heights.shape[1] - 1), (bounds[3] - bounds[1]) / (heights.shape[0] - 1)
    )
    limits = bounds[0], bounds[1], bounds[2], bounds[3]
    n, from_m = math.ceil(math.hypot(dx, dy) / post_m), place[2] + _POINT_HEIGHT_M
    for k in range(1, n):
        share = k / n
        ground = bilinear_at(heights, limits, place[0] + share * dx, place[1] + share * dy)
        if ground > from_m + share * (camera[2] - from_m):
            return True
    return False


@njit(cache=True)
def count_seen(
    points: F64, eyes: F64, R_camera_to_enu: F64, u: float, v: float, solids: F64
) -> tuple[int, int]:
    """How many points (M, 3) are in a picture, and how many of them no solid hides there.

    ``eyes`` (N, 3) and ``R_camera_to_enu`` (N, 3, 3) are the cameras', ``u`` and ``v`` half of the picture's
    width and height over the focal length.
    """
    pictured = seen = 0
    looking = np.empty(len(eyes), dtype=np.int64)  # cameras whose picture holds the point
    near = np.empty(len(solids), dtype=np.int64)  # solids that can hide it
    for k in range(len(points)):
        x, y, z = points[k]
        n_looking, flattest = 0, 0.0
        for n in range(len(eyes)):
            R, dx, dy, dz = R_camera_to_enu[n], x - eyes[n, 0], y - eyes[n, 1], z - eyes[n, 2]
            depth = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
            across = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
            down = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
            if dz < 0.0 < depth and abs(across) <= u * depth and abs(down) <= v * depth:
                looking[n_looking] = n
                n_looking += 1
                flattest = max(flattest, math.hypot(dx, dy) / -dz)
        n_near = 0
        for i in range(len(solids)):
            reach = max(solids[i, 8] - z, 0.0) * flattest + solids[i, 9]
            if (solids[i, 0] - x) ** 2 + (solids[i, 1] - y) ** 2 <= reach * reach:
                near[n_near] = i
                n_near += 1
        pictured += n_looking > 0
        for n in looking[:n_looking]:
            if not _any_hides(solids, near[:n_near], eyes[n], x, y, z):
                seen += 1
                break
    return pictured, seen


@njit(cache=True)
def _any_hides(solids: F64, near: I64, camera: F64, x: float, y: float, z: float) -> bool:
    """Whether a near solid is on the line from (x, y, z) to the camera."""
    dx, dy = camera[0] - x, camera[1] - y
    along = max(dx * dx + dy * dy, 1e-9)
    for i in near:
        gx, gy = solids[i, 0] - x, solids[i, 1] - y
        share = min(max((gx * dx + gy * dy) / along, 0.0), 1.0)
        away_x, away_y = gx - share * dx, gy - share * dy
        if away_x * away_x + away_y * away_y <= solids[i, 9] ** 2 and _hides(solids[i], camera, x, y, z):
            return True
    return False


@njit(cache=True)
def _hides(solid: F64, camera: F64, x: float, y: float, z: float) -> bool:
    """Whether the line from (x, y, z) to the camera meets the solid, in its own unit axes."""
    cos, sin = solid[6], solid[7]
    sx, sy, sz = x - solid[0], y - solid[1], z - solid[2]
    rx, ry, rz = camera[0] - x, camera[1] - y, camera[2] - z
    start = ((cos * sx + sin * sy) / solid[3], (cos * sy - sin * sx) / solid[4], sz / solid[5])
    ray = ((cos * rx + sin * ry) / solid[3], (cos * ry - sin * rx) / solid[4], rz / solid[5])
    if solid[10] == 1.0:  # slabs
        enter, leave = 0.0, 1.0
        for k in range(3):
            r = ray[k] if abs(ray[k]) > 1e-12 else 1e-12
            t0, t1 = (-1.0 - start[k]) / r, (1.0 - start[k]) / r
            enter, leave = max(enter, min(t0, t1)), min(leave, max(t0, t1))
        return leave > enter
    a = ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2
    b = start[0] * ray[0] + start[1] * ray[1] + start[2] * ray[2]
    root = b * b - a * (start[0] ** 2 + start[1] ** 2 + start[2] ** 2 - 1.0)
    if root <= 0.0:
        return False
    reach = math.sqrt(root)
    return bool((-b + reach) / a > 0.0 and (-b - reach) / a < 1.0)
