"""The effective sweep width of a scenario's detector, from the calibrated sensor.

Koopman, "Search and Screening" (1980): the integral of the lateral range curve, which is the chance that a
straight pass at some distance reports the target at least once. Here over level ground without anything
that hides it, covered as the search area is, at scan speed, with the camera straight down and across the
track.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.scenarios.model import Scenario
from skysweep.sensing.statistical.factors import (
    BLUR_MAX,
    CONTRAST_LIMITS,
    CONTRAST_UNIT,
    CONTRAST_USUAL,
    TOO_SMALL,
    VIEW_MAX,
)
from skysweep.sensing.statistical.luck import kept
from skysweep.sensing.statistical.model import KindModel, StatisticalModel, model_for, score_of
from skysweep.worlds.occlusion import FLAT, SHAPES, pixels_on_target
from skysweep.worlds.world import surfaces_of

_DISTANCES = 60  # from the track to the picture's edge
_PASSES = 1000


def sweep_width_m(scenario: Scenario) -> float:
    """Effective sweep width, metres, for the target of the scenario that is hardest to see.

    Raises UserError where the shipped sensor model is not for this camera and detector, the camera is tilted,
    or the detector finds nothing from the scan altitude.
    """
    refuse_tilted(scenario, "the sweep width")
    width_m = sweep_width_from(scenario, scenario.search.scan_altitude_agl_m)
    if width_m <= 0.0:
        raise UserError(
            f"search.scan_altitude_agl_m: from {scenario.search.scan_altitude_agl_m:g} m the detector finds "
            "nothing; write a lower altitude, or the sweep width"
        )
    return width_m


def sweep_width_from(scenario: Scenario, height_m: float) -> float:
    """The same from another height above ground; 0 where the target is smaller than any that was measured.

    Raises UserError where the sensor model is not for this camera and detector.
    """
    surfaces = surfaces_of(scenario)
    return min(
        _width_m(scenario, kind, low, height_m, surfaces)
        for name, (low, _) in scenario.target_sizes_m.items()
        for kind in model_for(scenario).searched(name, scenario.target_poses[name])
    )


def refuse_tilted(scenario: Scenario, what: str) -> None:
    """Raise UserError where the camera does not look straight down, for which ``what`` is computed."""
    if not scenario.camera.gimbal.looks_down:
        raise UserError(
            f"camera.gimbal.pitch_deg: is {scenario.camera.gimbal.pitch_deg:g}; {what} is computed for a "
            "camera that looks straight down, -90"
        )


def _width_m(
    scenario: Scenario, kind: KindModel, size_m: float, height_m: float, surfaces: Mapping[str, float]
) -> float:
    across_m = scenario.camera.lens.footprint_m(height_m)[0]
    aside_m = across_m / 2.0 * (np.arange(_DISTANCES) + 0.5) / _DISTANCES
    return float(across_m * np.mean(lateral_range(scenario, kind, size_m, height_m, aside_m, surfaces)))


def lateral_range(
    scenario: Scenario,
    kind: KindModel,
    size_m: float,
    height_m: float,
    aside_m: F64,
    surfaces: Mapping[str, float],
) -> F64:
    """Chance (N,) that a straight pass at distances (N,) reports a target of this kind at least once.

    ``surfaces`` are what covers the ground, with their shares: each pass's target lies on one of them. By
    Monte Carlo: of each pass's luck one part is the target's own, one its aspect's, which fades as it turns,
    one is each look's. So do lapses.
    """
    search, camera, model = scenario.search, scenario.camera, model_for(scenario)
    lens = camera.lens
    whole = model.view_of(camera, scenario.detector, scenario.smallest_size_m)
    view = whole.at(height_m)
    step_m = search.scan_speed_mps / min(scenario.detector.rate_hz, camera.rate_hz)
    along_m = lens.footprint_m(height_m)[1]
    looks = int(np.ceil(along_m / step_m))
    rng, of_lapses = np.random.default_rng(0), np.random.default_rng(1)
    beside = aside_m**2
    first_m = step_m * rng.random(_PASSES) - along_m / 2.0
    own, fading = rng.normal(size=(2, _PASSES, len(aside_m)))
    threshold, grid = float(score_of(scenario.detector.confidence_min)), np.log(model.pixels)
    rest = math.sqrt(max(1.0 - kind.object_share - kind.aspect_share, 0.0))
    away_m = np.linspace(0.0, math.hypot(*lens.footprint_m(height_m)), _DISTANCES)
    shape = SHAPES.get(kind.pose, FLAT)
    pixels_at = [pixels_on_target(view.focal_px, shape, size_m, x, 0.0, -height_m, height_m) for x in away_m]
    own_draw, aspect_draw = of_lapses.random((2, *own.shape))
    of_ground = _scores_of_ground(kind, model, surfaces, own.shape) + kind.lens * model.lens_octaves(whole)
    last_sight, last_at = np.zeros((3, *own.shape)), np.zeros(own.shape)
    reported = np.zeros(own.shape, dtype=np.bool_)
    for look in range(looks):
        along = (first_m + look * step_m)[:, None]
        square = beside + along**2
        pixels = np.interp(np.sqrt(square), away_m, pixels_at)
        blur_px = camera.exposure_s * search.scan_speed_mps * view.focal_px / height_m
        at = np.log(pixels)
        sight = np.stack(np.broadcast_arrays(aside_m, along, height_m)) / np.sqrt(height_m**2 + square)
        if look:
            turned_rad = np.linalg.norm(sight - last_sight, axis=0)
            left = kept(turned_rad, at - last_at, kind.fade_rad, model.fade_scale)
            fading = left * fading + np.sqrt(1.0 - left**2) * rng.normal(size=own.shape)
            stays, anew = of_lapses.random((2, *own.shape))
            aspect_draw = np.where(stays < left, aspect_draw, anew)
        last_sight, last_at = sight, at
        mean = np.interp(at, grid, kind.score) + of_ground
        mean += kind.view * np.minimum(square / (height_m**2 + square), VIEW_MAX)
        mean += kind.blur * np.minimum(blur_px / pixels, BLUR_MAX)
        luck = math.sqrt(kind.object_share) * own + math.sqrt(kind.aspect_share) * fading
        luck += rest * rng.normal(size=own.shape)
        seen = mean + np.interp(at, grid, kind.spread) * luck >= threshold
        lapsed = np.zeros(own.shape, dtype=np.bool_)
        draws = own_draw, aspect_draw, rng.random(own.shape)
        for draw, lapse in zip(draws, kind.lapses(is_among=False), strict=True):
            lapsed |= draw < np.interp(at, grid, lapse)
        large = pixels >= TOO_SMALL * model.pixels[0]
        reported |= large & seen & ~lapsed & (along <= along_m / 2.0)
    return np.asarray(reported.mean(axis=0))


def _scores_of_ground(
    kind: KindModel, model: StatisticalModel, surfaces: Mapping[str, float], shape: tuple[int, ...]
) -> F64:
    """What the ground below each pass's target adds to its score, and the target's colour against it."""
    rng, names = np.random.default_rng(2), list(surfaces)
    on = rng.choice(len(names), shape, p=list(surfaces.values()))
    of_surface = np.array([kind.grounds.get(name, 0.0) for name in names])
    mean, std = np.array([model.contrast(kind.kind, kind.pose, name) for name in names]).T
    contrast = (mean[on] + std[on] * rng.normal(size=shape) - CONTRAST_USUAL) / CONTRAST_UNIT
    return np.asarray(of_surface[on] + kind.contrast * np.clip(contrast, *CONTRAST_LIMITS))
