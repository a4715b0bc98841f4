"""Coverage of hilly ground: every cell of the area is seen, at heights and speeds that the vehicle can fly.

The transects are those of flat ground along the heading that takes least time over these hills. They are
flown higher where ground beside them rises out of the picture or hides more (``following.py``). A band in
which that takes them much higher, so that fewer pixels are left, is flown by two.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import shapely
from numpy.typing import NDArray

from skysweep.geometry.areas import heading_axes
from skysweep.planning.coverage import CoveragePlan, Rows, cost_m, footprints, plan_rows, plans_tried, rows_of
from skysweep.planning.following import HIGHER, LegProfile, profiles_of
from skysweep.planning.proof import prove
from skysweep.scenarios.model import ALTITUDE_TOLERANCE_M, Scenario
from skysweep.worlds.world import TerrainSurface

_MOST_HIGHER = 0.1  # of a transect
_HALVED_TIMES = 2  # at most
_ROUNDS = 6  # where it flies slower for the sake of one cell, it is lower elsewhere and may miss others
_EPS_M = 1e-6


def plan_over_hills(scenario: Scenario, altitude_agl_m: float, terrain: TerrainSurface) -> CoveragePlan:
    """Transects over the scenario's area and their profiles. Raises UserError as ``plan_coverage`` does."""
    area, lens, search = scenario.area_enu_m, scenario.camera.lens, scenario.search
    start = np.array(scenario.home.position_enu_m, dtype=float)
    width, height = lens.footprint_m(altitude_agl_m)
    scan_mps = search.scan_speed_mps

    def cost(plan: CoveragePlan) -> float:
        follows = profiles_of(plan.transects, plan.heading_deg, scenario, altitude_agl_m, terrain)
        return cost_m(plan, start) + scan_mps * sum(p.lost_s(scan_mps) for p in follows)

    tried = plans_tried(area, lens, altitude_agl_m, search.sidelap, search.transect_heading_deg, start)
    plan = with_profiles(min(tried, key=cost), scenario, altitude_agl_m, terrain)
    rows = rows_of(area, plan.heading_deg, width, search.sidelap)
    for _ in range(_HALVED_TIMES):
        crowded = _crowded(plan, rows, scenario, altitude_agl_m, terrain)
        if not crowded.any():
            break
        rows = rows.halved(crowded)
        plan = plan_rows(area, plan.heading_deg, rows, width, height, start)
        plan = with_profiles(plan, scenario, altitude_agl_m, terrain)
    return plan


def with_profiles(
    plan: CoveragePlan, scenario: Scenario, altitude_agl_m: float, terrain: TerrainSurface
) -> CoveragePlan:
    """The plan with the profiles of its transects; without any where constant height and speed will do.

    They are no higher than it takes to see, from some transect, every cell that is seen over flat ground.
    """
    follows = partial(profiles_of, plan.transects, plan.heading_deg, scenario, altitude_agl_m, terrain)
    profiles = follows()
    proof = prove(replace(plan, profiles=profiles), scenario, terrain)
    on_flat_ground = footprints(plan, scenario.camera.lens, altitude_agl_m).buffer(_EPS_M)
    shapely.prepare(on_flat_ground)
    wanted = shapely.contains_xy(on_flat_ground, proof.cells.centres_enu_m[:, :2])
    to_see = np.zeros(len(wanted), dtype=bool)
    for _ in range(_ROUNDS):
        missed = wanted & ~proof.seen
        if not missed.any():
            break
        to_see |= missed
        profiles = follows(proof.cells.only(to_see))
        proof = prove(replace(plan, profiles=profiles), scenario, terrain)
    if not to_see.any() and all(_is_plain(p, altitude_agl_m) for p in profiles):
        return plan
    return replace(plan, profiles=profiles)


def _is_plain(profile: LegProfile, altitude_agl_m: float) -> bool:
    highest_m = profile.ground_m + altitude_agl_m + ALTITUDE_TOLERANCE_M
    return bool((profile.height_m <= highest_m).all() and np.ptp(profile.speed_mps) == 0.0)


def _crowded(
    plan: CoveragePlan, rows: Rows, scenario: Scenario, altitude_agl_m: float, terrain: TerrainSurface
) -> NDArray[np.bool_]:
    """Which bands (R,) are flown much higher, for what has to be seen, along more than a short way."""
    if not plan.profiles:
        return np.zeros(len(rows.centres_m), dtype=bool)
    along = profiles_of(plan.transects, plan.heading_deg, scenario, altitude_agl_m, terrain)
    higher = [
        np.mean((p.height_m > p.ground_m + HIGHER * altitude_agl_m) & (p.height_m > q.height_m + _EPS_M))
        for p, q in zip(plan.profiles, along, strict=True)
    ]
    y = np.array(plan.transects).mean(axis=1) @ heading_axes(plan.heading_deg)[1]
    row = np.abs(rows.centres_m[None] - y[:, None]).argmin(axis=1)
    crowded = np.zeros(len(rows.centres_m), dtype=bool)
    crowded[row[np.array(higher) > _MOST_HIGHER]] = True
    return crowded
