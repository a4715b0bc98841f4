"""What a candidate may be, and how likely each hypothesis makes the looks at it.

A hypothesis is a kind of object in a pose and of a size, or nothing at all (a ghost). The calibrated sensor
model (``sensing/statistical/model.py``) gives the score of its looks a mean and a spread over the pixels on
target. Each hypothesis keeps a belief of its luck (``sensing/statistical/luck.py``), whose likelihood is its
weight.

What looks at a target have of their lapses in common is as the model says: a passing that missed it in
fourteen looks may have missed it once. Of other things it is half of that, for which look-alikes there are is
a guess. If all of it were shared, ten hits would tell a look-alike from a target hardly better than one. If
none were, clothing that was found in fourteen looks of fourteen would pass for a person.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import DEFAULT_SIZE_M, USUAL_POSES
from skysweep.sensing.statistical.factors import (
    CONTRAST_LIMITS,
    CONTRAST_UNIT,
    CONTRAST_USUAL,
    VIEW_MAX,
)
from skysweep.sensing.statistical.luck import (
    ASPECT,
    ASPECT_VAR,
    COVARIANCE,
    N_STATES,
    OWN,
    OWN_VAR,
    PIXELS,
    UP,
    WEIGHT,
    kept_since,
    unseen,
    update,
)
from skysweep.sensing.statistical.model import BackgroundModel, KindModel, StatisticalModel, score_of
from skysweep.sensing.statistical.view import View
from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.strategies.context import MissionContext
from skysweep.worlds.occlusion import FLAT, SHAPES, STANDING, pixels_on_target

_SIZES = (0.7, 1.0, 1.5)  # of what is not searched for, times its usual size
_SKERRIES_M = (0.7, 1.5, 3.0, 6.0, 10.0)  # rocks that stand out of water are as large as boats, too
_WATER_KINDS = {"buoy", "boat"}
_ANIMALS = {"sheep", "deer", "dog"}  # a mission is not told whether there are any: no hypothesis
_LAND_KINDS = {"stump", "red bucket", "red round sign", "stop sign"}
_SURPRISE_MAX = 9.0
_REPORTED_LEAST = 1e-3  # probability that a passing reports it
_SIZE, _SHAPE, _HEIGHT, _VIEW, _COMPANY, _UNSURE = range(6)  # of one
_OBJECT_SHARE, _ASPECT_SHARE, _FADE, _LAPSE_OBJECT_SHARE, _LAPSE_ASPECT_SHARE = range(6, 11)
_BESIDE, _SHADE = range(11, 13)
_IN_THE_OPEN = 0.0, 0.0  # beside a crown (0 or 1), share in the shade
_AROUND_M = 0.5  # places so near to each other have the same surroundings
_UP_A_TREE_M = 2.0  # standard deviation of where a report on a tree is placed, beside its crown's width
_CLUTTER_LEAST = 1e-3  # of the mean
_KNOWN_OF_THINGS = 0.5  # of what their lapses have in common
_AMONG_TREES_STD = 0.6  # of scores beside a crown or in the shade: leaves and light differ
_HECTARE_M2 = 1e4


class Hypotheses:
    """Those of one reported class in one mission."""

    def __init__(self, context: MissionContext, class_name: str, parameters: BeliefParameters) -> None:
        model = context.sensor_model
        self._view = context.sensor_view
        self._threshold = float(score_of(context.confidence_min))
        self._fade_scale = model.fade_scale
        self._log_pixels = np.log(model.pixels)
        rows = _rows(model, context, class_name)
        self._is_target = np.array([is_target for _, _, is_target, _ in rows] + [False])
        weights = np.array([*(weight for *_, weight in rows), 1.0])
        surface = context.surface
        tables, numbers, octaves = [], [], model.lens_octaves(self._view)
        for kind, size, is_target, _ in rows:
            score = kind.scores(surface, octaves)
            mean, own = _contrast(model, kind, surface)
            lapses = *kind.lapse, *kind.lapse_among
            tables.append([*(score + kind.contrast * mean), *kind.spread, *lapses])
            shape = SHAPES.get(kind.pose, FLAT)
            height = 0.5 * size if shape == STANDING else 0.0
            unsure = math.hypot(kind.contrast * own, parameters.model_std if is_target else 0.0)
            shares = kind.object_share, kind.aspect_share, kind.fade_rad
            known = 1.0 if is_target else _KNOWN_OF_THINGS
            of_lapses = known * kind.lapse_object_share, known * kind.lapse_aspect_share
            of_trees = kind.beside, kind.shade
            of_kind = size, shape, height, kind.view, kind.company, unsure
            numbers.append([*of_kind, *shares, *of_lapses, *of_trees])
        self._tables = np.array(tables)
        self._numbers = np.array(numbers)
        spreads = self._tables[:, len(model.pixels) : 2 * len(model.pixels)].mean(axis=1)
        own_var = self._numbers[:, _OBJECT_SHARE] * spreads**2 + self._numbers[:, _UNSURE] ** 2
        self._own_std = np.append(np.sqrt(own_var), 1.0)
        self._ghost = _Ghost(context, model, class_name)
        self._lapse_floor = parameters.lapse
        self._context, self._size_m = context, context.sizes_m[class_name][1]
        self._occluders = context.occluders
        self._around: dict[tuple[int, int], tuple[float, float]] = {}
        self._clutter: dict[tuple[int, int], tuple[float, float]] = {}
        reported = self._reported(context, weights)
        self._log_prior = np.log(weights / reported)
        of_groups = [reported[group].max(initial=_REPORTED_LEAST) for group in self._groups]
        self._log_reported = np.log([*of_groups, reported[-1]])
        self.reported = float(reported[0])  # probability that a passing of the scan reports a target

    def _reported(self, context: MissionContext, weights: F64) -> F64:
        """Probability that a passing of the scan reports a target, another thing, or nothing: (H + 1,).

        Only what was reported is a candidate: what seldom is was reported less likely by chance than its
        looks alone say (a truncated likelihood).
        """
        search, lens = context.search, context.lens
        height_m = search.scan_altitude_agl_m
        along_m, step_m = lens.footprint_m(height_m)[1], search.scan_speed_mps / context.looks_hz
        R = rotation_camera_to_enu(context.yaw_rad, context.gimbal_pitch_rad)
        missed = unseen((len(weights),))
        for offset_m in np.arange((step_m - along_m) / 2.0, along_m / 2.0, step_m).tolist():
            camera = CameraPose(np.array([*(offset_m * R[:2, 1]), height_m]), R)
            self._weigh(missed, camera, np.zeros(3), None, 1.0, 0, 1.0, _IN_THE_OPEN)
        reported = np.maximum(1.0 - np.exp(missed[:, WEIGHT]), _REPORTED_LEAST)
        for group in self._groups:
            reported[group] = weights[group] @ reported[group]
        return reported

    @property
    def _groups(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which hypotheses (H + 1,) are of targets, and which of other things."""
        is_thing = ~self._is_target
        is_thing[-1] = False
        return self._is_target, is_thing

    def fresh(self) -> F64:
        """The belief of a candidate that nobody has looked at: (H + 1, N_STATES)."""
        belief = unseen((len(self._log_prior),))
        belief[:, WEIGHT] = self._log_prior
        return belief

    def evidence(
        self, belief: F64, place_enu_m: F64, shift: float, only_cut: bool = False
    ) -> tuple[float, float, float, float, float]:
        """Log likelihoods of place and looks (a target, another thing, nothing), and what tells of the shift.

        ``shift`` is by how much targets here score higher than the model says. Told of it are the sum and the
        weight of a mean: its best value, if this is a target, is their quotient. ``only_cut`` says that an
        edge of the picture cut every report: those are no looks of the ``belief``, so that these need not
        have reported it.
        """
        own_std = np.hypot(self._own_std, _unsure_there(*self._surroundings(place_enu_m)))
        target, thing, nothing, total, weight = _evidence(belief, self._is_target, own_std, shift)
        if only_cut:
            target, thing, nothing = (np.array([target, thing, nothing]) + self._log_reported).tolist()
        return target, thing, nothing + self.clutter(place_enu_m, only_cut), total, weight

    def look(
        self,
        belief: F64,
        camera: CameraPose,
        place_enu_m: F64,
        score: float | None,
        widened: float,
        others: int,
        shown: float = 1.0,
    ) -> float:
        """Update a belief by one look at the place, in place; how surprising it was if this is a target.

        ``score`` is that of a hit, None of a miss; ``others`` are the other candidates in view. Targets'
        scores are spread ``widened`` times as far as the model says. ``shown`` is how probably the look shows
        what is there; otherwise a hit or miss is as likely as where nothing is. Surprise is the squared
        distance of the score from what was expected, in variances, 1 on average; 0 for a miss.
        """
        around = self._surroundings(place_enu_m)
        surprise = self._weigh(belief, camera, place_enu_m, score, widened, others, shown, around)
        belief[:, WEIGHT] -= belief[:, WEIGHT].max()
        return surprise

    def _weigh(
        self,
        belief: F64,
        camera: CameraPose,
        place_enu_m: F64,
        score: float | None,
        widened: float,
        others: int,
        shown: float,
        around: tuple[float, float],
    ) -> float:
        height_m = float(camera.position_enu_m[2] - place_enu_m[2])
        view = self._view_from(camera)
        return _look(
            belief,
            self._tables,
            self._numbers,
            self._log_pixels,
            camera.position_enu_m,
            camera.R_camera_to_enu,
            place_enu_m,
            view.focal_px,
            self._fade_scale,
            math.nan if score is None else score,
            self._threshold,
            self._lapse_floor,
            self._ghost.at(max(height_m * view.as_high, 1.0)),
            self._is_target,
            widened,
            math.log1p(others),
            shown,
            *around,
        )

    def _view_from(self, camera: CameraPose) -> View:
        if not self._view.below_m:
            return self._view
        x, y, z = camera.position_enu_m.tolist()
        return self._view.at(z - self._context.ground_at_m((x, y)))

    def _surroundings(self, place_enu_m: F64) -> tuple[float, float]:
        """Whether (0 or 1) a target there is beside a crown, and what share of it is in the shade."""
        near = _near(place_enu_m)
        if near not in self._around:
            beside, shade = self._occluders.around(self._place(near), self._size_m)
            self._around[near] = float(beside), shade
        return self._around[near]

    def clutter(self, place_enu_m: F64, only_cut: bool = False) -> float:
        """Log of the density of false reports of nothing there, over its mean in the area.

        ``only_cut`` is of reports that an edge of the picture cuts: over the mean times the share of targets
        that it cuts.
        """
        near = _near(place_enu_m)
        if near not in self._clutter:
            place = self._place(near)
            whole, cut = (self._ghost.clutter(place, of_cut, self._size_m) for of_cut in (False, True))
            self._clutter[near] = whole, cut
        return self._clutter[near][only_cut]

    def _place(self, near: tuple[int, int]) -> F64:
        x, y = near[0] * _AROUND_M, near[1] * _AROUND_M
        return np.array([x, y, self._context.ground_at_m((x, y))])

    def confusion(self, belief: F64, camera: CameraPose, place_enu_m: F64, nothing: float) -> float:
        """Share of today's doubt, 0..1, that looks from there would leave.

        The Chernoff bound of the error between each target and each other hypothesis, weighted by both.
        ``nothing`` is the share of those candidates that are no targets.
        """
        return float(
            _confusion(
                belief,
                self._tables,
                self._numbers,
                self._log_pixels,
                self._is_target,
                camera.position_enu_m,
                camera.R_camera_to_enu,
                place_enu_m,
                self._view_from(camera).focal_px,
                self._fade_scale,
                self._threshold,
                nothing,
                *self._surroundings(place_enu_m),
            )
        )


class _Ghost:
    """Reports where nothing is: where, their scores by altitude, and the chance of another.

    The altitude is that from which the calibrated camera's pixels show as much ground.
    """

    def __init__(self, context: MissionContext, model: StatisticalModel, class_name: str) -> None:
        self._floor = float(score_of(model.experiment.confidence_floor))
        self._occluders = context.occluders
        found = [b for b in model.background if b.reported_as == class_name]
        self._model: BackgroundModel | None = found[0] if found else None
        if self._model is not None:
            scan_m = context.search.scan_altitude_agl_m
            scan_m *= context.sensor_view.at(scan_m).as_high
            of_ground = self._model.surfaces.get(context.surface, 1.0)
            self._per_hectare = of_ground * self._at(scan_m, self._model.per_hectare)
            self._per_tree = self._at(scan_m, self._model.per_tree)
            self._per_cut_tree = self._at(scan_m, self._model.per_cut_tree)
            trees = self._occluders.crowns_in(context.area_enu_m)
            self._mean = self._per_hectare + self._per_tree * trees / (context.area_enu_m.area / _HECTARE_M2)

    def at(self, altitude_agl_m: float) -> F64:
        """(4,): mean and spread of the score, chance of no report, share that is its own."""
        if self._model is None:
            return np.array([self._floor + 0.3, 0.5, 0.5, 0.3])
        m = self._model
        scale = self._at(altitude_agl_m, m.score_scale)
        return np.array([self._floor + scale, max(scale, 0.1), 1.0 - m.again, m.same_share])

    def clutter(self, place_enu_m: F64, of_cut: bool, size_m: float) -> float:
        """Log of their density at a place (3,) from the scan's altitude, over its mean in the area.

        A tree's are spread normally around it, as wide as its crown and the error of a place that is
        projected to the ground from somewhere up a tree. An edge of the picture cuts (``of_cut``) as many
        more crowns than targets of that size as they are wider.
        """
        if self._model is None or self._mean <= 0.0:
            return 0.0
        away_m, radii_m = self._occluders.crowns_near(place_enu_m, 3.0 * _UP_A_TREE_M)
        var_m2 = (0.5 * radii_m) ** 2 + _UP_A_TREE_M**2
        per_m2 = np.exp(-0.5 * away_m**2 / var_m2) / (2.0 * math.pi * var_m2)
        per_tree = self._per_cut_tree * 2.0 * radii_m / size_m if of_cut else self._per_tree
        here = self._per_hectare + _HECTARE_M2 * float((per_tree * per_m2).sum())
        return math.log(max(here / self._mean, _CLUTTER_LEAST))

    def _at(self, altitude_agl_m: float, over_altitude: list[float]) -> float:
        assert self._model is not None
        grid = np.log(self._model.altitude_agl_m)
        return float(np.interp(math.log(altitude_agl_m), grid, over_altitude))


def _near(place_enu_m: F64) -> tuple[int, int]:
    return round(place_enu_m[0] / _AROUND_M), round(place_enu_m[1] / _AROUND_M)


def _rows(
    model: StatisticalModel, context: MissionContext, class_name: str
) -> list[tuple[KindModel, float, bool, float]]:
    """Kind, size in m, whether it is searched for, and weight among those that are, or are not."""
    reported = [kind for kind in model.kinds if kind.reported_as == class_name]
    targets = [kind for kind in reported if kind.kind == class_name]
    if not targets:
        raise UserError(
            f"search.strategy: belief needs a sensor model of '{class_name}'; write one with "
            "'skysweep calibrate', or take another strategy"
        )
    targets = [kind for kind in targets if kind.pose in context.poses[class_name]] or targets
    others = [kind for kind in reported if kind.kind != class_name and _is_plausible(kind, context)]
    rows = []
    for kinds in (targets, others):
        for kind in kinds:
            if kind.kind in context.sizes_m:
                low, high = context.sizes_m[kind.kind]
                sizes = sorted({low, (low + high) / 2, high})
            elif kind.kind == "rock" and context.surface == "water":
                sizes = list(_SKERRIES_M)
            else:
                sizes = [DEFAULT_SIZE_M[kind.kind] * share for share in _SIZES]
            weight = 1.0 / (len(kinds) * len(sizes))
            rows += [(kind, size, kinds is targets, weight) for size in sizes]
    return rows


def _is_plausible(kind: KindModel, context: MissionContext) -> bool:
    """Whether a kind that is not reported under its own name may be met on this ground."""
    if kind.kind in context.sizes_m:
        return kind.pose in context.poses[kind.kind]
    if kind.kind == "person" and kind.pose not in USUAL_POSES:
        return False
    if kind.kind == "person":
        return (kind.pose == "floating") == (context.surface == "water")
    unlikely = _LAND_KINDS if context.surface == "water" else _WATER_KINDS | {"stop sign"}
    return kind.kind not in unlikely | _ANIMALS


def _contrast(model: StatisticalModel, kind: KindModel, surface: str) -> tuple[float, float]:
    """Mean and spread of the contrast to the ground, in the unit of the factors."""
    mean, std = model.contrast(kind.kind, kind.pose, surface)
    return float(np.clip((mean - CONTRAST_USUAL) / CONTRAST_UNIT, *CONTRAST_LIMITS)), std / CONTRAST_UNIT


@njit(cache=True)
def _evidence(
    belief: F64, is_target: NDArray[np.bool_], own_std: F64, shift: float
) -> tuple[float, float, float, float, float]:
    """A belief N(m, v) of an offset weighs exp(d m + d² (v - 1) / 2) if its prior mean is d instead of 0."""
    n = len(belief) - 1
    target = other = 1e-300
    total = weight = 0.0
    for i in range(n):
        if is_target[i]:
            d, m, v = shift / own_std[i], belief[i, OWN], belief[i, OWN_VAR]
            likely = math.exp(belief[i, WEIGHT] + d * m + 0.5 * d * d * (v - 1.0))
            target += likely
            total += likely * m / own_std[i]
            weight += likely * (1.0 - v) / own_std[i] ** 2
        else:
            other += math.exp(belief[i, WEIGHT])
    nothing = max(belief[n, WEIGHT], math.log(1e-300))
    return math.log(target), math.log(other), nothing, total / target, weight / target


@njit(cache=True)
def _expect(
    out: F64,
    table: F64,
    numbers: F64,
    log_pixels: F64,
    eye: F64,
    R: F64,
    place: F64,
    focal: float,
    beside: float,
    shade: float,
) -> None:
    """Write pixels, mean and spread of the score, and chance of a lapse."""
    g = len(log_pixels)
    dx, dy, dz = place[0] - eye[0], place[1] - eye[1], place[2] + numbers[_HEIGHT] - eye[2]
    depth = max(R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz, 0.3)
    pixels = pixels_on_target(focal, int(numbers[_SHAPE]), numbers[_SIZE], dx, dy, dz, depth)
    at = min(max(math.log(pixels), log_pixels[0]), log_pixels[g - 1])
    k = 0
    while k < g - 2 and at >= log_pixels[k + 1]:
        k += 1
    w = (at - log_pixels[k]) / (log_pixels[k + 1] - log_pixels[k])
    across = dx * dx + dy * dy
    view = min(across / max(across + dz * dz, 1e-9), VIEW_MAX)
    out[0] = pixels
    out[1] = (1.0 - w) * table[k] + w * table[k + 1] + numbers[_VIEW] * view
    out[1] += numbers[_BESIDE] * beside + numbers[_SHADE] * shade
    out[2] = (1.0 - w) * table[g + k] + w * table[g + k + 1]
    of_lapses = (3 if beside > 0.0 or shade > 0.0 else 2) * g
    out[3] = (1.0 - w) * table[of_lapses + k] + w * table[of_lapses + k + 1]


@njit(cache=True)
def _unsure_there(beside: float, shade: float) -> float:
    """By how much a target's score there may differ from the model's mean, the same in every look."""
    return _AMONG_TREES_STD if beside > 0.0 or shade > 0.0 else 0.0


@njit(cache=True)
def _sight(eye: F64, place: F64) -> tuple[float, float, float]:
    """The direction from a place to the eye, of length 1."""
    x, y, z = eye[0] - place[0], eye[1] - place[1], eye[2] - place[2]
    distance = max(math.sqrt(x * x + y * y + z * z), 1e-9)
    return x / distance, y / distance, z / distance


@njit(cache=True)
def _confusion(
    belief: F64,
    tables: F64,
    numbers: F64,
    log_pixels: F64,
    is_target: NDArray[np.bool_],
    eye: F64,
    R: F64,
    place: F64,
    focal: float,
    fade_scale: float,
    threshold: float,
    nothing: float,
    beside: float,
    shade: float,
) -> float:
    n = len(tables)
    means, variances = np.empty(n + 1), np.empty(n + 1)
    unsure_there = _unsure_there(beside, shade)
    expected, sight = np.empty(4), _sight(eye, place)
    for i in range(n):
        _expect(expected, tables[i], numbers[i], log_pixels, eye, R, place, focal, beside, shade)
        spread, b = expected[2], belief[i]
        own = math.sqrt(numbers[i, _OBJECT_SHARE] * spread * spread + numbers[i, _UNSURE] ** 2)
        if is_target[i]:
            own = math.hypot(own, unsure_there)
        left = kept_since(b, expected[0], sight, numbers[i, _FADE], fade_scale)
        common = math.sqrt(numbers[i, _ASPECT_SHARE]) * spread
        means[i] = max(expected[1] + own * b[OWN] + common * left * b[ASPECT], threshold - 0.5)
        variances[i] = own * own * b[OWN_VAR] + 2.0 * own * common * left * b[COVARIANCE] + 0.01
        variances[i] += common * common * (1.0 - left * left * (1.0 - b[ASPECT_VAR]))
    means[n], variances[n] = threshold - 0.5, 0.1
    left, total = 0.0, 1e-300
    for i in range(n):
        if is_target[i]:
            for j in range(n + 1):
                if not is_target[j]:
                    weight = math.exp(belief[i, WEIGHT] + belief[j, WEIGHT])
                    weight *= nothing if j == n else 1.0 - nothing
                    gap = means[i] - means[j]
                    total += weight
                    left += weight * math.exp(-0.25 * gap * gap / (variances[i] + variances[j]))
    return left / total


@njit(cache=True)
def _look(
    belief: F64,
    tables: F64,
    numbers: F64,
    log_pixels: F64,
    eye: F64,
    R: F64,
    place: F64,
    focal: float,
    fade_scale: float,
    score: float,
    threshold: float,
    lapse_floor: float,
    ghost: F64,
    is_target: NDArray[np.bool_],
    widened: float,
    company: float,
    shown: float,
    beside: float,
    shade: float,
) -> float:
    n = len(tables)
    expected, seen, sight = np.empty(4), np.empty(N_STATES), _sight(eye, place)
    surprise, likely, where_nothing_is = 0.0, 1e-300, 1.0
    unsure_there = _unsure_there(beside, shade)
    for k in range(n + 1):
        i = k - 1 if k else n  # nothing at all comes first
        b = belief[i]
        seen[:] = b
        if i < n:
            _expect(expected, tables[i], numbers[i], log_pixels, eye, R, place, focal, beside, shade)
            pixels, mean, spread = expected[0], expected[1] + numbers[i, _COMPANY] * company, expected[2]
            lapse = max(expected[3], lapse_floor)
            object_share, aspect_share = numbers[i, _OBJECT_SHARE], numbers[i, _ASPECT_SHARE]
            unsure, fade_rad = numbers[i, _UNSURE], numbers[i, _FADE]
            of_model = expected[3] / lapse  # the rest is each look's own
            lapse_object = of_model * numbers[i, _LAPSE_OBJECT_SHARE]
            lapse_aspect = of_model * numbers[i, _LAPSE_ASPECT_SHARE]
            if is_target[i]:
                spread *= widened
                unsure = math.hypot(unsure, unsure_there)
        else:
            lapse_object = lapse_aspect = 0.0
            pixels, mean, spread, lapse = 1.0, ghost[0], ghost[1], ghost[2]
            object_share, aspect_share, unsure, fade_rad = ghost[3], 0.0, 0.0, 1.0
        middle, variance = update(
            seen,
            pixels,
            sight,
            fade_rad,
            fade_scale,
            mean,
            spread,
            lapse,
            object_share,
            aspect_share,
            lapse_object,
            lapse_aspect,
            unsure,
            score,
            threshold,
        )
        before, likely_seen = b[WEIGHT], math.exp(seen[WEIGHT] - b[WEIGHT])
        if i == n:
            where_nothing_is = likely_seen
        if i == n or shown == 1.0:
            b[:] = seen
        else:
            both = shown * likely_seen + (1.0 - shown) * where_nothing_is
            b += (shown * likely_seen / both) * (seen - b)
            b[WEIGHT] = before + math.log(both)
            b[PIXELS : UP + 1] = seen[PIXELS : UP + 1]
        if score == score and i < n and is_target[i]:
            weight = math.exp(before)
            likely += weight
            surprise += weight * min((score - middle) ** 2 / variance, _SURPRISE_MAX)
    return surprise / likely
