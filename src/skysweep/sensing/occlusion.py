"""How much of an object a camera sees, from simple solids: crowns, trunks and buildings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skysweep.geometry.camera import Lens
from skysweep.scenarios.world import World, WorldBuilding, WorldObject

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


def pixels_on_target(lens: Lens, thing: WorldObject, camera_enu_m: F64, depth_m: float) -> float:
    """Pixels that the object's longest visible extent spans, ``depth_m`` along the optical axis away."""
    return float(lens.focal_px * apparent_size_m(thing, camera_enu_m) / depth_m)


class Occluders:
    """The trees and buildings of one world, ready to be asked many times."""

    def __init__(self, world: World) -> None:
        trees, houses = world.trees, world.buildings
        self._trees_enu_m = np.array([t.position_enu_m for t in trees]).reshape(-1, 3)
        self._crown_radii_m = np.array([t.crown_radius_m for t in trees])
        self._half_crowns_m = 0.325 * np.array([t.height_m for t in trees])
        self._houses = houses
        centres = [t.position_enu_m[:2] for t in trees] + [b.position_enu_m[:2] for b in houses]
        self._centres_xy = np.array(centres).reshape(-1, 2)
        self._reach_m = np.array([t.crown_radius_m for t in trees] + [max(b.size_m) for b in houses])

    def visible_fraction(self, camera_enu_m: F64, thing: WorldObject) -> float:
        """Share (0..1) of five points of the object that the camera sees."""
        near = self._near_ray(camera_enu_m, thing)
        if not len(near):
            return 1.0
        offsets = np.column_stack([_SAMPLES * thing.size_m, np.full(len(_SAMPLES), 0.1)])
        points = thing.position_enu_m + offsets
        n_trees = len(self._crown_radii_m)
        hidden = self._behind_crowns(near[near < n_trees], camera_enu_m, points)
        for k in near[near >= n_trees]:
            hidden |= _behind_building(self._houses[k - n_trees], camera_enu_m, points)
        return float(1.0 - hidden.mean())

    def _near_ray(self, camera: F64, thing: WorldObject) -> NDArray[np.int64]:
        """Which solids can touch the line from the object to the camera, seen from above."""
        base = thing.position_enu_m[:2]
        along = camera[:2] - base
        gaps = self._centres_xy - base
        share = np.clip(gaps @ along / max(float(along @ along), 1e-9), 0.0, 1.0)
        away = gaps - share[:, None] * along
        return np.flatnonzero((away * away).sum(axis=1) <= (self._reach_m + thing.size_m) ** 2)

    def _behind_crowns(self, which: NDArray[np.int64], camera: F64, points: F64) -> NDArray[np.bool_]:
        """Lines of sight against ellipsoids, which fill the upper 65 % of the trees."""
        radii, half = self._crown_radii_m[which], self._half_crowns_m[which]
        scale = np.column_stack([radii, radii, half])[:, None]
        top_down = np.column_stack([np.zeros((len(which), 2)), half / 0.325 - half])
        start = (points - (self._trees_enu_m[which] + top_down)[:, None]) / scale
        ray = (camera - points) / scale
        a = (ray * ray).sum(axis=-1)
        b = (start * ray).sum(axis=-1)
        c = (start * start).sum(axis=-1) - 1.0
        root = b * b - a * c
        leave = (-b + np.sqrt(np.maximum(root, 0.0))) / a
        enter = (-b - np.sqrt(np.maximum(root, 0.0))) / a
        return np.asarray(((root > 0) & (leave > 0) & (enter < 1)).any(axis=0))


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
