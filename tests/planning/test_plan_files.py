"""A QGroundControl plan that is flown as it is."""

import json

import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.plan_files import plan_of_mission, scenario_from_plan
from skysweep.planning.qgc import plan_for_qgc, write_plan
from skysweep.scenarios.model import Scenario

FIELD = {
    "name": "field",
    "area": {"polygon_enu_m": [[0, 0], [120, 0], [120, 80], [0, 80]]},
    "home": {"position_enu_m": [-5, -5], "latitude_deg": 60.2, "longitude_deg": 22.1},
    "geofence_enu_m": [[-30, -30], [150, -30], [150, 110], [-30, 110]],
    "search": {"scan_altitude_agl_m": 25.0},
}


def drawn(path, **changes):
    """A plan file of the field, with changes to its JSON."""
    field = Scenario.model_validate(FIELD)
    coverage, _ = plan_scenario(field)
    write_plan(path, plan_for_qgc(field, coverage))
    data = json.loads(path.read_text())
    for dotted, value in changes.items():
        *parents, last = dotted.split("__")
        node = data
        for parent in parents:
            node = node[parent]
        node[last] = value
    path.write_text(json.dumps(data))
    return path, coverage


def waypoint(latitude, longitude, altitude):
    params = [0, 0, 0, None, latitude, longitude, altitude]
    return {"type": "SimpleItem", "command": 16, "frame": 3, "params": params, "autoContinue": True}


def test_a_survey_is_flown_as_drawn_inside_its_fence(tmp_path):
    path, coverage = drawn(tmp_path / "field.plan")
    scenario = scenario_from_plan(path)
    assert scenario.search.scan_altitude_agl_m == 25.0
    flown, _ = plan_scenario(scenario)
    offset = np.array(FIELD["home"]["position_enu_m"])
    assert flown.waypoints_xy_enu_m + offset == pytest.approx(coverage.waypoints_xy_enu_m, abs=0.05)
    assert len(scenario.geofence_enu_m) == 4
    kept = plan_of_mission(scenario, flown)
    assert len(kept.geoFence.polygons) == 1


def test_plain_waypoints_make_a_mission_around_their_path(tmp_path):
    items = [waypoint(60.2001 + 0.0002 * i, 22.101 + 0.0004 * (i % 2), 30.0) for i in range(4)]
    path, _ = drawn(tmp_path / "path.plan", mission__items=items, geoFence__polygons=[])
    scenario = scenario_from_plan(path)
    assert scenario.search.scan_altitude_agl_m == 30.0
    assert plan_scenario(scenario)[0].waypoints_xy_enu_m.shape == (4, 2)


@pytest.mark.parametrize(
    ("heights", "sentence"),
    [
        ([30.0, None], "no altitude above home"),
        ([30.0, -5.0], "no altitude above home"),
        ([30.0, 60.0], "30 to 60 m above home; write one height"),
        ([30.0], "no path to fly"),
        ([3.0, 3.0], "check_altitude_agl_m"),
    ],
)
def test_heights_that_cannot_be_flown_are_said(tmp_path, heights, sentence):
    items = [waypoint(60.2001 + 0.0005 * i, 22.101 + 0.0005 * i, h) for i, h in enumerate(heights)]
    path, _ = drawn(tmp_path / "path.plan", mission__items=items, geoFence__polygons=[])
    with pytest.raises(UserError, match=sentence):
        scenario_from_plan(path)


def test_a_fence_that_leaves_out_the_mission_is_said(tmp_path):
    corners = [[60.2, 22.1], [60.2001, 22.1], [60.2001, 22.1002], [60.2, 22.1002]]
    fence = [{"version": 1, "inclusion": True, "polygon": corners}]
    path, _ = drawn(tmp_path / "field.plan", geoFence__polygons=fence)
    with pytest.raises(UserError, match="fence"):
        scenario_from_plan(path)


def test_no_fly_areas_and_rally_points_of_a_plan_are_kept(tmp_path):
    hole = [[60.2003, 22.1005], [60.2004, 22.1005], [60.2004, 22.1007]]
    fence = [{"version": 1, "inclusion": False, "polygon": hole}]
    rally = [[60.2001, 22.1001, 20.0]]
    path, _ = drawn(tmp_path / "field.plan", geoFence__polygons=fence, rallyPoints__points=rally)
    scenario = scenario_from_plan(path)
    assert scenario.geofence_enu_m is None
    assert len(scenario.safety.no_fly_enu_m) == 1
    kept = plan_of_mission(scenario, plan_scenario(scenario)[0])
    assert [p.inclusion for p in kept.geoFence.polygons] == [False]
    assert len(kept.rallyPoints.points) == 1
