"""The fence where nobody drew one."""

import numpy as np
import pytest
import shapely

from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.surroundings import fence_words, surroundings
from skysweep.scenarios.files import list_scenarios, load_scenario


@pytest.mark.parametrize("name", list_scenarios())
def test_area_path_and_home_are_inside_by_the_margin(name):
    scenario = load_scenario(name)
    path = plan_scenario(scenario)[0].waypoints_xy_enu_m
    fence = surroundings(scenario, path)
    home = shapely.Point(scenario.home.position_enu_m)
    everything = shapely.union_all([scenario.area_enu_m, home, shapely.MultiPoint(path)])
    assert fence.boundary.distance(everything) == pytest.approx(30.0, abs=0.2)
    assert fence.covers(everything)


def test_of_what_is_flown_round_only_what_reaches_in_is_taken_in():
    scenario = load_scenario("clusters")
    east = scenario.area_enu_m.bounds[2]
    near = shapely.box(east + 20.0, 0.0, east + 100.0, 10.0)
    behind = shapely.box(east + 120.0, 0.0, east + 130.0, 10.0)  # reached once the first is taken in
    far = shapely.box(east + 1000.0, 0.0, east + 1010.0, 10.0)
    fence = surroundings(scenario, np.zeros((0, 2)), [near, far, behind])
    assert fence.covers(near)
    assert fence.covers(behind)
    assert not fence.intersects(far)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "30 m around area, path, home and take-off (safety.fence_margin_m)"),
        ({"safety": {"fence_margin_m": None}}, "none"),
        ({"geofence_enu_m": [[-900, -900], [900, -900], [900, 900], [-900, 900]]}, "as drawn"),
    ],
)
def test_a_person_is_told_which_fence_there_is(changes, words):
    scenario = load_scenario("clusters")
    data = scenario.model_dump(by_alias=True) | changes
    assert fence_words(type(scenario).model_validate(data)).startswith(words)
