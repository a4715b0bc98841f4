"""A PX4 as a vehicle: the embedded one behind its MAVLink face, over UDP, flown through MAVSDK."""

import contextlib
import math
import socket
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from look_alike import LookAlike
from mavlink_clients import free_port, scenario, served, wait
from pymavlink.dialects.v20 import common as m
from relay import Relay

pytest.importorskip("mavsdk.mavsdk")

from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.flight_plan import FlightEstimate, plan_scenario
from skysweep.planning.plan_files import plan_of_mission
from skysweep.types import Setpoint
from skysweep.vehicles.embedded.at_home import embedded_vehicle
from skysweep.vehicles.mavlink.modes import PX4Mode, Site
from skysweep.vehicles.px4.offboard import horizontal_velocity_enu_mps
from skysweep.vehicles.px4.preflight import Demands, preflight
from skysweep.vehicles.px4.telemetry import Telemetry
from skysweep.vehicles.px4.vehicle import Px4Vehicle, names_its_place, placed
from skysweep.vehicles.served.server import LOOPBACK, VehicleServer

SPEED = 5.0
metres = st.floats(-500.0, 500.0)


def flat(xy):
    return np.zeros(len(xy))


def setpoint(x, y, z, speed=5.0):
    return Setpoint(np.array([x, y, z], dtype=float), speed, 0.0)


@contextlib.contextmanager
def connected(of=None, speed=SPEED):
    """The vehicle, and the server with its truth."""
    of = of or scenario()
    with served(of, speed) as (server, (url,)):
        vehicle = Px4Vehicle(url, of, flat, 30.0)
        try:
            yield vehicle, server
        finally:
            vehicle.close()


def fly_until(vehicle, condition, longest_s=120.0):
    """Lets vehicle time pass."""
    end_s = vehicle.state().time_s + longest_s
    while not condition(vehicle.state()):
        vehicle.advance(0.1)
        assert vehicle.state().time_s < end_s, vehicle.state()


def demands(
    plan, energy_share=0.1, farthest_m=100.0, highest_m=20.0, return_clear_m=10.0, shares_flown=(1.0,)
):
    estimate = FlightEstimate(
        path_length_m=1000.0,
        search_time_s=500.0,
        time_s=600.0,
        energy_wh=energy_share * scenario().vehicle.battery_wh,
        batteries=len(shares_flown),
        gsd_cm=5.0,
        pixels_on_target=15.0,
        area_m2=1e4,
        n_transects=5,
        shares_flown=shares_flown,
    )
    return Demands(plan, estimate, farthest_m, highest_m, return_clear_m)


def hovering(vehicle, up=8.0):
    vehicle.takeoff(up)
    fly_until(vehicle, lambda s: s.position_enu_m[2] > up - 1.0)


def distance(state, *xyz):
    return float(np.linalg.norm(state.position_enu_m - xyz))


# ---- setpoints and frames --------------------------------------------------------------------------------


@given(metres, metres, metres, metres, st.floats(0.5, 12.0))
def test_it_cruises_no_faster_than_the_setpoint_says(x, y, to_x, to_y, speed):
    here, gain = np.array([x, y, 10.0]), 0.95
    velocity = horizontal_velocity_enu_mps(setpoint(to_x, to_y, 10.0, speed), here, gain)
    way = np.array([to_x - x, to_y - y])
    if velocity is None:
        assert gain * math.hypot(*way) <= speed + 1e-9
    else:
        assert math.hypot(*velocity) == pytest.approx(speed)
        assert velocity @ way > 0.999 * speed * math.hypot(*way)


@given(metres, metres, metres)
def test_a_place_goes_to_ned_and_back(x, y, z):
    site = Site(LocalFrame(60.0, 22.0), np.array([-4.8, -5.3, 2.1]))
    place = np.array([x, y, z])
    assert site.enu_from_ned(site.ned_from_enu(place)) == pytest.approx(place, abs=1e-9)


def test_a_scenario_without_a_place_is_flown_where_the_vehicle_stands():
    nowhere = scenario(home={"position_enu_m": [-5.0, 20.0]})
    assert not names_its_place(nowhere)
    there = placed(nowhere, 47.4, 8.5, 489.0)
    assert names_its_place(there)
    x, y, _ = there.frame.enu_from_geodetic([47.4, 8.5, 489.0])[0]
    assert (x, y) == pytest.approx((-5.0, 20.0), abs=0.01)


class Radio:
    """A link that hears what a test says."""

    def __init__(self):
        self.said, self._listeners, self.clock_s = {}, {}, 0.0

    def on(self, name, listener):
        self._listeners[name] = listener

    def newest(self, name):
        return self.said.get(name)

    def now_s(self):
        return self.clock_s

    def say(self, name, **fields):
        self.said[name] = fields
        if name in self._listeners:
            self._listeners[name](fields)


def position(time_ms, x=1.0, **changes):
    said = {"time_boot_ms": time_ms, "x": x, "y": 2.0, "z": -3.0, "vx": 0.0, "vy": 0.0, "vz": 0.0}
    return said | changes


@pytest.mark.parametrize("broken", [{"x": None}, {"z": math.inf}, {"vx": 1e9}, {"y": math.nan}])
def test_broken_positions_are_not_believed(broken):
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    radio.say("LOCAL_POSITION_NED", **position(1000))
    radio.say("LOCAL_POSITION_NED", **(position(1100, x=9.0) | broken))
    assert (told.boot_s, told.ned_m[0]) == (1.0, 1.0)


def test_late_positions_change_nothing_and_a_restart_is_noticed():
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    radio.say("LOCAL_POSITION_NED", **position(60_000))
    radio.say("LOCAL_POSITION_NED", **position(59_900, x=7.0))
    assert (told.boot_s, told.ned_m[0], told.restarted) == (60.0, 1.0, False)
    for k in range(5):
        assert not told.restarted
        radio.say("LOCAL_POSITION_NED", **position(500 + 30 * k))
    assert told.restarted


@pytest.mark.parametrize(
    "late_ms", [[58_500], [57_000, 57_030, 57_060], [59_000] * 6, [500, 400, 300, 200, 100, 0]]
)
def test_a_few_late_or_repeated_positions_are_no_restart(late_ms):
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    for k in range(4):
        radio.say("LOCAL_POSITION_NED", **position(60_000 + 40 * k))
        for time_ms in late_ms:
            radio.say("LOCAL_POSITION_NED", **position(time_ms + 7 * k, x=7.0))
    assert not told.restarted
    assert (told.boot_s, told.ned_m[0]) == (pytest.approx(60.12), 1.0)


@pytest.mark.parametrize("then", [{}, {"q1": None, "q2": None, "q3": None, "q4": None}])
def test_an_attitude_that_is_told_no_more_is_no_position(then):
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    radio.say("ATTITUDE_QUATERNION", q1=1.0, q2=0.0, q3=0.0, q4=0.0)
    told_for(1.5, radio)
    assert told.position_std_m == 0.0
    for k in range(3, 10):
        told_for(0.5, radio, since_s=0.5 * k)
        if then:
            radio.say("ATTITUDE_QUATERNION", **then)
    assert told.position_std_m == math.inf
    radio.say("ATTITUDE_QUATERNION", q1=1.0, q2=0.0, q3=0.0, q4=0.0)
    assert told.position_std_m == 0.0


def test_an_old_word_is_not_todays():
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    radio.say("ESTIMATOR_STATUS", flags=m.ESTIMATOR_POS_HORIZ_ABS, pos_horiz_accuracy=0.2)
    radio.say("WIND_COV", wind_x=3.0, wind_y=1.0, wind_z=None)
    radio.say("GIMBAL_DEVICE_ATTITUDE_STATUS", q=[1.0, 0.0, 0.0, 0.0], flags=0)
    told_for(1.5, radio)
    assert told.position_std_m == 0.2
    assert told.wind_enu_mps is not None
    assert told.reported_gimbal_pitch_rad == 0.0
    told_for(11.0, radio, since_s=1.5)
    assert told.position_std_m == math.inf
    assert told.wind_enu_mps is None
    assert told.reported_gimbal_pitch_rad is None


def test_what_is_not_said_is_not_made_up():
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    assert told.position_std_m == math.inf
    assert told.wind_enu_mps is None
    radio.say("ESTIMATOR_STATUS", flags=m.ESTIMATOR_ATTITUDE, pos_horiz_accuracy=0.2)
    assert told.position_std_m == math.inf
    radio.say("ESTIMATOR_STATUS", flags=m.ESTIMATOR_POS_HORIZ_ABS, pos_horiz_accuracy=0.2)
    assert told.position_std_m == 0.2
    radio.say("WIND_COV", wind_x=3.0, wind_y=1.0, wind_z=None)
    assert told.wind_enu_mps == pytest.approx([1.0, 3.0, 0.0])


def test_energy_is_voltage_times_current():
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    site = Site(LocalFrame(60.0, 22.0), np.zeros(3))
    for time_ms in (0, 36_000):
        radio.say("LOCAL_POSITION_NED", **position(time_ms))
        radio.say(
            "BATTERY_STATUS", voltages=[4000] * 4 + [65535] * 6, current_battery=1000, battery_remaining=90
        )
    assert told.state(site, 0.0).energy_used_wh == pytest.approx(1.6)


def battery(percent, volts=16.0, amperes=10.0, number=0):
    cells = [round(volts * 250.0)] * 4 + [65535] * 6
    return {
        "id": number,
        "voltages": cells,
        "current_battery": -1 if amperes is None else round(amperes * 100.0),
        "battery_remaining": percent,
    }


def told_for(told_s, radio, *batteries, since_s=0.0):
    """Positions every half second; each battery says a word until it is silent."""
    for k in range(round(2.0 * told_s)):
        now_s = since_s + 0.5 * k
        radio.say("LOCAL_POSITION_NED", **position(round(now_s * 1000.0)))
        for said in batteries:
            radio.say("BATTERY_STATUS", **said)


@pytest.mark.parametrize(
    ("batteries", "left"),
    [
        ([], math.nan),
        ([battery(-1)], math.nan),
        ([battery(80)], 0.8),
        ([battery(80, number=0), battery(30, number=1)], 0.3),
        ([battery(80, number=0), battery(-1, number=1)], 0.8),
    ],
)
def test_the_emptiest_battery_counts_and_unknown_is_unknown(batteries, left):
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    told_for(3.0, radio, *batteries)
    assert told.battery_remaining == pytest.approx(left, nan_ok=True)


@pytest.mark.parametrize("then", [[], [battery(-1)], [battery(80)]])
def test_a_battery_that_says_no_more_is_unknown(then):
    """80 % heard once is not 80 % an hour later, and neither battery's silence is hidden by the other."""
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    told_for(3.0, radio, battery(80), battery(70, number=1))
    assert told.battery_remaining == 0.7
    told_for(12.0, radio, *then, since_s=3.0)
    assert math.isnan(told.battery_remaining)


@pytest.mark.parametrize("amperes", [10.0, None])
def test_one_report_of_an_empty_battery_lands_nobody(amperes):
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    site = Site(LocalFrame(60.0, 22.0), np.zeros(3))
    told_for(3.0, radio, battery(80, amperes=amperes))
    used_wh = told.state(site, 0.0).energy_used_wh
    told_for(0.5, radio, battery(0, amperes=amperes), since_s=3.0)
    assert told.battery_remaining == 0.8
    assert told.state(site, 0.0).energy_used_wh < used_wh + 1.0
    told_for(0.5, radio, battery(79, amperes=amperes), since_s=3.5)
    assert told.battery_remaining == 0.79
    told_for(1.0, radio, battery(40, amperes=amperes), since_s=4.0)
    assert told.battery_remaining == 0.4


def test_a_silence_of_the_whole_vehicle_does_not_age_its_battery():
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    told_for(3.0, radio, battery(80))
    radio.say("LOCAL_POSITION_NED", **position(63_000))
    assert told.battery_remaining == 0.8


def test_the_energy_of_two_batteries_adds_up():
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    site = Site(LocalFrame(60.0, 22.0), np.zeros(3))
    told_for(36.5, radio, battery(90), battery(90, number=1))
    assert told.state(site, 0.0).energy_used_wh == pytest.approx(3.2, rel=0.01)


def test_a_clock_that_stands_still_is_silence():
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    radio.say("LOCAL_POSITION_NED", **position(1000))
    radio.clock_s += 5.0
    radio.say("LOCAL_POSITION_NED", **position(1000, x=2.0))
    assert told.silent_s == 5.0
    radio.say("LOCAL_POSITION_NED", **position(1100))
    assert told.silent_s == 0.0


def ranged(centimetres, **changes):
    down = {"orientation": m.MAV_SENSOR_ROTATION_PITCH_270, "min_distance": 10, "max_distance": 4000}
    return down | {"current_distance": centimetres} | changes


@pytest.mark.parametrize(
    ("said", "below_m"),
    [
        (ranged(1250), 12.5),
        (ranged(4000), None),
        (ranged(5), None),
        (ranged(1250, orientation=m.MAV_SENSOR_ROTATION_NONE), None),
    ],
)
def test_a_rangefinder_that_looks_down_measures_the_height(said, below_m):
    radio = Radio()
    told = Telemetry(radio, -1.57, 98.0)
    radio.say("LOCAL_POSITION_NED", **position(1000))
    radio.say("DISTANCE_SENSOR", **said)
    assert told.ground_below_m == below_m
    told_for(3.0, radio, since_s=1.5)
    assert told.ground_below_m is None


# ---- flying ----------------------------------------------------------------------------------------------


def test_it_takes_off_flies_waits_lands_and_stands_by():
    with connected() as (vehicle, server):
        pilot = server.face.pilot
        assert not vehicle.state().airborne
        hovering(vehicle)
        assert vehicle.state().time_s < 20.0
        start_s = vehicle.state().time_s
        vehicle.command(setpoint(20.0, 0.0, 8.0))
        fly_until(
            vehicle, lambda s: not vehicle.command(setpoint(20.0, 0.0, 8.0)) and s.position_enu_m[0] > 19
        )
        assert vehicle.state().time_s - start_s > 4.0
        truth = pilot.state.position_enu_m
        assert np.linalg.norm(vehicle.state().position_enu_m - truth) < 2.0
        vehicle.hold()
        fly_until(vehicle, lambda s: np.linalg.norm(s.velocity_enu_mps) < 0.3)
        assert pilot.mode is PX4Mode.OFFBOARD
        vehicle.command(setpoint(20.0, 10.0, 8.0))
        fly_until(vehicle, lambda s: distance(s, 20.0, 10.0, 8.0) < 1.0)
        vehicle.land()
        fly_until(vehicle, lambda s: not s.airborne)
        assert vehicle.wait_disarmed(20.0)
        assert pilot.mode is PX4Mode.HOLD


def test_time_is_the_vehicles_and_advances_by_as_much_as_asked():
    with connected(speed=10.0) as (vehicle, _):
        before_s, wall_s = vehicle.state().time_s, time.monotonic()
        for _ in range(30):
            vehicle.advance(0.5)
        assert vehicle.state().time_s - before_s >= 15.0 - 0.1
        assert time.monotonic() - wall_s < 12.0


def test_the_gimbal_is_pointed_and_believed():
    with connected() as (vehicle, server):
        assert vehicle.gimbal
        vehicle.look(-0.5)
        vehicle.advance(3.0)
        fly_until(vehicle, lambda s: abs(s.camera.R_camera_to_enu[2, 2] - math.sin(-0.5)) < 0.02)
        true = server.face.pilot._vehicle.true_camera_pose().R_camera_to_enu
        assert true[2, 2] == pytest.approx(math.sin(-0.5), abs=0.03)


def test_a_setpoint_points_the_gimbal():
    with connected() as (vehicle, server):
        hovering(vehicle)
        there = setpoint(0.0, 0.0, 8.0)
        vehicle.command(there._replace(gimbal_pitch_rad=-0.5))
        fly_until(vehicle, lambda s: abs(s.camera.pitch_rad + 0.5) < 0.02)
        true = server.face.pilot._vehicle.true_camera_pose()
        assert true.pitch_rad == pytest.approx(-0.5, abs=0.03)
        vehicle.command(there)  # leaves it as it is
        vehicle.advance(2.0)
        assert vehicle.state().camera.pitch_rad == pytest.approx(-0.5, abs=0.02)


def test_a_camera_without_a_gimbal_is_believed_to_look_as_before():
    vehicle = LookAlike(0).vehicle
    vehicle.gimbal = vehicle._has_gimbal = False
    vehicle.look(-0.5)
    assert vehicle.telemetry.gimbal_pitch_rad == pytest.approx(-math.pi / 2)


def test_preflight_says_whose_the_gimbal_is():
    with connected() as (vehicle, server):
        plan = plan_of_mission(vehicle.scenario, plan_scenario(vehicle.scenario)[0])
        (check,) = [c for c in preflight(vehicle, demands(plan), False) if c.name == "gimbal"]
        assert (check.passed, check.said) == (True, "ours, looks to -90 degrees, told -90")
        server.face.payload.control = 7, 1
        assert vehicle.link.wait(lambda: vehicle.gimbal_obeys == (7, 1), 10.0)
        (check,) = [c for c in preflight(vehicle, demands(plan), False) if c.name == "gimbal"]
        assert check.passed is False
        assert check.said.startswith("obeys 7/1, not us (245/190)")


def test_whoever_takes_it_over_keeps_it_until_a_person_gives_it_back():
    with connected() as (vehicle, server):
        pilot = server.face.pilot
        hovering(vehicle)
        vehicle.command(setpoint(15.0, 0.0, 8.0))
        vehicle.advance(1.0)
        pilot.change_mode(PX4Mode.RETURN)
        fly_until(vehicle, lambda s: s.taken_over, 20.0)
        assert "Return" in vehicle.state().taken_over
        for order in (vehicle.hold, vehicle.land, lambda: vehicle.command(setpoint(15.0, 0.0, 8.0))):
            order()
            vehicle.advance(0.5)
            assert pilot.mode in (PX4Mode.RETURN, PX4Mode.LAND)
        time.sleep(1.5)
        assert vehicle.regain(vehicle.state().taken_over) == ""
        vehicle.advance(0.5)
        assert (pilot.mode, vehicle.state().taken_over) == (PX4Mode.OFFBOARD, "")
        pilot.change_mode(PX4Mode.RETURN)
        fly_until(vehicle, lambda s: s.taken_over, 20.0)
        vehicle.close()
        time.sleep(0.5)
        assert pilot.mode in (PX4Mode.RETURN, PX4Mode.LAND)


def test_a_hold_during_take_off_is_somebody_elses():
    with connected() as (vehicle, server):
        vehicle.takeoff(20.0)
        server.face.pilot.change_mode(PX4Mode.HOLD)
        fly_until(vehicle, lambda s: s.taken_over, 10.0)
        vehicle.command(setpoint(15.0, 0.0, 8.0))
        vehicle.advance(1.0)
        assert server.face.pilot.mode is PX4Mode.HOLD


def test_its_end_hands_over_to_hold():
    with served(speed=SPEED) as (server, (url,)):
        vehicle = Px4Vehicle(url, scenario(), flat, 30.0)
        hovering(vehicle)
        vehicle.command(setpoint(50.0, 0.0, 8.0))
        vehicle.advance(0.5)
        assert server.face.pilot.mode is PX4Mode.OFFBOARD
        vehicle.close()
        assert server.face.pilot.mode is PX4Mode.HOLD
        assert not server.face.pilot.failsafe


def test_a_link_that_is_lost_and_found_again():
    of, port = scenario(), free_port()
    relay = Relay(port)
    with VehicleServer(embedded_vehicle(of, 0), of, [(LOOPBACK, relay.port)], SPEED) as server:
        server.face.parameters.set("COM_OBL_RC_ACT", 5)
        vehicle = Px4Vehicle(f"udpin://{LOOPBACK}:{port}", of, flat, 30.0)
        hovering(vehicle)
        vehicle.command(setpoint(90.0, 0.0, 8.0))
        vehicle.advance(1.0)
        relay.open = False
        wait(lambda: server.face.pilot.mode is PX4Mode.HOLD)
        before_s = vehicle.state().time_s
        wait(lambda: not vehicle.advance(0.1) and vehicle.state().silent_s > 1.5)
        assert vehicle.state().time_s - before_s < 3.0
        relay.open = True
        wait(lambda: not vehicle.advance(0.1) and vehicle.state().silent_s < 0.3)
        pilot = server.face.pilot
        wait(lambda: not vehicle.command(setpoint(90.0, 0.0, 8.0)) and pilot.mode is PX4Mode.OFFBOARD)
        assert not vehicle.state().taken_over
        vehicle.close()
    relay.close()


# ---- before it flies -------------------------------------------------------------------------------------


def test_the_preflight_list_and_the_fence_that_it_uploads():
    of = scenario(
        geofence_enu_m=[[-30, -30], [150, -30], [150, 110], [-30, 110]],
        safety={"no_fly_enu_m": [[[130, 90], [140, 90], [140, 100]]]},
    )
    with connected(of) as (vehicle, server):
        plan = plan_of_mission(vehicle.scenario, plan_scenario(vehicle.scenario)[0])
        looked = {check.name: check for check in preflight(vehicle, demands(plan), False)}
        assert all(check.passed is not False for check in looked.values()), looked
        assert "not uploaded" in looked["fence"].said
        assert server.face.pilot.fence.inside == ()
        sent = {check.name: check for check in preflight(vehicle, demands(plan), True)}
        assert "7 corners uploaded" in sent["fence"].said
        fence = server.face.pilot.fence
        assert fence.allows(np.array([140.0, 80.0, 0.0]))
        assert not fence.allows(np.array([160.0, 50.0, 0.0]))
        assert not fence.allows(np.array([137.0, 93.0, 0.0]))
        assert not server.face.pilot.armed


@pytest.mark.parametrize("estimated", [False, True])
def test_preflight_wants_a_word_where_nobody_knows_the_battery(estimated):
    there = LookAlike(5, scenario(safety={"battery_estimated": estimated}))
    silence = m.MAV_CMD_SET_MESSAGE_INTERVAL, m.MAVLINK_MSG_ID_BATTERY_STATUS, -1.0
    there.vehicle.link.command(*silence)
    there.wait(11.0)
    plan = plan_of_mission(there.vehicle.scenario, plan_scenario(there.vehicle.scenario)[0])
    (check,) = [c for c in preflight(there.vehicle, demands(plan), False, 0.0) if c.name == "battery"]
    assert check.passed is (None if estimated else False)
    assert "does not say how full it is" in check.said


def test_a_battery_that_is_not_enough_stops_it_before_the_fence_is_sent():
    of = scenario(geofence_enu_m=[[-30, -30], [150, -30], [150, 110], [-30, 110]])
    with connected(of) as (vehicle, server):
        plan = plan_of_mission(vehicle.scenario, plan_scenario(vehicle.scenario)[0])
        (battery,) = (c for c in preflight(vehicle, demands(plan, 0.95), True) if c.passed is False)
        assert battery.name == "battery"
        assert server.face.pilot.fence.inside == ()


@pytest.mark.parametrize(
    ("batteries", "passed", "says"),
    [
        (1, {"battery": False, "sorties": None}, "vehicle.batteries (1) last for 60%: write 2"),
        (2, {"battery": True, "sorties": True}, "the plan without checks takes 2, in 10 min with the swaps"),
    ],
)
def test_the_list_says_how_many_sorties_the_plan_takes(batteries, passed, says):
    there = LookAlike(5, scenario(vehicle={"batteries": batteries}))
    plan = plan_of_mission(there.vehicle.scenario, plan_scenario(there.vehicle.scenario)[0])
    wanted = demands(plan, 1.4, shares_flown=(0.6, 1.0))
    checks = {c.name: c for c in preflight(there.vehicle, wanted, False, 0.0)}
    assert {name: checks[name].passed for name in passed} == passed
    assert says in checks["sorties"].said
    there.sky.pilot.battery_share = 0.7
    there.wait(2.0)
    (battery,) = (c for c in preflight(there.vehicle, wanted, False, 0.0) if c.name == "battery")
    assert battery.passed is False


def test_nobody_changes_a_battery_while_the_motors_run():
    there = LookAlike(5, scenario(vehicle={"batteries": 2}))
    assert there.sky.face.parameters.set("COM_DISARM_LAND", -1.0)
    plan = plan_of_mission(there.vehicle.scenario, plan_scenario(there.vehicle.scenario)[0])
    checks = preflight(there.vehicle, demands(plan, 1.4, shares_flown=(0.6, 1.0)), False, 0.0)
    (check,) = (c for c in checks if c.name == "sorties")
    assert check.passed is False
    assert "set COM_DISARM_LAND to 2" in check.said


def test_a_plan_for_one_battery_has_no_word_of_sorties():
    there = LookAlike(5, scenario())
    plan = plan_of_mission(there.vehicle.scenario, plan_scenario(there.vehicle.scenario)[0])
    assert "sorties" not in {c.name for c in preflight(there.vehicle, demands(plan), False, 0.0)}


@pytest.mark.parametrize(
    ("parameters", "name", "passed", "words"),
    [
        ({"COM_OBL_RC_ACT": 5}, "link lost", True, "Hold after"),
        ({"COM_OBL_RC_ACT": 0}, "link lost", None, "sinks and lands"),
        ({"COM_OBL_RC_ACT": 7}, "link lost", False, "motors stop in the air; set COM_OBL_RC_ACT to 5"),
        ({"COM_LOW_BAT_ACT": 0}, "low battery", None, "nothing brings it home"),
        ({"COM_LOW_BAT_ACT": 3}, "low battery", True, "Return, then Land"),
        ({"RTL_RETURN_ALT": 8.0}, "return altitude", False, "set RTL_RETURN_ALT to 10"),
        ({"RTL_RETURN_ALT": 30.0}, "return altitude", True, "30 m above home"),
        ({"GF_MAX_HOR_DIST": 90.0}, "own fence", False, "GF_MAX_HOR_DIST is 90 m, the flight needs 103"),
        ({"GF_MAX_VER_DIST": 22.0}, "own fence", False, "GF_MAX_VER_DIST is 22 m, the flight needs 23"),
        ({"GF_MAX_HOR_DIST": 200.0}, "own fence", True, "200 m"),
        ({}, "pilot", None, "nobody can take over by hand"),
    ],
)
def test_preflight_judges_the_vehicles_own_settings(parameters, name, passed, words):
    there = LookAlike(0)
    for parameter, value in parameters.items():
        assert there.sky.face.parameters.set(parameter, value)
    plan = plan_of_mission(there.vehicle.scenario, plan_scenario(there.vehicle.scenario)[0])
    (check,) = [c for c in preflight(there.vehicle, demands(plan), False, ready_s=1.0) if c.name == name]
    assert check.passed is passed, check
    assert words in check.said


def test_preflight_sees_a_pilot_whose_lost_sticks_would_stop_the_motors():
    there = LookAlike(5)
    plan = plan_of_mission(there.vehicle.scenario, plan_scenario(there.vehicle.scenario)[0])
    there.sticks(moving=False)
    there.wait(2.0)
    for action, passed in ((2, True), (6, False)):
        there.sky.face.parameters.set("NAV_RCL_ACT", action)
        (check,) = [c for c in preflight(there.vehicle, demands(plan), False, 1.0) if c.name == "pilot"]
        assert check.passed is passed, check


@pytest.mark.parametrize(
    ("mode", "sticks", "passed"),
    [(PX4Mode.HOLD, False, True), (PX4Mode.RETURN, False, False), (PX4Mode.POSITION, True, False)],
)
def test_a_vehicle_that_somebody_flies_is_not_gone_on_with(mode, sticks, passed):
    there = LookAlike(5)
    there.sticks(moving=False if sticks else None)
    there.vehicle.takeoff(10.0)
    there.wait(8.0)
    there.command(m.MAV_CMD_DO_SET_MODE, 1, *mode.value)
    there.connect()
    there.wait(2.0)
    plan = plan_of_mission(there.vehicle.scenario, plan_scenario(there.vehicle.scenario)[0])
    (check,) = [c for c in preflight(there.vehicle, demands(plan), False, 1.0) if c.name == "control"]
    assert check.passed is passed, check


def test_a_vehicle_that_lost_its_program_is_gone_on_with():
    there = LookAlike(3)
    there.vehicle.takeoff(10.0)
    while there.vehicle.telemetry.flown != PX4Mode.OFFBOARD.value:
        there.wait(0.1)
    there.connect()
    there.wait(3.0)
    assert there.flown()[0] == PX4Mode.RETURN.value
    plan = plan_of_mission(there.vehicle.scenario, plan_scenario(there.vehicle.scenario)[0])
    (check,) = [c for c in preflight(there.vehicle, demands(plan), False, 1.0) if c.name == "control"]
    assert check.passed, check


def test_a_word_for_one_takeover_is_not_for_the_next_of_the_same_mode():
    there = LookAlike(5)
    there.vehicle.takeoff(10.0)
    holders = []
    for _ in range(2):
        while there.flown()[0] != PX4Mode.OFFBOARD.value:
            there.wait(0.1)
        there.command(m.MAV_CMD_DO_SET_MODE, 1, *PX4Mode.HOLD.value)
        there.wait(2.0)
        holders.append(there.vehicle.state().taken_over)
        if len(holders) == 1:
            assert there.vehicle.regain(holders[0]) == ""
    assert holders == ["it is in Hold: somebody chose that", "it is in Hold: somebody chose that (time 2)"]
    assert "since then somebody else took" in there.vehicle.regain(holders[0])
    assert there.flown()[0] == PX4Mode.HOLD.value
    assert there.vehicle.regain(holders[1]) == ""


def test_who_arms_it_after_it_refused_us_is_not_disarmed_at_our_end():
    there = LookAlike(5)
    there.sky.pilot.battery_share = 0.03
    there.wait(2.0)
    with pytest.raises(UserError, match="does not arm"):
        there.vehicle.takeoff(10.0)
    there.sky.pilot.battery_share = 1.0
    there.wait(2.0)
    there.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    there.wait(2.0)
    there.vehicle.close()
    assert there.flown()[1]


def test_what_speaks_against_arming_is_said():
    there = LookAlike(5)
    there.sky.pilot.battery_share = 0.03
    there.wait(2.0)
    with pytest.raises(UserError, match=r"does not arm .*battery"):
        there.vehicle.takeoff(10.0)


def test_a_hold_before_it_left_the_ground_is_not_waited_for_in_silence():
    there = LookAlike(5)
    pilot, since = there.sky.pilot, []

    def hold_it():
        if pilot.mode is PX4Mode.TAKEOFF and not pilot.state.airborne:
            since.append(there.now_s())
            if since[-1] - since[0] > 0.3:
                there.command(m.MAV_CMD_DO_SET_MODE, 1, *PX4Mode.HOLD.value)

    there.vehicle.link.others.append(hold_it)
    with pytest.raises(UserError, match="did not take off: it is in Hold"):
        there.vehicle.takeoff(10.0)
    assert there.now_s() - since[0] < 2.0


def beating(port, systems):
    """Vehicles with these ids that send heartbeats to a port, until ``close``."""
    over = threading.Event()

    def beat():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
            while not over.wait(0.1):
                for system in systems:
                    voice = m.MAVLink(None, srcSystem=system, srcComponent=1)
                    said = m.MAVLink_heartbeat_message(m.MAV_TYPE_QUADROTOR, m.MAV_AUTOPILOT_PX4, 81, 0, 3, 3)
                    radio.sendto(said.pack(voice), (LOOPBACK, port))

    threading.Thread(target=beat, daemon=True).start()
    return contextlib.closing(SimpleNamespace(close=over.set))


@pytest.mark.parametrize(
    ("system_id", "words"),
    [
        (None, "several vehicles answer; choose one: --system-id 1, 7"),
        (9, "--system-id 9: no such vehicle was heard"),
        (7, "the vehicle has no position"),
    ],
)
def test_several_vehicles_on_one_link_are_named(system_id, words):
    port = free_port()
    with beating(port, (1, 7)), pytest.raises(UserError, match=words):
        Px4Vehicle(f"udpin://{LOOPBACK}:{port}", scenario(), flat, 3.0, system_id)


def test_a_serial_port_that_is_not_there_is_named():
    with pytest.raises(UserError, match="there is no serial port /dev/ttyNOWHERE; "):
        Px4Vehicle("serial:///dev/ttyNOWHERE:57600", scenario(), flat, 3.0)


def test_nobody_there_is_said_after_the_time_given():
    started_s = time.monotonic()
    with pytest.raises(UserError, match=r"no vehicle was heard in 2 s"):
        Px4Vehicle(f"udpin://{LOOPBACK}:{free_port()}", scenario(), flat, 2.0)
    assert time.monotonic() - started_s < 10.0


def test_an_address_that_is_none_is_said():
    with pytest.raises(UserError, match=r"cannot be opened .* write udpin://"):
        Px4Vehicle("nonsense", scenario(), flat, 2.0)


@pytest.mark.parametrize(
    ("autopilot", "kind", "sentence"),
    [
        (m.MAV_AUTOPILOT_ARDUPILOTMEGA, m.MAV_TYPE_QUADROTOR, "firmware is not PX4"),
        (m.MAV_AUTOPILOT_PX4, m.MAV_TYPE_FIXED_WING, "not a multicopter"),
    ],
)
def test_what_this_program_cannot_fly_is_refused(autopilot, kind, sentence):
    port, over = free_port(), threading.Event()
    heard = []

    def beat():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
            radio.bind((LOOPBACK, 0))
            radio.setblocking(False)
            voice = m.MAVLink(None, srcSystem=1, srcComponent=1)
            while not over.wait(0.1):
                beat = m.MAVLink_heartbeat_message(kind, autopilot, 81, 0, 3, 3)
                radio.sendto(beat.pack(voice), (LOOPBACK, port))
                with contextlib.suppress(BlockingIOError):
                    heard.append(radio.recvfrom(65_535)[0])

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    with pytest.raises(UserError, match=sentence):
        Px4Vehicle(f"udpin://{LOOPBACK}:{port}", scenario(), flat, 20.0)
    over.set()
    thread.join()
    kinds = {int.from_bytes(datagram[7:10], "little") for datagram in heard}
    assert m.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED not in kinds


def test_a_vehicle_far_from_the_scenarios_home_is_refused():
    elsewhere = scenario(home={"latitude_deg": 60.5, "longitude_deg": 22.3})
    with served() as (_, (url,)), pytest.raises(UserError, match=r"stands 56\d\d m from .* write home"):
        Px4Vehicle(url, elsewhere, flat, 30.0)
