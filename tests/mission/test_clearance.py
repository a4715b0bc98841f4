"""Over and round what is known to stand there; looking at it from beside. Alone, and in whole missions."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from skysweep.flights.build import build_mission
from skysweep.flights.fly import fly_in_memory
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import CameraPose, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.mission.clearance import Clearance, keep_m, too_high
from skysweep.mission.fence import Fence
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.results.metrics import compute_summary
from skysweep.results.run_folder import Run
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.types import Waypoint
from skysweep.worlds.obstacles import known_obstacles

BASE = {
    "name": "wood",
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
    "home": {"position_enu_m": [-5, -5]},
    "camera": {"hfov_rad": 1.2},
    "trees": [{"position_enu_m": [30, 20], "height_m": 12, "crown_radius_m": 3}],
}
HEIGHT_M = 5.0


def wood(**changes):
    return Scenario.model_validate(BASE | changes)


def clearance(scenario, yaw_rad=0.0):
    known = known_obstacles(scenario)
    return Clearance(scenario, known, Fence(scenario), yaw_rad)


def to_look(x, y):
    return Waypoint((x, y), HEIGHT_M, 1.0, to_look=True)


def over(clear, here, *way, speed_mps=2.0):
    return clear.over(np.array(here, dtype=float), way, 0.0, Waypoint(way[-1], HEIGHT_M, speed_mps))


@settings(max_examples=60)
@given(
    seed=st.integers(0, 50),
    place=st.tuples(st.floats(2, 58), st.floats(2, 38)),
    keeps_m=st.floats(0, 10),
    noise_m=st.floats(0, 2),
    altitude_m=st.floats(2, 12),
    east_m=st.floats(-0.4, 0.4),
)
def test_a_lookout_on_a_hillside_is_where_the_ground_lets_it_come(
    seed, place, keeps_m, noise_m, altitude_m, east_m
):
    """Arrived there, and off by little in any direction, nothing raises the vehicle any more."""
    steep = wood(
        trees=[],
        terrain={"hills_height_m": 60, "hills_wavelength_m": 120, "seed": seed},
        safety={"clearance_m": keeps_m},
        vehicle={"position_noise_m": noise_m},
    )
    clear, ground_m = clearance(steep), known_obstacles(steep).terrain.height_at_m(*place)
    lookout = clear.lookout(Waypoint(place, altitude_m, 1.0, to_look=True))
    assert lookout.altitude_agl_m >= altitude_m
    here = np.array([place[0] + east_m, place[1] - east_m, ground_m + lookout.altitude_agl_m])
    *_, height_m = clear.over(here, [place], ground_m, lookout)
    assert height_m <= ground_m + lookout.altitude_agl_m + 1e-9


def test_checks_on_a_hillside_end():
    """A GNSS error of 1 m once let a vehicle hover above a slope until its battery was low."""
    steep = wood(
        area={"polygon_enu_m": [[0, 0], [120, 0], [120, 80], [0, 80]]},
        trees=[],
        terrain={"hills_height_m": 60, "hills_wavelength_m": 120, "seed": 1},
        targets=[
            {"class": "person", "position_enu_m": [20, 15]},
            {"class": "person", "position_enu_m": [45, 30]},
        ],
        vehicle={"position_noise_m": 1},
        search={"n_c": 1, "check_altitude_agl_m": 6},
    )
    summary = fly_in_memory(steep, 0)
    assert summary["end_reason"] == "completed"
    assert summary["collisions"] == 0
    assert summary["n_checked"] > 0


def test_what_is_kept_clear_of_grows_with_the_error_of_the_position():
    assert keep_m(wood(vehicle={"position_noise_m": 0.0})) == 2.0
    assert keep_m(wood(vehicle={"position_noise_m": 1.0}, safety={"clearance_m": 4})) == 7.0


def test_where_nothing_is_in_the_way_it_is_flown_to_straight():
    assert over(clearance(wood()), (0, 0, 5), (60.0, 0.0)) == (60.0, 0.0, HEIGHT_M)
    assert over(clearance(wood(trees=[])), (0, 20, 5), (60.0, 20.0)) == (60.0, 20.0, HEIGHT_M)
    assert over(clearance(wood()), (0, 20, 30), (10.0, 20.0)) == (10.0, 20.0, HEIGHT_M)


def test_before_a_tree_it_climbs_and_behind_it_it_comes_down():
    clear = clearance(wood())
    heights = [over(clear, (x, 20, 20), (60.0, 20.0))[2] for x in (0, 10, 20, 25, 30, 35, 37, 45)]
    assert heights[0] == HEIGHT_M
    assert heights == [*sorted(heights[:5]), *sorted(heights[5:], reverse=True)]
    assert heights[4] == pytest.approx(12.0 + keep_m(wood()) + 0.5)
    assert heights[6:] == [HEIGHT_M, HEIGHT_M]


@pytest.mark.parametrize("x", [0, 8, 13, 20, 25])
def test_what_stands_behind_the_first_place_of_a_way_is_climbed_for_in_time(x):
    clear = clearance(wood())
    on_the_way, height_m = (x + 4.0, 20.0), over(clear, (x, 20, 20), (60.0, 20.0))[2]
    assert over(clear, (x, 20, 20), on_the_way, (60.0, 20.0)) == (*on_the_way, pytest.approx(height_m))


def test_too_low_before_a_tree_it_waits_and_climbs_straight_up_until_it_is_high_enough():
    clear = clearance(wood())
    assert over(clear, (22, 20, 6), (60.0, 20.0))[:2] == (22.0, 20.0)
    assert over(clear, (22.4, 20.1, 9), (60.0, 20.0))[:2] == (22.0, 20.0), "where it began to wait"
    assert over(clear, (22.4, 20.1, 15), (60.0, 20.0))[:2] == (60.0, 20.0)
    assert over(clear, (38.0, 20.0, 6), (0.0, 20.0))[:2] == (38.0, 20.0), "not where it waited before"


def test_given_back_elsewhere_it_climbs_there():
    """It flew low to where it had waited, through what stood between."""
    clear = clearance(wood())
    assert over(clear, (22, 20, 6), (60.0, 20.0))[:2] == (22.0, 20.0)
    assert over(clear, (38, 20, 6), (0.0, 20.0))[:2] == (38.0, 20.0)
    assert over(clear, (37, 20, 6), (0.0, 20.0))[:2] == (38.0, 20.0)
    clear.start_over()
    assert over(clear, (37, 20, 6), (0.0, 20.0))[:2] == (37.0, 20.0)


def test_a_place_in_the_open_is_looked_at_from_above():
    place = to_look(10.0, 10.0)
    assert clearance(wood()).lookout(place) is place
    assert clearance(wood(trees=[])).lookout(to_look(30.0, 20.0)) == to_look(30.0, 20.0)


@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, math.pi / 2])
@pytest.mark.parametrize("place", [(33.5, 20.0), (34.5, 22.0), (30.0, 24.5), (27.0, 17.5)])
def test_a_place_beside_a_crown_is_looked_at_from_where_it_is_seen_and_the_vehicle_is_clear(place, yaw_rad):
    scenario = wood()
    known, keep = known_obstacles(scenario), keep_m(scenario)
    lookout = clearance(scenario, yaw_rad).lookout(to_look(*place))
    assert lookout.xy_enu_m != place
    eye = np.array([*lookout.xy_enu_m, lookout.altitude_agl_m])
    assert known.clearances_m(eye[None], np.zeros(1, dtype=bool))[0] > keep
    assert not known.hide(np.array([*place, 0.0]), eye)
    pose = CameraPose(eye, rotation_camera_to_enu(yaw_rad, -math.pi / 2))
    pixel, _ = project(scenario.camera.lens, pose, [[*place, 0.0]])
    assert (pixel > 30).all()
    assert (pixel < np.array([scenario.camera.width_px, scenario.camera.height_px]) - 30).all()


def test_the_lookout_is_the_lowest_and_there_the_nearest():
    lookout = clearance(wood()).lookout(to_look(35.8, 20.0))
    assert lookout.altitude_agl_m == HEIGHT_M
    needed_m = 33.0 + keep_m(wood()) + 0.5 - 35.8
    assert needed_m <= math.dist(lookout.xy_enu_m, (35.8, 20.0)) < 3.0 * needed_m
    assert clearance(wood()).lookout(to_look(34.0, 20.0)).altitude_agl_m > HEIGHT_M


def test_a_place_that_moves_a_little_keeps_its_lookout():
    clear = clearance(wood())
    first = clear.lookout(to_look(34.5, 20.0))
    assert clear.lookout(to_look(34.7, 20.3)) is first
    assert clear.lookout(to_look(34.5, 23.0)) is not first


def test_below_the_middle_of_a_wide_crown_nothing_is_seen():
    wide = [{"position_enu_m": [30, 20], "height_m": 12, "crown_radius_m": 14}]
    assert clearance(wood(trees=wide)).lookout(to_look(30.0, 20.0)) is None


def test_lookouts_are_inside_the_fence():
    place, east = to_look(35.8, 20.0), [[36, 0], [60, 0], [60, 40], [36, 40]]
    fence = Fence(wood(safety={"no_fly_enu_m": [east]}))
    assert not fence.allows(clearance(wood()).lookout(place).xy_enu_m)
    fenced = clearance(wood(safety={"no_fly_enu_m": [east]})).lookout(place)
    assert fence.allows(fenced.xy_enu_m)


def test_what_is_higher_than_the_ceiling_is_flown_round():
    tower = [{"position_enu_m": [30, 20], "size_m": [6, 6], "height_m": 60}]
    scenario = wood(buildings=tower, trees=[], safety={"altitude_max_agl_m": 50})
    outlines = too_high(scenario, known_obstacles(scenario))
    assert too_high(wood(buildings=tower), known_obstacles(wood(buildings=tower))) == []
    way = Fence(scenario, outlines).way((0.0, 20.0), (60.0, 20.0))
    leg = shapely.LineString([(0.0, 20.0), *way])
    assert len(way) > 1
    assert shapely.box(27, 17, 33, 23).distance(leg) > 2.0


# ---- in whole missions -------------------------------------------------------------------------------


def flown(scenario, seed=0):
    journal = MemoryJournal()
    reason = fly(build_mission(scenario, seed, Rig("statistical")), journal)
    run = Run(scenario, tuple(journal.lines))
    return reason, run, compute_summary(run)


@pytest.mark.parametrize(("name", "seed"), [("buildings", 0), ("buildings", 1), ("person-wilderness", 2)])
def test_shipped_scenarios_with_obstacles_are_flown_clear_of_them(name, seed):
    scenario = load_scenario(name)
    reason, _, summary = flown(scenario, seed)
    assert reason in ("completed", "return energy")
    assert summary["collisions"] == 0
    assert summary["min_clearance_m"] > scenario.safety.clearance_m - 0.3
    assert summary["recall"] > 0.6  # the sensor may miss two whatever is flown


def test_the_simulator_notices_what_a_mission_runs_into_that_does_not_look_out(monkeypatch):
    monkeypatch.setattr(Clearance, "lookout", lambda self, waypoint: waypoint)
    monkeypatch.setattr(
        Clearance,
        "over",
        lambda self, here, way, ground_m, waypoint: (*way[0], ground_m + waypoint.altitude_agl_m),
    )
    _, run, summary = flown(load_scenario("buildings"))
    assert summary["collisions"] >= 4
    assert summary["min_clearance_m"] == 0.0
    (seen,) = run.events("clearance")
    assert seen["collisions"] == summary["collisions"]


WOODLAND = {
    "trees": [
        {"position_enu_m": [x, y], "height_m": 9, "crown_radius_m": 1.5}
        for x in (12, 30, 48)
        for y in (10, 30)
    ]
}


@pytest.mark.parametrize("strategy", ["low-only", "scan-check"])
def test_a_search_below_the_tree_tops_flies_over_them(strategy):
    scenario = wood(
        **WOODLAND,
        targets=[{"class": "stop sign", "position_enu_m": [21, 18], "size_m": 0.9}],
        search={"strategy": strategy, "n_c": 1, "scan_altitude_agl_m": 8, "check_altitude_agl_m": 4},
    )
    reason, run, summary = flown(scenario)
    assert reason == "completed"
    assert (summary["collisions"], summary["n_confirmed"]) == (0, 1)
    assert summary["min_clearance_m"] > 1.7
    assert run.states.position_enu_m[:, 2].max() > 11.0


def test_a_cliff_is_climbed_in_time():
    rows = [[0.0] * 12 + [30.0] * 11] * 23
    scenario = wood(trees=[], terrain={"heightmap_m": rows}, search={"scan_altitude_agl_m": 8})
    reason, _, summary = flown(scenario)
    assert reason == "completed"
    assert summary["collisions"] == 0
    assert summary["min_clearance_m"] > 1.7


def test_a_candidate_under_trees_is_reported_with_the_reason():
    grove = [
        {"position_enu_m": [45 + dx, 12 + dy], "height_m": 14, "crown_radius_m": 4}
        for dx in (-6, 0, 6)
        for dy in (-6, 0, 6)
    ]
    sign = {"class": "stop sign", "position_enu_m": [45, 12], "size_m": 0.9}
    scenario = wood(trees=[], targets=[sign], search={"n_c": 1})
    mission = build_mission(scenario, 0, Rig("statistical"))
    mission = replace(mission, obstacles=known_obstacles(wood(trees=grove)))
    journal = MemoryJournal()
    assert fly(mission, journal) == "completed"
    told = [
        (line["kind"], line.get("reason"))
        for line in journal.lines
        if line["kind"] in ("confirmed", "unchecked")
    ]
    assert told == [("unchecked", "no clear view")]
    (refused,) = [line["sentence"] for line in journal.lines if line["kind"] == "safety"]
    assert "no place clear of trees and buildings has it in view" in refused


ISLET = {
    "area": {
        "polygon_enu_m": [[0, 0], [90, 0], [90, 60], [0, 60]],
        "holes_enu_m": [[[35, 20], [55, 20], [55, 40], [35, 40]]],
    },
    "trees": [],
    "targets": [
        {"class": "stop sign", "position_enu_m": [45, 30], "size_m": 0.9},
        {"class": "stop sign", "position_enu_m": [15, 30], "size_m": 0.9},
    ],
    "search": {"n_c": 1, "scan_altitude_agl_m": 20},
}


@pytest.mark.parametrize("strategy", ["scan-check", "scan-only"])
def test_a_candidate_in_a_hole_is_reported_and_not_come_down_to(strategy):
    _, run, _ = flown(wood(**ISLET | {"search": ISLET["search"] | {"strategy": strategy}}))
    verdicts = {
        (round(r["p"][0], -1), r["kind"], r.get("reason"))
        for r in run.events("confirmed", "rejected", "unchecked")
    }
    assert (40.0, "unchecked", "outside the area") in {
        (40.0 if 35 < x < 55 else x, k, why) for x, k, why in verdicts
    }
    assert all(not 35 < r["p"][0] < 55 for r in run.events("confirmed", "rejected"))
    hole = shapely.box(37, 22, 53, 38)
    low = run.states.position_enu_m[(run.states.position_enu_m[:, 2] < 15.0)]
    assert not shapely.intersects_xy(hole, low[:, :2]).any()


def test_a_candidate_in_a_hole_is_checked_where_that_is_asked_for():
    _, run, summary = flown(wood(**ISLET, safety={"check_outside_area": True}))
    assert summary["n_confirmed"] == 2
    assert run.events("unchecked") == ()
