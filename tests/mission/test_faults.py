"""The fault table of docs/safety.md: each fault is put around the real part, and the mission stays safe.

No target is lost: it is confirmed, or its place is reported as unchecked.
"""

import itertools
import math
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import Lens, project
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.mission.orders import CONTINUE, Order
from skysweep.scenarios.model import Scenario
from skysweep.sensing.exposures import Exposures
from skysweep.sensing.imaging import ImagingSensor
from skysweep.types import Detections, Frame, Setpoint

SCENARIO = {
    "name": "faults",
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 70], [0, 70]]},
    "home": {"position_enu_m": [-5, -5]},
    "targets": [
        {"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9},
        {"class": "stop sign", "position_enu_m": [45, 55], "size_m": 0.9},
    ],
    "camera": {"hfov_rad": 1.2},
    "search": {"n_c": 1, "check_speed_mps": 2.0},
}
LENS = Lens(640, 360, 1.2)
HOME = np.array(SCENARIO["home"]["position_enu_m"], dtype=float)


class Around:
    """A part with another one inside; what is not overridden is the inner part's."""

    def __init__(self, inner):
        self.inner = inner

    def __getattr__(self, name):
        return getattr(self.inner, name)


class Flown:
    """A mission with faults around its parts, and what its journal tells."""

    def __init__(
        self, vehicle=None, sensor=None, operator=None, journal=None, seed=0, battery_wh=98.0, **changes
    ):
        scenario = SCENARIO | {"vehicle": {"battery_wh": battery_wh}} | changes
        mission = build_mission(Scenario.model_validate(scenario), seed, Rig("statistical"))
        self.embedded = mission.vehicle
        if vehicle is not None:
            mission = replace(mission, vehicle=vehicle(mission.vehicle))
        if sensor is not None:
            mission = replace(mission, sensor=sensor(mission.sensor))
        self.modes = []
        journal = MemoryJournal() if journal is None else journal(self.embedded)
        self.reason = fly(
            mission,
            journal,
            lambda state, mode, _: self.modes.append((state.time_s, mode)),
            operator or (lambda: None),
        )
        self.lines = journal.lines

    def of_kind(self, kind):
        return [line for line in self.lines if line["kind"] == kind]

    @property
    def safety(self):
        """(cause, action) in order."""
        return [(line["cause"], line["action"]) for line in self.of_kind("safety")]

    def seconds_in(self, mode):
        return 0.1 * sum(m == mode for _, m in self.modes)

    def places(self, kind):
        return np.array([line["p"][:2] for line in self.of_kind(kind)]).reshape(-1, 2)

    def assert_found(self):
        for target in SCENARIO["targets"]:
            gaps = self.places("confirmed") - target["position_enu_m"]
            assert np.hypot(*gaps.T).min(initial=np.inf) < 1.5, f"{target} was not confirmed"

    def assert_landed_at_home(self):
        assert len(self.of_kind("landed")) == 1
        assert not self.embedded.state().airborne
        assert np.linalg.norm(self.embedded.true_position_enu_m[:2] - HOME) < 2.5


@pytest.fixture(scope="module")
def untroubled():
    return Flown()


def test_without_faults_safety_says_nothing(untroubled):
    assert untroubled.reason == "completed"
    assert untroubled.safety == []
    untroubled.assert_found()
    untroubled.assert_landed_at_home()


# ---- the detector ------------------------------------------------------------------------------------


class LosesLooks(Around):
    """A sensor whose answers fail in a span of vehicle time: it raises, or says nothing."""

    def __init__(self, inner, since_s, until_s=math.inf, error=None):
        super().__init__(inner)
        self.span, self.error = (since_s, until_s), error

    def sense(self, state):
        found = self.inner.sense(state)
        if found is not None and self.span[0] <= found.time_s < self.span[1]:
            if self.error is not None:
                raise self.error
            return None
        return found


@pytest.mark.parametrize("error", [RuntimeError("out of memory"), ValueError("boxes are not finite"), None])
def test_a_detector_that_fails_for_a_while_costs_time_but_no_target(error, untroubled):
    flown = Flown(sensor=lambda inner: LosesLooks(inner, 20.0, 40.0, error))
    assert flown.reason == "completed"
    flown.assert_found()
    flown.assert_landed_at_home()
    assert flown.safety == [("detector silent", "CONTINUE"), ("detector silent", "CONTINUE")]
    (blind,) = flown.of_kind("unsearched")
    assert blind["length_m"] > 40.0
    first = flown.of_kind("safety")[0]["sentence"]
    assert error is None or str(error) in first
    assert flown.modes[-1][0] > untroubled.modes[-1][0] + 10.0


def test_a_flown_blind_leg_is_flown_again():
    nothing_seen = {"targets": [], "detector": {"confidence_min": 0.9}}
    flown = Flown(sensor=lambda inner: LosesLooks(inner, 20.0, 40.0), **nothing_seen)
    (blind,) = flown.of_kind("unsearched")
    after = [
        line["p"] for line in flown.of_kind("state") if line["mode"] == "SCAN" and line["t"] > blind["t"]
    ]
    for leg in blind["legs_enu_m"]:
        for end in leg:
            assert min(math.dist(end, p[:2]) for p in after) < 3.0


def test_a_single_failure_changes_nothing_but_that_look():
    flown = Flown(sensor=lambda inner: LosesLooks(inner, 30.0, 30.3, RuntimeError("hiccup")))
    assert flown.reason == "completed"
    assert flown.safety == []
    flown.assert_found()


def test_a_detector_that_stays_dead_brings_the_vehicle_home():
    flown = Flown(sensor=lambda inner: LosesLooks(inner, 25.0), area=WIDE)
    assert flown.reason == "detector silent"
    assert flown.safety == [("detector silent", "CONTINUE"), ("detector silent", "RETURN")]
    flown.assert_landed_at_home()
    returned_s = next(t for t, mode in flown.modes if mode == "RETURN")
    assert returned_s == pytest.approx(25.0 + 60.0, abs=3.0)


def test_a_detector_that_dies_in_a_small_area_is_waited_for_then_given_up():
    flown = Flown(sensor=lambda inner: LosesLooks(inner, 25.0))
    assert flown.reason == "detector silent"
    assert flown.of_kind("finished") == []
    flown.assert_landed_at_home()


def test_a_detector_that_dies_above_a_candidate_does_not_reject_it():
    checked_s = next(line["t"] for line in Flown().of_kind("check_started"))
    flown = Flown(sensor=lambda inner: LosesLooks(inner, checked_s))
    assert flown.reason == "detector silent"
    assert flown.of_kind("rejected") == []
    gaps = flown.places("unchecked") - SCENARIO["targets"][0]["position_enu_m"]
    assert np.hypot(*gaps.T).min() < 3.0
    flown.assert_landed_at_home()


class Late(Around):
    """A sensor whose answers come ``by_s`` later than they should."""

    def __init__(self, inner, by_s):
        super().__init__(inner)
        self.by_s, self.answers = by_s, []

    def sense(self, state):
        found = self.inner.sense(state)
        if found is not None:
            self.answers.append((state.time_s + self.by_s, found))
        if self.answers and self.answers[0][0] <= state.time_s:
            return self.answers.pop(0)[1]
        return None


def test_answers_five_seconds_late_lose_nothing():
    flown = Flown(sensor=lambda inner: Late(inner, 5.0))
    assert flown.reason == "completed"
    assert flown.safety[0] == ("detector silent", "CONTINUE")
    assert flown.of_kind("unsearched") == []
    flown.assert_found()
    flown.assert_landed_at_home()


class Shuffled(Around):
    """A sensor that answers every look twice, and every other pair of looks in the wrong order."""

    def __init__(self, inner):
        super().__init__(inner)
        self.kept, self.queue, self.n = [], [], 0

    def sense(self, state):
        found = self.inner.sense(state)
        if found is not None:
            self.kept.append(found)
        if len(self.kept) == 2:
            first, second = self.kept
            self.kept, self.n = [], self.n + 1
            self.queue += [first, first, second, second] if self.n % 2 else [second, first, first, second]
        return self.queue.pop(0) if self.queue else None


def test_duplicated_and_swapped_frames_count_once():
    flown = Flown(sensor=Shuffled)
    assert flown.reason == "completed"
    flown.assert_found()
    exposures = [(line["t"], line["candidate"]) for line in flown.of_kind("sighting")]
    assert len(exposures) == len(set(exposures))
    assert any(a[0] > b[0] for a, b in itertools.pairwise(exposures)), "nothing was swapped"


def test_a_picture_with_a_wrong_date_does_not_count():
    class WrongClock(Around):
        def sense(self, state):
            found = self.inner.sense(state)
            if found is not None and 20.0 <= state.time_s < 30.0:
                return replace(found, time_s=found.time_s + 3600.0)
            return found

    flown = Flown(sensor=WrongClock)
    assert flown.reason == "completed"
    assert "+3600 s" in flown.of_kind("safety")[0]["sentence"]
    flown.assert_found()


RELEASED = threading.Event()  # of the detector that hangs


class BlankCamera:
    """Takes pictures that show nothing, in no time; from 30 s on the detector that hangs is released."""

    renderer = None

    def capture(self, state):
        if state.time_s >= 30.0:
            RELEASED.set()
        return Frame(state.time_s, np.zeros((2, 2, 3), np.uint8), state.camera, LENS)

    def close(self):
        pass


class Detector:
    """Knows where the targets are, and goes wrong in its own way in a span of time."""

    class_names = ("stop sign",)

    def __init__(self, wrong, since_s=20.0, until_s=40.0):
        self.wrong, self.span = wrong, (since_s, until_s)

    def detect(self, frame):
        if self.span[0] <= frame.time_s < self.span[1]:
            boxes = self.wrong()
            return Detections(
                frame.time_s,
                boxes,
                np.full(len(boxes), 0.99),
                ("stop sign",) * len(boxes),
                frame.camera,
                LENS,
            )
        places = np.array([[*target["position_enu_m"], 0.0] for target in SCENARIO["targets"]])
        pixels, depth = project(LENS, frame.camera, places)
        inside = (depth > 0) & (np.abs(pixels - (320, 180)) < (310, 170)).all(axis=1)
        seen, half = pixels[inside], LENS.pixels_on_target(0.45, depth[inside])[:, None]
        return Detections(
            frame.time_s,
            np.column_stack([seen - half, seen + half]),
            np.full(len(seen), 0.99),
            ("stop sign",) * len(seen),
            frame.camera,
            LENS,
        )


def runs_out_of_memory():
    raise MemoryError("out of memory")


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (runs_out_of_memory, "MemoryError: out of memory"),
        (lambda: np.full((1, 4), np.nan), "not finite"),
        (lambda: np.zeros((2, 3)), "do not match"),
        (lambda: np.zeros((1, 4)), "a box has no extent"),
        (lambda: np.tile([0.0, 0.0, 9.0, 9.0], (2000, 1)), "2000 boxes in one picture, more than 300"),
        (RELEASED.wait, "no answer"),
    ],
    ids=["raises", "NaN boxes", "no boxes", "empty boxes", "thousands of boxes", "hangs"],
)
def test_a_detector_that_goes_wrong_in_its_own_thread(wrong, says):
    RELEASED.clear()

    def imaging(_):
        scenario = Scenario.model_validate(SCENARIO)
        exposures = Exposures(scenario.detector.rate_hz, scenario.camera.pose_delay_s)
        detector = Detector(wrong, 20.0, 20.5 if says == "no answer" else 40.0)
        return ImagingSensor(
            BlankCamera(),
            detector,
            exposures,
            scenario.camera.latency_s,
            patience_s=0.3 if says == "no answer" else 60.0,
        )

    flown = Flown(sensor=imaging)
    assert flown.reason == "completed"
    assert says in flown.of_kind("safety")[0]["sentence"]
    flown.assert_found()
    flown.assert_landed_at_home()


# ---- link and clock ----------------------------------------------------------------------------------


class LosesLink(Around):
    """A vehicle that is cut off: telemetry stands still, commands are lost, and it holds after a second."""

    def __init__(self, inner, since_s, for_s):
        super().__init__(inner)
        self.since_s, self.for_s, self.last, self.held = since_s, for_s, None, False

    def cut_off(self):
        return self.since_s <= self.inner.state().time_s < self.since_s + self.for_s

    def state(self):
        now = self.inner.state()
        if not self.cut_off():
            self.last = now
            return now
        return self.last._replace(silent_s=now.time_s - self.last.time_s)

    def command(self, setpoint):
        if not self.cut_off():
            self.inner.command(setpoint)

    def hold(self):
        if not self.cut_off():
            self.inner.hold()

    def land(self):
        if not self.cut_off():
            self.inner.land()

    def advance(self, duration_s):
        self.inner.advance(duration_s)
        if self.cut_off() and not self.held and self.inner.state().time_s > self.since_s + 1.0:
            self.held = True
            self.inner.hold()


@pytest.mark.parametrize(
    ("lost_s", "events"),
    [
        (0.5, []),
        (1.5, [("telemetry silent", "HOLD"), ("telemetry silent", "CONTINUE")]),
        (30.0, [("telemetry silent", "HOLD"), ("telemetry silent", "CONTINUE")]),
    ],
)
def test_a_lost_link_is_waited_for(lost_s, events):
    flown = Flown(vehicle=lambda inner: LosesLink(inner, 25.0, lost_s))
    assert flown.reason == "completed"
    assert flown.safety == events
    flown.assert_found()
    flown.assert_landed_at_home()


def test_a_link_lost_for_long_ends_the_search():
    flown = Flown(vehicle=lambda inner: LosesLink(inner, 25.0, 90.0))
    assert flown.reason == "telemetry silent"
    assert ("telemetry silent", "RETURN") in flown.safety
    flown.assert_landed_at_home()


@pytest.mark.parametrize("jump_s", [3600.0, -3600.0])
def test_a_jump_of_the_wall_clock_changes_nothing(monkeypatch, untroubled, jump_s):
    true_time, started_s = time.time, time.time()
    monkeypatch.setattr(
        time, "time", lambda: true_time() + (jump_s if true_time() > started_s + 0.05 else 0.0)
    )
    assert Flown().lines == untroubled.lines


# ---- position, wind, battery -------------------------------------------------------------------------


class Misplaced(Around):
    """A vehicle that believes to be ``offset_m`` elsewhere, or nowhere, in a span of time."""

    def __init__(self, inner, since_s, until_s, offset_m=(0.0, 0.0), std_m=0.0):
        super().__init__(inner)
        self.span, self.std_m = (since_s, until_s), std_m
        self.offset = np.array([*offset_m, 0.0])

    def state(self):
        state = self.inner.state()
        if not self.span[0] <= state.time_s < self.span[1]:
            return state
        camera = state.camera._replace(position_enu_m=state.camera.position_enu_m + self.offset)
        return state._replace(
            position_enu_m=state.position_enu_m + self.offset, camera=camera, position_std_m=self.std_m
        )

    def command(self, setpoint):
        if self.span[0] <= self.inner.state().time_s < self.span[1]:
            setpoint = setpoint._replace(position_enu_m=setpoint.position_enu_m - self.offset)
        self.inner.command(setpoint)


def test_a_position_that_jumps_by_50_m_and_back_is_waited_for():
    flown = Flown(vehicle=lambda inner: Misplaced(inner, 25.0, 35.0, (30.0, -40.0)))
    assert flown.reason == "completed"
    assert flown.safety[:2] == [("position jump", "HOLD"), ("position jump", "CONTINUE")]
    assert flown.seconds_in("HOLD") == pytest.approx(10.0, abs=1.5)
    flown.assert_found()
    flown.assert_landed_at_home()
    for line in flown.of_kind("sighting"):
        assert not 25.0 < line["t"] < 35.0, "seen from who knows where"


def test_a_position_that_stays_displaced_brings_the_vehicle_home():
    flown = Flown(vehicle=lambda inner: Misplaced(inner, 25.0, math.inf, (30.0, -40.0)))
    assert flown.reason == "position jump"
    assert flown.safety[:2] == [("position jump", "HOLD"), ("position jump", "RETURN")]
    assert len(flown.of_kind("landed")) == 1
    believed = flown.embedded.true_position_enu_m[:2] + np.array([30.0, -40.0])
    assert np.linalg.norm(believed - HOME) < 2.5


def test_a_lost_position_that_comes_back_is_waited_for():
    flown = Flown(vehicle=lambda inner: Misplaced(inner, 25.0, 40.0, std_m=math.inf))
    assert flown.reason == "completed"
    assert flown.safety[:2] == [("position lost", "HOLD"), ("position lost", "CONTINUE")]
    flown.assert_found()
    flown.assert_landed_at_home()


def test_a_position_that_stays_lost_makes_it_land():
    flown = Flown(vehicle=lambda inner: Misplaced(inner, 25.0, math.inf, std_m=math.inf))
    assert flown.reason == "position lost"
    assert flown.safety == [("position lost", "HOLD"), ("position lost", "LAND")]
    assert flown.seconds_in("RETURN") == 0.0
    assert not flown.embedded.state().airborne


class Blown(Around):
    """A vehicle in a wind that its estimator sees rise, and the air does too, in a span of time."""

    def __init__(self, inner, since_s, until_s, speed_mps):
        super().__init__(inner)
        self.span, self.speed_mps = (since_s, until_s), speed_mps

    def state(self):
        state = self.inner.state()
        if self.span[0] <= state.time_s < self.span[1]:
            return state._replace(wind_enu_mps=np.array([self.speed_mps, 0.0, 0.0]))
        return state


def test_a_storm_that_passes_is_waited_for():
    flown = Flown(vehicle=lambda inner: Blown(inner, 25.0, 50.0, 12.0))
    assert flown.reason == "completed"
    assert flown.safety == [("wind", "HOLD"), ("wind", "CONTINUE")]
    flown.assert_found()
    flown.assert_landed_at_home()


def test_a_storm_that_stays_ends_the_search():
    flown = Flown(vehicle=lambda inner: Blown(inner, 25.0, math.inf, 12.0))
    assert flown.reason == "wind"
    assert flown.safety[:2] == [("wind", "HOLD"), ("wind", "RETURN")]
    flown.assert_landed_at_home()


def test_wind_above_cruise_speed_is_flown_while_the_air_speed_lasts():
    flown = Flown(wind={"mean_speed_mps": 6.5, "from_heading_deg": 200.0, "gust_std_mps": 0.3})
    assert flown.reason == "completed"
    flown.assert_found()
    flown.assert_landed_at_home()


def test_wind_above_the_limit_keeps_it_on_the_ground():
    with pytest.raises(UserError, match=r"wind: blows at 12\.0 m/s, above safety\.wind_max_mps \(9\)"):
        Flown(wind={"mean_speed_mps": 12.0})


def test_a_wind_that_carries_it_away_makes_it_land():
    """The way home leads nowhere."""

    class CarriedAway(Around):
        def state(self):
            state = self.inner.state()
            if state.time_s < 25.0:
                return state
            return state._replace(wind_enu_mps=np.array([12.0, 0.0, 0.0]))

        def command(self, setpoint):
            if self.inner.state().time_s > 25.0:
                here = self.inner.state().position_enu_m
                setpoint = setpoint._replace(position_enu_m=here + np.array([5.0, 0.0, 0.0]))
            self.inner.command(setpoint)

    flown = Flown(vehicle=CarriedAway)
    assert ("no way home", "LAND") in flown.safety
    assert not flown.embedded.state().airborne


class Drained(Around):
    """A vehicle whose battery shows ``left`` from the first time that it is low in a CHECK."""

    def __init__(self, inner, left):
        super().__init__(inner)
        self.left, self.low = left, False

    def state(self):
        state = self.inner.state()
        self.low |= state.time_s > 30.0 and state.position_enu_m[2] < 8.0
        return state._replace(battery_remaining=self.left) if self.low else state


@pytest.mark.parametrize(("left", "action"), [(0.14, "RETURN"), (0.04, "LAND")])
def test_a_battery_that_gets_low_in_the_middle_of_a_check(left, action):
    flown = Flown(vehicle=lambda inner: Drained(inner, left), search={"n_c": math.inf})
    cause = "low battery" if action == "RETURN" else "battery critical"
    assert flown.reason == cause
    assert (cause, action) in flown.safety
    modes = [mode for _, mode in flown.modes]
    assert modes[modes.index("CHECK") :].count("SCAN") == 0
    known = np.concatenate([flown.places("unchecked"), flown.places("confirmed")])
    for target in SCENARIO["targets"]:
        assert np.hypot(*(known - target["position_enu_m"]).T).min() < 3.0
    if action == "RETURN":
        flown.assert_landed_at_home()
    else:
        assert "RETURN" not in modes
        assert not flown.embedded.state().airborne


# ---- the operator ------------------------------------------------------------------------------------


def words(*told):
    """An operator who says each word at its step."""
    return ordering(*((step, Order(word)) for step, word in told))


def ordering(*orders):
    """An operator who gives each order at its step."""
    steps = iter(range(10**9))
    at = dict(orders)
    return lambda: at.get(next(steps))


def test_the_operator_holds_and_lets_go_on():
    flown = Flown(operator=words((300, "hold"), (400, "continue")))
    assert flown.reason == "completed"
    assert flown.safety == [("operator", "HOLD"), ("operator", "CONTINUE")]
    assert flown.seconds_in("HOLD") == pytest.approx(10.0, abs=0.5)
    flown.assert_found()


def test_the_operator_calls_it_home():
    flown = Flown(operator=words((300, "hold"), (350, "return")))
    assert flown.reason == "operator"
    assert flown.seconds_in("HOLD") == pytest.approx(5.0, abs=0.5)
    flown.assert_landed_at_home()


def test_whatever_goes_wrong_in_our_own_code_leaves_the_vehicle_holding():
    class Broken(Around):
        def sense(self, state):
            if state.time_s > 30.0:
                raise KeyboardInterrupt
            return self.inner.sense(state)

    mission = build_mission(Scenario.model_validate(SCENARIO), 0, Rig("statistical"))
    broken = replace(mission, sensor=Broken(mission.sensor))
    with pytest.raises(KeyboardInterrupt):
        fly(broken, MemoryJournal())
    vehicle = mission.vehicle
    vehicle.advance(10.0)
    before = vehicle.true_position_enu_m
    vehicle.advance(10.0)
    assert np.linalg.norm(vehicle.true_position_enu_m - before) < 1.0


WIDE = {"polygon_enu_m": [[0, 0], [150, 0], [150, 100], [0, 100]]}


# ---- somebody else flies it -------------------------------------------------------------------------------


class Taken(Around):
    """A vehicle that somebody flies to another place for a while."""

    def __init__(self, inner, since_s=25.0, for_s=20.0):
        super().__init__(inner)
        self.since_s, self.until_s = since_s, since_s + for_s

    @property
    def theirs(self):
        return self.since_s <= self.inner.state().time_s < self.until_s

    def state(self):
        return self.inner.state()._replace(taken_over="it is in Position" if self.theirs else "")

    def command(self, setpoint):
        assert not self.theirs, "commanded while somebody else flies it"
        self.inner.command(setpoint)

    def hold(self):
        assert not self.theirs, "held while somebody else flies it"
        self.inner.hold()

    def advance(self, duration_s):
        if self.theirs:
            here = self.inner.state().position_enu_m
            self.inner.command(Setpoint(np.array([-20.0, 30.0, here[2]]), 5.0, 0.0))
        self.inner.advance(duration_s)


class TakenAndLanded(Taken):
    """A vehicle that somebody flies over the second target and lands there."""

    landing = False

    def advance(self, duration_s):
        state = self.inner.state()
        if self.theirs and state.time_s < self.since_s + 25.0:
            self.inner.command(Setpoint(np.array([45.0, 50.0, state.position_enu_m[2]]), 5.0, 0.0))
        elif self.theirs and not self.landing:
            self.landing = True
            self.inner.land()
        self.inner.advance(duration_s)


def test_what_is_seen_while_somebody_else_flies_is_in_the_journal():
    flown = Flown(vehicle=lambda inner: TakenAndLanded(inner, 18.0, 1e9))
    assert flown.reason == "taken over"
    assert np.linalg.norm(flown.places("sighting") - [45.0, 55.0], axis=1).min() < 1.5
    assert np.linalg.norm(flown.places("unchecked") - [45.0, 55.0], axis=1).min() < 1.5


def test_what_is_seen_in_a_wind_hold_is_in_the_journal(untroubled):
    first_s = untroubled.of_kind("sighting")[0]["t"]
    flown = Flown(vehicle=lambda inner: Blown(inner, first_s - 1.0, math.inf, 12.0))
    assert flown.reason == "wind"
    assert flown.of_kind("sighting")


def test_who_takes_it_keeps_it_and_only_what_is_so_is_told():
    """The operator's hold lasts through the takeover, and is not told to be over before it is."""
    words = {24.0: "hold", 60.0: "continue"}

    class Keyboard:
        def __init__(self):
            self.flown = None

        def __call__(self):
            now_s = vehicles[0].inner.state().time_s if vehicles else 0.0
            due = [t for t in words if t <= now_s]
            return Order(words.pop(due[0])) if due else None

    vehicles = []

    def taken(inner):
        vehicles.append(Taken(inner))
        return vehicles[0]

    flown = Flown(vehicle=taken, operator=Keyboard())
    assert flown.safety == [
        ("operator", "HOLD"),
        ("taken over", "KEEP_OUT"),
        ("taken over", "CONTINUE"),
        ("operator", "CONTINUE"),
    ]
    flown.assert_found()
    flown.assert_landed_at_home()


def test_a_path_flown_by_somebody_else_is_no_part_of_the_scan():
    """Even where the detector is silent meanwhile: nothing of it is flown again."""
    flown = Flown(
        vehicle=lambda inner: Taken(inner),
        sensor=lambda inner: LosesLooks(inner, 26.0, 15.0),
    )
    flown.assert_found()
    legs = [leg for line in flown.of_kind("unsearched") for leg in line["legs_enu_m"]]
    assert all(x > -10.0 for leg in legs for x, _ in leg)


# ---- on the way home ---------------------------------------------------------------------------------


class FullFrom:
    """A journal on a disk that is full from a time on."""

    def __init__(self, since_s):
        self.lines, self.failed, self._since_s = [], None, since_s

    def write(self, time_s, kind, **fields):
        self.lines.append({"t": time_s, "kind": kind} | fields)
        if time_s > self._since_s:
            self.failed = "no space"


class Holds:
    """The operator holds the vehicle on the way home, and lets it go on after half a minute."""

    def __init__(self):
        self.mission = self.held_s = None

    def __call__(self):
        now_s = self.mission.embedded.state().time_s
        if self.held_s is None and self.mission.modes and self.mission.modes[-1][1] == "RETURN":
            self.held_s = now_s
            return Order("hold")
        return Order(CONTINUE) if self.held_s is not None and now_s == self.held_s + 30.0 else None


class FlownByHand(Flown):
    def __init__(self, **changes):
        operator = Holds()
        operator.mission = self
        super().__init__(operator=operator, **changes)
        self.held_s = operator.held_s


@pytest.mark.parametrize(
    "fault",
    [
        {"journal": lambda _: FullFrom(25.0)},
        {"vehicle": lambda inner: JumpsFrom(inner, 25.0)},
    ],
    ids=["a full disk", "a position that jumped"],
)
def test_what_ended_the_search_does_not_outweigh_the_operators_hold(fault):
    """It flew on home, the hold in its journal."""
    flown = FlownByHand(**fault)
    places = np.array([s["p"] for s in flown.of_kind("state") if 5.0 < s["t"] - flown.held_s < 29.0])
    assert len(places) > 20
    assert np.ptp(places, axis=0).max() < 3.0
    assert len(flown.of_kind("landed")) == 1


class JumpsFrom(Around):
    """Positions are 50 m off from a time on, and so is where it flies."""

    def __init__(self, inner, since_s, unknown_s=0.0):
        super().__init__(inner)
        self.since_s, self.unknown_s, self.off = since_s, unknown_s, np.array([50.0, 0.0, 0.0])

    def state(self):
        state = self.inner.state()
        if state.time_s >= self.since_s:
            there = state.camera.position_enu_m + self.off
            camera = state.camera._replace(position_enu_m=there)
            return state._replace(position_enu_m=state.position_enu_m + self.off, camera=camera)
        if state.time_s >= self.since_s - self.unknown_s:
            return state._replace(velocity_enu_mps=np.full(3, math.nan))
        return state

    def command(self, setpoint):
        off = self.off if self.inner.state().time_s >= self.since_s else 0.0
        self.inner.command(setpoint._replace(position_enu_m=setpoint.position_enu_m - off))


def test_a_velocity_that_is_not_known_hides_no_jump():
    flown = Flown(vehicle=lambda inner: JumpsFrom(inner, 32.0, unknown_s=2.0))
    assert ("position jump", "HOLD") in flown.safety
    assert flown.reason == "position jump"


# ---- before take-off ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stands_enu_m", "changes"),
    [
        ((-160.0, -5.0), {"geofence_enu_m": [[-20, -20], [80, -20], [80, 90], [-20, 90]]}),
        ((-60.0, -5.0), {"safety": {"no_fly_enu_m": [[[-70, -15], [-50, -15], [-50, 5], [-70, 5]]]}}),
    ],
    ids=["beyond the fence", "in a no-fly area"],
)
def test_where_nobody_may_fly_it_does_not_take_off(stands_enu_m, changes):
    away = Scenario.model_validate(
        SCENARIO | {"home": {"position_enu_m": list(stands_enu_m)}, "safety": {"fence_margin_m": None}}
    )
    elsewhere = build_mission(away, 0, Rig("statistical")).vehicle
    with pytest.raises(UserError, match=r"^position: the vehicle stands \d+ m inside a no-fly area"):
        Flown(vehicle=lambda _: elsewhere, **changes)
    assert not elsewhere.state().airborne
