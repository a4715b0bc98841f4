"""Random placement of objects and trees."""

from __future__ import annotations

import math

import numpy as np
import shapely

from skysweep.arrays import F64
from skysweep.scenarios.model import Generator
from skysweep.types import XY

_FILLS = 0.1  # of its bounding box: a polygon that fills less is split into triangles
_UNTIL_CLOSER = 500  # tries before the separation is halved
_SPARSE_TRIES = 1000
_SCATTER_TRIES = 100
_BESIDE_CROWN = 0.6, 1.15  # distance from the trunk, in crown radii
_CLUSTER_TRIES = 10_000, 100  # in all, and more for each object


class Ground:
    """A polygon or multipolygon from which places are drawn uniformly."""

    def __init__(self, polygon: shapely.Geometry) -> None:
        self.polygon = polygon
        shapely.prepare(polygon)
        self._low, self._high = np.array(polygon.bounds).reshape(2, 2)
        self._is_thin = polygon.area < _FILLS * np.prod(self._high - self._low)
        if self._is_thin:
            triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
            self._corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
            self._areas_m2 = np.cumsum(shapely.area(triangles))

    def covers(self, xy: XY) -> bool:
        """Whether a place lies inside."""
        return bool(shapely.intersects_xy(self.polygon, *xy))

    def draw(self, count: int, rng: np.random.Generator) -> F64:
        """Places (count, 2)."""
        if self._is_thin:
            which, u, v = rng.random((count, 3)).T
            chosen = np.searchsorted(self._areas_m2, which * self._areas_m2[-1])
            a, b, c = self._corners[chosen].swapaxes(0, 1)
            u, v = np.where(u + v > 1.0, (1.0 - u, 1.0 - v), (u, v))
            return np.asarray(a + u[:, None] * (b - a) + v[:, None] * (c - a))
        found = np.empty((0, 2))
        while len(found) < count:
            tries = rng.uniform(self._low, self._high, (count - len(found), 2))
            found = np.concatenate([found, tries[shapely.intersects_xy(self.polygon, tries)]])
        return found


def generate_positions(generator: Generator, area: Ground, rng: np.random.Generator) -> list[XY]:
    """Positions inside the area by the generator's pattern, at least ``min_separation_m`` apart.

    If the area has no room for that, the separation is halved until the positions fit. If clusters hardly
    overlap the area, their remaining positions are placed anywhere in it.
    """
    count, spread_m = generator.count, generator.spread_m
    if generator.pattern == "sparse":
        return _pairs(_sparse(area, count, rng))
    centres = None
    if generator.pattern == "clustered" and generator.centres_enu_m is not None:
        centres = np.array(generator.centres_enu_m)
    elif generator.pattern == "clustered":
        inner = area.polygon.buffer(-spread_m)
        centres = _sparse(area if inner.is_empty else Ground(inner), generator.clusters, rng)
    cluster_tries = _CLUSTER_TRIES[0] + _CLUSTER_TRIES[1] * count
    placed, n, tries = np.empty((count, 2)), 0, 0
    separation_m = generator.min_separation_m
    while n < count:
        batch = min(count - n, _UNTIL_CLOSER - tries % _UNTIL_CLOSER)
        in_cluster = centres is not None and tries < cluster_tries
        drawn = rng.normal(0.0, spread_m, (batch, 2)) if in_cluster else area.draw(batch, rng)
        for xy in drawn:
            if centres is not None and in_cluster:
                xy = centres[n % len(centres)] + xy
            gaps_m = np.hypot(*(placed[:n] - xy).T)
            if gaps_m.min(initial=math.inf) >= separation_m and area.covers((xy[0], xy[1])):
                placed[n] = xy
                n += 1
        tries += batch
        if tries % _UNTIL_CLOSER == 0:
            separation_m /= 2
    return _pairs(placed)


def beside_trees(places: list[XY], crowns: F64, area: Ground, rng: np.random.Generator) -> list[XY]:
    """Each place moved to the nearest crown, half under it or just outside; rows of x, y and radius."""
    moved = []
    for x, y in places:
        gaps_m = np.hypot(crowns[:, 0] - x, crowns[:, 1] - y) - crowns[:, 2]
        tree_x, tree_y, radius_m = crowns[np.argmin(gaps_m)].tolist()
        for _ in range(_SCATTER_TRIES):
            away_m, angle = radius_m * rng.uniform(*_BESIDE_CROWN), rng.uniform(0, 2 * np.pi)
            xy = tree_x + away_m * math.cos(angle), tree_y + away_m * math.sin(angle)
            if area.covers(xy):
                break
        moved.append(xy if area.covers(xy) else (x, y))
    return moved


def scattered(xy: XY, scatter_m: float, area: Ground, rng: np.random.Generator) -> XY:
    """``xy`` moved at random. A place in the area stays in it; if every try leaves it, any place is drawn."""
    if scatter_m == 0:
        return xy
    stays = area.covers(xy)
    for _ in range(_SCATTER_TRIES):
        dx, dy = rng.normal(0.0, scatter_m, 2).tolist()
        moved = (xy[0] + dx, xy[1] + dy)
        if not stays or area.covers(moved):
            return moved
    return _pairs(area.draw(1, rng))[0]


def _sparse(area: Ground, count: int, rng: np.random.Generator) -> F64:
    """Positions (count, 2) by Mitchell's best candidate sampling."""
    from scipy.spatial import KDTree  # imported late: it takes half a second

    placed = area.draw(1, rng)
    while len(placed) < count:
        tries = area.draw(min(10 * len(placed) + 10, _SPARSE_TRIES), rng)
        gaps_m, _ = KDTree(placed).query(tries)
        placed = np.concatenate([placed, tries[[np.argmax(gaps_m)]]])
    return placed


def _pairs(positions: F64) -> list[XY]:
    return [(x, y) for x, y in positions.tolist()]
