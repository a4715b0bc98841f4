"""A QGroundControl plan as a mission of its own, and a mission's plan as a vehicle keeps it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely

from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.area_files import Ring, enu_of, fence_of, scenario_from_area, scenario_over
from skysweep.planning.coverage import CoveragePlan
from skysweep.planning.qgc import QgcPlan, plan_for_qgc, read_plan, survey_polygons
from skysweep.scenarios.files import change_scenario
from skysweep.scenarios.model import Home, Scenario

_SLACK_M = 1.0  # between the heights of a plan's waypoints
_BESIDE_PATH_M = 5.0  # of a plan that draws no area: the surroundings of its path are it


def scenario_from_plan(path: str | Path) -> Scenario:
    """A scenario that flies the plan as drawn, at its height, inside its fence, from where it has home.

    What a plan does not say, such as camera and targets, is the default. Raises UserError where the plan has
    no path, no height or several, or a fence that leaves out home or the path.
    """
    plan = read_plan(path)
    latitude, longitude, altitude_amsl_m = plan.mission.plannedHomePosition
    frame = LocalFrame(latitude, longitude, altitude_amsl_m)
    if survey_polygons(plan):
        drawn = scenario_from_area(path)
    else:
        home = Home(latitude_deg=latitude, longitude_deg=longitude, altitude_amsl_m=altitude_amsl_m)
        drawn = scenario_over(path, home, _around(path, plan, frame), **fence_of(path, plan, frame))
    return change_scenario(
        drawn,
        {
            "search.plan": str(path),
            "search.scan_altitude_agl_m": _height_m(path, plan),
        },
    )


def plan_of_mission(scenario: Scenario, coverage: CoveragePlan) -> QgcPlan:
    """What a vehicle should keep of a mission: fence with no-fly areas, rally points, survey.

    Fence and rally points are those of ``search.plan`` where it has some.
    """
    plan = plan_for_qgc(scenario, coverage)
    drawn = read_plan(scenario.search.plan) if scenario.search.plan is not None else None
    has_fence = drawn is not None and (drawn.geoFence.polygons or drawn.geoFence.circles)
    fence = drawn.geoFence if drawn is not None and has_fence else plan.geoFence
    rally = plan.rallyPoints if drawn is None else drawn.rallyPoints
    return plan.model_copy(update={"geoFence": fence, "rallyPoints": rally})


def _height_m(path: str | Path, plan: QgcPlan) -> float:
    """Above home, of every waypoint."""
    sea_level_m = plan.mission.plannedHomePosition[2]
    points = plan.waypoints
    heights = [p.altitude_m - (sea_level_m if p.above == "sea level" else 0.0) for p in points]
    if len(heights) < 2:
        raise UserError(f"{path}: mission.items: there is no path to fly; draw a Survey or 2 waypoints")
    low, high = min(heights), max(heights)
    if not low > 0.0:
        raise UserError(f"{path}: a waypoint has no altitude above home; write one for every waypoint")
    if high - low > _SLACK_M:
        raise UserError(
            f"{path}: its waypoints are {low:g} to {high:g} m above home; write one height for all of them"
        )
    return round(float(np.median(heights)), 2)


def _around(path: str | Path, plan: QgcPlan, frame: LocalFrame) -> Ring:
    corners = enu_of([(p.latitude_deg, p.longitude_deg) for p in plan.waypoints], frame)
    if len(corners) < 2:
        raise UserError(f"{path}: mission.items: there is no path to fly; draw a Survey or 2 waypoints")
    around = shapely.MultiPoint(corners).convex_hull.buffer(_BESIDE_PATH_M, join_style="mitre")
    return [(float(x), float(y)) for x, y in shapely.get_coordinates(around)[:-1]]
