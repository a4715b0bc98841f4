"""Where a mission stays when nobody drew a geofence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from skysweep.scenarios.model import Scenario


def surroundings(
    scenario: Scenario, path_xy_enu_m: NDArray[np.float64], flown_round: Sequence[shapely.Polygon] = ()
) -> shapely.Polygon | None:
    """The convex hull of area, path (N, 2) and home, wider by ``safety.fence_margin_m``.

    None where that is null. What is ``flown_round`` and reaches into it is taken in whole: there has to be
    room for the way round.
    """
    margin_m = scenario.safety.fence_margin_m
    if margin_m is None:
        return None
    places = shapely.multipoints([*path_xy_enu_m.tolist(), scenario.home.position_enu_m])
    within = shapely.union_all([scenario.area_enu_m, places])
    beside = np.array(flown_round, dtype=object)
    while True:
        inside = within.convex_hull.buffer(margin_m)
        reaching = shapely.intersects(inside, beside)
        if not reaching.any():
            return inside
        within = shapely.union_all([within, *beside[reaching]])
        beside = beside[~reaching]


def fence_words(scenario: Scenario) -> str:
    """What keeps the vehicle in, as a person is told."""
    if scenario.geofence_enu_m is not None:
        return "as drawn (geofence_enu_m)"
    margin_m = scenario.safety.fence_margin_m
    if margin_m is None:
        return "none"
    return f"{margin_m:g} m around area, path, home and take-off (safety.fence_margin_m)"
