"""What terrain says of where a person may be: factors of likelihood for each cell of a map.

A factor is how much more often people are found on such ground than elsewhere; it is the user's or a stated
source's number. Factors of several kinds are multiplied (``ProbabilityMap.times``), as if they were
independent.
"""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import ArrayLike

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.planning.prior.checks import positive
from skysweep.planning.prior.flown import ground_path
from skysweep.planning.prior.maps import ProbabilityMap
from skysweep.scenarios.model import Scenario
from skysweep.text import percent
from skysweep.worlds.world import build_terrain


def slope_deg(heights_m: ArrayLike, cell_size_m: float) -> F64:
    """Steepness (R, C) in degrees of ground whose heights (R, C) are those in the middles of cells."""
    heights = np.asarray(heights_m, dtype=float)
    if heights.ndim != 2 or min(heights.shape) < 2 or not np.isfinite(heights).all():
        raise UserError("heights_m: write finite heights for at least two rows and two columns of cells")
    rise = np.hypot(*np.gradient(heights, positive(cell_size_m, "cell_size_m")))
    return np.asarray(np.degrees(np.arctan(rise)))


def heights_of_scenario(scenario: Scenario, cells: ProbabilityMap) -> F64:
    """Heights (R, C) of a scenario's terrain in the middles of a map's cells, metres.

    Raises UserError where its ground does not reach under the whole map.
    """
    xy = cells.centres_xy_m.reshape(-1, 2)
    geodetic = cells.frame.geodetic_from_enu(np.column_stack([xy, np.zeros(len(xy))]))
    ground, places = build_terrain(scenario), ground_path(geodetic[:, :2], scenario.frame)
    west, south, east, north = ground.bounds_enu_m
    reaches = ((places >= [west, south]) & (places <= [east, north])).all(axis=1)
    if not reaches.all():
        missing = percent(float(1.0 - reaches.mean()))
        raise UserError(
            f"{scenario.name}: its ground has no height for {missing} of the map; give one whose ground "
            "covers all of it, or make the map over that scenario"
        )
    return ground.height_m(places).reshape(cells.poa.shape)


def slope_factors(slopes_deg: F64, upto_deg: ArrayLike, factors: ArrayLike) -> F64:
    """Factors (R, C) by steepness: ``factors`` (N,) in the classes up to ``upto_deg`` (N,), rising.

    Steeper ground than the last class is as that. Raises UserError where classes do not rise or do not match.
    """
    limits, values = np.asarray(upto_deg, dtype=float), _factors(factors)
    if limits.shape != values.shape or not (np.diff(limits) > 0.0).all():
        raise UserError("upto_deg: write rising limits in degrees, one for each factor")
    return values[np.minimum(np.searchsorted(limits, slopes_deg), len(values) - 1)]


def factors_near(cells: ProbabilityMap, features: shapely.Geometry, within_m: float, factor: float) -> F64:
    """``factor`` for cells (R, C) whose middles are near trails or streams (ENU metres), 1 elsewhere."""
    middles = shapely.points(cells.centres_xy_m)
    shapely.prepare(features)
    near = shapely.dwithin(middles, features, positive(within_m, "within_m"))
    return np.where(near, _factors([factor])[0], 1.0)


def factors_within(cells: ProbabilityMap, features: shapely.Geometry, factor: float) -> F64:
    """``factor`` for cells (R, C) whose middles lie in water, forest or fields (ENU metres), 1 elsewhere."""
    x, y = np.moveaxis(cells.centres_xy_m, -1, 0)
    return np.where(shapely.contains_xy(features, x, y), _factors([factor])[0], 1.0)


def _factors(values: ArrayLike) -> F64:
    factors = np.atleast_1d(np.asarray(values, dtype=float))
    if factors.ndim != 1 or not len(factors) or not (np.isfinite(factors) & (factors >= 0.0)).all():
        raise UserError("factor: write finite likelihoods from 0 on")
    return factors
