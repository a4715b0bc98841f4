"""Where what drifts at sea may be: Monte Carlo of wind and current.

Each particle drifts by ``scenarios.leeway``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.planning.prior.checks import checked_poa, place, positive
from skysweep.planning.prior.maps import ProbabilityMap
from skysweep.scenarios.leeway import Leeway, leeway_mps

PARTICLES = 20_000
MOST_PARTICLES = 1_000_000


@dataclass(frozen=True)
class Weather:
    """Steps of wind (at 10 m) and surface current, east and north in m/s, and their errors."""

    step_s: float
    wind_mps: F64  # (N, 2) where it blows to
    current_mps: F64  # (N, 2) where it flows to
    wind_std_mps: float  # of each component
    current_std_mps: float


def drifted(
    leeway: Leeway,
    weather: Weather,
    start_xy_m: ArrayLike,
    start_std_m: float,
    rng: np.random.Generator,
    particles: int = PARTICLES,
) -> F64:
    """Where particles (P, 2) are after the last step, ENU metres.

    Each starts about ``start_xy_m`` (2,) with a standard deviation along each axis, and keeps its own error
    of wind and current. Raises UserError where a field cannot be drifted with.
    """
    wind, current = _steps(weather.wind_mps, "wind_mps"), _steps(weather.current_mps, "current_mps")
    if wind.shape != current.shape:
        raise UserError("current_mps: write as many steps as of wind_mps")
    if not 1 <= particles <= MOST_PARTICLES:
        raise UserError(f"particles: write from 1 to {MOST_PARTICLES:,}")
    step_s = positive(weather.step_s, "step_s", "seconds")
    for value, field in (
        (start_std_m, "start_std_m"),
        (weather.wind_std_mps, "wind_std_mps"),
        (weather.current_std_mps, "current_std_mps"),
    ):
        if not (np.isfinite(value) and value >= 0.0):
            raise UserError(f"{field}: is {value:g}; write a standard deviation from 0 on")
    xy = place(start_xy_m, "start_xy_m") + start_std_m * rng.normal(size=(particles, 2))
    wind_error = weather.wind_std_mps * rng.normal(size=(particles, 2))
    current_error = weather.current_std_mps * rng.normal(size=(particles, 2))
    to_right = rng.random(particles) < 0.5
    error = rng.normal(size=(2, particles))
    for wind_now, current_now in zip(wind, current, strict=True):
        leeway_now = leeway_mps(leeway, wind_now + wind_error, to_right, error)
        xy = xy + step_s * (current_now + current_error + leeway_now)
    return xy


def map_of_particles(cells: ProbabilityMap, particles_xy_m: F64, smooth_m: float = 0.0) -> ProbabilityMap:
    """The map of where particles (P, 2) are, on the cells given, smoothed by a standard deviation.

    Raises UserError where none is on the map.
    """
    rows, columns = cells.poa.shape
    west, south, east, north = cells.bounds_m
    x, y = np.asarray(particles_xy_m, dtype=float).T
    counts, _, _ = np.histogram2d(y, x, bins=(rows, columns), range=((south, north), (west, east)))
    if not counts.any():
        raise UserError("cells: no particle drifts onto the map; move it, or make it larger")
    if smooth_m > 0.0:
        counts = ndimage.gaussian_filter(counts, smooth_m / cells.cell_size_m, mode="constant")
    return cells.with_poa(checked_poa(counts, "particles"))


def share_on(cells: ProbabilityMap, particles_xy_m: F64) -> float:
    """How many of the particles (P, 2) are within a map's bounds, as a share."""
    west, south, east, north = cells.bounds_m
    inside = (particles_xy_m >= [west, south]) & (particles_xy_m <= [east, north])
    return float(inside.all(axis=1).mean())


def _steps(values: ArrayLike, field: str) -> F64:
    steps = np.atleast_2d(np.asarray(values, dtype=float))
    if steps.ndim != 2 or steps.shape[1] != 2 or not len(steps) or not np.isfinite(steps).all():
        raise UserError(f"{field}: write east and north in m/s for each step")
    return steps
