"""The fault table of docs/safety.md, second half: the vehicle's clock, numbers, battery and obedience."""

import math
import re
from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from test_faults import HOME, SCENARIO, Around, Drained, Flown, Misplaced, words

from skysweep.errors import UserError
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import CameraPose
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.mission.orders import Order
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.types import Setpoint
from skysweep.worlds.obstacles import known_obstacles

NAN = np.full(3, math.nan)
SINCE_S = 25.0


# ---- clock and states --------------------------------------------------------------------------------


class Clock(Around):
    """A vehicle that says another time than it is."""

    def __init__(self, inner, told, left=None):
        super().__init__(inner)
        self.told, self.left = told, left

    def state(self):
        state = self.inner.state()
        battery = self.left if self.left is not None and state.time_s > 70.0 else state.battery_remaining
        return state._replace(time_s=self.told(state.time_s), battery_remaining=battery)


def stands(until_s):
    return lambda t: SINCE_S if SINCE_S <= t < until_s else t


def goes_back(t):
    return t if t < 60.0 else t - 50.0


def test_a_clock_that_stands_still_is_waited_for():
    flown = Flown(vehicle=lambda inner: Clock(inner, stands(45.0)))
    assert flown.reason == "completed"
    assert flown.safety == [("telemetry silent", "HOLD"), ("telemetry silent", "CONTINUE")]
    flown.assert_found()
    flown.assert_landed_at_home()


def test_a_clock_that_stands_still_for_good_ends_the_search():
    flown = Flown(vehicle=lambda inner: Clock(inner, stands(math.inf)))
    assert flown.reason == "telemetry silent"
    assert flown.safety == [("telemetry silent", "HOLD"), ("telemetry silent", "RETURN")]
    flown.assert_landed_at_home()


def test_a_clock_that_goes_back_is_followed_and_said():
    flown = Flown(vehicle=lambda inner: Clock(inner, goes_back))
    assert flown.reason == "completed"
    assert flown.safety == [("clock", "CONTINUE")]
    assert "went back by 50 s" in flown.of_kind("safety")[0]["sentence"]
    times = [line["t"] for line in flown.of_kind("state")]
    assert times == sorted(times)
    flown.assert_found()
    flown.assert_landed_at_home()


@pytest.mark.parametrize("told", [stands(math.inf), goes_back])
def test_whatever_the_clock_does_an_empty_battery_is_seen(told):
    flown = Flown(vehicle=lambda inner: Clock(inner, told, left=0.04))
    assert ("battery critical", "LAND") in flown.safety
    assert not flown.embedded.state().airborne


class Repeated(Around):
    """A vehicle whose state is told again and again; it does as it is told."""

    def __init__(self, inner, until_s):
        super().__init__(inner)
        self.until_s, self.kept = until_s, None

    def state(self):
        state = self.inner.state()
        if not SINCE_S <= state.time_s < self.until_s:
            return state
        self.kept = self.kept or state
        return self.kept


def test_a_state_told_again_and_again_is_no_news():
    flown = Flown(vehicle=lambda inner: Repeated(inner, 45.0))
    assert flown.reason == "completed"
    assert flown.safety == [("telemetry silent", "HOLD"), ("telemetry silent", "CONTINUE")]
    flown.assert_found()
    flown.assert_landed_at_home()


def test_a_vehicle_not_heard_of_for_longer_than_its_battery_lasts_is_given_up():
    flown = Flown(vehicle=lambda inner: Repeated(inner, math.inf), battery_wh=20.0)
    assert flown.reason == "vehicle lost"
    assert flown.safety[-1] == ("vehicle lost", "LAND")
    assert flown.of_kind("landed") == []
    flown.embedded.advance(60.0)
    assert not flown.embedded.state().airborne
    assert np.linalg.norm(flown.embedded.true_position_enu_m[:2] - HOME) < 2.5


class OutOfOrder(Around):
    """A vehicle of which every third state is half a second old."""

    def __init__(self, inner):
        super().__init__(inner)
        self.past, self.ticks = deque(maxlen=6), 0

    def advance(self, duration_s):
        self.inner.advance(duration_s)
        self.past.append(self.inner.state())
        self.ticks += 1

    def state(self):
        return self.past[0] if self.ticks % 3 == 2 else self.inner.state()


def test_states_that_come_out_of_order_change_nothing_much():
    flown = Flown(vehicle=OutOfOrder)
    assert (flown.reason, flown.safety) == ("completed", [])
    times = [line["t"] for line in flown.of_kind("state")]
    assert times == sorted(times)
    flown.assert_found()
    flown.assert_landed_at_home()


class NoNumber(Around):
    """A vehicle whose estimate is NaN in a span of time."""

    def __init__(self, inner, what, until_s):
        super().__init__(inner)
        self.what, self.until_s = what, until_s

    def state(self):
        state = self.inner.state()
        if not SINCE_S <= state.time_s < self.until_s:
            return state
        if self.what == "position":
            camera = CameraPose(NAN, state.camera.R_camera_to_enu)
            return state._replace(position_enu_m=NAN, camera=camera)
        if self.what == "velocity":
            return state._replace(velocity_enu_mps=NAN)
        R = np.full((3, 3), math.nan)
        return state._replace(R_body_to_enu=R, camera=CameraPose(NAN, R))


@pytest.mark.parametrize("what", ["position", "velocity", "attitude"])
def test_an_estimate_that_is_no_number_is_a_lost_position(what):
    flown = Flown(vehicle=lambda inner: NoNumber(inner, what, 40.0))
    assert flown.reason == "completed"
    assert flown.safety == [("position lost", "HOLD"), ("position lost", "CONTINUE")]
    flown.assert_found()
    flown.assert_landed_at_home()


@pytest.mark.parametrize("what", ["position", "velocity", "attitude"])
def test_an_estimate_that_stays_no_number_makes_it_land(what):
    flown = Flown(vehicle=lambda inner: NoNumber(inner, what, math.inf))
    assert flown.reason == "position lost"
    assert flown.safety == [("position lost", "HOLD"), ("position lost", "LAND")]
    assert not flown.embedded.state().airborne


def test_without_a_position_it_stays_on_the_ground():
    class Nowhere(Around):
        def state(self):
            state = self.inner.state()
            camera = CameraPose(NAN, state.camera.R_camera_to_enu)
            return state._replace(position_enu_m=NAN, camera=camera)

    with pytest.raises(UserError, match="position: the vehicle has none"):
        Flown(vehicle=Nowhere)


# ---- position and height -----------------------------------------------------------------------------


class Raised(Misplaced):
    """A vehicle that believes to be ``by_m`` higher than it is in a span of time."""

    def __init__(self, inner, until_s, by_m=20.0):
        super().__init__(inner, SINCE_S, until_s)
        self.offset = np.array([0.0, 0.0, by_m])


def test_a_height_that_jumps_and_back_is_waited_for():
    flown = Flown(vehicle=lambda inner: Raised(inner, 35.0))
    assert flown.reason == "completed"
    assert flown.safety == [("position jump", "HOLD"), ("position jump", "CONTINUE")]
    flown.assert_found()
    flown.assert_landed_at_home()


def test_a_height_that_stays_elsewhere_brings_the_vehicle_home():
    flown = Flown(vehicle=lambda inner: Raised(inner, math.inf))
    assert flown.reason == "position jump"
    flown.assert_landed_at_home()


class Sinking(Raised):
    """A vehicle whose barometer drifts by 0.5 m/s; its rangefinder measures what is so."""

    def __init__(self, inner):
        super().__init__(inner, math.inf)

    def state(self):
        now_s = self.inner.state().time_s
        self.offset = np.array([0.0, 0.0, min(20.0, 0.5 * max(0.0, now_s - SINCE_S))])
        return super().state()._replace(ground_below_m=self.inner.true_position_enu_m[2])


def test_a_barometer_that_drifts_is_seen_by_the_rangefinder():
    flown = Flown(vehicle=Sinking, search={"n_c": math.inf}, area={"polygon_enu_m": WIDE})
    assert flown.reason == "height"
    assert flown.safety[:2] == [("height", "CONTINUE"), ("height", "RETURN")]
    assert flown.embedded.state().airborne is False


class Unheard(Sinking):
    """Its telemetry is silent for 4 s while the rangefinder disagrees, and then it is called home."""

    def state(self):
        state = super().state()
        return state._replace(silent_s=2.0) if 47.0 <= state.time_s < 51.0 else state


def test_what_is_not_looked_at_is_not_told_as_over():
    flown = Flown(vehicle=Unheard, search={"n_c": math.inf}, area={"polygon_enu_m": WIDE})
    assert flown.reason == "height"
    told = [line["sentence"] for line in flown.of_kind("safety")]
    assert "Telemetry is back." in told
    assert "The rangefinder agrees with the height again." not in told


class Ranging(Raised):
    """A vehicle with a rangefinder fixed to it, that meets crowns, roofs and ground; it may believe to be
    higher than it is, from the beginning."""

    def __init__(self, inner, obstacles, by_m):
        super().__init__(inner, math.inf, by_m)
        self.span, self.obstacles, self.told = (0.0, math.inf), obstacles, None

    def advance(self, duration_s):
        self.inner.advance(duration_s)
        self.told = None

    def state(self):
        self.told = self.told or super().state()._replace(ground_below_m=self.measured_m())
        return self.told

    def measured_m(self):
        up = self.inner.true_R_body_to_enu[:, 2]
        beam = self.inner.true_position_enu_m - np.arange(0.0, 50.0, 0.5)[:, None] * up
        ground_m = self.obstacles.terrain.height_m(beam[:, :2])
        met = beam[:, 2] <= np.maximum(self.obstacles.top_within_m(beam[:, :2], 0.0), ground_m)
        return 0.5 * int(np.argmax(met)) * up[2] if met.any() else None


def forest(lowest_m, highest_m):
    crowns = {"height_m": [lowest_m, highest_m], "crown_radius_m": [2.0, 3.0]}
    where = {"trees_per_hectare": 1000, "polygon_enu_m": SCENARIO["area"]["polygon_enu_m"]}
    return {"targets": [], "forests": [where | crowns]}


def houses(eaves_m, width_m):
    places = [[30.0, y] for y in (10.0, 35.0, 60.0)]
    return {
        "targets": [],
        "buildings": [
            {"position_enu_m": place, "size_m": [50.0, width_m], "height_m": eaves_m, "yaw_deg": yaw_deg}
            for place, yaw_deg in zip(places, (0.0, 20.0, 0.0), strict=True)
        ],
    }


def ranging(world, by_m):
    known = known_obstacles(Scenario.model_validate(SCENARIO | world))
    return Flown(vehicle=lambda inner: Ranging(inner, known, by_m), **world)


@pytest.mark.parametrize("world", [{"targets": []}, forest(14.0, 18.0), houses(8.0, 20.0)])
def test_a_rangefinder_over_known_trees_and_roofs_says_nothing(world):
    flown = ranging(world, 0.0)
    assert flown.reason == "completed"
    assert "height" not in [cause for cause, _ in flown.safety]
    flown.assert_landed_at_home()


@pytest.mark.parametrize("world", [{"targets": []}, forest(3.0, 6.0), houses(3.0, 8.0)])
def test_a_barometer_20_m_off_is_seen_by_the_rangefinder_over_trees_and_roofs_too(world):
    flown = ranging(world, 20.0)
    assert flown.reason == "height"
    told = [(cause, action) for cause, action in flown.safety if cause == "height"]
    assert told == [("height", "CONTINUE"), ("height", "RETURN")]
    assert re.search(
        r"rangefinder measures \d+ m down, not [\dto ]*[23]\d m", flown.of_kind("safety")[-1]["sentence"]
    )
    flown.assert_landed_at_home()


@pytest.mark.parametrize("by_m", [0.0, 20.0])
@pytest.mark.parametrize("name", ["buildings", "person-wilderness"])
def test_a_rangefinder_over_shipped_trees_and_roofs(name, by_m):
    mission, journal = build_mission(load_scenario(name), 0, Rig("statistical")), MemoryJournal()
    vehicle = Ranging(mission.vehicle, mission.obstacles, by_m)
    reason = fly(replace(mission, vehicle=vehicle), journal)
    told = [line for line in journal.lines if line["kind"] == "safety" and line["cause"] == "height"]
    if by_m == 0.0:
        assert reason != "height"  # the wilderness may be more than the battery lasts for
        assert told == []
        return
    assert (reason, [line["action"] for line in told]) == ("height", ["CONTINUE", "RETURN"])
    begun_s = next(line["t"] for line in journal.lines if line.get("mode") == "SCAN")
    assert [line["t"] - begun_s for line in told] == pytest.approx([3.0, 10.0], abs=1.5)


WIDE = [[0, 0], [150, 0], [150, 100], [0, 100]]


class LostInCheck(Around):
    """A vehicle without GNSS for ten seconds from the first time that it is low."""

    def __init__(self, inner):
        super().__init__(inner)
        self.low_s = math.inf

    def state(self):
        state = self.inner.state()
        if state.time_s > 30.0 and state.position_enu_m[2] < 8.0:
            self.low_s = min(self.low_s, state.time_s)
        lost = self.low_s <= state.time_s < self.low_s + 10.0
        return state._replace(position_std_m=math.inf) if lost else state


def test_gnss_that_is_lost_in_the_middle_of_a_check_is_waited_for():
    flown = Flown(vehicle=LostInCheck)
    assert flown.reason == "completed"
    assert flown.safety == [("position lost", "HOLD"), ("position lost", "CONTINUE")]
    assert flown.of_kind("rejected") == []
    flown.assert_found()
    flown.assert_landed_at_home()


class Drifting(Around):
    """A vehicle that is carried 15 m east by its take-off."""

    def advance(self, duration_s):
        if self.inner.state().time_s < 15.0:
            self.inner._x["target_position"][0] += duration_s
        self.inner.advance(duration_s)


def test_a_take_off_that_drifts_is_made_up_for():
    flown = Flown(vehicle=Drifting)
    assert max(line["p"][0] for line in flown.of_kind("state") if line["mode"] == "TAKEOFF") > HOME[0] + 10.0
    assert (flown.reason, flown.safety) == ("completed", [])
    flown.assert_found()
    flown.assert_landed_at_home()


@pytest.mark.parametrize("height_m", [6.0, 20.0])
def test_a_slope_is_landed_on(height_m):
    """The embedded vehicle does not tip over."""
    flown = Flown(terrain={"hills_height_m": height_m, "hills_wavelength_m": 60.0, "seed": 1})
    assert (flown.reason, flown.safety) == ("completed", [])
    flown.assert_found()
    flown.assert_landed_at_home()


# ---- battery -----------------------------------------------------------------------------------------


class Mute(Around):
    """A vehicle that does not say how full its battery is in a span of time."""

    def __init__(self, inner, since_s, until_s):
        super().__init__(inner)
        self.span = since_s, until_s

    def state(self):
        state = self.inner.state()
        silent = self.span[0] <= state.time_s < self.span[1]
        return state._replace(battery_remaining=math.nan) if silent else state


def test_a_battery_not_told_of_for_a_while_is_waited_for():
    flown = Flown(vehicle=lambda inner: Mute(inner, SINCE_S, 45.0))
    assert flown.reason == "completed"
    assert flown.safety == [("battery unknown", "CONTINUE"), ("battery unknown", "CONTINUE")]
    flown.assert_found()
    flown.assert_landed_at_home()


def test_a_battery_that_nobody_knows_any_more_brings_the_vehicle_home():
    flown = Flown(vehicle=lambda inner: Mute(inner, SINCE_S, math.inf))
    assert flown.reason == "battery unknown"
    assert flown.safety == [("battery unknown", "CONTINUE"), ("battery unknown", "RETURN")]
    flown.assert_landed_at_home()


def test_a_battery_that_was_never_told_of_needs_a_word():
    with pytest.raises(UserError, match=r"battery: .* write safety\.battery_estimated: true"):
        Flown(vehicle=lambda inner: Mute(inner, 0.0, math.inf))
    flown = Flown(vehicle=lambda inner: Mute(inner, 0.0, math.inf), safety={"battery_estimated": True})
    assert (flown.reason, flown.safety) == ("completed", [("battery unknown", "CONTINUE")])
    flown.assert_found()
    flown.assert_landed_at_home()


class Sags(Drained):
    """A vehicle whose battery shows ``left`` for three seconds."""

    def __init__(self, inner, left):
        super().__init__(inner, left)
        self.since_s = None

    def state(self):
        state = super().state()
        if self.low:
            self.since_s = self.since_s or state.time_s
        over = self.since_s is not None and state.time_s > self.since_s + 3.0
        return self.inner.state() if over else state


def test_a_battery_that_sags_is_not_trusted_again():
    flown = Flown(vehicle=lambda inner: Sags(inner, 0.14))
    assert flown.reason == "low battery"
    flown.assert_landed_at_home()


# ---- obedience ---------------------------------------------------------------------------------------


class Deaf(Around):
    """A vehicle that ignores setpoints in a span of time, and hovers."""

    def __init__(self, inner, until_s):
        super().__init__(inner)
        self.until_s = until_s

    @property
    def is_deaf(self):
        return SINCE_S <= self.inner.state().time_s < self.until_s

    def advance(self, duration_s):
        before = self.is_deaf
        self.inner.advance(duration_s)
        if self.is_deaf and not before:
            self.inner.hold()

    def command(self, setpoint):
        if not self.is_deaf:
            self.inner.command(setpoint)


def test_setpoints_that_are_ignored_for_a_while_are_said():
    flown = Flown(vehicle=lambda inner: Deaf(inner, 60.0))
    assert flown.reason == "completed"
    assert flown.safety == [("setpoints ignored", "CONTINUE")] * 2
    flown.assert_found()
    flown.assert_landed_at_home()


def test_setpoints_that_are_ignored_for_good_make_it_land():
    flown = Flown(vehicle=lambda inner: Deaf(inner, math.inf))
    assert flown.reason == "setpoints ignored"
    assert flown.safety == [
        ("setpoints ignored", "CONTINUE"),
        ("setpoints ignored", "RETURN"),
        ("no way home", "LAND"),
    ]
    assert not flown.embedded.state().airborne
    assert flown.modes[-1][0] < SINCE_S + 200.0


class Twisted(Around):
    """A vehicle whose nose points a radian to the left of where it is told."""

    def command(self, setpoint):
        wrong = self.inner.state().time_s > SINCE_S
        self.inner.command(setpoint._replace(yaw_rad=setpoint.yaw_rad + 1.0) if wrong else setpoint)


def test_a_nose_that_does_not_follow_brings_the_vehicle_home():
    flown = Flown(vehicle=Twisted)
    assert flown.reason == "turned away"
    assert flown.safety[:2] == [("turned away", "CONTINUE"), ("turned away", "RETURN")]
    assert "57 degrees" in flown.of_kind("safety")[0]["sentence"]
    flown.assert_landed_at_home()


class TooHeavy(Around):
    """A vehicle that cannot lift its payload higher than 12 m."""

    def takeoff(self, altitude_agl_m):
        self.inner.takeoff(min(altitude_agl_m, 12.0))


def test_a_payload_that_is_too_heavy_makes_it_land():
    flown = Flown(vehicle=TooHeavy)
    assert (flown.reason, flown.safety) == ("take-off", [("take-off", "LAND")])
    flown.assert_landed_at_home()


class Weak(Around):
    """A vehicle with a rotor that gives less and less: it sinks by 0.2 m/s and nothing lifts it."""

    def __init__(self, inner):
        super().__init__(inner)
        self.wanted, self.lands = None, False

    def command(self, setpoint):
        self.wanted = setpoint

    def land(self):
        self.lands = True
        self.inner.land()

    def advance(self, duration_s):
        if self.wanted is not None and not self.lands:
            highest_m = 30.0 - 0.2 * max(0.0, self.inner.state().time_s - SINCE_S)
            x, y, z = self.wanted.position_enu_m
            self.inner.command(self.wanted._replace(position_enu_m=np.array([x, y, min(z, highest_m)])))
        self.inner.advance(duration_s)


def test_a_vehicle_that_cannot_keep_its_height_comes_home():
    flown = Flown(vehicle=Weak)
    assert flown.reason == "setpoints ignored"
    assert flown.safety[:2] == [("setpoints ignored", "CONTINUE"), ("setpoints ignored", "RETURN")]
    flown.assert_landed_at_home()


def test_gusts_are_flown_through():
    flown = Flown(wind={"mean_speed_mps": 5.0, "from_heading_deg": 200.0, "gust_std_mps": 3.0})
    assert flown.reason == "completed"
    flown.assert_found()
    flown.assert_landed_at_home()


class Carried(Around):
    """A vehicle that is carried off to the west, and comes back when it is called home."""

    def __init__(self, inner):
        super().__init__(inner)
        self.called = False

    def command(self, setpoint):
        self.called |= self.inner.state().time_s > SINCE_S and bool(
            np.linalg.norm(setpoint.position_enu_m[:2] - HOME) < 0.1
        )
        if not self.called and self.inner.state().time_s > SINCE_S:
            setpoint = Setpoint(np.array([-200.0, 0.0, 30.0]), 5.0, setpoint.yaw_rad)
        self.inner.command(setpoint)


def test_a_vehicle_beyond_the_margin_around_the_area_is_called_home():
    flown = Flown(vehicle=Carried)
    assert flown.reason == "geofence"
    assert min(line["p"][0] for line in flown.of_kind("state")) > HOME[0] - 30.0 - 5.0 - 15.0
    flown.assert_landed_at_home()


def test_a_vehicle_may_take_off_beyond_the_margin_around_the_area():
    away = Scenario.model_validate(SCENARIO | {"home": {"position_enu_m": [-65, -5]}})
    flown = Flown(vehicle=lambda _: build_mission(away, 0, Rig("statistical")).vehicle)
    assert (flown.reason, flown.safety) == ("completed", [])


# ---- landing, operator, disk -------------------------------------------------------------------------


class HardToLand(Around):
    """A vehicle that hovers instead of landing, as often as it says; it knows whether it was told to."""

    def __init__(self, inner, misses):
        super().__init__(inner)
        self.misses, self.orders = misses, 0

    def land(self):
        self.orders += 1
        if self.orders > self.misses:
            self.inner.land()
        else:
            self.inner.hold()


def test_an_order_to_land_that_was_not_done_is_given_again():
    flown = Flown(vehicle=lambda inner: HardToLand(inner, 1))
    assert (flown.reason, flown.safety) == ("completed", [("landing", "LAND")])
    flown.assert_landed_at_home()


class Flickers(Around):
    """A land detector that says *landed* for 0.6 s in the middle of the landing."""

    landing_s = math.inf

    def land(self):
        self.landing_s = self.inner.state().time_s
        self.inner.land()

    def state(self):
        state = self.inner.state()
        flickers = 2.0 < state.time_s - self.landing_s < 2.6
        return state._replace(airborne=False) if flickers else state


def test_a_land_detector_that_flickers_ends_no_landing():
    flown = Flown(vehicle=Flickers)
    assert (flown.reason, flown.safety) == ("completed", [])
    flown.assert_landed_at_home()


def test_a_landing_that_never_ends_is_given_up_with_a_word():
    flown = Flown(vehicle=lambda inner: HardToLand(inner, math.inf))
    assert flown.reason == "landing"
    assert flown.safety == [("landing", "LAND")] * 3
    assert flown.of_kind("safety")[-1]["sentence"].endswith("take over by hand.")
    assert flown.of_kind("landed") == []
    assert flown.lines[-1]["kind"] == "end"


def test_an_operator_who_holds_and_never_comes_back():
    flown = Flown(operator=words((300, "hold")), battery_wh=15.0)
    assert flown.reason in ("low battery", "return energy")
    assert flown.safety[0] == ("operator", "HOLD")
    flown.assert_landed_at_home()


@pytest.mark.parametrize("mute", [False, True])
def test_an_operator_who_holds_the_way_home_and_never_comes_back(mute):
    flies, told = [], [(SINCE_S + 2.0, "hold"), (SINCE_S, "return")]

    def vehicle(inner):
        flies.append(Mute(inner, 0.0 if mute else math.inf, math.inf))
        return flies[0]

    def operator():
        due = flies and told and flies[0].inner.state().time_s > told[-1][0]
        return Order(told.pop()[1]) if due else None

    flown = Flown(vehicle=vehicle, operator=operator, battery_wh=15.0, safety={"battery_estimated": mute})
    assert flown.reason == "operator"
    assert ("operator", "HOLD") in flown.safety
    assert flown.seconds_in("RETURN") > 60.0
    assert "LAND" not in [action for _, action in flown.safety]
    flown.assert_landed_at_home()


class Watcher:
    """Says hold when a landing vehicle is lower than 8 m, and another word 20 s later."""

    def __init__(self, word):
        self.word, self.vehicle, self.held_s, self.heights = word, None, None, []

    def see(self, inner):
        self.vehicle = HardToLand(inner, 0)
        return self.vehicle

    def __call__(self):
        if not (self.vehicle and self.vehicle.orders):
            return None
        state = self.vehicle.inner.state()
        if self.held_s is None and state.position_enu_m[2] < 8.0:
            self.held_s = state.time_s
            return Order("hold")
        if self.held_s is None or self.word is None:
            return None
        if state.time_s > self.held_s + 20.0:
            word, self.word = self.word, None
            return Order(word)
        self.heights.append(state.position_enu_m[2])
        return None


@pytest.mark.parametrize("word", ["continue", "return"])
def test_the_operator_is_heard_while_it_lands(word):
    watcher = Watcher(word)
    flown = Flown(vehicle=watcher.see, operator=watcher)
    assert flown.reason == "completed"
    assert flown.safety == [("operator", "HOLD"), ("operator", "CONTINUE")]
    assert min(watcher.heights) > 5.0
    assert len(watcher.heights) > 150
    flown.assert_landed_at_home()


class Refuses(HardToLand):
    """A vehicle that refuses to be commanded once it lands."""

    def command(self, setpoint):
        if self.orders:
            raise UserError("the vehicle does not go into Offboard")
        self.inner.command(setpoint)


def test_a_vehicle_that_refuses_to_be_held_goes_on_landing():
    watcher = Watcher(None)

    def vehicle(inner):
        watcher.vehicle = Refuses(inner, 0)
        return watcher.vehicle

    flown = Flown(vehicle=vehicle, operator=watcher)
    assert flown.reason == "completed"
    assert "does not go into Offboard" in flown.of_kind("safety")[1]["sentence"]
    flown.assert_landed_at_home()


def test_an_operator_who_holds_a_landing_and_never_comes_back():
    watcher = Watcher(None)
    flown = Flown(vehicle=watcher.see, operator=watcher, battery_wh=25.0)
    assert flown.safety[:3] == [("operator", "HOLD"), ("landing energy", "LAND"), ("operator", "CONTINUE")]
    assert flown.embedded.state().battery_remaining > 0.04
    flown.assert_landed_at_home()


class SlowDisk(MemoryJournal):
    """A journal that takes five seconds of the vehicle's time for each candidate."""

    def __init__(self, vehicle):
        super().__init__()
        self.vehicle = vehicle

    def write(self, time_s, kind, **fields):
        super().write(time_s, kind, **fields)
        if kind == "scanned":
            self.vehicle.advance(5.0)


def test_a_disk_that_takes_five_seconds_costs_time_but_no_target():
    flown = Flown(journal=SlowDisk)
    assert flown.reason == "completed"
    flown.assert_found()
    flown.assert_landed_at_home()
