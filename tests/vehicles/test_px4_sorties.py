"""Missions in sorties on the look-alike: none begins without a person's word and a full battery."""

from itertools import pairwise

import pytest
from look_alike import LookAlike
from takeovers import HOLD, POSITION
from test_px4_given_back import BOOTED_S, SMALL, Killed

from skysweep.errors import UserError
from skysweep.flights.build import build_mission
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.resume import resume_folder
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal, read_journal
from skysweep.mission.loop import fly
from skysweep.mission.orders import CONTINUE, RETURN, TAKE_BACK, Order
from skysweep.results.run_folder import load_run
from skysweep.scenarios.model import Scenario
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import Refused

SWAP_S = 30.0


def in_sorties(batteries=3) -> Scenario:
    """It takes two batteries."""
    return Scenario.model_validate(
        SMALL | {"vehicle": {"battery_wh": 9.0, "batteries": batteries}, "search": {"n_c": 1}}
    )


class Sorties:
    """A mission on the look-alike. ``on_ground`` is asked in each swap, with the seconds that it lasts."""

    def __init__(self, on_ground, of=None):
        of = of or in_sorties()
        self.there = LookAlike(5, of, BOOTED_S)
        mission = build_mission(of, 0, Rig("statistical", vehicle=self.there.vehicle))
        journal, self.modes, self._orders, since_s = MemoryJournal(), [], [], []

        def watch(state, mode, _new):
            self.modes.append((state.time_s, str(mode), self.there.sky.pilot.armed))
            if mode != "SWAP":
                since_s.clear()
                return
            since_s.append(state.time_s)
            assert state.time_s - since_s[0] < 900.0
            said = on_ground(self.there, state.time_s - since_s[0])
            self._orders = said if isinstance(said, list) else [said]

        def operator():
            return self._orders.pop(0) if self._orders else None

        self.reason = fly(mission, journal, watch, operator)
        self.lines = journal.lines

    def of_kind(self, kind):
        return [line for line in self.lines if line["kind"] == kind]

    def swap_s(self):
        return sum(mode == "SWAP" for _, mode, _ in self.modes) * 0.1


def once(*when_what):
    """Does each thing once its time on the ground has come; the result of the last one is the order."""
    left = list(when_what)

    def happens(there, lasted_s):
        if left and lasted_s >= left[0][0]:
            return left.pop(0)[1](there)
        return None

    return happens


def new_battery(there):
    there.sky.pilot.change_battery()


def go(_there):
    return Order(CONTINUE)


def test_a_person_changes_the_battery_and_says_continue():
    flight = Sorties(once((SWAP_S, new_battery), (SWAP_S + 5.0, go)))
    assert flight.reason == "completed"
    (landed,), (again,) = flight.of_kind("sortie"), flight.of_kind("next_sortie")
    assert (landed["number"], again["number"]) == (1, 2)
    assert landed["battery"] < 0.6
    assert again["battery"] > 0.95
    assert again["t"] - landed["t"] == pytest.approx(SWAP_S + 5.0, abs=8.0)  # arming, and PX4's slow start
    assert len(flight.of_kind("confirmed")) == 2
    times = [t for t, _, _ in flight.modes]
    assert all(b >= a for a, b in pairwise(times))
    waiting = [armed for _, mode, armed in flight.modes if mode == "SWAP"]
    assert not any(waiting[30:])  # its motors stop soon after landing, and stay so


def test_a_hold_right_after_continue_keeps_it_down():
    def thinks_again(_there):
        return [Order(CONTINUE), Order("hold")]

    flight = Sorties(once((SWAP_S, new_battery), (SWAP_S + 5.0, thinks_again), (SWAP_S + 40.0, go)))
    assert flight.reason == "completed"
    (landed,), (again,) = flight.of_kind("sortie"), flight.of_kind("next_sortie")
    assert again["t"] - landed["t"] >= SWAP_S + 39.0
    said = [line["sentence"] for line in flight.of_kind("safety") if line["cause"] == "battery change"]
    why = "the operator called the take-off off: nothing was armed"
    assert f"No take-off: {why}. Say continue when it is ready." in said


def test_it_never_takes_off_by_itself():
    flight = Sorties(once((SWAP_S, new_battery), (240.0, lambda _: Order(RETURN))))
    assert flight.reason == "operator"
    assert flight.swap_s() >= 235.0
    assert flight.of_kind("next_sortie") == []
    assert flight.of_kind("landed")
    assert flight.there.flown() == (HOLD, False) or not flight.there.flown()[1]


def test_a_battery_that_is_not_charged_is_refused_in_a_sentence():
    def worn(there):
        there.sky.pilot.battery_share = 0.5

    flight = Sorties(once((10.0, worn), (12.0, go), (40.0, new_battery), (42.0, go)))
    assert flight.reason == "completed"
    said = [line["sentence"] for line in flight.of_kind("safety") if line["cause"] == "battery change"]
    assert any("The battery is at 50%, less than 80%: put in a charged one." in sentence for sentence in said)
    assert flight.swap_s() >= 41.0


def test_the_operator_who_calls_it_home_ends_the_mission():
    of, modes, ordered = in_sorties(), [], []
    there = LookAlike(5, of, BOOTED_S)

    def operator():
        if modes and modes[-1] == "RETURN" and not ordered:
            ordered.append(RETURN)
            return Order(RETURN)
        return None

    journal = MemoryJournal()
    mission = build_mission(of, 0, Rig("statistical", vehicle=there.vehicle))

    def watch(_state, mode, _new):
        modes.append(str(mode))
        assert modes.count("SWAP") < 9000

    reason = fly(mission, journal, watch, operator)
    assert reason == "operator"
    assert modes.count("SWAP") <= 1
    assert "next_sortie" not in [line["kind"] for line in journal.lines]


def test_somebody_flies_it_between_two_sorties():
    def takes(there):
        there.sticks(moving=False)
        there.wait(0.2)
        there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)
        there.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def gives_back(there):
        there.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
        there.wait(0.2)
        return Order(TAKE_BACK)

    flight = Sorties(
        once((5.0, takes), (8.0, go), (9.0, gives_back), (12.0, new_battery), (14.0, go), (20.0, go))
    )
    causes = [(line["cause"], line["action"]) for line in flight.of_kind("safety")]
    assert flight.reason == "completed", causes
    assert flight.swap_s() >= 13.0


def test_the_look_alike_keeps_its_battery_while_it_is_armed():
    there = LookAlike(5, in_sorties(), BOOTED_S)
    there.vehicle.takeoff(10.0)
    with pytest.raises(Refused, match="armed"):
        there.sky.pilot.change_battery()


def test_killed_on_the_ground_it_goes_on_with_the_next_sortie(tmp_path):
    of, folder = in_sorties(), tmp_path / "run"
    there, swaps = LookAlike(5, of, BOOTED_S), []

    def watch(_state, mode, _new):
        if mode == "SWAP":
            swaps.append(mode)
            if len(swaps) == 50:
                raise Killed

    with pytest.raises(Killed):
        fly_to_folder(of, 0, folder, Rig("statistical", vehicle=there.vehicle, watch=watch))
    there.connect()
    there.wait(20.0)
    there.sky.pilot.change_battery()
    there.vehicle.stand_by()
    summary = resume_folder(folder, Rig(vehicle=there.vehicle))
    assert summary["completed"]
    assert summary["sorties"] == 2
    assert summary["n_confirmed"] == 2
    lines = read_journal(folder / "journal.jsonl")
    modes = [line["mode"] for line in lines if line["kind"] == "state"]
    assert "TRANSIT" in modes
    times = [line["t"] for line in lines if line["kind"] == "state"]
    assert times == sorted(times)
    first, second = load_run(folder).sorties
    assert (first.why, second.why) == ("return energy", "completed")


def test_an_autopilot_that_restarts_on_the_ground_says_how_to_go_on():
    def restarts(there):
        there.vehicle.telemetry.restarted = True

    with pytest.raises(UserError, match=r"restarted on the ground.*skysweep fly FOLDER"):
        Sorties(once((5.0, restarts)))
