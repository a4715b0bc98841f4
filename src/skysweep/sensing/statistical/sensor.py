"""A sensor without pictures: it draws detections from a model fitted to renders and the real detector.

Objects are projected through the true camera; detections carry the estimated pose. Georeferencing therefore
degrades in turns for the same physical reasons as with pictures; only detection is statistical.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from skysweep.arrays import F64
from skysweep.geometry.camera import CameraPose
from skysweep.geometry.point_tree import PointTree, refit
from skysweep.scenarios.model import CameraModel, DetectorModel
from skysweep.sensing.exposures import Exposures
from skysweep.sensing.statistical.draws import (
    GHOST_CLASS,
    OCTAVES,
    ROUNDING_M,
    SENSOR,
    TABLES,
    THING,
    WIDTH,
    draw_look,
)
from skysweep.sensing.statistical.factors import CONTRAST_LIMITS, CONTRAST_UNIT, CONTRAST_USUAL
from skysweep.sensing.statistical.model import (
    BackgroundModel,
    KindModel,
    StatisticalModel,
    confidence_of,
    score_of,
)
from skysweep.types import Detections, Truth, VehicleState
from skysweep.worlds.occlusion import Occluders, middle_enu_m, relief, shape_of
from skysweep.worlds.world import TerrainSurface, World, WorldObject, WorldTree

_EPS_S = 1e-6
_MAX_GHOSTS = 64  # in one picture
_MOST_REPORTS = 9  # of one object, in tiles that overlap
_NOT_SEEN = (math.nan, math.nan, math.nan, math.nan)
_NOTHING = (np.zeros((0, 4)), np.zeros(0), ())


class StatisticalSensor:
    """Draws detections instead of rendering pictures. Implements ``types.Sensor``.

    ``eye`` knows the camera's true pose; ``classes`` are those that the mission searches for. Each of several
    sensors in one world is another ``unit``, with its own draws of the same objects. ``smallest_m`` is the
    size of the smallest target; with 0 no picture is halved for the detector.
    """

    def __init__(
        self,
        world: World,
        camera: CameraModel,
        detector: DetectorModel,
        eye: Truth,
        exposures: Exposures,
        classes: Sequence[str],
        seed: int,
        model: StatisticalModel,
        unit: int = 0,
        smallest_m: float = 0.0,
    ) -> None:
        self._model, self._view = model, model.view_of(camera, detector, smallest_m)
        self._ground_at_m = world.terrain.height_at_m
        self._lens, self._latency_s = camera.lens, camera.latency_s
        self._eye, self._exposures = eye, exposures
        self._pending: deque[Detections] = deque()
        self._movers: list[tuple[int, WorldObject]] = []  # by their rows of the things
        self._row_names: list[str] = []
        self._ghost_names: list[str] = []
        self._look_number = 0
        once = np.random.default_rng([seed, 29])
        occluders = Occluders(world)
        of_lapses = np.random.default_rng([seed, 37])
        things, *of_rows = self._tabulate_objects(world, occluders, classes, once, of_lapses)
        self._octaves, *of_ghosts = self._tabulate_ghosts(world, classes, once)
        of_looks = np.random.default_rng([seed, 31, unit] if unit else [seed, 31])
        seed_of_looks = of_looks.integers(2**62)
        box, largest_m = model.box, things["size"].max(initial=0.0)
        farthest_cut_m = max((tree.crown_radius_m for tree in world.trees), default=0.0) + ROUNDING_M
        scores = (score_of(detector.confidence_min), score_of(model.experiment.confidence_floor))
        boxes = (box.pixels, box.of_object, box.of_blur, model.fade_scale, detector.iou_max)
        self._sensors: dict[float, F64] = {}  # by the scale of a view
        for view in (self._view, *self._view.halved):
            optics = (view.focal_px, view.width_px, view.height_px, camera.exposure_s)
            sensor = (*optics, seed_of_looks, *scores, *boxes, largest_m, farthest_cut_m)
            self._sensors[view.scale] = np.array([sensor], dtype=SENSOR).view(np.float64)
        in_tiles = min(len(self._view.tiles_px), _MOST_REPORTS)
        places = in_tiles * len(self._row_names) + _MAX_GHOSTS
        self._boxes, self._scores = np.empty((places, 4)), np.empty(places)
        self._rows = np.empty(places, dtype=np.int64)
        most_ghosts = max(len(octave.ghosts) for octave in self._octaves)
        room = np.empty(len(things) + most_ghosts + len(occluders.solids), dtype=np.int64)
        self._things, self._tree = things, PointTree.of(things["place"])
        self._world, self._occluders = world, occluders
        of_solids = (occluders.solids, *occluders.grid, *relief(world.terrain))
        self._of_things = (things.view(np.float64), *self._tree, *of_solids, *of_rows)
        self._of_ghosts = (*of_ghosts, room, self._boxes, self._scores, self._rows)

    def sense(self, state: VehicleState) -> Detections | None:
        """Draw a look if one is due; return the oldest result whose time has come."""
        believed = self._exposures.due(state)
        if believed is not None:
            self._pending.append(self._look(state.time_s, believed))
        if self._pending and state.time_s >= self._pending[0].time_s + self._latency_s - _EPS_S:
            return self._pending.popleft()
        return None

    def close(self) -> None:
        """Nothing is held open."""

    def _look(self, time_s: float, believed: CameraPose) -> Detections:
        """The draws of one picture."""
        self._move(time_s)
        position, R = self._eye.true_camera_pose()
        velocity_mps, rates_radps = self._eye.true_camera_motion()
        x, y, z = position.tolist()
        height_m = z - self._ground_at_m(x, y)
        view = self._view.at(height_m)
        log_altitude = math.log(max(height_m * view.as_high, 1.0))
        octave = self._octaves[min(int(log_altitude / math.log(2.0)), OCTAVES - 1)]
        of_octave = octave.ghosts, octave.first, *octave.tree
        of_world: tuple[Any, ...] = (*self._of_things, *of_octave, *self._of_ghosts)
        n, end = draw_look(
            self._sensors[view.scale],
            view.tiles_px,
            position,
            R,
            velocity_mps,
            rates_radps,
            log_altitude,
            self._look_number,
            *of_world,
        )
        self._look_number += 1
        if not end:
            return Detections(time_s, *_NOTHING, believed, self._lens)
        rows = self._rows[:end].tolist()
        names = [self._row_names[row] for row in rows[:n]] + [self._ghost_names[c] for c in rows[n:]]
        confidences, boxes = confidence_of(self._scores[:end]), self._boxes[:end] / view.scale
        return Detections(time_s, boxes, confidences, tuple(names), believed, self._lens)

    def _move(self, time_s: float) -> None:
        """Put what moves where it is at this time. Its ground stays that on which it began."""
        if not self._movers:
            return
        for row, thing in self._movers:
            now, record = self._world.at(thing, time_s), self._things[row]
            record["place"], record["facing"] = middle_enu_m(now), _facing(now)
            record["beside"], record["shade"] = self._occluders.around(record["place"], now.size_m)
        refit(*self._tree, self._things["place"])

    def _tabulate_objects(
        self,
        world: World,
        occluders: Occluders,
        classes: Sequence[str],
        once: np.random.Generator,
        of_lapses: np.random.Generator,
    ) -> tuple[NDArray[Any], ...]:
        """The records THING, then what ``draw_look`` takes from ``table`` to ``aspects``."""
        m = self._model
        wanted = [kind for kind in m.kinds if kind.reported_as in classes]
        octaves = m.lens_octaves(self._view)
        luck = once.normal(size=(len(world.objects), 1 + len(classes)))
        lapse_luck = of_lapses.normal(size=(len(world.objects), len(classes)))
        things: list[tuple[Any, ...]] = []
        rows: list[list[float]] = []
        for thing, (colour, *own), own_lapse in zip(world.objects, luck, lapse_luck, strict=True):
            kinds = _kinds_of(thing, wanted)
            if not kinds:
                continue
            surface, first_row = world.terrain.surface_at(*thing.position_enu_m[:2].tolist()), len(rows)
            beside, shade = occluders.around(middle_enu_m(thing), thing.size_m)
            for kind in kinds:
                reported_as = list(classes).index(kind.reported_as)
                offset = own[reported_as] * np.sqrt(kind.object_share)
                rest = max(1.0 - kind.object_share - kind.aspect_share, 0.0)
                shares = np.sqrt([kind.aspect_share, rest])
                lapses = ndtri(np.clip([kind.lapses(is_among) for is_among in (False, True)], 1e-9, 1.0))
                score = kind.scores(surface, octaves)
                luck_of_row = offset, *shares, own_lapse[reported_as], kind.fade_rad
                rows.append([*score, *kind.spread, *lapses.ravel(), *kind.factors, *luck_of_row])
                self._row_names.append(kind.reported_as)
            looks_so = shape_of(thing), beside, shade, self._contrast(thing, surface, colour)
            if thing.track is not None:
                self._movers.append((len(things), thing))
            its_rows = first_row, len(rows)
            things.append((middle_enu_m(thing), thing.size_m, *looks_so, _facing(thing), its_rows, _NOT_SEEN))
        return (
            np.array(things, dtype=THING),
            np.array(rows, dtype=float).reshape(-1, TABLES * len(m.pixels) + WIDTH),
            np.log(m.pixels),
            np.zeros((len(rows), 2)),
        )

    def _contrast(self, thing: WorldObject, surface: str, draw: float) -> float:
        """Of one object against this ground; the usual one if not measured."""
        mean, std = self._model.contrast(thing.kind, thing.pose, surface)
        return float(np.clip((mean + std * draw - CONTRAST_USUAL) / CONTRAST_UNIT, *CONTRAST_LIMITS))

    def _tabulate_ghosts(
        self, world: World, classes: Sequence[str], once: np.random.Generator
    ) -> tuple[list[_Octave], NDArray[Any], NDArray[Any]]:
        """The ghosts of each octave, ``ghost_classes`` and ``over_altitude`` of ``draw_look``.

        Altitudes are those from which the calibrated camera's pixels show as much ground. Every octave of
        them has its own ghosts. Each has a level, in reports a hectare or a tree: it is there while the rate
        at the altitude exceeds it.
        """
        m = self._model
        background = [b for b in m.background if b.reported_as in classes]
        sources: list[tuple[BackgroundModel, list[float], _Grounds | _Trees]] = []
        for b in background:
            sources += [
                (b, b.per_hectare, _Grounds.of(b, world)),
                (b, b.per_tree, _Trees(world.trees)),
                (b, b.per_cut_tree, _Trees(world.trees, are_cut=True)),
            ]
        sources = [source for source in sources if max(source[1]) > 0.0]
        self._ghost_names = [b.reported_as for b, _, _ in sources]
        log_altitudes = [np.log(b.altitude_agl_m) for b, _, _ in sources]
        of_classes = [
            (ndtri(b.again), math.sqrt(1.0 - b.same_share), b.pixels, b.unit_scale, 1.0 / b.score_shape)
            for b, _, _ in sources
        ]
        nodes = max(map(len, log_altitudes), default=0)
        over_altitude = np.array(
            [
                [np.pad(row, (0, nodes - len(row)), "edge") for row in (grid, rates, b.score_scale)]
                for grid, (b, rates, _) in zip(log_altitudes, sources, strict=True)
            ]
        ).reshape(len(sources), 3, nodes)
        octaves, first = list[_Octave](), 0
        for k in range(OCTAVES):
            parts = [np.zeros((0, 7))]
            for c, (b, rates, where) in enumerate(sources):
                ends = np.log(2.0) * np.array([k, k + 1])
                grid = log_altitudes[c]
                inside = grid[(grid > ends[0]) & (grid < ends[1])]
                top = float(np.interp([*ends, *inside], grid, rates).max())
                places = where.places(top / b.again, once)
                n = len(places)
                own = once.normal(size=n) * math.sqrt(b.same_share)
                levels = once.uniform(0.0, top, n)
                parts.append(np.column_stack([places[:, :3], np.full(n, c), levels, own, places[:, 3]]))
            ghosts = np.concatenate(parts)
            ghosts = ghosts[ghosts[:, 4].argsort(kind="stable")]
            octaves.append(_Octave(ghosts.ravel(), first, PointTree.of(ghosts[:, :3])))
            first += len(ghosts)
        return octaves, np.array(of_classes, dtype=GHOST_CLASS).view(np.float64), over_altitude


class _Octave(NamedTuple):
    """The ghosts of one octave of altitude."""

    ghosts: F64
    first: int
    tree: PointTree


class _Grounds(NamedTuple):
    """By what the rate of background reports is multiplied on each ground of a world."""

    terrain: TerrainSurface
    factors: F64  # of the names of its cover, or of its only surface

    @classmethod
    def of(cls, background: BackgroundModel, world: World) -> _Grounds:
        terrain = world.terrain
        names = [terrain.surface] if terrain.cover is None else terrain.cover.names
        return cls(terrain, np.array([background.surfaces.get(name, 1.0) for name in names]))

    def places(self, per_hectare: float, once: np.random.Generator) -> F64:
        """(N, 4) of so many a hectare, times the factor of the ground there; the last is 0."""
        west, south, east, north = self.terrain.bounds_enu_m
        hectares, most = (east - west) * (north - south) / 1e4, float(self.factors.max())
        n = int(once.poisson(hectares * per_hectare * most))
        xy = once.uniform((west, south), (east, north), (n, 2))
        if (cover := self.terrain.cover) is not None:
            xy = xy[once.random(n) * most < self.factors[cover.codes_at(xy)]]
        z = self.terrain.height_m(xy) if len(xy) else np.zeros(0)
        return np.column_stack([xy, z, np.zeros(len(xy))])


class _Trees(NamedTuple):
    """The trees and bushes of a world, on which the detector reports what is not there."""

    trees: Sequence[WorldTree]
    are_cut: bool = False  # by an edge of the picture

    def places(self, per_tree: float, once: np.random.Generator) -> F64:
        """(N, 4) of so many a tree, anywhere between its foot and its top, and the radius of what is cut."""
        n = int(once.poisson(len(self.trees) * per_tree))
        heights = once.uniform(0.0, 1.0, n)
        chosen = once.integers(len(self.trees), size=n).tolist() if n else []
        places = [
            (east, north, up + share * tree.height_m, tree.crown_radius_m if self.are_cut else 0.0)
            for tree, share in zip((self.trees[k] for k in chosen), heights.tolist(), strict=True)
            for east, north, up in [tree.position_enu_m.tolist()]
        ]
        return np.array(places, dtype=float).reshape(-1, 4)


def _facing(thing: WorldObject) -> tuple[float, float]:
    """Cosine and sine of its yaw."""
    return math.cos(thing.yaw_rad), math.sin(thing.yaw_rad)


def _kinds_of(thing: WorldObject, kinds: list[KindModel]) -> list[KindModel]:
    """The models of this kind in this pose, or in another if the pose was not measured."""
    of_kind = [k for k in kinds if k.kind == thing.kind]
    same_pose = [k for k in of_kind if k.pose == thing.pose]
    return same_pose or [k for k in of_kind if k.pose == of_kind[0].pose]
