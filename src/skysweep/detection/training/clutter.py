"""Worlds as people leave them: fields, roads and cars, houses, fences, rubbish, jetties with rows of boats.

Cars and boats are labelled; all else is background.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from skysweep.arrays import F64, U8
from skysweep.worlds.textures import noise
from skysweep.worlds.world import (
    HELD_OUT_VARIANTS,
    GroundCover,
    World,
    WorldBuilding,
    WorldClutter,
    WorldObject,
)

CELL_M = 0.5
CAR_LENGTHS_M = (3.6, 5.8)
CLEAR_M = 1.5  # around what is searched for, of anything but what it lies on
LENGTHS_M = {
    "jetty": (10.0, 28.0),
    "fence": (5.0, 22.0),
    "fallen tree": (4.0, 12.0),
    "rubbish": (1.2, 4.0),
    "canopy": (1.8, 4.5),
    "pool": (2.5, 9.0),
    "bale": (1.1, 1.5),
}
_FIELDS = ("grass", "forest floor", "sand", "rock", "asphalt")
_ABOUT = {"fence": 0.3, "fallen tree": 0.2, "rubbish": 0.25, "canopy": 0.08, "pool": 0.07, "bale": 0.1}


def with_clutter(world: World, first_variant: int, rng: np.random.Generator) -> World:
    """The same world and more in it; looks are those from ``first_variant`` on."""
    yard = _Yard(world, first_variant, rng)
    return _at_sea(yard) if world.terrain.surface == "water" else _on_land(yard)


class _Yard:
    """A world that fills up."""

    def __init__(self, world: World, first_variant: int, rng: np.random.Generator) -> None:
        self.world, self.rng, self._first = world, rng, first_variant
        self.things: list[WorldClutter] = []
        self.vehicles: list[WorldObject] = []
        self.half_m = world.terrain.bounds_enu_m[2]
        self._taken = np.array([o.position_enu_m[:2] for o in world.objects]).reshape(-1, 2)

    def variant(self) -> int:
        return self._first + int(self.rng.integers(HELD_OUT_VARIANTS))

    def somewhere(self) -> F64:
        return np.array([*self.rng.uniform(-self.half_m, self.half_m, 2), 0.0])

    def put(self, kind: str, place: F64, yaw_rad: float, length_m: float | None = None) -> bool:
        """Whether the thing stands there: not on what is searched for."""
        if length_m is None:
            length_m = float(self.rng.uniform(*LENGTHS_M[kind]))
        if free := self._is_free(place, yaw_rad, length_m):
            self.things.append(WorldClutter(kind, place, length_m, yaw_rad, self.variant()))
        return free

    def park(self, place: F64, yaw_rad: float) -> None:
        """A car, unless it would stand on what is searched for."""
        length_m = float(self.rng.uniform(*CAR_LENGTHS_M))
        if self._is_free(place, yaw_rad, length_m):
            self.vehicles.append(
                WorldObject("car", place, yaw_rad, length_m, "face-up", True, self.variant())
            )

    def _is_free(self, place: F64, yaw_rad: float, length_m: float) -> bool:
        along = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
        offsets = self._taken - place[:2]
        ahead, beside = offsets @ along, offsets @ np.array([-along[1], along[0]])
        return not np.any((np.abs(ahead) < length_m / 2 + CLEAR_M) & (np.abs(beside) < 1.0 + CLEAR_M))


def _on_land(yard: _Yard) -> World:
    rng = yard.rng
    cover, roads = _ground(yard)
    for start, end, width_m in roads:
        _traffic(yard, start, end, width_m)
    for _ in range(int(rng.integers(0, 3))):
        _car_park(yard)
    kinds, weights = list(_ABOUT), np.array(list(_ABOUT.values()))
    for kind in rng.choice(kinds, int(rng.integers(15, 60)), p=weights):
        yard.put(str(kind), yard.somewhere(), float(rng.uniform(0, 2 * np.pi)))
    houses = tuple(_house(yard) for _ in range(int(rng.choice([0, 3, 8, 16]))))
    world = yard.world
    return replace(
        world,
        terrain=replace(world.terrain, cover=cover),
        objects=world.objects + tuple(yard.vehicles),
        buildings=world.buildings + houses,
        clutter=tuple(yard.things),
    )


def _ground(yard: _Yard) -> tuple[GroundCover, list[tuple[F64, F64, float]]]:
    """Fields and roads; each road from where to where, and how wide."""
    rng, half = yard.rng, yard.half_m
    n = round(2 * half / CELL_M)
    own = yard.world.terrain.surface
    names = (own, *(name for name in _FIELDS if name != own))
    codes: U8 = np.zeros((n, n), np.uint8)
    for _ in range(int(rng.integers(0, 4))):
        patch = noise(n, rng, 1.6, 1, 12) > rng.uniform(0.5, 0.65)
        codes[patch] = rng.integers(len(names))
    roads = []
    for _ in range(int(rng.integers(0, 4))):
        angle, aside = float(rng.uniform(0, np.pi)), float(rng.uniform(-0.6, 0.6)) * half
        along = np.array([np.cos(angle), np.sin(angle)])
        middle = aside * np.array([-along[1], along[0]])
        start, end = middle - 1.5 * half * along, middle + 1.5 * half * along
        width_m = float(rng.uniform(2.2, 8.0))
        code = names.index(str(rng.choice(["asphalt", "sand", "rock"])))
        ends = [tuple(np.rint((p + half) / CELL_M).astype(int).tolist()) for p in (start, end)]
        cv2.line(codes, ends[0], ends[1], code, max(1, round(width_m / CELL_M)))
        roads.append((start, end, width_m))
    return GroundCover(codes, yard.world.terrain.bounds_enu_m, names), roads


def _traffic(yard: _Yard, start: F64, end: F64, width_m: float) -> None:
    rng, way = yard.rng, end - start
    yaw = float(np.arctan2(way[1], way[0]))
    side = np.array([-way[1], way[0]]) / np.hypot(*way)
    for share in np.sort(rng.uniform(0.1, 0.9, int(rng.integers(0, 14)))):
        lane = float(rng.choice([-1, 1])) * min(0.25 * width_m, 2.0)
        place = np.array([*(start + share * way + lane * side), 0.0])
        yard.park(place, yaw + (np.pi if lane > 0 else 0))


def _car_park(yard: _Yard) -> None:
    rng, corner, yaw = yard.rng, yard.somewhere(), float(yard.rng.uniform(0, 2 * np.pi))
    along, ahead = (np.array([np.cos(yaw + a), np.sin(yaw + a), 0.0]) for a in (0.0, np.pi / 2))
    for row in range(int(rng.integers(1, 4))):
        for place in range(int(rng.integers(4, 14))):
            if rng.random() < 0.75:
                turn = float(rng.normal(0, 0.03)) + float(rng.choice([0.0, np.pi]))
                yard.park(corner + 2.6 * place * along + 6.5 * row * ahead, yaw + np.pi / 2 + turn)


def _house(yard: _Yard) -> WorldBuilding:
    """A house, or a block with a flat roof and facades."""
    rng, yaw = yard.rng, float(yard.rng.uniform(0, 2 * np.pi))
    if rng.random() < 0.3:
        size, height = (float(rng.uniform(12, 30)), float(rng.uniform(9, 16))), float(rng.uniform(6, 20))
        return WorldBuilding(yard.somewhere(), size, height, yaw, yard.variant(), flat_roof=True)
    size, height = (float(rng.uniform(5, 15)), float(rng.uniform(4, 11))), float(rng.uniform(2.5, 6.5))
    return WorldBuilding(yard.somewhere(), size, height, yaw, yard.variant())


def _at_sea(yard: _Yard) -> World:
    """Jetties, with boats beside them."""
    rng = yard.rng
    boats: list[WorldObject] = []
    for _ in range(int(rng.integers(0, 4))):
        place, yaw, length_m = yard.somewhere(), float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(10, 28))
        if not yard.put("jetty", place, yaw, length_m):
            continue
        along, out = (np.array([np.cos(yaw + a), np.sin(yaw + a), 0.0]) for a in (0.0, np.pi / 2))
        for berth in np.arange(-length_m / 2 + 1.5, length_m / 2 - 1.0, float(rng.uniform(2.8, 4.0))):
            for side in (-1.0, 1.0):
                if rng.random() < 0.6:
                    size_m = float(rng.uniform(3.5, 7.5))
                    at = place + berth * along + side * (1.6 + size_m / 2) * out
                    heading = yaw + side * np.pi / 2 + float(rng.normal(0, 0.05))
                    boats.append(WorldObject("boat", at, heading, size_m, "face-up", True, yard.variant()))
    world = yard.world
    return replace(world, objects=world.objects + tuple(boats), clutter=tuple(yard.things))
