"""The operator's orders on the look-alike of PX4: looks and verdicts, with a pilot and a kill in between."""

import math

import numpy as np
import pytest
from look_alike import LookAlike
from takeovers import HOLD, POSITION
from test_px4_given_back import BOOTED_S, Flight, Killed, small

from skysweep.flights.fly import fly_to_folder
from skysweep.flights.resume import resume_folder
from skysweep.flights.rig import Rig
from skysweep.mission.orders import TAKE_BACK, Order
from skysweep.results.run_folder import load_run
from skysweep.vehicles.mavlink.dialect import mavlink as m

PLACE = (50.0, 30.0)
LOOK = Order("look", None, PLACE)


class At:
    """Gives each order at the first step from its time on."""

    def __init__(self, orders):
        self.orders = dict(orders)

    def __call__(self, _there, state, _mode):
        due = [at_s for at_s in self.orders if at_s <= state.time_s]
        return self.orders.pop(due[0]) if due else None


def test_it_looks_at_a_place_and_goes_on_where_it_was_left():
    flight = Flight(At({20.0: LOOK, 20.2: Order("reject", 1), 45.0: Order("hold"), 55.0: Order("continue")}))
    assert flight.reason == "completed"
    (seen,) = flight.of_kind("looked")
    there = min(flight.states, key=lambda s: abs(s[0] - seen["t"]))[2]
    assert math.dist(there[:2], PLACE) < 2.0
    assert there[2] < 7.0
    left = [p for t, mode, p, _ in flight.states if mode == "SCAN" and t <= 20.1][-1]
    on = next(p for t, mode, p, _ in flight.states if t > seen["t"] and mode == "SCAN")
    assert np.linalg.norm(on - left) < 4.0
    flight.assert_found()


def test_a_pilot_takes_it_on_the_way_to_the_place():
    said = []

    def happens(there, state, mode):
        if not said and state.time_s > 20.0:
            said.append("look")
            return LOOK
        if said == ["look"] and mode == "LOOK" and state.position_enu_m[0] > 25.0:
            said.append("taken")
            there.sticks(moving=False)
            there.wait(0.2)
            there.command(m.MAV_CMD_DO_SET_MODE, 1, *POSITION)
            there.sticks(moving=True)
            said.append(state.time_s)
        elif len(said) == 3 and state.time_s > said[2] + 5.0:
            said.append("refused")
            return Order("look", None, (10.0, 10.0))
        elif len(said) == 4 and state.time_s > said[2] + 15.0:
            there.sticks(moving=False)
            said.append("given back")
            return Order(TAKE_BACK)
        return None

    flight = Flight(happens)
    assert flight.reason == "completed"
    assert [line["word"] for line in flight.of_kind("operator")] == ["look", "look", "take back"]
    assert flight.safety == [("taken over", "KEEP_OUT"), ("operator", "CONTINUE"), ("taken over", "CONTINUE")]
    assert "somebody else flies the vehicle" in flight.of_kind("safety")[1]["sentence"]
    assert [line["p"][:2] for line in flight.of_kind("looked")] == [list(PLACE)]
    flight.assert_found()


@pytest.mark.parametrize("killed_in", ["TAKEOFF", "LOOK"])
def test_killed_it_remembers_what_was_ordered(tmp_path, killed_in):
    there, folder = LookAlike(5, small(), BOOTED_S), tmp_path / "run"
    orders, order = At({2.0 if killed_in == "TAKEOFF" else 20.0: LOOK}), []

    def watch(state, mode, _new):
        if not orders.orders and not order and mode == killed_in:
            there.vehicle.hold = lambda: None
            raise Killed
        order[:] = filter(None, [orders(there, state, mode)])

    def operator():
        return order.pop() if order else None

    with pytest.raises(Killed):
        fly_to_folder(
            small(), 0, folder, Rig("statistical", vehicle=there.vehicle, watch=watch, operator=operator)
        )
    there.connect()
    there.wait(40.0)
    assert there.flown()[0] == HOLD
    modes, verdicts = [], [Order("confirm", 1)]
    second = Rig(
        vehicle=there.vehicle,
        watch=lambda _state, mode, _new: modes.append(mode),
        operator=lambda: verdicts.pop() if verdicts and "RETURN" in modes else None,
    )
    summary = resume_folder(folder, second)
    assert [line["p"][:2] for line in load_run(folder).events("looked")] == [list(PLACE)]
    assert summary["completed"]
    assert summary["n_confirmed"] == 2
    assert summary["n_by_operator"] == 1
