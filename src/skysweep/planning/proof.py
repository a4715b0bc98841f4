"""Proof, cell by cell, that a plan's pictures show all of an area, over flat or hilly ground.

A cell is seen if its middle is inside the picture from a station of some transect, at the height that is
flown there, and no ground is in between. Trees and buildings are not counted: they hide from some sides only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.planning.coverage import CoveragePlan
from skysweep.planning.following import profiles_of
from skysweep.planning.sight import (
    GroundCells,
    View,
    foot_point,
    ground_cells,
    least_height,
    strip_of_row,
)
from skysweep.scenarios.model import Scenario
from skysweep.worlds.world import TerrainSurface

_FARTHEST = 1.5  # of half a flat swath: down a slope, pictures reach farther
_STATIONS = 4  # tried before and behind the foot point
_EPS_M = 1e-6


class Proof(NamedTuple):
    """Which cells of the area are seen."""

    cells: GroundCells
    seen: NDArray[np.bool_]  # (N,)

    @property
    def share(self) -> float:
        """Of the area, 0..1."""
        return float(self.seen.mean()) if len(self.seen) else 1.0

    def unseen_places(self) -> list[tuple[shapely.Point, float]]:
        """Middle and area (m2) of each patch that is not seen, the largest first."""
        half_m = 0.5 * self.cells.size_m * (1.0 + 1e-6)
        x, y, _ = self.cells.centres_enu_m[~self.seen].T
        patches = shapely.get_parts(
            shapely.union_all(shapely.box(x - half_m, y - half_m, x + half_m, y + half_m))
        )
        return sorted(
            ((p.representative_point(), float(p.area)) for p in patches), key=lambda found: -found[1]
        )


def prove(plan: CoveragePlan, scenario: Scenario, terrain: TerrainSurface) -> Proof:
    """What the camera sees along the plan's transects."""
    lens = scenario.camera.lens
    cells = ground_cells(scenario.area_enu_m, terrain, plan.swath_m)
    altitude_agl_m = plan.swath_m / lens.footprint_m(1.0)[0]
    profiles = plan.profiles or profiles_of(
        plan.transects, plan.heading_deg, scenario, altitude_agl_m, terrain
    )
    view = View.of(lens, plan.heading_deg)
    seen = np.zeros(len(cells.centres_enu_m), dtype=np.bool_)
    for profile in profiles:
        highest_m = float((profile.height_m - profile.ground_m).max())
        reach_m = _FARTHEST * highest_m * max(view.across, view.along)
        _see(
            seen,
            *cells,
            terrain.heights_m,
            terrain.bounds_enu_m,
            view,
            profile.leg_xy_enu_m,
            profile.height_m,
            reach_m,
            highest_m * view.along,
        )
    return Proof(cells, seen)


@njit(cache=True)
def _see(
    seen: NDArray[np.bool_],
    centres: F64,
    starts: NDArray[np.int64],
    south: float,
    size: float,
    heights: F64,
    bounds: tuple[float, float, float, float],
    view: View,
    leg: F64,
    flown: F64,
    reach: float,
    along: float,
) -> None:
    last, length = len(flown) - 1, math.hypot(leg[1, 0] - leg[0, 0], leg[1, 1] - leg[0, 1])
    low, high = min(leg[0, 1], leg[1, 1]) - reach, max(leg[0, 1], leg[1, 1]) + reach
    first_row = max(math.ceil((low - south) / size), 0)
    last_row = min(math.floor((high - south) / size), len(starts) - 2)
    for row in range(first_row, last_row + 1):
        begin, end = starts[row], starts[row + 1]
        west, east = strip_of_row(leg, south + row * size, reach)
        i = begin + np.searchsorted(centres[begin:end, 0], west)
        while i < end and centres[i, 0] <= east:
            _, _, foot = foot_point(leg, centres[i, 0], centres[i, 1])
            for k in range(2 * _STATIONS + 1):
                if seen[i]:
                    break
                aside = (k + 1) // 2 * (1 if k % 2 else -1) / _STATIONS * along / max(length, 1e-9)
                share = min(max(foot + aside, 0.0), 1.0)
                x, y = (
                    leg[0, 0] + share * (leg[1, 0] - leg[0, 0]),
                    leg[0, 1] + share * (leg[1, 1] - leg[0, 1]),
                )
                at = min(int(share * last), last - 1)
                height = flown[at] + (share * last - at) * (flown[at + 1] - flown[at])
                enough = height + _EPS_M
                seen[i] = least_height(heights, bounds, view, centres[i], x, y, enough) <= enough
            i += 1
