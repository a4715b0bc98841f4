"""The belief: a raster over the search area of where something unseen may still be.

A cell's value is the chance that a target there would have gone unseen so far. If targets are rare, it is
also the probability that something unseen is there, relative to that before the first look.

The chance that a look detects a target comes from the statistical sensor's model: pixels on target at this
depth, the angle of view, the ground, lapses, the confidence threshold. A target's luck, its own and that of a
pass, of the score and of lapses, stays the same in all looks, as if there were one pass: the raster rather
falls too slowly than too fast. Targets have a searched class, the smallest size, and with equal probability
any pose that was measured.
Heading, colour, blur and the camera's true pose are unknown to the mission and ignored. A place below a crown
or a roof is never seen; places beside them that they hide count as open.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import shapely
from numba import njit
from numpy.polynomial.hermite_e import hermegauss
from numpy.typing import NDArray
from scipy.special import ndtr

from skysweep.arrays import F32, F64, I64
from skysweep.geometry.camera import CameraPose
from skysweep.gym.spaces import Chart
from skysweep.mission.mission import Mission
from skysweep.scenarios.model import USUAL_POSES, Scenario
from skysweep.sensing.statistical.factors import (
    CONTRAST_LIMITS,
    CONTRAST_UNIT,
    CONTRAST_USUAL,
    TOO_SMALL,
    VIEW_MAX,
)
from skysweep.sensing.statistical.model import KindModel, StatisticalModel, model_for, score_of
from skysweep.sensing.statistical.view import View
from skysweep.worlds.occlusion import FLAT, SHAPES, pixels_on_target

_LUCKS = 5  # nodes of the Gauss-Hermite quadrature over a target's luck
_DEPTHS_M = np.geomspace(1.0, 512.0, 73)
_VIEWS = np.linspace(0.0, 1.0, 21)  # squares of the sine of the angle off the vertical
_LOOKS_TO_COVER = 2
_LEAST = 1e-12  # smaller numbers become slow


class Belief:
    """``unseen`` (rows south to north, columns west to east): 1 before the first look, 0 outside the area."""

    def __init__(self, scenario: Scenario, mission: Mission, chart: Chart, cells: int) -> None:
        xy = chart.places_of_cells(cells)
        inside = shapely.contains_xy(scenario.area_enu_m, xy).reshape(-1)
        if not inside.any():
            inside[:] = True  # an area thinner than a cell
        cell = np.flatnonzero(inside)
        places = np.array([(x, y, mission.ground_at_m(x, y)) for x, y in xy[cell].tolist()])
        roofed = mission.obstacles.top_within_m(places[:, :2], 0.0) > places[:, 2]
        lens, (chances, weights) = scenario.camera.lens, chances_of_look(scenario)
        self._cell, self._places, self._roofed = cell, places, roofed
        self._optics = np.array([lens.focal_px, lens.width_px, lens.height_px])
        self._chances, self._weights = chances, weights
        self._missed = np.ones((len(cell), len(weights)))
        self._looks = np.zeros(len(cell), dtype=np.int64)
        self._n_covered = 0
        self.unseen: F32 = inside.astype(np.float32).reshape(cells, cells)

    @property
    def covered(self) -> float:
        """Share of the area that was in two pictures or more."""
        return self._n_covered / len(self._looks)

    def look(self, camera: CameraPose) -> None:
        """Update the belief with one look from the believed camera pose."""
        known: tuple[Any, ...] = self._places, self._roofed, self._chances, self._weights
        changed: tuple[Any, ...] = self._missed, self._looks, self._cell, self.unseen.ravel()
        self._n_covered += _look(self._optics, *camera, *known, *changed)


def chances_of_look(scenario: Scenario) -> tuple[F64, F64]:
    """The chance (D, V, L) that one look reports a target, and the weights (L,) of its lucks.

    The axes are ``_DEPTHS_M``, ``_VIEWS`` and a target's possible lucks, the last of which is that all looks
    lapse. Raises UserError as ``model_for``.
    """
    model = model_for(scenario)
    lucks, weights = hermegauss(_LUCKS)
    own = [k for k in model.kinds if k.kind == k.reported_as and k.kind in scenario.target_classes]
    kinds = [k for k in own if k.pose in (*USUAL_POSES, *scenario.target_poses[k.kind])]
    in_scan = [_common_lapse(model, kind, _scan_pixels(model, kind, scenario)) for kind in kinds]
    lapsing = float(np.mean(in_scan))
    seeing = np.mean([_chances(model, kind, scenario, lucks) for kind in kinds], axis=0) / (1.0 - lapsing)
    chances = np.concatenate([np.minimum(seeing, 1.0), np.zeros((*seeing.shape[:2], 1))], axis=-1)
    return chances, np.append((1.0 - lapsing) * weights / weights.sum(), lapsing)


def _view_of(model: StatisticalModel, scenario: Scenario) -> View:
    return model.view_of(scenario.camera, scenario.detector, scenario.smallest_size_m)


def _scan_pixels(model: StatisticalModel, kind: KindModel, scenario: Scenario) -> float:
    """On a target of the smallest size, from straight above."""
    height_m = scenario.search.scan_altitude_agl_m
    focal_px = _view_of(model, scenario).at(height_m).focal_px
    shape, size_m = SHAPES.get(kind.pose, FLAT), scenario.target_sizes_m[kind.kind][0]
    return pixels_on_target(focal_px, shape, size_m, 0.0, 0.0, height_m, height_m)


def _common_lapse(model: StatisticalModel, kind: KindModel, pixels: F64 | float) -> F64:
    """Share of the targets at which all looks at one aspect lapse."""
    own, of_aspect, _ = kind.lapses(is_among=False)
    return np.asarray(np.interp(np.log(pixels), np.log(model.pixels), 1.0 - (1.0 - own) * (1.0 - of_aspect)))


def _chances(model: StatisticalModel, kind: KindModel, scenario: Scenario, lucks: F64) -> F64:
    shape, size_m = SHAPES.get(kind.pose, FLAT), scenario.target_sizes_m[kind.kind][0]
    view = _view_of(model, scenario)
    across, up = np.sqrt(_VIEWS), np.sqrt(1.0 - _VIEWS)
    rays = zip(across.tolist(), up.tolist(), strict=True)
    of_focal = np.array([pixels_on_target(1.0, shape, size_m, a, 0.0, u, 1.0) for a, u in rays])
    focal_px = np.array([view.at(depth_m).focal_px for depth_m in _DEPTHS_M.tolist()])
    pixels = of_focal * (focal_px / _DEPTHS_M)[:, None]
    at, grid = np.log(pixels), np.log(model.pixels)
    surface = scenario.terrain.surface
    contrast = next((c for c in model.contrasts if (c.kind, c.pose) == (kind.kind, kind.pose)), None)
    mean, _ = contrast.surfaces.get(surface, (CONTRAST_USUAL, 0.0)) if contrast else (CONTRAST_USUAL, 0.0)
    score = (
        np.interp(at, grid, kind.scores(surface, model.lens_octaves(view)))
        + kind.view * np.minimum(_VIEWS, VIEW_MAX)
        + kind.contrast * np.clip((mean - CONTRAST_USUAL) / CONTRAST_UNIT, *CONTRAST_LIMITS)
    )
    spread = np.interp(at, grid, kind.spread)
    luck = kind.object_share + kind.aspect_share
    missing = score_of(scenario.detector.confidence_min) - score
    z = (spread[..., None] * math.sqrt(luck) * lucks - missing[..., None]) / (
        spread[..., None] * math.sqrt(max(1.0 - luck, 1e-6))
    )
    chances = (1.0 - np.interp(at, grid, kind.lapse))[..., None] * ndtr(z)
    return np.asarray(np.where((pixels < TOO_SMALL * model.pixels[0])[..., None], 0.0, chances))


_FIRST_DEPTH, _DEPTH_STEP = math.log(_DEPTHS_M[0]), math.log(_DEPTHS_M[1] / _DEPTHS_M[0])


@njit(cache=True)
def _look(
    optics: F64,  # focal length, width, height (px)
    eye: F64,
    R: F64,
    places: F64,
    roofed: NDArray[np.bool_],
    chances: F64,
    weights: F64,
    missed: F64,
    looks: I64,
    cell: I64,
    unseen: F32,
) -> int:
    """Update ``missed``, ``looks`` and ``unseen`` of the cells in the picture.

    Returns the number of newly covered cells.
    """
    focal, half_width, half_height = optics[0], optics[1] / 2.0, optics[2] / 2.0
    n_depths, n_views, n_lucks = chances.shape
    covered = 0
    for i in range(len(places)):
        dx, dy, dz = places[i, 0] - eye[0], places[i, 1] - eye[1], places[i, 2] - eye[2]
        depth = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        if depth <= 0.1:
            continue
        if abs(R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz) * focal > half_width * depth:
            continue
        if abs(R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz) * focal > half_height * depth:
            continue
        looks[i] += 1
        covered += looks[i] == _LOOKS_TO_COVER
        if roofed[i]:
            continue
        across = dx * dx + dy * dy
        d = min(max((math.log(depth) - _FIRST_DEPTH) / _DEPTH_STEP, 0.0), n_depths - 1.001)
        v = min(across / (across + dz * dz) * (n_views - 1), n_views - 1.001)
        j, k = int(d), int(v)
        d, v = d - j, v - k
        left = 0.0
        for n in range(n_lucks):
            near = chances[j, k, n] + v * (chances[j, k + 1, n] - chances[j, k, n])
            far = chances[j + 1, k, n] + v * (chances[j + 1, k + 1, n] - chances[j + 1, k, n])
            missed[i, n] = max(missed[i, n] * (1.0 - (near + d * (far - near))), _LEAST)
            left += weights[n] * missed[i, n]
        unseen[cell[i]] = left
    return covered
