"""How much of an object a camera sees, from simple solids: crowns, trunks and buildings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skysweep.scenarios.world import World, WorldBuilding, WorldObject, WorldTree

F64 = NDArray[np.float64]

_STANDING_WIDTH_SHARE = 0.3  # shoulders against body height
_FLOATING_SHARE = 0.4  # head, shoulders and arms against body height
_SAMPLES = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]) * 0.35


def apparent_size_m(thing: WorldObject, camera_enu_m: F64) -> float:
    """The longest extent across the line of sight: what pixels on target are counted from."""
    if thing.pose == "floating":
        return thing.size_m * _FLOATING_SHARE
    if thing.pose != "standing":
        return thing.size_m
    ray = thing.position_enu_m - camera_enu_m
    off_nadir_sine = float(np.hypot(ray[0], ray[1]) / max(np.linalg.norm(ray), 1e-9))
    return thing.size_m * max(off_nadir_sine, _STANDING_WIDTH_SHARE)


def visible_fraction(world: World, camera_enu_m: F64, thing: WorldObject) -> float:
    """Share (0..1) of five points of the object that the camera sees."""
    trees = [t for t in world.trees if _near_ray(t.position_enu_m, t.crown_radius_m, camera_enu_m, thing)]
    houses = [b for b in world.buildings if _near_ray(b.position_enu_m, max(b.size_m), camera_enu_m, thing)]
    if not trees and not houses:
        return 1.0
    offsets = np.column_stack([_SAMPLES * thing.size_m, np.full(len(_SAMPLES), 0.1)])
    points = thing.position_enu_m + offsets
    hidden = np.zeros(len(points), dtype=bool)
    for tree in trees:
        hidden |= _behind_crown(tree, camera_enu_m, points)
    for house in houses:
        hidden |= _behind_building(house, camera_enu_m, points)
    return float(1.0 - hidden.mean())


def _near_ray(centre: F64, radius_m: float, camera: F64, thing: WorldObject) -> bool:
    """Whether a solid of this radius can touch the line from the object to the camera, seen from above."""
    base = thing.position_enu_m[:2]
    along = camera[:2] - base
    length2 = float(along @ along)
    gap = centre[:2] - base
    share = min(max(float(gap @ along) / length2, 0.0), 1.0) if length2 > 1e-9 else 0.0
    away = gap - share * along
    return bool(away @ away <= (radius_m + thing.size_m) ** 2)


def _behind_crown(tree: WorldTree, camera: F64, points: F64) -> NDArray[np.bool_]:
    """Line of sight against the crown's ellipsoid, which fills the upper 65 % of the tree."""
    half_height = 0.325 * tree.height_m
    scale = np.array([tree.crown_radius_m, tree.crown_radius_m, half_height])
    centre = tree.position_enu_m + np.array([0.0, 0.0, tree.height_m - half_height])
    start = (points - centre) / scale
    ray = (camera - points) / scale
    a = (ray * ray).sum(axis=1)
    b = (start * ray).sum(axis=1)
    c = (start * start).sum(axis=1) - 1.0
    root = b * b - a * c
    exit_share = (-b + np.sqrt(np.maximum(root, 0.0))) / a
    return np.asarray((root > 0) & (exit_share > 0))


def _behind_building(house: WorldBuilding, camera: F64, points: F64) -> NDArray[np.bool_]:
    """Line of sight against the box of walls (slab test in the building's own axes)."""
    c, s = np.cos(house.yaw_rad), np.sin(house.yaw_rad)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    start = (points - house.position_enu_m) @ turn.T
    ray = (camera - points) @ turn.T
    ray = np.where(np.abs(ray) < 1e-12, 1e-12, ray)
    low = np.array([-house.size_m[0] / 2, -house.size_m[1] / 2, 0.0])
    high = np.array([house.size_m[0] / 2, house.size_m[1] / 2, house.height_m])
    t0, t1 = (low - start) / ray, (high - start) / ray
    enter = np.minimum(t0, t1).max(axis=1)
    leave = np.maximum(t0, t1).min(axis=1)
    return np.asarray((leave > np.maximum(enter, 0.0)) & (enter < 1.0))
