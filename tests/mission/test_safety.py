"""The rules one by one, on hand-written states."""

import math
from dataclasses import replace

import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.mission.energy import ReturnEnergy
from skysweep.mission.fence import Fence
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.looks import Looks
from skysweep.mission.loop import fly
from skysweep.mission.safety import Action, Guard, Phase
from skysweep.planning.flight_plan import GUSTS, LEG_LAG_S
from skysweep.scenarios.model import Scenario
from skysweep.sensing.exposures import Exposures
from skysweep.types import Command, Setpoint, VehicleState, Waypoint
from skysweep.worlds.obstacles import known_obstacles
from skysweep.worlds.world import TerrainSurface

BASE = {"name": "rules", "area": {"polygon_enu_m": [[0, 0], [200, 0], [200, 200], [0, 200]]}}


def scenario(**changes):
    return Scenario.model_validate(BASE | changes)


def state(t=100.0, x=0.0, y=0.0, z=30.0, v=(0.0, 0.0, 0.0), **changes):
    position = np.array([x, y, z])
    pose = CameraPose(position, rotation_camera_to_enu(0.0, -math.pi / 2))
    plain = VehicleState(t, position, np.array(v), np.eye(3), pose, 0.9, 10.0, True)
    return plain._replace(**changes)


def leaning(by_deg):
    """Body to ENU of a vehicle that leans east."""
    c, s = math.cos(math.radians(by_deg)), math.sin(math.radians(by_deg))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


class Watched:
    """A guard whose detector has answered until ``looked_s``."""

    def __init__(self, looked_s=100.0, begins_in_air=False, **changes):
        s = scenario(**changes | {"safety": {"fence_margin_m": None} | changes.get("safety", {})})
        self.looks, self.fence = Looks(s, Exposures(s.detector.rate_hz, 0.0), 30.0), Fence(s)
        self.looks.begin(looked_s)
        known = known_obstacles(s)
        self.energy = ReturnEnergy(s, self.fence, known.terrain, 30.0, 1.6)
        self.guard = Guard(s, self.fence, self.energy, self.looks, known, begins_in_air)

    def refusal(self, seen, waypoint):
        return self.guard.refusal(seen, 30.0, waypoint, waypoint)

    def __call__(self, seen, agl=30.0, phase=Phase.SEARCH, goal=None):
        return {a.cause: a.action for a in self.guard.alarms(seen, agl, phase, goal)}


def test_nothing_wrong():
    assert Watched()(state()) == {}


@pytest.mark.parametrize(
    ("silent_s", "action"), [(0.9, None), (1.1, Action.HOLD), (59.0, Action.HOLD), (61.0, Action.RETURN)]
)
def test_telemetry_silence(silent_s, action):
    assert Watched()(state(silent_s=silent_s)).get("telemetry silent") is action


@pytest.mark.parametrize(
    ("left", "alarms"),
    [
        (0.16, {}),
        (0.14, {"low battery": Action.RETURN}),
        (0.04, {"battery critical": Action.LAND, "return energy": Action.RETURN}),
    ],
)
def test_battery(left, alarms):
    assert Watched(vehicle={"battery_wh": 300.0})(state(battery_remaining=left)) == alarms


UNKNOWN = math.nan


def over_time(watched, at_s, phase=Phase.SEARCH, **changes):
    """The alarms at each time; the detector answers."""
    said = []
    for t in at_s:
        watched.looks.begin(t)
        said.append(watched(state(t=t, **changes), phase=phase))
    return said


def test_a_battery_that_nobody_knows_is_said_at_once_and_brings_it_home():
    times = (100.0, 101.0, 129.0, 131.0)
    actions = [a.get("battery unknown") for a in over_time(Watched(), times, battery_remaining=UNKNOWN)]
    assert actions == [Action.CONTINUE] * 3 + [Action.RETURN]


def test_a_battery_that_was_never_known_is_flown_by_an_estimate_where_that_is_agreed():
    watched = Watched(safety={"battery_estimated": True}, vehicle={"battery_wh": 10.0})
    first, *_, last = over_time(watched, range(100, 400), battery_remaining=UNKNOWN)
    assert first == {"battery unknown": Action.CONTINUE}
    assert last == {
        "battery unknown": Action.CONTINUE,
        "low battery": Action.RETURN,
        "return energy": Action.RETURN,
    }
    spent_s = 0.85 * 10.0 / 190.0 * 3600.0
    early, late = Watched(safety={"battery_estimated": True}, vehicle={"battery_wh": 10.0}), []
    for t in (0.0, spent_s - 5.0, spent_s + 5.0):
        early.looks.begin(t)
        late.append(early(state(t=t, battery_remaining=UNKNOWN)).get("low battery"))
    assert late == [None, None, Action.RETURN]


def test_what_is_measured_counts_where_it_is_more_than_the_estimate():
    watched = Watched(vehicle={"battery_wh": 100.0})
    over_time(watched, (100.0,), energy_used_wh=10.0)
    (alarms,) = over_time(watched, (101.0,), battery_remaining=UNKNOWN, energy_used_wh=90.0)
    assert "low battery" in alarms


def test_nobody_knows_what_an_estimated_battery_holds_that_is_in_the_air_already():
    watched = Watched(begins_in_air=True, safety={"battery_estimated": True})
    assert over_time(watched, (100.0, 131.0), battery_remaining=UNKNOWN)[-1] == {
        "battery unknown": Action.RETURN
    }


def test_a_battery_that_was_known_once_is_not_flown_by_an_estimate():
    watched = Watched(safety={"battery_estimated": True})
    over_time(watched, (100.0,))
    assert over_time(watched, (101.0, 132.0), battery_remaining=UNKNOWN)[-1] == {
        "battery unknown": Action.RETURN
    }


@pytest.mark.parametrize("field", ["position_std_m", "battery_remaining"])
def test_what_is_no_number_is_no_all_clear(field):
    assert Watched()(state(**{field: math.nan})) != {}


def test_a_wind_that_is_no_number_is_unknown():
    assert Watched()(state(wind_enu_mps=np.array([math.nan, 0.0, 0.0]))) == {}


def sent(x, y, z=30.0, speed=5.0, yaw=0.0):
    return Setpoint(np.array([x, y, z]), speed, yaw)


def test_a_vehicle_that_ignores_where_it_is_sent_is_said_then_called_home():
    watched, actions = Watched(), []
    for t in (0.0, 15.0, 25.0, 60.0, 62.0):
        watched.looks.begin(t)
        actions.append(watched(state(t=t), goal=sent(50, 0)).get("setpoints ignored"))
    assert actions == [None, None, Action.CONTINUE, Action.CONTINUE, Action.RETURN]


@pytest.mark.parametrize("mps", [0.06, 1.0, 5.0])
def test_a_slow_vehicle_is_no_disobedient_one(mps):
    watched = Watched()
    for t in range(300):
        watched.looks.begin(t)
        at = state(t=float(t), x=mps * t, v=(mps, 0.0, 0.0))
        assert watched(at, goal=sent(max(50.0, 2 * mps * t), 0, speed=mps)) == {}


def test_a_vehicle_that_waits_where_it_was_sent_does_what_it_is_told():
    watched = Watched()
    for t in range(300):
        watched.looks.begin(t)
        assert watched(state(t=float(t), x=1.0), goal=sent(0, 0)) == {}


def test_a_nose_that_points_elsewhere_is_said_then_brings_it_home():
    watched, actions = Watched(), []
    for t in (0.0, 5.0, 11.0, 59.0, 61.0):
        watched.looks.begin(t)
        actions.append(watched(state(t=t), goal=sent(0, 0, yaw=0.5)).get("turned away"))
    assert actions == [None, None, Action.CONTINUE, Action.CONTINUE, Action.RETURN]
    assert Watched()(state(), goal=sent(0, 0, yaw=2.0 * math.pi + 0.1)) == {}


@pytest.mark.parametrize(
    ("below_m", "actions"),
    [
        (30.0, [None] * 3),
        (24.0, [None] * 3),
        (20.0, [None, Action.CONTINUE, Action.CONTINUE]),
        (10.0, [None, Action.CONTINUE, Action.RETURN]),
        (45.0, [None, Action.CONTINUE, Action.CONTINUE]),
    ],
)
def test_a_rangefinder_that_does_not_agree_with_the_height(below_m, actions):
    watched = Watched()
    said = [a.get("height") for a in over_time(watched, (0.0, 4.0, 11.0), ground_below_m=below_m)]
    assert said == actions


HALL = {"buildings": [{"position_enu_m": [0, 0], "size_m": [40, 20], "height_m": 5}]}  # 15 m high


@pytest.mark.parametrize(
    ("below_m", "actions"),
    [
        (30.0, [None] * 3),
        (36.0, [None] * 3),
        (39.0, [None, Action.CONTINUE, Action.CONTINUE]),
        (15.0, [None] * 3),
        (12.0, [None] * 3),
        (10.0, [None, Action.CONTINUE, Action.CONTINUE]),
        (7.0, [None, Action.CONTINUE, Action.RETURN]),
    ],
)
def test_a_rangefinder_may_meet_anything_between_a_known_roof_and_the_ground(below_m, actions):
    said = [a.get("height") for a in over_time(Watched(**HALL), (0.0, 4.0, 11.0), ground_below_m=below_m)]
    assert said == actions


@pytest.mark.parametrize(
    ("x", "changes", "action"),
    [
        (22.0, {}, None),  # 1.6 m beside its eaves, and the beam is 3 m wide
        (30.0, {}, Action.CONTINUE),
        (30.0, {"position_std_m": 3.0}, None),
        (30.0, {"R_body_to_enu": leaning(20.0)}, None),  # the beam leans with the vehicle
    ],
)
def test_a_roof_counts_as_far_beside_it_as_position_and_beam_leave_open(x, changes, action):
    said = over_time(Watched(**HALL), (0.0, 4.0), ground_below_m=15.0, x=x, **changes)
    assert said[-1].get("height") is action


@pytest.mark.parametrize(("below_m", "action"), [(18.0, Action.CONTINUE), (21.0, None), (40.0, None)])
def test_over_a_steep_slope_a_rangefinder_may_meet_higher_and_lower_ground(below_m, action):
    slope = scenario(terrain={"heightmap_m": [[0.0, 400.0], [0.0, 400.0]]})
    z = 30.0 + known_obstacles(slope).terrain.height_at_m(100.0, 100.0)
    watched = Watched(terrain=slope.terrain.model_dump())
    said = over_time(watched, (0.0, 4.0), ground_below_m=below_m, x=100.0, y=100.0, z=z)
    assert said[-1].get("height") is action


def test_a_height_that_jumps_holds_until_it_jumps_back():
    watched, actions = Watched(), []
    for t, z in ((0.0, 30.0), (1.0, 50.0), (2.0, 50.0), (3.0, 30.0)):
        watched.looks.begin(t)
        actions.append(watched(state(t=t, z=z), agl=30.0).get("position jump"))
    assert actions == [None, Action.HOLD, Action.HOLD, None]


def test_whoever_led_it_out_of_the_fence_may_give_it_back_there():
    watched = Watched(safety={"fence_margin_m": 30.0})
    watched(state(t=100.0, x=300.0, taken_over="it is in Position"))
    assert watched(state(t=101.0, x=300.0)) == {}
    assert watched(state(t=160.0, x=100.0), phase=Phase.RETURN) == {}
    watched.looks.begin(161.0)
    assert watched(state(t=161.0, x=100.0)) == {}
    assert watched(state(t=222.0, x=300.0)).get("geofence") is Action.RETURN


@pytest.mark.parametrize(("z", "left", "held"), [(30.0, 0.2, True), (30.0, 0.18, False), (3.0, 0.18, True)])
def test_a_landing_is_held_while_the_battery_holds_what_it_takes_to_land(z, left, held):
    """From 30 m that is 1.3 of 10 Wh, and the critical 5 %."""
    watched = Watched(vehicle={"battery_wh": 10.0})
    watched.guard.heed("hold")
    seen = state(z=z, battery_remaining=left)
    ends = {"landing energy": Action.LAND}
    assert watched(seen, agl=z, phase=Phase.LAND) == ({"operator": Action.HOLD} if held else ends)
    assert watched(seen, agl=z, phase=Phase.LAND) == ({"operator": Action.HOLD} if held else {})


def test_a_landing_that_is_not_held_asks_for_no_energy():
    assert Watched()(state(battery_remaining=0.06), phase=Phase.LAND) == {}
    watched = Watched()
    watched.guard.heed("return")
    assert watched(state(battery_remaining=0.06), phase=Phase.LAND) == {}


def test_a_mission_that_goes_on_beyond_the_fence_flies_back_inside():
    watched = Watched(begins_in_air=True, safety={"fence_margin_m": 30.0})
    assert watched(state(t=100.0, x=300.0)) == {}
    assert "geofence" not in watched(state(t=160.0, x=100.0))
    assert watched(state(t=222.0, x=300.0)).get("geofence") is Action.RETURN


@pytest.mark.parametrize(
    ("x", "left", "ends"), [(0.0, 0.16, None), (0.0, 0.14, "low battery"), (2000.0, 0.3, "return energy")]
)
def test_the_battery_ends_a_hold_on_the_way_home(x, left, ends):
    watched = Watched()
    watched.guard.heed("hold")
    seen = state(x=x, battery_remaining=left)
    assert watched(seen, phase=Phase.RETURN) == ({ends: Action.RETURN} if ends else {"operator": Action.HOLD})
    assert watched(seen, phase=Phase.RETURN) == ({} if ends else {"operator": Action.HOLD})


def test_without_a_position_no_battery_sends_a_held_vehicle_anywhere():
    watched = Watched()
    watched.guard.heed("hold")
    seen = state(battery_remaining=0.14, position_std_m=9.0)
    assert max(watched(seen, phase=Phase.RETURN).values()) is Action.HOLD


@pytest.mark.parametrize("phase", [Phase.RETURN, Phase.LAND])
def test_the_estimate_ends_a_hold_on_the_way_home_and_while_landing(phase):
    watched = Watched(safety={"battery_estimated": True}, vehicle={"battery_wh": 19.0})
    watched.guard.heed("hold")
    early, late = over_time(watched, (0.0, 310.0), phase=phase, battery_remaining=UNKNOWN)
    assert early == {"battery unknown": Action.CONTINUE, "operator": Action.HOLD}
    assert late.get("low battery") is Action.RETURN
    assert "operator" not in late


def test_nothing_heard_for_longer_than_a_battery_lasts_is_given_up():
    watched = Watched(vehicle={"battery_wh": 19.0})
    assert watched(state(silent_s=359.0), phase=Phase.LAND) == {}
    assert watched(state(silent_s=361.0), phase=Phase.LAND) == {"vehicle lost": Action.LAND}
    assert watched(state(silent_s=361.0), phase=Phase.RETURN) == {"vehicle lost": Action.LAND}


def test_the_reserve_grows_with_distance_and_head_wind():
    calm, breezy = (0.0, 0.0), (7.0, 0.0)
    energy = Watched().energy
    near, far = energy.home_wh((50, 0), 30.0, calm), energy.home_wh((500, 0), 30.0, calm)
    assert far - near == pytest.approx(450 / 5.0 * 190 * math.hypot(1, 5 / 9.81) ** 1.5 / 3600, rel=1e-6)
    assert energy.home_wh((500, 0), 30.0, breezy) > 1.5 * energy.home_wh((-500, 0), 30.0, breezy)
    assert energy.home_wh((500, 0), 4.0, calm) > far
    assert energy.home_wh((500, 0), 30.0, (12.0, 0.0)) == math.inf


def test_the_way_home_is_reserved_for_a_wind_a_little_stronger_than_it_is_told():
    """Against 7 m/s, a twentieth more takes a seventh more energy: without, one landed short of home."""
    told, stronger = Watched().energy, (7.0 * (1.0 + GUSTS), 0.0)
    landing_wh = told.landing_wh(30.0, stronger)
    way_wh = told.home_wh((500, 0), 30.0, (7.0, 0.0)) - landing_wh
    air_mps = scenario().safety.air_speed_max_mps
    seconds = 500.0 / (air_mps - stronger[0]) + LEG_LAG_S
    assert way_wh == pytest.approx(told.power_w(air_mps) * seconds / 3600.0)
    assert way_wh > 1.1 * told.power_w(air_mps) * (500.0 / (air_mps - 7.0)) / 3600.0


def test_the_reserve_counts_the_way_round_a_no_fly_area():
    wall = [[90.0, -100.0], [110.0, -100.0], [110.0, 100.0], [90.0, 100.0]]
    straight, round_it = Watched().energy, Watched(safety={"no_fly_enu_m": [wall]}).energy
    assert round_it.home_wh((200, 0), 30.0, (0, 0)) > straight.home_wh((280, 0), 30.0, (0, 0))


def test_the_reserve_counts_the_climb_over_a_ridge():
    """One of 100 m, 150 to 250 m from home: it waits for the climb, and comes down at home."""
    ridge = np.zeros((2, 101))
    ridge[:, 35:46] = 100.0  # from x = -200 to 800 m
    ground, s = TerrainSurface(ridge, (-200.0, -500.0, 800.0, 500.0), "grass"), scenario()
    level, over_it = Watched().energy, ReturnEnergy(s, Watched().fence, ground, 30.0, 1.6)
    more_wh = over_it.home_wh((300, 0), 30.0, (0, 0)) - level.home_wh((300, 0), 30.0, (0, 0))
    assert more_wh > 190.0 * 20.0 / 3600.0
    assert over_it.home_wh((100, 0), 30.0, (0, 0)) == pytest.approx(level.home_wh((100, 0), 30.0, (0, 0)))
    there = Waypoint((300.0, 0.0), 30.0, 5.0)
    assert over_it.waypoint_wh(state(), 30.0, there) > level.waypoint_wh(state(), 30.0, there) + more_wh


def test_far_from_home_the_way_back_is_reserved():
    watched = Watched(looked_s=100.0)
    assert watched(state(x=2000.0, battery_remaining=0.5)) == {}
    assert Watched()(state(x=2000.0, battery_remaining=0.3)) == {"return energy": Action.RETURN}


@pytest.mark.parametrize("to_look", [True, False])
def test_a_waypoint_that_would_eat_the_reserve_is_refused_whatever_it_is_for(to_look):
    far = Waypoint((400.0, 0.0), 4.0, 1.0, to_look)
    outside = {"safety": {"check_outside_area": True}}
    assert Watched(**outside).refusal(state(battery_remaining=0.9), far) is None
    alarm = Watched(**outside).refusal(state(battery_remaining=0.3), far)
    assert (alarm.action, alarm.cause) == (Action.REFUSE_CHECK, "return energy")
    assert "400 m east" in alarm.sentence
    faster = Waypoint((400.0, 0.0), 30.0, 5.0)
    assert Watched().refusal(state(battery_remaining=0.3), faster) is None


def test_the_energy_of_a_waypoint_counts_the_climb_and_the_way_round():
    wall = [[90.0, -100.0], [110.0, -100.0], [110.0, 100.0], [90.0, 100.0]]
    low, high = Waypoint((150.0, 0.0), 30.0, 5.0), Waypoint((150.0, 0.0), 90.0, 5.0)
    straight, round_it = Watched().energy, Watched(safety={"no_fly_enu_m": [wall]}).energy
    assert straight.waypoint_wh(state(), 30.0, high) - straight.waypoint_wh(state(), 30.0, low) == (
        pytest.approx(190 * (60.0 / 3.0 + 60.0 / 1.5 - 150.0 / 5.0) / 3600.0)  # up; down beyond the way home
    )
    there_wh = [
        e.waypoint_wh(state(), 30.0, low) - e.home_wh((150, 0), 30.0, (0, 0)) for e in (straight, round_it)
    ]
    assert there_wh[1] > 1.5 * there_wh[0]


def test_a_place_is_judged_again_when_its_altitude_changes():
    guard = Watched()
    place = Waypoint((50.0, 50.0), 5.0, 1.0)
    assert guard.refusal(state(), place) is None
    assert guard.refusal(state(), place._replace(altitude_agl_m=0.4)).cause == "altitude"
    assert guard.refusal(state(), place) is None
    assert guard.refusal(state(), place._replace(xy_enu_m=(51.0, 50.0))) is None


def test_what_was_allowed_once_is_not_asked_again_on_the_way_there():
    guard, place = Watched(), Waypoint((200.0, 0.0), 5.0, 1.0)
    assert guard.refusal(state(battery_remaining=0.9), place) is None
    assert guard.refusal(state(battery_remaining=0.2), place) is None
    assert Watched().refusal(state(battery_remaining=0.2), place).cause == "return energy"


@pytest.mark.parametrize(
    ("floor_m", "altitude_m", "refused"), [(2.0, 2.0, False), (2.0, 1.9, True), (4.0, 3.9, True)]
)
def test_nothing_goes_below_the_floor_of_descents(floor_m, altitude_m, refused):
    watched = Watched(safety={"descent_floor_agl_m": floor_m})
    alarm = watched.refusal(state(), Waypoint((50.0, 50.0), altitude_m, 1.0))
    assert (alarm is not None and alarm.cause == "altitude") == refused


POND = {"area": {**BASE["area"], "holes_enu_m": [[[90, 90], [110, 90], [110, 110], [90, 110]]]}}


@pytest.mark.parametrize(
    ("x", "y", "outside"),
    [(50.0, 50.0, False), (100.0, 100.0, True), (150.0, 230.0, True), (200.5, 50.0, False)],
)
def test_candidates_outside_the_area_or_in_its_holes_are_refused(x, y, outside):
    to_look, to_scan = Waypoint((x, y), 5.0, 1.0, to_look=True), Waypoint((x, y), 30.0, 5.0)
    alarm = Watched(**POND).refusal(state(), to_look)
    assert (alarm is not None and alarm.cause == "outside the area") == outside
    assert Watched(**POND).refusal(state(), to_scan) is None
    assert Watched(**POND, safety={"check_outside_area": True}).refusal(state(), to_look) is None


def test_a_place_that_nothing_sees_is_refused():
    alarm = Watched().guard.refusal(state(), 30.0, Waypoint((50.0, 50.0), 5.0, 1.0, to_look=True), None)
    assert (alarm.action, alarm.cause) == (Action.REFUSE_CHECK, "no clear view")


@pytest.mark.parametrize(
    ("waypoint", "cause"),
    [
        (Waypoint((250.0, 50.0), 30.0, 5.0), "geofence"),
        (Waypoint((105.0, 105.0), 30.0, 5.0), "geofence"),
        (Waypoint((50.0, 50.0), 130.0, 5.0), "altitude"),
        (Waypoint((50.0, 50.0), 0.5, 5.0), "altitude"),
    ],
)
def test_setpoints_are_checked_before_they_are_sent(waypoint, cause):
    fenced = {
        "geofence_enu_m": [[-10, -10], [210, -10], [210, 210], [-10, 210]],
        "safety": {"no_fly_enu_m": [[[100, 100], [110, 100], [110, 110], [100, 110]]]},
    }
    guard = Watched(**fenced)
    assert guard.refusal(state(), waypoint).cause == cause
    assert guard.refusal(state(), Waypoint((50.0, 50.0), 30.0, 5.0)) is None


@pytest.mark.parametrize(("x", "alarmed"), [(204.0, False), (214.0, False), (216.0, True)])
def test_the_position_is_checked_too(x, alarmed):
    fenced = Watched(geofence_enu_m=[[-10, -10], [210, -10], [210, 210], [-10, 210]])
    assert fenced(state(x=x)) == ({"geofence": Action.RETURN} if alarmed else {})


@pytest.mark.parametrize(("agl", "alarmed"), [(119.0, False), (124.0, False), (126.0, True), (0.9, True)])
def test_altitude_above_terrain(agl, alarmed):
    assert Watched()(state(), agl) == ({"altitude": Action.RETURN} if alarmed else {})


@pytest.mark.parametrize(
    ("looked_s", "action"), [(98.0, None), (97.0, Action.CONTINUE), (30.0, Action.RETURN)]
)
def test_detector(looked_s, action):
    assert Watched(looked_s)(state(t=100.0)).get("detector silent") is action


def test_wind_holds_then_turns_home():
    watched = Watched()
    gale = np.array([8.0, 5.0, 0.0])
    actions = []
    for t in (0.0, 30.0, 59.0, 61.0):
        watched.looks.begin(t)
        actions.append(watched(state(t=t, wind_enu_mps=gale)).get("wind"))
    assert actions == [Action.HOLD] * 3 + [Action.RETURN]
    assert "wind" not in watched(state(t=62.0, wind_enu_mps=gale), phase=Phase.RETURN)


@pytest.mark.parametrize("unknown", [None, np.full(3, math.nan)])
def test_a_wind_that_was_too_strong_and_is_not_known_any_more_is_said(unknown):
    watched = Watched()
    watched(state(wind_enu_mps=np.array([0.0, 12.0, 0.0])))
    (alarm,) = watched.guard.alarms(state(t=101.0, wind_enu_mps=unknown), 30.0, Phase.SEARCH)
    assert (alarm.action, alarm.cause) == (Action.CONTINUE, "wind")
    assert alarm.sentence == "The wind is no longer known."
    assert watched(state(t=101.5, wind_enu_mps=np.array([0.0, 5.0, 0.0]))) == {}
    assert watched(state(t=102.0, wind_enu_mps=unknown)) == {}


def test_a_turn_at_speed_is_no_jump():
    watched = Watched()
    assert watched(state(t=0.0, x=0.0, v=(5.0, 0.0, 0.0))) == {}
    assert watched(state(t=1.0, x=2.0, y=2.0, v=(0.0, 5.0, 0.0))) == {}


def test_a_jump_holds_until_it_is_taken_back():
    watched = Watched()
    places = [(0.0, 0.0, None), (1.0, 50.0, Action.HOLD), (2.0, 50.0, Action.HOLD), (3.0, 1.0, None)]
    for t, x, action in places:
        watched.looks.begin(t)
        assert watched(state(t=t, x=x)).get("position jump") is action


@pytest.mark.parametrize("gap_s", [1.0, 2.0, 2.5, 3.0])
@pytest.mark.parametrize("by_m", [(50.0, 0.0, 0.0), (0.0, 0.0, 15.0)])
def test_a_jump_in_a_gap_of_the_link_is_noticed(gap_s, by_m):
    watched = Watched()
    x, y, z = by_m
    assert watched(state(t=0.0, v=(5.0, 0.0, 0.0)), phase=Phase.RETURN) == {}
    jumped = state(t=gap_s, x=5.0 * gap_s + x, y=y, z=30.0 + z, v=(5.0, 0.0, 0.0))
    assert watched(jumped, phase=Phase.RETURN) == {"position jump": Action.HOLD}
    back = state(t=gap_s + 1.0, x=5.0 * gap_s + 5.0, v=(5.0, 0.0, 0.0))
    assert watched(back, phase=Phase.RETURN) == {}


@pytest.mark.parametrize("speed_mps", [5.0, 9.0])
def test_what_is_flown_in_a_gap_of_the_link_is_no_jump(speed_mps):
    """The turns, braking, climbs and descents of a mission."""
    speeds = {"scan_speed_mps": speed_mps, "check_speed_mps": speed_mps, "n_c": 1}
    of = Scenario.model_validate(
        {
            "name": "gaps",
            "area": {"polygon_enu_m": [[0, 0], [80, 0], [80, 60], [0, 60]]},
            "targets": [{"class": "stop sign", "position_enu_m": [40, 30], "size_m": 0.9}],
            "vehicle": {"cruise_speed_mps": speed_mps},
            "search": speeds,
        }
    )
    states, modes = [], set()

    def watch(seen, mode, _new):
        states.append(seen)
        modes.add(mode)

    fly(build_mission(of, 0, Rig("statistical")), MemoryJournal(), watch)
    assert {"TAKEOFF", "SCAN", "CHECK", "RETURN", "LAND"} <= modes
    guard = Watched().guard
    for gap_s in (2.1, 2.5, 3.0, 4.0, 6.0, 10.0, 30.0):
        for before, after in zip(states[::3], states[round(10 * gap_s) :: 3], strict=False):
            guard.begin_sortie()
            guard.alarms(before, 30.0, Phase.RETURN)
            causes = {alarm.cause for alarm in guard.alarms(after, 30.0, Phase.RETURN)}
            assert "position jump" not in causes, (gap_s, before.time_s, after.time_s)


def test_the_most_severe_action_wins():
    watched = Watched()
    alarms = watched.guard.alarms(state(battery_remaining=0.03, silent_s=2.0), 30.0, Phase.SEARCH)
    assert max(a.action for a in alarms) is Action.LAND
    assert list(Action) == sorted(Action)


def test_on_the_way_home_only_what_keeps_from_it_counts():
    watched = Watched(looked_s=0.0)
    assert watched(state(battery_remaining=0.12), agl=200.0, phase=Phase.RETURN) == {}
    assert watched(state(t=101.0, silent_s=5.0), phase=Phase.RETURN) == {"telemetry silent": Action.HOLD}
    assert watched(state(t=110.0, battery_remaining=0.02), phase=Phase.RETURN) == {
        "battery critical": Action.LAND
    }


def test_no_progress_home_means_landing():
    watched = Watched()
    actions = [watched(state(t=t, x=80.0), phase=Phase.RETURN).get("no way home") for t in (0.0, 59.0, 61.0)]
    assert actions == [None, None, Action.LAND]


def test_a_way_round_a_no_fly_area_that_leads_away_is_progress_home():
    """Out of a cul-de-sac of 500 m, at 5 m/s: the straight way home grows for 100 s."""
    walls = [[100, -50], [900, -50], [900, -30], [120, -30], [120, 30], [900, 30], [900, 50], [100, 50]]
    watched = Watched(
        safety={"no_fly_enu_m": [walls]}, geofence_enu_m=[[-50, -200], [1500, -200], [1500, 200], [-50, 200]]
    )
    times = np.arange(0.0, 150.0, 5.0)
    told = [watched(state(t=t, x=150.0 + 5.0 * t), phase=Phase.RETURN) for t in times]
    assert not [alarms for alarms in told if "no way home" in alarms]
    held = [watched(state(t=t, x=800.0), phase=Phase.RETURN) for t in times + 150.0]
    assert "no way home" in held[-1]


def test_a_climb_before_a_ridge_is_progress_home_and_bobbing_is_none():
    def told(height_m):
        watched, times = Watched(), np.arange(0.0, 100.0, 5.0)
        over_the_ridge = Setpoint(np.array([0.0, 0.0, 300.0]), 5.0, 0.0)
        alarms = [
            watched(state(t=t, x=80.0, z=height_m(t)), phase=Phase.RETURN, goal=over_the_ridge) for t in times
        ]
        return [t for t, alarm in zip(times, alarms, strict=True) if "no way home" in alarm]

    assert told(lambda t: 30.0 + 3.0 * t) == []
    assert told(lambda t: 30.0 + 2.0 * math.sin(t))[0] == pytest.approx(70.0, abs=10.0)
    assert told(lambda t: 30.0 + min(3.0 * t, 90.0))[0] == pytest.approx(95.0)


def test_every_alarm_is_one_sentence():
    watched = Watched(looked_s=0.0)
    seen = state(battery_remaining=0.03, wind_enu_mps=np.array([30.0, 0.0, 0.0]))
    for alarm in watched.guard.alarms(seen, 200.0, Phase.SEARCH):
        assert alarm.sentence.endswith(".")
        assert "\n" not in alarm.sentence


# ---- in a whole mission ------------------------------------------------------------------------------

SMALL = {
    "name": "small",
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
    "home": {"position_enu_m": [-5, -5]},
    "targets": [{"class": "stop sign", "position_enu_m": [45, 12], "size_m": 0.9}],
    "camera": {"hfov_rad": 1.2},
}


def flown(**changes):
    journal = MemoryJournal()
    reason = fly(build_mission(Scenario.model_validate(SMALL | changes), 0, Rig("statistical")), journal)
    return reason, journal.lines


def test_a_candidate_in_a_no_fly_area_is_reported_and_not_flown_to():
    around = [[40.0, 7.0], [50.0, 7.0], [50.0, 17.0], [40.0, 17.0]]
    reason, lines = flown(safety={"no_fly_enu_m": [around]})
    assert reason == "completed"
    unchecked = [line["p"] for line in lines if line["kind"] == "unchecked"]
    assert min(math.dist(p[:2], (45, 12)) for p in unchecked) < 2.0
    assert {line["reason"] for line in lines if line["kind"] == "unchecked"} == {"geofence"}
    assert [line for line in lines if line["kind"] == "confirmed"] == []
    flown_xy = np.array([line["p"] for line in lines if line["kind"] == "state"])
    inside = (abs(flown_xy[:, 0] - 45) < 5) & (abs(flown_xy[:, 1] - 12) < 5)
    assert not inside.any()


@pytest.mark.parametrize("fence", [None, [[-9, -9], [69, -9], [69, 49], [-9, 49]]])
def test_a_strategy_that_insists_on_a_refused_waypoint_ends_the_search(fence):
    class Stubborn:
        def step(self, observation):
            return Command("SCAN", Waypoint((500.0, 0.0), 30.0, 5.0))

    scenario = Scenario.model_validate(SMALL | {"geofence_enu_m": fence})
    mission = replace(build_mission(scenario, 0, Rig("statistical")), strategy=Stubborn())
    journal = MemoryJournal()
    assert fly(mission, journal) == "geofence"
    told = [(line["cause"], line["action"]) for line in journal.lines if line["kind"] == "safety"]
    assert told == [("geofence", "REFUSE_CHECK"), ("geofence", "RETURN")]
    assert journal.lines[-1]["t"] < 60.0


def test_the_way_to_a_candidate_and_home_leads_round_a_no_fly_area():
    wall = [[22.0, -8.0], [30.0, -8.0], [30.0, 17.0], [22.0, 17.0]]
    reason, lines = flown(safety={"no_fly_enu_m": [wall]})
    assert reason == "completed"
    assert any(line["kind"] == "confirmed" for line in lines)
    xy = np.array([line["p"][:2] for line in lines if line["kind"] == "state"])
    inside = (xy[:, 0] > 22.5) & (xy[:, 0] < 29.5) & (xy[:, 1] < 16.5)
    assert not inside.any()
    assert math.dist(xy[-1], (-5, -5)) < 2.0


def test_a_path_over_a_no_fly_area_is_refused_on_the_ground():
    with pytest.raises(UserError, match=r"safety\.no_fly_enu_m: .*area\.holes_enu_m"):
        flown(safety={"no_fly_enu_m": [[[1.0, 1.0], [59.0, 1.0], [59.0, 39.0], [1.0, 39.0]]]})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"safety": {"no_fly_enu_m": [[[0, 0], [1, 1]]]}}, "at least 3 corners"),
        ({"safety": {"no_fly_enu_m": [[[-9, -9], [0, -9], [0, 0], [-9, 0]]]}}, "move home"),
        ({"search": {"scan_altitude_agl_m": 130.0}}, "altitude_max_agl_m"),
        (
            {"safety": {"descent_floor_agl_m": 5.0}},
            r"search\.check_altitude_agl_m: is 4; write at least safety\.descent_floor_agl_m \(5\), or lower",
        ),
    ],
)
def test_scenarios_that_cannot_be_flown_safely(changes, message):
    with pytest.raises(ValueError, match=message):
        Scenario.model_validate(SMALL | changes)


WAITS = {"waits": "It hovers until a person says continue."}


@pytest.mark.parametrize("phase", [Phase.SEARCH, Phase.RETURN, Phase.LAND])
def test_a_vehicle_that_is_ours_again_without_a_word_is_held(phase):
    watched = Watched(looked_s=103.0)
    assert watched(state(taken_over="it is in Land"), phase=phase) == {"taken over": Action.KEEP_OUT}
    (alarm,) = watched.guard.alarms(state(t=101.0, **WAITS), 30.0, phase)
    assert (alarm.action, alarm.sentence) == (Action.HOLD, WAITS["waits"])
    assert watched(state(t=102.0), phase=phase) == {"taken over": Action.HOLD}
    assert watched(state(t=103.0, **WAITS), phase=phase) == {"taken over": Action.HOLD}
    watched.guard.heed("continue")
    assert watched(state(t=104.0, **WAITS), phase=phase) == {}


def test_a_persons_word_counts_more_than_the_wait():
    watched = Watched()
    watched(state(taken_over="it is in Land"))
    watched.guard.heed("return")
    assert watched(state(t=101.0, **WAITS)) == {"operator": Action.RETURN}


@pytest.mark.parametrize(
    ("left", "cause", "action"),
    [(0.14, "low battery", Action.RETURN), (0.04, "battery critical", Action.LAND)],
)
def test_the_battery_is_looked_after_while_a_vehicle_waits_for_a_word(left, cause, action):
    watched = Watched()
    watched(state(taken_over="it is in Land"))
    found = watched(state(t=101.0, battery_remaining=left, **WAITS))
    assert found["taken over"] is Action.HOLD
    assert found[cause] is action
    theirs = state(t=102.0, battery_remaining=left, taken_over="it is in Position")
    assert watched(theirs) == {"taken over": Action.KEEP_OUT}
