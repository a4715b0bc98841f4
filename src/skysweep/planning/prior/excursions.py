"""Straight ways from paths to parts of a map that are worth the way."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from skysweep.arrays import F64, I64
from skysweep.planning.prior.coverage import length_of
from skysweep.planning.prior.growth import Paths

_PARTS = 12  # looked at in one go, the best first
_PLACES = 3000  # on the paths from where a way may begin
_SMOOTH_CELLS = 1.0


def go_where_it_pays(paths: Paths, worth_per_m: float) -> None:
    """Lead paths to parts of the map where what is left to find is worth search and way."""
    worth, parts = _parts(paths, worth_per_m)
    least = 2.0 * worth_per_m * paths.lattice.pitch_m
    best = np.argsort(-worth, kind="stable")[:_PARTS]
    best = best[worth[best] > least]
    departures = [_Departures.of(paths, path) for path in range(len(paths.starts_xy_m)) if len(best)]
    for part in best:
        cells = np.argwhere(parts == part + 1)
        led = _go_to(paths, departures, cells, float(worth[part]), worth_per_m)
        if led is not None:
            departures[led] = _Departures.of(paths, led)


def _parts(paths: Paths, worth_per_m: float) -> tuple[F64, NDArray[np.int32]]:
    """Parts of the map that are worth visits: what each finds beyond its cost, and their labels (R, C).

    Cells that are close to each other belong together; only those that are worth a visit themselves have a
    label.
    """
    field = paths.lattice
    cost = worth_per_m * field.pitch_m
    left = field.poa * np.exp(-paths.coverage)
    smooth = ndimage.gaussian_filter(left, _SMOOTH_CELLS, mode="nearest")
    share = -np.expm1(-field.step)
    labels, n = ndimage.label(smooth * share > cost, structure=np.ones((3, 3)))
    index = np.arange(1, n + 1)
    log_left = np.log(left, where=left > 0.0, out=np.full(left.shape, -np.inf))
    visits = np.maximum(np.floor((log_left + np.log(share / cost)) / field.step) + 1.0, 0.0)
    net = left * -np.expm1(-visits * field.step) - cost * visits
    pays = visits > 0.0
    return np.atleast_1d(ndimage.sum_labels(net, labels, index)), np.where(pays, labels, 0)


@dataclass(frozen=True)
class _Departures:
    """Places on one path from where a way may begin, the last first."""

    visits: I64  # (K,) the visit before each place
    final: NDArray[np.bool_]  # (K,) whether the path ends with that visit
    from_xy_m: F64  # (K, 2) where that visit is
    to_xy_m: F64  # (K, 2) where the path leads from it
    legs_m: F64  # (K,) how far that is
    xy_m: F64  # (K, 2)

    @classmethod
    def of(cls, paths: Paths, path: int) -> _Departures:
        visits, pitch_m = paths.visits(path), paths.lattice.pitch_m
        places = paths.xy_m(visits)
        ends = np.append(places[1:], places[-1:], axis=0)
        legs = np.linalg.norm(ends - places, axis=1)
        pieces = np.where(legs > 1.5 * pitch_m, np.ceil(legs / (2.0 * pitch_m)), 1).astype(int)
        leg = np.repeat(np.arange(len(visits)), pieces)
        share = (np.arange(len(leg)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / pieces[leg]
        every = -(-len(leg) // _PLACES)
        leg, share = leg[len(leg) - 1 :: -every], share[len(leg) - 1 :: -every]
        between = places[leg] + share[:, None] * (ends - places)[leg]
        return cls(visits[leg], leg == len(visits) - 1, places[leg], ends[leg], legs[leg], between)

    def near(self, places_xy_m: F64, cost_m: float) -> _Departures:
        """Those from where a way to one of the places (M, 2) may cost so little; some others as well."""
        beside = np.maximum(places_xy_m.min(axis=0) - self.xy_m, self.xy_m - places_xy_m.max(axis=0))
        farthest_m = np.where(self.final, cost_m, cost_m / 2.0 + self.legs_m)
        may = np.linalg.norm(np.maximum(beside, 0.0), axis=1) <= farthest_m
        return _Departures(*(getattr(self, field.name)[may] for field in fields(self)))


def _go_to(
    paths: Paths, departures: list[_Departures], cells: I64, worth: float, worth_per_m: float
) -> int | None:
    """Lead the path nearest to one of the cells (M, 2) there and back, or there from its end; which one."""
    pitch_m = paths.lattice.pitch_m
    centres = paths.lattice.xy_m(cells)
    tree = cKDTree(centres)
    best: tuple[float, int, int, I64] | None = None
    for path, all_ways in enumerate(departures):
        most_m = min(paths.left_m[path] - pitch_m, worth / worth_per_m if best is None else best[0])
        ways = all_ways.near(centres, most_m)
        if not len(ways.visits):
            continue
        near = tree.query(ways.xy_m)[1]
        there = centres[near]
        way = np.linalg.norm(there - ways.from_xy_m, axis=1)
        back = np.linalg.norm(there - ways.to_xy_m, axis=1) - ways.legs_m + pitch_m
        cost_m = np.where(ways.final, way, way + back)
        k = int(np.argmin(cost_m))
        if cost_m[k] + pitch_m <= paths.left_m[path] and (best is None or cost_m[k] < best[0]):
            best = float(cost_m[k]), path, int(ways.visits[k]), cells[near[k]]
    if best is None or best[0] * worth_per_m >= worth:
        return None
    _insert(paths, best[2], best[3])
    return best[1]


def _insert(paths: Paths, visit: int, node: I64) -> None:
    """Fly to a node after a visit, and from the one beside it on to where the path led."""
    field, after, first = paths.lattice, int(paths.following[visit]), paths.count
    new = [node] if after < 0 else [node, _beside(paths, node)]
    paths.count += len(new)
    paths.nodes[first : paths.count] = new
    paths.owner[first : paths.count] = paths.owner[visit]
    paths.following[visit] = first
    paths.following[first : paths.count] = [*range(first + 1, paths.count), after]
    old = [visit] if after < 0 else [visit, after]
    led = paths.xy_m(np.array(old))
    leads = paths.xy_m(np.array([visit, *range(first, paths.count), *old[1:]]))
    paths.left_m[paths.owner[visit]] -= length_of(leads) - length_of(led)
    field.add_coverage(paths.coverage, leads)
    field.add_coverage(paths.coverage, led, -1.0)


def _beside(paths: Paths, node: I64) -> I64:
    """The first node next to one where half as much is left to find, or where most is."""
    left = paths.lattice.poa * np.exp(-paths.coverage)
    near = node + np.array([[0, 1], [0, -1], [1, 0], [-1, 0]])
    on_map = near[((near >= 0) & (near < left.shape)).all(axis=1)]
    enough = np.minimum(left[tuple(on_map.T)], left[tuple(node)] / 2.0)
    return np.asarray(on_map[np.argmax(enough)] if len(on_map) else node)
