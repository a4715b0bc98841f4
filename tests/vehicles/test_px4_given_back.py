"""Whole missions on the look-alike: somebody takes the vehicle, the link is lost, our program is killed."""

import numpy as np
import pytest
from look_alike import LookAlike
from takeovers import ALTITUDE, HOLD, LAND, OFFBOARD, POSITION

from skysweep.errors import UserError
from skysweep.flights.build import build_mission
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.on_px4 import _Waiting
from skysweep.flights.resume import begun_scenario, resume_folder
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal, read_journal
from skysweep.mission.loop import fly
from skysweep.mission.orders import CONTINUE, TAKE_BACK, Order
from skysweep.results.journal_lines import can_be_gone_on_with
from skysweep.results.run_folder import load_run
from skysweep.scenarios.model import Scenario
from skysweep.vehicles.mavlink.dialect import mavlink as m

SMALL = {
    "name": "small",
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
    "home": {"position_enu_m": [-5, -5]},
    "targets": [
        {"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9},
        {"class": "stop sign", "position_enu_m": [45, 12], "size_m": 0.9},
    ],
    "wind": {"mean_speed_mps": 0.0, "gust_std_mps": 0.0},
    "camera": {"hfov_rad": 1.2},
}
BOOTED_S = 900.0


def small() -> Scenario:
    return Scenario.model_validate(SMALL)


class Flight:
    """A mission on the look-alike; ``happens`` is asked at every step and may give the operator's order."""

    def __init__(self, happens, on_loss=5):
        self.there = LookAlike(on_loss, small(), BOOTED_S)
        mission = build_mission(small(), 0, Rig("statistical", vehicle=self.there.vehicle))
        journal, self.states, self._order = MemoryJournal(), [], None

        def watch(state, mode, _new):
            self.states.append((state.time_s, mode, state.position_enu_m, bool(state.taken_over)))
            self._order = happens(self.there, state, mode)

        def operator():
            order, self._order = self._order, None
            return order

        self.reason = fly(mission, journal, watch, operator)
        self.lines = journal.lines

    def of_kind(self, kind):
        return [line for line in self.lines if line["kind"] == kind]

    @property
    def safety(self):
        return [(line["cause"], line["action"]) for line in self.of_kind("safety")]

    def assert_found(self):
        places = np.array([line["p"][:2] for line in self.of_kind("confirmed")])
        for target in SMALL["targets"]:
            assert np.hypot(*(places - target["position_enu_m"]).T).min() < 1.5


class Pilot:
    """Takes the vehicle ``at_s`` into a scan and flies it away; gives it back ``for_s`` later."""

    is_given_back = False

    def __init__(self, at_s=18.0, for_s=25.0):
        self.at_s, self.for_s, self.took_s, self.took_at, self.ours = at_s, for_s, None, None, []

    def __call__(self, there, state, mode):
        if self.took_s is None and state.time_s > self.at_s and mode == "SCAN":
            self.took_s, self.took_at = state.time_s, state.position_enu_m
            there.sticks(moving=False)
            there.wait(0.2)
            there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)
            there.sticks(moving=True)
            there.orders()
        elif self.took_s is not None and state.time_s < self.took_s + self.for_s:
            self.ours += there.orders()
            assert there.flown()[0] == POSITION
        elif state.taken_over and not self.is_given_back:
            self.is_given_back = True
            there.sticks(moving=False)
            return Order(TAKE_BACK)
        return None


def test_a_pilot_keeps_the_vehicle_and_the_search_goes_on_where_it_was_left():
    pilot = Pilot()
    flight = Flight(pilot)
    assert flight.reason == "completed"
    assert pilot.ours == []
    assert flight.safety == [("taken over", "KEEP_OUT"), ("taken over", "CONTINUE")]
    taken = flight.of_kind("safety")[0]
    assert "until a person says take back" in taken["sentence"]
    assert taken["holder"].startswith("it is in Position: ")
    assert can_be_gone_on_with(taken)
    away = max(np.linalg.norm(p - pilot.took_at) for _, _, p, taken in flight.states if taken)
    assert away > 30.0
    after = [p for t, mode, p, _ in flight.states if t > pilot.took_s + pilot.for_s and mode == "SCAN"]
    assert min(np.linalg.norm((p - pilot.took_at)[:2]) for p in after) < 3.0
    flight.assert_found()


def test_the_journal_says_who_has_it_and_why_it_is_not_taken_back():
    """A ground station holds it, then a pilot takes it; words that were meant for the first come later."""
    words = [
        (4.0, "hands", lambda there: there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)),
        (7.0, "order", Order(CONTINUE)),
        (8.0, "order", Order(TAKE_BACK, holder="it is in Hold: somebody chose that")),
        (9.0, "hands", lambda there: there.cut(3.0)),
        (10.0, "order", Order(TAKE_BACK)),
        (15.0, "order", Order(TAKE_BACK, holder="it is in Position: somebody chose that")),
    ]
    begun_s = []

    def happens(there, state, mode):
        if not begun_s and state.time_s > 20.0:
            begun_s.append(there.now_s())
            there.sticks(moving=False)
            there.wait(0.3)
            there.command(m.MAV_CMD_DO_SET_MODE, 1, *HOLD)
        if begun_s and words and there.now_s() > begun_s[0] + words[0][0]:
            assert words[0][0] < 5.0 or there.flown()[0] == POSITION
            _, kind, what = words.pop(0)
            if kind == "order":
                return what
            what(there)
        return None

    flight = Flight(happens)
    assert flight.reason == "completed"
    said = [line for line in flight.of_kind("safety") if line["cause"] in ("taken over", "operator")]
    assert [line.get("holder") for line in said] == [
        "it is in Hold: somebody chose that",
        "it is in Position: somebody chose that",
        None,
        None,
        None,
        None,
    ]
    assert [line["sentence"] for line in said[2:]] == [
        "Somebody else flies the vehicle: say take back.",
        "Not taken back: since then somebody else took the vehicle (it is in Position: somebody chose that); "
        "say take back again.",
        "Not taken back: the vehicle is not heard; say it again when it is.",
        "The vehicle is the mission's again.",
    ]
    orders = flight.of_kind("operator")
    assert [line.get("holder", "") for line in orders] == ["", said[0]["holder"], "", said[1]["holder"]]
    flight.assert_found()


class CalledOff:
    """A flight of ``Px4Flight`` on the look-alike, with orders before it takes off."""

    def __init__(self, folder, operator):
        self.folder = folder
        self.there = LookAlike(5, small(), BOOTED_S)
        waiting = _Waiting(lambda: operator(self.there))
        self.there.vehicle.is_called_off = waiting.calls_off
        self.there.sticks(moving=False)
        self.there.wait(2.0)
        with pytest.raises(UserError) as ended:
            fly_to_folder(
                small(), 0, folder, Rig("statistical", vehicle=self.there.vehicle, operator=waiting)
            )
        self.why = str(ended.value)
        self.orders = self.there.orders()
        self.lines = read_journal(folder / "journal.jsonl")

    def assert_on_the_ground(self, *words):
        assert not self.there.flown()[1]
        assert [line["word"] for line in self.lines if line["kind"] == "operator"] == list(words)
        (said,) = [line for line in self.lines if line["kind"] == "safety"]
        assert (said["t"], said["cause"], said["action"]) == (0.0, "operator", "HOLD")
        assert said["sentence"] == "The operator calls the take-off off."


@pytest.mark.parametrize("words", [("hold",), ("return",), ("continue", "hold")])
def test_a_word_before_arming_keeps_it_on_the_ground(tmp_path, words):
    waiting = list(map(Order, words))
    flight = CalledOff(tmp_path / "run", lambda _there: waiting.pop(0) if waiting else None)
    flight.assert_on_the_ground(*words)
    assert flight.orders == []
    assert flight.why == "the operator called the take-off off: nothing was armed"
    flight.there.connect()
    summary = resume_folder(tmp_path / "run", Rig(vehicle=flight.there.vehicle))
    assert summary["completed"]
    assert summary["n_confirmed"] == 2


@pytest.mark.parametrize("word", ["hold", "return"])
def test_a_word_while_it_arms_disarms_it(tmp_path, word):
    waiting = [Order(word)]

    def operator(there):
        return waiting.pop() if waiting and there.flown()[1] else None

    flight = CalledOff(tmp_path / "run", operator)
    flight.assert_on_the_ground(word)
    assert set(flight.orders) == {m.MAV_CMD_COMPONENT_ARM_DISARM}
    assert flight.why == "the operator called the take-off off: the vehicle is disarmed again"


def test_who_takes_it_while_it_arms_is_not_disarmed(tmp_path):
    waiting = [Order("hold")]

    def operator(there):
        if not waiting or not there.flown()[1]:
            return None
        there.command(m.MAV_CMD_DO_SET_MODE, 1, *ALTITUDE)
        there.wait(0.5)
        return waiting.pop()

    flight = CalledOff(tmp_path / "run", operator)
    assert "it is in Altitude" in flight.why
    assert flight.there.flown() == (ALTITUDE, True)


def test_what_has_left_the_ground_holds_when_it_is_up(tmp_path):
    waiting = [Order("hold"), Order("continue")]

    def happens(there, state, mode):
        return waiting.pop(0) if waiting and (len(waiting) == 2 or mode == "HOLD") else None

    flight = Flight(happens)
    assert flight.reason == "completed"
    assert flight.safety == [("operator", "HOLD"), ("operator", "CONTINUE")]


def test_the_last_word_before_take_off_counts(tmp_path):
    waiting, vehicle = [Order("hold"), Order("confirm", 7), Order("continue")], LookAlike(5, small()).vehicle
    rig = Rig("statistical", vehicle=vehicle, operator=lambda: waiting.pop(0) if waiting else None)
    assert fly_to_folder(small(), 0, tmp_path / "run", rig)["completed"]


def test_a_pilot_who_lands_ends_the_mission_and_what_was_seen_is_reported():
    def happens(there, state, mode):
        if state.time_s > 30.0 and there.flown()[0] == OFFBOARD:
            there.command(m.MAV_CMD_DO_SET_MODE, 1, *LAND)

    flight = Flight(happens)
    assert flight.reason == "taken over"
    assert not flight.there.sky.vehicle.state().airborne
    assert flight.of_kind("landed")
    assert flight.lines[-1]["kind"] == "end"


@pytest.mark.parametrize("on_loss", [0, 3, 5])
def test_px4_gives_it_back_by_itself_after_a_lost_link(on_loss):
    cut = []

    def happens(there, state, mode):
        if not cut and state.time_s > 20.0 and mode == "SCAN":
            cut.append((state.time_s, state.position_enu_m))
            there.cut(20.0)

    flight = Flight(happens, on_loss)
    assert flight.reason == "completed"
    assert flight.safety == [("telemetry silent", "HOLD"), ("telemetry silent", "CONTINUE")]
    flight.assert_found()
    after_s, place = cut[0][0] + 20.0, cut[0][1]
    scan = [p for t, mode, p, _ in flight.states if after_s < t < after_s + 40.0 and mode == "SCAN"]
    assert min(np.linalg.norm((p - place)[:2]) for p in scan) < 8.0  # silence is noticed late


def test_a_ground_station_that_holds_it_is_not_overruled_for_ever():
    held = []

    def happens(there, state, mode):
        if not held and state.time_s > 20.0:
            held.append(state.time_s)
            there.command(m.MAV_CMD_DO_SET_MODE, 1, *HOLD)
        if held and state.time_s > held[0] + 300.0:
            return Order(TAKE_BACK) if state.taken_over else None
        assert not held or there.flown()[0] == HOLD

    flight = Flight(happens)
    assert flight.reason == "completed"
    flight.assert_found()


class Killed(BaseException):
    """Our program is killed: nothing is said to the vehicle."""


def killer(there, at_s):
    def watch(state, _mode, _new):
        assert state.time_s < BOOTED_S
        if state.time_s > at_s:
            there.vehicle.hold = lambda: None
            raise Killed

    return watch


def test_a_flight_killed_twice_goes_on_in_the_missions_time(tmp_path):
    there = LookAlike(5, small(), BOOTED_S)
    other = LookAlike(5, small()).vehicle
    uninterrupted = fly_to_folder(small(), 0, tmp_path / "whole", Rig("statistical", vehicle=other))

    watch = killer(there, 30.0)
    with pytest.raises(Killed):
        fly_to_folder(small(), 0, tmp_path / "run", Rig("statistical", watch=watch, vehicle=there.vehicle))
    for at_s in (55.0, 1e9):
        there.connect()
        there.wait(40.0)
        assert there.flown()[0] == HOLD
        try:
            summary = resume_folder(tmp_path / "run", Rig(watch=killer(there, at_s), vehicle=there.vehicle))
        except Killed:
            continue
    run = load_run(tmp_path / "run")
    times = [r["t"] for r in run.records if r["kind"] == "state"]
    assert max(np.diff(times)) < 5.0
    assert min(np.diff(times)) > -2.0
    assert not [r for r in run.records if r["kind"] == "safety"]
    assert summary["n_confirmed"] == uninterrupted["n_confirmed"] == 2
    assert summary["mission_time_s"] == pytest.approx(times[-1], abs=60.0)
    assert summary["mission_time_s"] < uninterrupted["mission_time_s"] + 60.0


def with_a_flipped_bit(journal, kind):
    """Damage the first line of that kind; its number, and what the journal then holds."""
    lines = journal.read_bytes().splitlines(keepends=True)
    k = next(k for k, line in enumerate(lines) if f'"kind": "{kind}"'.encode() in line)
    lines[k] = lines[k].replace(b'"t": ', b'"u": ')
    journal.write_bytes(b"".join(lines))
    return k + 1, journal.read_bytes()


def test_a_flight_goes_on_from_the_sound_lines_of_its_journal(tmp_path):
    there, folder = LookAlike(5, small(), BOOTED_S), tmp_path / "run"
    journal, said = folder / "journal.jsonl", []

    watch = killer(there, 95.0)
    with pytest.raises(Killed):
        fly_to_folder(small(), 0, folder, Rig("statistical", watch=watch, vehicle=there.vehicle))
    before = read_journal(journal)
    number, damaged = with_a_flipped_bit(journal, "confirmed")
    there.connect()
    there.wait(40.0)
    for go_on in (begun_scenario, lambda run: resume_folder(run, Rig(vehicle=there.vehicle))):
        with pytest.raises(UserError, match=rf"line {number} is damaged, .*fly.* goes on from those"):
            go_on(folder)
    assert begun_scenario(folder, True, said.append).name == "small"
    assert f"line {number} is damaged and left out with all lines after it" in said[0]
    assert journal.read_bytes() == damaged

    summary = resume_folder(folder, Rig(vehicle=there.vehicle), from_sound_lines=True)
    assert (folder / "journal.jsonl.damaged").read_bytes() == damaged
    after = read_journal(journal)
    resumed = next(k for k, r in enumerate(after) if r["kind"] == "resumed") - 1
    assert after[resumed]["kind"] == "clock"
    assert after[:resumed] == before[:resumed]
    assert resumed < number
    assert summary["completed"]
    assert summary["n_confirmed"] == 2, "what the damaged line said is found again"

    with_a_flipped_bit(journal, "confirmed")
    there.connect()
    with pytest.raises(UserError, match=r"its flight had ended; .*--from-sound-lines .* its undamaged part"):
        begun_scenario(folder, from_sound_lines=True)
    with pytest.raises(UserError, match="its flight had ended"):
        resume_folder(folder, Rig(vehicle=there.vehicle), from_sound_lines=True)
    assert not there.sky.vehicle.state().airborne


def test_the_operator_is_heard_while_px4_lands():
    held = []

    def happens(there, state, mode):
        if mode != "LAND" or len(held) > 1:
            return None
        if not held and state.position_enu_m[2] < 10.0:
            held.append(state.time_s)
            return Order("hold")
        if held and state.time_s > held[0] + 15.0:
            held.append(state.time_s)
            return Order(CONTINUE)
        return None

    flight = Flight(happens)
    assert flight.safety == [("operator", "HOLD"), ("operator", "CONTINUE")]
    while_held = [p[2] for t, _, p, _ in flight.states if held[0] + 3.0 < t < held[1]]
    assert min(while_held) > 6.0
    assert np.ptp(while_held) < 1.5
    assert flight.of_kind("landed")
    assert not flight.there.sky.vehicle.state().airborne


def test_a_home_that_the_autopilot_moves_is_not_ours():
    def happens(there, state, mode):
        if state.time_s > 20.0:
            there.sky.pilot.home_enu_m = np.array([60.0, 60.0, 0.0])

    flight = Flight(happens)
    assert flight.reason == "completed"
    flight.assert_found()
    x, y, _ = flight.there.sky.vehicle.true_position_enu_m
    assert np.hypot(x + 5.0, y + 5.0) < 3.0


def test_a_px4_whose_battery_falls_silent_comes_home():
    silenced = []

    def happens(there, state, mode):
        if state.time_s > 20.0 and not silenced:
            silenced.append(state.time_s)
            number = m.MAVLINK_MSG_ID_BATTERY_STATUS
            there.vehicle.link.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, number, -1.0)

    flight = Flight(happens)
    assert flight.reason == "battery unknown"
    assert flight.safety == [("battery unknown", "CONTINUE"), ("battery unknown", "RETURN")]
    first, second = flight.of_kind("safety")
    assert 9.0 < first["t"] - silenced[0] < 13.0
    assert 29.0 < second["t"] - first["t"] < 32.0
    assert flight.of_kind("landed")


class Done(BaseException):
    """Enough was seen."""


def test_a_landing_that_px4_broke_off_waits_for_a_word():
    """Held by the operator; PX4 lost the GNSS, sank, and flew our setpoints again by itself."""
    seen = {"orders": []}

    def happens(there, state, mode):
        now_s = there.now_s()
        if "home" not in seen and state.time_s > 25.0:
            seen["home"] = now_s
            return Order("return")
        if mode == "LAND" and "held" not in seen and state.position_enu_m[2] < 18.0:
            seen["held"] = now_s
            return Order("hold")
        if "held" in seen:
            there.sky.pilot.gnss_lost = seen["held"] + 5.0 < now_s < seen["held"] + 13.0
            if now_s > seen["held"] + 12.0:
                seen["orders"] += [order for order in there.orders() if order == m.MAV_CMD_DO_SET_MODE]
            else:
                there.orders()
            if now_s > seen["held"] + 30.0:
                seen["waits"] = state.waits
                raise Done
        return None

    with pytest.raises(Done):
        Flight(happens)
    assert seen["orders"] == []
    assert "hovers until a person says continue" in seen["waits"]
