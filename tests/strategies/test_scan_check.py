"""Algorithm 1 on hand-written event sequences: every line of the paper and every silent case."""

import math

import numpy as np
import pytest
from contexts import context_of
from pydantic import ValidationError

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.scenarios.model import Search
from skysweep.strategies.baselines import SingleAltitude
from skysweep.strategies.scan_check import ScanCheck
from skysweep.types import Candidate, EventKind, Look, Observation, Sighting, VehicleState, Waypoint

H_S, H_C = 30.0, 4.0
F = [(0.0, 0.0), (100.0, 0.0), (100.0, 30.0)]


class Player:
    """Plays observations to a strategy: where the vehicle is and what is seen there."""

    def __init__(self, look_s=1.0, waypoints=F, **search):
        parameters = {"n_c": math.inf, "d_c_m": math.inf, "c_t": 0.6} | search
        heights = {"scan_altitude_agl_m": H_S, "check_altitude_agl_m": H_C}
        self.strategy = ScanCheck(context_of(waypoints, look_s, **(heights | parameters)))
        self.candidates = {}
        self.time_s = 0.0

    def put(self, candidate_id, x, y, sightings=2):
        self.candidates[candidate_id] = Candidate(
            candidate_id, "stop sign", np.array([x, y, 0.0]), np.eye(2), 0.0, 0.0, (0.5,) * sightings
        )

    def at(self, x, y, z=H_S, sees=(), confidence=0.5, dt=0.1, looked_s=math.inf, **more):
        """One step at a place, seeing the candidates ``sees`` from there."""
        self.time_s += dt
        position = np.array([x, y, z], dtype=float)
        state = VehicleState(
            self.time_s, position, np.zeros(3), np.eye(3), CameraPose(position, np.eye(3)), 1.0, 0.0, True
        )
        hits = tuple(
            Sighting(k, False, self.time_s, self.candidates[k].position_enu_m, confidence, z) for k in sees
        )
        looks = () if looked_s is None else (Look(looked_s, state.camera, Lens(640, 360, 1.4), hits),)
        return self.strategy.step(Observation(state, z, looks, dict(self.candidates), **more))


def kinds(command):
    return [e.kind for e in command.events]


def test_scan_flies_f_in_order_at_scan_altitude_and_speed():
    p = Player()
    first = p.at(-20, 0)
    assert first.mode == "SCAN"
    assert first.waypoint.xy_enu_m == F[0]
    assert (first.waypoint.altitude_agl_m, first.waypoint.speed_mps) == (H_S, 5.0)
    assert p.at(0, 0).waypoint.xy_enu_m == F[1]
    assert p.at(50, 0).waypoint.xy_enu_m == F[1]
    assert p.at(100, 0).waypoint.xy_enu_m == F[2]


def test_nothing_seen_ends_with_f():
    p = Player(n_c=1)
    for x, y in F[:2]:
        assert p.at(x, y).waypoint is not None
    last = p.at(*F[2])
    assert last.waypoint is None
    assert kinds(last) == ["waypoint_reached", "finished"]


def test_n_c_1_checks_at_once_at_check_altitude_and_speed():
    p = Player(n_c=1)
    p.put(1, 20, 3)
    command = p.at(10, 0, sees=[1])
    assert kinds(command) == ["scanned", "check_started"]
    assert command.mode == "CHECK"
    assert command.waypoint.xy_enu_m == (20.0, 3.0)
    assert (command.waypoint.altitude_agl_m, command.waypoint.speed_mps) == (H_C, 1.0)


def test_n_c_waits_for_that_many():
    p = Player(n_c=3)
    for k in (1, 2, 3):
        p.put(k, 10 * k, 0)
    assert p.at(5, 0, sees=[1]).mode == "SCAN"
    assert p.at(6, 0, sees=[2]).mode == "SCAN"
    assert p.at(7, 0, sees=[1, 2]).mode == "SCAN", "known candidates do not count again"
    assert p.at(8, 0, sees=[3]).mode == "CHECK"


def test_d_c_counts_from_where_the_last_new_one_was_seen():
    p = Player(d_c_m=20.0)
    p.put(1, 10, 0)
    p.put(2, 15, 0)
    p.at(10, 0, sees=[1])
    assert p.at(25, 0, sees=[2]).mode == "SCAN", "a new one starts the distance anew"
    assert p.at(44, 0).mode == "SCAN"
    assert p.at(45, 0).mode == "CHECK"


def test_seeing_a_known_one_again_does_not_reset_d_c():
    p = Player(d_c_m=20.0)
    p.put(1, 10, 0)
    p.at(10, 0, sees=[1])
    p.at(29, 0, sees=[1])
    assert p.at(30, 0).mode == "CHECK"


def test_d_c_with_empty_s_never_checks():
    p = Player(d_c_m=1.0, n_c=1)
    assert all(p.at(x, 0).mode == "SCAN" for x in range(10, 90, 5))


def test_d_c_starts_anew_after_a_check():
    p = Player(d_c_m=20.0)
    p.put(1, 10, 0)
    p.at(10, 0, sees=[1])
    assert p.at(30, 0).mode == "CHECK"
    assert p.at(10, 0, H_C, sees=[1], confidence=0.9).mode == "SCAN"
    assert p.at(70, 0).mode == "SCAN"


def test_confirmed_at_check_altitude_with_confidence():
    p = Player(n_c=1)
    p.put(1, 10, 0)
    p.at(10, 0, sees=[1])
    assert "confirmed" not in kinds(p.at(10, 0, 10.0, sees=[1], confidence=0.99)), "too high"
    assert "confirmed" not in kinds(p.at(10, 0, H_C, sees=[1], confidence=0.59)), "not sure enough"
    command = p.at(10, 0, H_C, sees=[1], confidence=0.6)
    assert kinds(command) == ["confirmed", "scan_resumed"]
    assert command.mode == "SCAN"
    assert command.waypoint.altitude_agl_m == H_S


def test_rejected_only_after_a_full_look_from_above():
    p = Player(n_c=1, look_s=1.0)
    p.put(1, 20, 0)
    p.at(10, 0, sees=[1])
    for _ in range(50):
        assert p.at(18, 0, H_C).mode == "CHECK", "not there yet"
    p.at(20, 0, H_C)
    assert p.at(20, 0, H_C, dt=0.9).mode == "CHECK"
    command = p.at(20, 0, H_C, dt=0.2)
    assert kinds(command) == ["rejected", "scan_resumed"]


def test_settled_candidates_are_not_scanned_again():
    p = Player(n_c=1)
    p.put(1, 10, 0)
    p.put(2, 12, 0)
    p.at(10, 0, sees=[1])
    p.at(10, 0, H_C, sees=[1], confidence=0.9)
    assert p.at(20, 0, sees=[1], confidence=0.9).mode == "SCAN"
    p.at(20, 0, sees=[2])
    p.at(12, 0, H_C)
    p.at(12, 0, H_C, dt=2.0)
    assert p.at(20, 0, sees=[1, 2]).mode == "SCAN"


def test_s_is_emptied_when_it_becomes_c():
    p = Player(n_c=2)
    for k in (1, 2, 3):
        p.put(k, 10 * k, 0)
    p.at(5, 0, sees=[1, 2])
    p.at(10, 0, H_C, sees=[1], confidence=0.9)
    p.at(20, 0, H_C, sees=[2], confidence=0.9)
    assert p.at(25, 0, sees=[3]).mode == "SCAN", "one new one is not two"


def test_c_is_visited_in_the_order_of_discovery():
    p = Player(n_c=3)
    for k, x in ((7, 50), (4, 10), (9, 30)):
        p.put(k, x, 0)
    command = p.at(5, 0, sees=[7, 4, 9])
    order = [command.waypoint.xy_enu_m[0]]
    for k in (7, 4):
        x = p.candidates[k].position_enu_m[0]
        order.append(p.at(x, 0, H_C, sees=[k], confidence=0.9).waypoint.xy_enu_m[0])
    assert order == [50, 10, 30]


def test_another_of_c_is_confirmed_on_the_way():
    p = Player(n_c=2)
    p.put(1, 10, 0)
    p.put(2, 12, 0)
    p.at(5, 0, sees=[1, 2])
    command = p.at(10, 0, H_C, sees=[2], confidence=0.9)
    assert kinds(command) == ["confirmed"]
    assert command.mode == "CHECK"
    assert command.waypoint.xy_enu_m[0] == 10


def test_first_seen_in_check_is_scanned_only_when_a_scan_sees_it():
    p = Player(n_c=1)
    p.put(1, 10, 0)
    p.put(2, 14, 0)
    p.at(5, 0, sees=[1])
    command = p.at(9, 0, 12.0, sees=[2], confidence=0.9)
    assert "scanned" not in kinds(command)
    p.at(10, 0, H_C, sees=[1], confidence=0.9)
    command = p.at(10, 0, 8.0, sees=[2])
    assert kinds(command) == ["scanned", "check_started"], "the climb is a scan"


def test_the_scan_goes_on_where_it_was_left_and_at_scan_altitude():
    p = Player(n_c=1)
    p.put(1, 48, 12)
    p.at(0, 0)
    p.at(40, 1, sees=[1])
    command = p.at(48, 12, H_C, sees=[1], confidence=0.9)
    assert command.waypoint.xy_enu_m == (40.0, 1.0)
    assert p.at(40, 1, 20.0).waypoint.xy_enu_m == (40.0, 1.0), "still too low"
    assert p.at(40, 1, H_S - 0.5).waypoint.xy_enu_m == F[1]


def test_a_check_on_the_way_back_does_not_move_the_place_to_go_on_from():
    p = Player(n_c=1)
    p.put(1, 48, 12)
    p.put(2, 44, 8)
    p.at(0, 0)
    p.at(40, 1, sees=[1])
    p.at(48, 12, H_C, sees=[1], confidence=0.9)
    assert p.at(45, 9, 12.0, sees=[2]).mode == "CHECK"
    command = p.at(44, 8, H_C, sees=[2], confidence=0.9)
    assert command.waypoint.xy_enu_m == (40.0, 1.0)


def test_last_check_when_f_is_empty_then_the_end():
    p = Player()
    p.put(1, 50, 0)
    p.at(0, 0)
    p.at(50, 0, sees=[1])
    p.at(100, 0)
    command = p.at(100, 30)
    assert kinds(command) == ["waypoint_reached", "check_started"]
    assert command.waypoint.xy_enu_m == (50.0, 0.0)
    command = p.at(50, 0, H_C, sees=[1], confidence=0.9)
    assert command.waypoint is None
    assert kinds(command) == ["confirmed", "scan_resumed", "finished"]


def test_last_check_takes_along_what_only_checks_have_seen():
    p = Player()
    p.put(1, 50, 0)
    p.at(0, 0)
    p.at(50, 0, sees=[1])
    p.at(100, 0)
    p.at(100, 30)
    p.put(2, 45, 0)
    p.at(60, 10, 15.0, sees=[2])
    command = p.at(50, 0, H_C, sees=[1], confidence=0.9)
    assert kinds(command) == ["confirmed", "scan_resumed", "check_started"]
    assert command.waypoint.xy_enu_m == (45.0, 0.0)
    command = p.at(45, 0, H_C, sees=[2], confidence=0.9)
    assert command.waypoint is None


def test_what_only_a_check_saw_and_only_once_is_left_alone():
    p = Player()
    p.put(1, 50, 0)
    p.at(0, 0)
    p.at(50, 0, sees=[1])
    p.at(100, 0)
    p.at(100, 30)
    p.put(2, 45, 0, sightings=1)
    p.at(60, 10, 15.0, sees=[2])
    assert p.at(50, 0, H_C, sees=[1], confidence=0.9).waypoint is None


def test_moving_estimates_are_followed():
    p = Player(n_c=1)
    p.put(1, 20, 0)
    p.at(10, 0, sees=[1])
    p.put(1, 21, 1)
    assert p.at(15, 0, 15.0, sees=[1]).waypoint.xy_enu_m == (21.0, 1.0)


@pytest.mark.parametrize("cut", range(1, 9))
def test_a_restored_strategy_goes_on_as_if_nothing_had_happened(cut):
    def script(p):
        yield p.at(0, 0)
        yield p.at(5, 0, sees=[1])
        yield p.at(8, 0, sees=[2])
        yield p.at(10, 0, H_C)
        yield p.at(10, 0, H_C, dt=0.9)
        yield p.at(10, 0, H_C, dt=0.2)
        yield p.at(20, 0, H_C, sees=[2], confidence=0.8)
        yield p.at(100, 0)
        yield p.at(100, 30)

    def player():
        p = Player(n_c=2)
        p.put(1, 10, 0)
        p.put(2, 20, 0)
        return p

    whole = list(script(player()))
    p = player()
    resumed = []
    for i, command in enumerate(script(p), start=1):
        resumed.append(command)
        if i == cut:
            fresh = player()
            fresh.strategy.restore(p.strategy.snapshot())
            p.strategy = fresh.strategy
    assert resumed == whole


def test_a_refused_candidate_is_unchecked_and_the_next_one_is_checked():
    p = Player(n_c=2)
    p.put(1, 20, 0)
    p.put(2, 30, 0)
    assert p.at(10, 0, sees=[1, 2]).waypoint.xy_enu_m == (20.0, 0.0)
    command = p.at(10, 0, refused="geofence")
    assert kinds(command) == ["unchecked"]
    assert command.waypoint.xy_enu_m == (30.0, 0.0)
    command = p.at(10, 0, refused="geofence")
    assert kinds(command) == ["unchecked", "scan_resumed"]
    assert command.mode == "SCAN"
    assert kinds(p.at(10, 0, sees=[1, 2])) == [], "it is not asked for again"


def test_a_refusal_that_comes_with_the_verdict_does_not_count_for_the_next_one():
    p = Player(n_c=2)
    p.put(1, 20, 0)
    p.put(2, 30, 0)
    p.at(10, 0, sees=[1, 2])
    command = p.at(10, 0, z=H_C, sees=[1], confidence=0.9, refused="geofence")
    assert kinds(command) == ["confirmed"]
    assert command.waypoint.xy_enu_m == (30.0, 0.0)


BESIDE = Waypoint((23.0, 0.0), 9.0, 1.0, to_look=True)


def test_a_candidate_is_flown_to_for_what_is_seen_there():
    p = Player(n_c=1)
    p.put(1, 20, 0)
    assert p.at(10, 0, sees=[1]).waypoint.to_look
    assert not Player().at(10, 0).waypoint.to_look


def test_from_a_lookout_a_candidate_is_confirmed_at_its_height_but_not_on_the_way_there():
    p = Player(n_c=1)
    p.put(1, 20, 0)
    p.at(10, 0, sees=[1])
    assert kinds(p.at(15, 0, z=9.0, sees=[1], confidence=0.9, lookout=BESIDE)) == []
    assert kinds(p.at(23, 0, z=9.0, lookout=BESIDE)) == []
    command = p.at(23, 0, z=9.0, sees=[1], confidence=0.9, lookout=BESIDE)
    assert kinds(command) == ["confirmed", "scan_resumed"]


def test_at_that_height_it_is_not_confirmed_without_a_lookout():
    p = Player(n_c=1)
    p.put(1, 20, 0)
    p.at(10, 0, sees=[1])
    for _ in range(3):
        assert kinds(p.at(20, 0, z=9.0, sees=[1], confidence=0.9)) == []


@pytest.mark.parametrize(("x", "z", "rejected"), [(23.0, 9.0, True), (20.0, 9.0, False), (23.0, 12.0, False)])
def test_a_rejection_needs_looks_from_the_lookout(x, z, rejected):
    p = Player(n_c=1, look_s=1.0)
    p.put(1, 20, 0)
    p.at(10, 0, sees=[1])
    told = [kind for _ in range(15) for kind in kinds(p.at(x, 0, z=z, lookout=BESIDE))]
    assert ("rejected" in told) == rejected


def test_the_lookout_of_one_candidate_is_not_that_of_the_next():
    p = Player(n_c=2, look_s=1.0)
    p.put(1, 20, 0)
    p.put(2, 23, 0)
    p.at(10, 0, sees=[1, 2])
    p.at(23, 0, z=9.0, lookout=BESIDE)
    assert kinds(p.at(23, 0, z=9.0, sees=[1], confidence=0.9, lookout=BESIDE)) == ["confirmed"]
    assert [kind for _ in range(15) for kind in kinds(p.at(23, 0, z=9.0))] == []


def test_a_candidate_is_not_rejected_before_two_looks_from_above_were_answered():
    p = Player(n_c=1, look_s=1.0)
    p.put(1, 20, 0)
    p.at(10, 0, sees=[1])
    p.at(20, 0, H_C, looked_s=None)
    above_s = p.time_s
    assert p.at(20, 0, H_C, dt=60.0, looked_s=None).mode == "CHECK"
    assert p.at(20, 0, H_C, looked_s=above_s - 0.1).mode == "CHECK", "exposed on the way"
    assert p.at(20, 0, H_C, looked_s=above_s).mode == "CHECK"
    assert kinds(p.at(20, 0, H_C, looked_s=above_s + 0.4)) == ["rejected", "scan_resumed"]


def test_legs_flown_blind_come_at_the_end_of_f():
    p = Player()
    p.at(0, 0, unsearched=(((10.0, 0.0), (40.0, 0.0)), ((40.0, 0.0), (40.0, 20.0))))
    visited = []
    while (command := p.at(*(visited[-1] if visited else (0, 0)))).waypoint is not None:
        if command.waypoint.xy_enu_m not in visited[-1:]:
            visited.append(command.waypoint.xy_enu_m)
    assert visited == [*F[1:], (10.0, 0.0), (40.0, 0.0), (40.0, 20.0)]


def test_a_blind_leg_told_at_the_end_is_still_flown():
    p = Player()
    for xy in F[:2]:
        p.at(*xy)
    command = p.at(*F[2], unsearched=(((5.0, 5.0), (50.0, 5.0)),))
    assert command.waypoint.xy_enu_m == (5.0, 5.0)


@pytest.mark.parametrize("altitude", [H_S, H_C])
def test_the_baselines_fly_blind_legs_again_too(altitude):
    p = Player()
    p.strategy = SingleAltitude(context_of(F), altitude)
    for xy in F[:2]:
        p.at(*xy, altitude)
    command = p.at(*F[2], altitude, unsearched=(((5.0, 5.0), (50.0, 5.0)),))
    assert command.waypoint.xy_enu_m == (5.0, 5.0)


def test_a_drawn_plan_is_of_the_scan_altitude():
    drawn = context_of(F, strategy="low-only", plan="mine.plan")
    with pytest.raises(UserError, match=r"search\.plan: .* low-only flies at 4 m; delete it"):
        SingleAltitude(drawn, 4.0)


def test_a_close_look_that_is_demanded_is_one_from_low_enough():
    with pytest.raises(
        ValidationError, match=r"confirm_height_max_m: is 4, and checks are .* write 4.8 or more"
    ):
        Search(check_altitude_agl_m=4.0, confirm_height_max_m=4.0)
    with pytest.raises(UserError, match=r"is 20, and scan-only looks from 30 m alone; write null"):
        SingleAltitude(context_of(F, strategy="scan-only", confirm_height_max_m=20.0), 30.0)
    assert SingleAltitude(context_of(F, confirm_height_max_m=20.0), 4.0)


def test_the_operators_verdict_takes_a_candidate_out_of_s():
    p = Player(n_c=2)
    p.put(1, 20, 0)
    p.put(2, 30, 0)
    p.at(10, 0, sees=[1])
    rejected = {1: EventKind.REJECTED}
    assert p.at(11, 0, sees=[2], verdicts=rejected).mode == "SCAN", "one is left of the two"
    assert kinds(p.at(12, 0, sees=[1], verdicts=rejected)) == [], "it is not scanned again"


def test_the_operators_verdict_on_the_goal_turns_to_the_next_one():
    p = Player(n_c=2)
    p.put(1, 20, 0)
    p.put(2, 30, 0)
    p.at(10, 0, sees=[1, 2])
    command = p.at(12, 0, verdicts={1: EventKind.CONFIRMED}, refused="geofence")
    assert kinds(command) == [], "what was refused was the way to the first one"
    assert command.waypoint.xy_enu_m == (30.0, 0.0)
    both = {1: EventKind.CONFIRMED, 2: EventKind.REJECTED}
    assert kinds(p.at(13, 0, verdicts=both)) == ["scan_resumed"]


def test_the_operators_verdict_on_another_one_leaves_the_check_as_it_is():
    p = Player(n_c=2)
    p.put(1, 20, 0)
    p.put(2, 30, 0)
    p.at(10, 0, sees=[1, 2])
    p.at(20, 0, z=H_C)
    p.at(20, 0, z=H_C, dt=0.5, verdicts={2: EventKind.REJECTED})
    assert kinds(p.at(20, 0, z=H_C, dt=0.6, verdicts={2: EventKind.REJECTED})) == ["rejected", "scan_resumed"]


def test_the_operators_verdict_may_change_and_outlives_a_snapshot():
    p = Player(n_c=1)
    p.put(1, 20, 0)
    p.at(10, 0, sees=[1])
    p.at(11, 0, verdicts={1: EventKind.REJECTED})
    assert p.strategy.snapshot()["rejected"] == [1]
    p.at(12, 0, verdicts={1: EventKind.CONFIRMED})
    assert (p.strategy.snapshot()["rejected"], p.strategy.snapshot()["confirmed"]) == ([], [1])
    p.strategy.restore(p.strategy.snapshot())
    assert kinds(p.at(13, 0, sees=[1], verdicts={1: EventKind.CONFIRMED})) == []


def test_looks_from_elsewhere_are_no_looks_from_above():
    p = Player(n_c=1)
    p.put(1, 20, 0)
    p.at(10, 0, sees=[1])
    p.at(20, 0, z=H_C)
    p.at(20, 0, z=H_C, dt=30.0, looked_s=20.0, elsewhere=True)
    assert kinds(p.at(20, 0, z=H_C)) == [], "one look from above is too few"
    assert kinds(p.at(20, 0, z=H_C, dt=1.0)) == ["rejected", "scan_resumed"]


def test_a_single_altitude_says_nothing_of_what_the_operator_decided():
    p = Player()
    p.strategy = SingleAltitude(context_of(F, 1.0, scan_altitude_agl_m=H_S, check_altitude_agl_m=H_C), H_S)
    p.put(1, 20, 0)
    assert kinds(p.at(10, 0, sees=[1], confidence=0.9, verdicts={1: EventKind.REJECTED})) == []
    assert kinds(p.at(10, 0, sees=[1], confidence=0.9)) == ["scanned", "confirmed"]
