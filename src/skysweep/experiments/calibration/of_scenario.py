"""Adapts the statistical sensor to one scenario: to its own ground, light, weather and things.

The general fit averages over many grounds and lights; a scenario has one of each. Pictures of the scenario's
worlds are shown to the detector, and from the same poses the sensor without pictures draws reports, with its
scores shifted by each of SHIFTS. Both are assigned to the things in view in the same way, so what is assigned
wrongly is so in both. A kind in a pose, reported as a class, gets the shift that makes the measured number of
reports most likely (simulated moments: McFadden, Econometrica 57, 1989), drawn towards 0. Rates of false
reports on the ground and on trees are multiplied by measured over drawn, drawn towards 1. Both are fitted
twice, from the scan's height and from near a check's, with a straight line over the log of the pixels or of
the altitude in between: another lens or ground changes otherwise what is seen from afar than from near.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.experiments.calibration.looks import HIT_RADIUS, HIT_RADIUS_MIN_PX, Crowns
from skysweep.experiments.workers import run_jobs
from skysweep.files.writing import whole_files
from skysweep.flights.build import make_detector
from skysweep.geometry.camera import CameraPose, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import Scenario
from skysweep.sensing.cameras.exposing import exposing
from skysweep.sensing.statistical.model import (
    BackgroundModel,
    KindModel,
    OfScenario,
    PartOfScenario,
    StatisticalModel,
    model_for,
)
from skysweep.sensing.statistical.posed import PosedSensor
from skysweep.types import Detections, Frame
from skysweep.worlds.obstacles import Obstacles
from skysweep.worlds.occlusion import middle_enu_m
from skysweep.worlds.places import Ground
from skysweep.worlds.rendering.renderer import make_renderer, refuse_unrenderable
from skysweep.worlds.world import World, build_world

PICTURES_PER_WORLD = 40
SHIFTS = tuple(np.linspace(-2.0, 2.0, 9).tolist())  # of the scores
_AS_IT_IS = SHIFTS.index(0.0)
_SENSORS, _DRAWS = 4, 4  # of each world, each with the objects' luck drawn anew; and of each at each pose
_SHIFT_STD = 0.5  # prior
_USUAL_REPORTS = 2.0  # that count as drawn rightly, beside what was measured on ground and trees
_FIRST_SEED = 1_500_000  # of the worlds: none that missions commonly have
_SCAN_SHARE = 0.5  # of the pictures are from the scan's height, the others from the lower half to a check's
_AIMED_SHARE = 0.5  # are aimed at a thing
_TILT_STD_DEG = 2.0
_CLEAR_M = 2.0  # of crowns and houses
_TRIES = 200
_LEAST_CHANCE = 1e-4

Thing = tuple[str, str]  # kind and pose
GROUND, TREE = ("ground", ""), ("tree", "")
Key = tuple[Thing, str]  # and the class that it is reported as
FAR, NEAR = 0, 1  # from the scan's height, and from lower
BANDS = (FAR, NEAR)


@dataclass
class Tally:
    """Counts of one world, or of several, from each of BANDS."""

    pictures: Counter[int] = field(default_factory=Counter)
    heights: dict[int, tuple[float, float]] = field(default_factory=dict)  # lowest and highest, metres
    objects: Counter[tuple[Thing, int]] = field(default_factory=Counter)  # that were seen
    looks: Counter[tuple[Thing, int]] = field(default_factory=Counter)  # of GROUND and TREE the pictures
    scales: dict[tuple[Thing, int], float] = field(default_factory=dict)  # sums over looks, see ``scale``
    reported: Counter[tuple[Key, int]] = field(default_factory=Counter)
    drawn: Counter[tuple[Key, int, int]] = field(default_factory=Counter)  # in all draws, by shift number

    def expected(self, key: Key, band: int, shift: int) -> float:
        """How many reports are drawn for as many looks as there are pictures."""
        return self.drawn[key, band, shift] / (_SENSORS * _DRAWS)

    def scale(self, thing: Thing, band: int) -> float:
        """Mean log of an object's pixels, or of the pictures' altitudes; 0 without looks."""
        return self.scales.get((thing, band), 0.0) / max(self.looks[thing, band], 1)

    def look(self, thing: Thing, band: int, scale: float) -> None:
        """Count a look at a thing."""
        self.looks[thing, band] += 1
        self.scales[thing, band] = self.scales.get((thing, band), 0.0) + scale

    def __add__(self, other: Tally) -> Tally:
        ends = [each.heights for each in (self, other)]
        return Tally(
            self.pictures + other.pictures,
            {
                band: (min(low for low, _ in of_band), max(high for _, high in of_band))
                for band in BANDS
                if (of_band := [heights[band] for heights in ends if band in heights])
            },
            self.objects + other.objects,
            self.looks + other.looks,
            {
                key: sum(scales.get(key, 0.0) for scales in (self.scales, other.scales))
                for key in self.scales | other.scales
            },
            self.reported + other.reported,
            self.drawn + other.drawn,
        )


@dataclass(frozen=True, slots=True)
class WorldJob:
    """Pictures of one world of the scenario."""

    scenario: Scenario
    model: StatisticalModel
    index: int
    n_pictures: int
    seed: int


def calibrate_on_scenario(
    scenario: Scenario,
    out_yaml: Path,
    pictures: int = 800,
    seed: int = 0,
    workers: int | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StatisticalModel:
    """Adapt the scenario's sensor model, or the shipped one, to its own worlds; write it.

    The same arguments give the same file, whatever the number of workers. ``progress`` is called with
    pictures done and total. Raises UserError when the sensor model is another detector's, nothing can be
    rendered, or the results cannot be written.
    """
    model = model_for(scenario)
    refuse_unrenderable(scenario.camera)
    tallies: dict[int, Tally] = {}
    jobs = _jobs(scenario, model, pictures, seed)
    done = 0
    for job, tally in run_jobs(look_around, jobs, workers):
        tallies[job.index] = tally
        done += job.n_pictures
        progress(done, pictures)
    in_order = [tallies[index] for index in sorted(tallies)]
    adapted = _adapted(model, fit(in_order, model))
    told = OfScenario(name=scenario.name, pictures=pictures, seed=seed, parts=_parts(in_order, model))
    adapted = adapted.model_copy(update={"scenario": told})
    text = yaml.safe_dump(
        adapted.model_dump(exclude_none=True), sort_keys=False, default_flow_style=None, width=110
    )
    with whole_files(out_yaml.parent) as unfinished:
        header = f"# Written by skysweep calibrate, for the scenario {scenario.name}.\n"
        (unfinished / out_yaml.name).write_text(header + text, encoding="utf-8")
    return adapted


def _jobs(scenario: Scenario, model: StatisticalModel, pictures: int, seed: int) -> list[WorldJob]:
    n = -(-pictures // PICTURES_PER_WORLD)
    shares = [pictures // n + (k < pictures % n) for k in range(n)]
    return [WorldJob(scenario, model, k, share, seed) for k, share in enumerate(shares)]


# ---- looking ------------------------------------------------------------------------------------------


def look_around(job: WorldJob) -> Tally:
    """Pictures of one world, and what is drawn from the same poses."""
    cv2.setNumThreads(1)
    scenario, camera = job.scenario, job.scenario.camera
    world_seed = _FIRST_SEED + 1000 * job.seed + job.index
    rng = np.random.default_rng([job.seed, job.index, 59])
    view = _View(scenario, build_world(scenario, world_seed))
    renderer = make_renderer(view.world)
    expose = exposing(camera, renderer, int(rng.integers(2**31)))
    detector = make_detector(scenario, threads=1)
    seen_as = job.model.view_of(camera, scenario.detector, scenario.smallest_size_m)
    tally, seen = Tally(), set[tuple[int, int]]()
    looks: list[tuple[CameraPose, F64, int]] = []
    for number in range(job.n_pictures):
        pose, height_m = view.pose(rng)
        band = FAR if height_m >= scenario.search.scan_altitude_agl_m else NEAR
        angle = rng.uniform(0.0, 2.0 * np.pi)
        velocity = scenario.search.scan_speed_mps * np.array([np.cos(angle), np.sin(angle), 0.0])
        looks.append((pose, velocity, band))
        image = expose(number, pose, 0.0, velocity, np.zeros(3), height_m)
        keys = view.assigned(pose, detector.detect(Frame(0.0, image, pose, camera.lens)))
        tally.reported.update((key, band) for key in keys)
        low, high = tally.heights.get(band, (height_m, height_m))
        tally.heights[band] = min(low, height_m), max(high, height_m)
        tally.pictures[band] += 1
        inside, seen_so = view.inside(pose), seen_as.at(height_m)
        seen.update((i, band) for i in inside)
        for i in inside:
            size_m = view.world.objects[i].size_m
            tally.look(view.things[i], band, math.log(seen_so.pixels_on_target(size_m, height_m)))
        for thing in (GROUND, TREE):
            tally.look(thing, band, math.log(seen_so.as_high * height_m))
    renderer.close()
    tally.objects.update((view.things[i], band) for i, band in seen)
    for band, n in tally.pictures.items():
        tally.objects[GROUND, band] = tally.objects[TREE, band] = n
    for number, shift in enumerate(SHIFTS):
        with_strays = number == _AS_IT_IS
        shifted = _shifted(job.model, shift)
        for k in range(_SENSORS):
            sensor = PosedSensor(scenario, view.world, shifted, world_seed + 1_000_000 * (k + 1))
            for pose, velocity, band in looks:
                for _ in range(_DRAWS):
                    found = sensor.detect(pose, velocity)
                    tally.drawn.update((key, band, number) for key in view.assigned(pose, found, with_strays))
    return tally


class _View:
    """A world of the scenario, from where it is looked at, and what a report in a picture is of."""

    def __init__(self, scenario: Scenario, world: World) -> None:
        self.world, self._scenario, self._lens = world, scenario, scenario.camera.lens
        self.things: list[Thing] = [(thing.kind, thing.pose) for thing in world.objects]
        self._places = np.array([middle_enu_m(thing) for thing in world.objects]).reshape(-1, 3)
        self._sizes_m = np.array([thing.size_m for thing in world.objects])
        self._size_px = np.array([self._lens.width_px, self._lens.height_px], dtype=float)
        self._crowns = Crowns(world, self._lens)
        self._obstacles = Obstacles(world.terrain, world.trees, world.buildings)
        self._area = Ground(scenario.area_enu_m)

    @cached_property
    def _of_each_thing(self) -> list[NDArray[np.int_]]:
        alike: dict[Thing, list[int]] = {}
        for i, thing in enumerate(self.things):
            alike.setdefault(thing, []).append(i)
        return [np.array(numbers) for numbers in alike.values()]

    def pose(self, rng: np.random.Generator) -> tuple[CameraPose, float]:
        """A pose as a search has them, and its height above the ground."""
        search, pitch_rad = self._scenario.search, self._scenario.camera.gimbal.pitch_rad
        for _ in range(_TRIES):
            height_m = search.scan_altitude_agl_m
            if rng.random() >= _SCAN_SHARE:
                lowest, highest = np.log([min(search.check_altitude_agl_m, height_m), height_m])
                height_m = float(np.exp(rng.uniform(lowest, (lowest + highest) / 2.0)))
            yaw_rad, (tilt, roll) = (
                float(rng.uniform(-np.pi, np.pi)),
                np.radians(_TILT_STD_DEG) * rng.normal(size=2),
            )
            R = rotation_camera_to_enu(yaw_rad, pitch_rad + tilt, roll)
            aimed = self.things and rng.random() < _AIMED_SHARE
            if aimed:
                alike = self._of_each_thing[int(rng.integers(len(self._of_each_thing)))]
                place = self._places[alike[int(rng.integers(len(alike)))]]
                pixel = rng.uniform(0.05, 0.95, 2) * self._size_px
                ray = R @ np.array([*(pixel - self._size_px / 2) / self._lens.focal_px, 1.0])
                xy = (place + ray * height_m / min(ray[2], -0.2))[:2]
            else:
                xy = self._area.draw(1, rng)[0]
            z = self.world.terrain.height_at_m(*xy.tolist()) + height_m
            if z > self._obstacles.top_within_m(xy[None], _CLEAR_M).item() + _CLEAR_M:
                return CameraPose(np.array([*xy, z]), R), height_m
        raise UserError(
            f"search.scan_altitude_agl_m: {search.scan_altitude_agl_m:g} m is lower than what stands here; "
            "write more"
        )

    def inside(self, pose: CameraPose) -> list[int]:
        """The objects whose middle is in the picture."""
        return np.flatnonzero(self._are_inside(*project(self._lens, pose, self._places))).tolist()

    def _are_inside(self, pixels: F64, depths_m: F64) -> NDArray[np.bool_]:
        return (depths_m > 0.1) & ((pixels >= 0.0) & (pixels < self._size_px)).all(axis=1)

    def assigned(self, pose: CameraPose, found: Detections, with_strays: bool = True) -> list[Key]:
        """What is reported as what: a thing once as each class, ground and trees with every report.

        Reports of things that are not ``inside`` are left out.
        """
        if not len(found.boxes_xyxy_px):
            return []
        middles = (found.boxes_xyxy_px[:, :2] + found.boxes_xyxy_px[:, 2:]) / 2.0
        pixels, depths_m = project(self._lens, pose, self._places)
        reach_px = HIT_RADIUS * self._lens.focal_px * self._sizes_m / np.maximum(depths_m, 0.1)
        gaps = np.linalg.norm(middles[:, None] - pixels[None], axis=2)
        near = (depths_m > 0.1) & (gaps <= np.maximum(reach_px, HIT_RADIUS_MIN_PX))
        of_things = {
            (int(np.where(near[k], gaps[k], np.inf).argmin()), name)
            for k, name in enumerate(found.class_names)
            if near[k].any()
        }
        inside = self._are_inside(pixels, depths_m)
        keys: list[Key] = [(self.things[i], name) for i, name in of_things if inside[i]]
        strays = np.flatnonzero(~near.any(axis=1))
        if with_strays and len(strays):
            on_tree = self._crowns.lie_on(pose, middles[strays])
            keys += [
                (TREE if on else GROUND, found.class_names[k])
                for k, on in zip(strays.tolist(), on_tree.tolist(), strict=True)
            ]
        return keys


# ---- fitting ------------------------------------------------------------------------------------------


Points = tuple[tuple[float, ...], tuple[float, ...]]  # places on an axis, ascending, and values there


@dataclass(frozen=True, slots=True)
class Fitted:
    """What changes, over log pixels and over log altitude; constant beyond the outermost points."""

    shifts: Mapping[Key, Points]  # of scores
    times: Mapping[Key, Points]  # logs of factors on the rates of reports on the ground and on trees


_NOTHING: Points = ((0.0,), (0.0,))


def fit(tallies: Iterable[Tally], model: StatisticalModel) -> Fitted:
    """Shifts and factors from worlds."""
    all_ = sum(tallies, Tally())
    strays = [(thing, b.reported_as) for b in model.background for thing in (GROUND, TREE)]
    return Fitted(
        {_key(kind): _points(all_, _key(kind), _shift) for kind in model.kinds},
        {key: _points(all_, key, _log_times) for key in strays},
    )


def _points(tally: Tally, key: Key, value: Callable[[Tally, Key, int], float]) -> Points:
    """A value from each band in which there was a look."""
    found = sorted(
        (tally.scale(key[0], band), value(tally, key, band)) for band in BANDS if tally.looks[key[0], band]
    )
    return (tuple(at for at, _ in found), tuple(v for _, v in found)) if found else _NOTHING


def _key(kind: KindModel) -> Key:
    return (kind.kind, kind.pose), kind.reported_as


_FINE = np.linspace(SHIFTS[0], SHIFTS[-1], 161)


def _chances(tally: Tally, key: Key, band: int) -> F64:
    """Of a report in one look, at the FINE shifts."""
    drawn = np.array([tally.expected(key, band, k) for k in range(len(SHIFTS))]) / tally.looks[key[0], band]
    chances = np.clip(drawn, _LEAST_CHANCE, 1.0 - _LEAST_CHANCE)
    return np.asarray(1.0 / (1.0 + np.exp(-np.interp(_FINE, SHIFTS, np.log(chances / (1.0 - chances))))))


def _shift(tally: Tally, key: Key, band: int) -> float:
    """Looks at one object count as one look."""
    n, hits = tally.looks[key[0], band], tally.reported[key, band]
    chances, alike = _chances(tally, key, band), n / tally.objects[key[0], band]
    likelihood = (hits * np.log(chances) + (n - hits) * np.log1p(-chances)) / alike
    return round(float(_FINE[np.argmax(likelihood - 0.5 * (_FINE / _SHIFT_STD) ** 2)]), 3)


def _log_times(tally: Tally, key: Key, band: int) -> float:
    drawn = tally.expected(key, band, _AS_IT_IS)
    return math.log((tally.reported[key, band] + _USUAL_REPORTS) / (drawn + _USUAL_REPORTS))


def _shifted(model: StatisticalModel, shift: float) -> StatisticalModel:
    """The model with all scores shifted alike."""
    return _adapted(model, Fitted({_key(kind): ((0.0,), (shift,)) for kind in model.kinds}, {}))


def _adapted(model: StatisticalModel, fitted: Fitted) -> StatisticalModel:
    """The model with its scores shifted and its rates multiplied."""
    log_pixels = np.log(model.pixels)
    kinds = [
        kind.model_copy(update={"score": np.round(np.add(kind.score, by), 3).tolist()})
        for kind in model.kinds
        for by in [np.interp(log_pixels, *fitted.shifts.get(_key(kind), _NOTHING))]
    ]
    return model.model_copy(
        update={"kinds": kinds, "background": [_with_times(b, fitted.times) for b in model.background]}
    )


def _with_times(b: BackgroundModel, times: Mapping[Key, Points]) -> BackgroundModel:
    log_altitudes = np.log(b.altitude_agl_m)

    def multiplied(rates: Sequence[float], thing: Thing) -> list[float]:
        factors = np.exp(np.interp(log_altitudes, *times.get((thing, b.reported_as), _NOTHING)))
        return [float(f"{rate * factor:.3g}") for rate, factor in zip(rates, factors, strict=True)]

    update = {
        "per_hectare": multiplied(b.per_hectare, GROUND),
        "per_tree": multiplied(b.per_tree, TREE),
        "per_cut_tree": multiplied(b.per_cut_tree, TREE),
    }
    return b.model_copy(update=update)


def _parts(tallies: Sequence[Tally], model: StatisticalModel) -> list[PartOfScenario]:
    """Measured and drawn reports of each part; those drawn now are predicted from the other half's fit."""
    halves = [sum(tallies[k::2], Tally()) for k in (0, 1)]
    all_ = sum(halves, Tally())
    fits = [fit([half], model) for half in reversed(halves)]
    parts = []
    for key, band in sorted({(key, band) for key, band, _ in all_.drawn} | set(all_.reported)):
        thing, name = key
        before, now = all_.expected(key, band, _AS_IT_IS), 0.0
        for half, other in zip(halves, fits, strict=True):
            at = half.scale(thing, band)
            if key in other.times:
                now += half.expected(key, band, _AS_IT_IS) * math.exp(np.interp(at, *other.times[key]))
            elif half.looks[thing, band]:
                shift = np.interp(at, *other.shifts.get(key, _NOTHING))
                chance = np.interp(shift, _FINE, _chances(half, key, band))
                now += float(chance) * half.looks[thing, band]
        low, high = (f"{height_m:.3g}" for height_m in all_.heights[band])
        kind, pose = thing
        parts.append(
            PartOfScenario(
                part=(f"{kind}, {pose}" if pose else f"nothing: {kind}")
                + (f", from {low} m" if low == high else f", from {low} to {high} m"),
                reported_as=name,
                looks=all_.looks[thing, band],
                measured=all_.reported[key, band],
                before=round(before, 1),
                now=round(now, 1),
            )
        )
    return parts
