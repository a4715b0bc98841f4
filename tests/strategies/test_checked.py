"""What a strategy of a user's own code answers is looked at before it is flown."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from contexts import context_of, observed

from skysweep.errors import UserError
from skysweep.strategies.checked import Checked, make_checked
from skysweep.types import Command, Event, EventKind, Mode, Waypoint

GOAL = Waypoint((10.0, 20.0), 30.0, 5.0)
TUTORIAL = Path(__file__).parents[2] / "docs/tutorials/strategy.md"


class Answers:
    """Answers the same to everything."""

    def __init__(self, command, state=None):
        self.command, self.state = command, {} if state is None else state

    def step(self, seen):
        return self.command(seen) if callable(self.command) else self.command

    def snapshot(self):
        return self.state

    def restore(self, snapshot):
        self.state = snapshot


def answer(command, **more):
    return Checked(Answers(command, **more), "mine:Own").step(observed())


def flown_to(**changes):
    return answer(Command(Mode.SCAN, GOAL._replace(**changes))).waypoint


def told(event):
    return answer(Command(Mode.SCAN, GOAL, (event,))).events


@pytest.mark.parametrize("xy", [[10.0, 20.0], np.array([10.0, 20.0]), (10, np.float32(20.0))])
def test_a_waypoint_is_of_plain_numbers(xy):
    waypoint = flown_to(xy_enu_m=xy, then_xy_enu_m=xy, altitude_agl_m=np.float64(30.0), speed_mps=5)
    assert waypoint == GOAL._replace(then_xy_enu_m=(10.0, 20.0))
    numbers = (*waypoint.xy_enu_m, *waypoint.then_xy_enu_m, waypoint.altitude_agl_m, waypoint.speed_mps)
    assert {type(number) for number in numbers} == {float}
    hash(waypoint)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"xy_enu_m": (1.0, 2.0, 0.0)}, r"the waypoint's xy_enu_m \(1\.0, 2\.0, 0\.0\); return two numbers"),
        ({"xy_enu_m": None}, "the waypoint's xy_enu_m None; return two numbers"),
        ({"xy_enu_m": ("1", "2")}, "the waypoint's xy_enu_m '1'; return a number"),
        ({"then_xy_enu_m": 3.0}, r"the waypoint's then_xy_enu_m 3\.0"),
        ({"altitude_agl_m": None}, "the waypoint's altitude_agl_m None; return a number"),
        ({"speed_mps": 10**400}, "the waypoint's speed_mps 1000.*; return a number"),
        ({"speed_mps": "fast"}, "the waypoint's speed_mps 'fast'"),
        ({"yaw_rad": "north"}, "the waypoint's yaw_rad 'north'"),
        ({"to_look": np.array([1, 0])}, r"the waypoint's to_look array\(\[1, 0\]\); return True or False"),
    ],
)
def test_a_waypoint_that_is_none_is_one_sentence(changes, sentence):
    with pytest.raises(UserError, match=f"^mine:Own: step returned {sentence}"):
        flown_to(**changes)


def test_a_settled_candidate_has_its_own_place_unless_another_is_given():
    own = (7.0, 8.0, 0.5)
    assert told(Event(EventKind.CONFIRMED, 1)) == (Event(EventKind.CONFIRMED, 1, own),)
    (event,) = told(Event("confirmed", np.int64(1), np.array(own), np.float32(0.5)))
    assert event == Event(EventKind.CONFIRMED, 1, own, 0.5)
    assert [type(value) for value in (event.kind, event.candidate_id)] == [EventKind, int]
    assert told(Event(EventKind.REJECTED, 1, (1, 2, 3)))[0].position_enu_m == (1.0, 2.0, 3.0)
    assert told(Event(EventKind.WAYPOINT_REACHED)) == (Event(EventKind.WAYPOINT_REACHED),)


@pytest.mark.parametrize(
    ("event", "sentence"),
    [
        ("confirmed", "the event 'confirmed'; return an Event"),
        (Event("found it", 1), "the event's kind 'found it'; return an EventKind"),
        (Event(EventKind.CONFIRMED), "the candidate_id of confirmed None; return the candidate"),
        (Event(EventKind.UNCHECKED, None, (1.0, 2.0, 3.0)), "the candidate_id of unchecked None"),
        (Event(EventKind.REASSESSED, 9), "the candidate_id of reassessed 9; return a key of"),
        (Event(EventKind.CONFIRMED, "1"), "the candidate_id of confirmed '1'"),
        (Event(EventKind.CONFIRMED, 1, (1.0, 2.0)), r"the position_enu_m of confirmed \(1\.0, 2\.0\)"),
        (Event(EventKind.CONFIRMED, 1, (math.nan, 0.0, 0.0)), "the position_enu_m of confirmed"),
        (Event(EventKind.CONFIRMED, 1, (0.0, 1e7, 0.0)), "the position_enu_m of confirmed"),
        (Event(EventKind.CONFIRMED, 1, probability=1.5), "the probability of confirmed 1.5; return a number"),
        (Event(EventKind.CONFIRMED, 1, probability=math.nan), "the probability of confirmed nan"),
        (Event(EventKind.CONFIRMED, 1, reason=3), "the reason of confirmed 3; return words"),
        (Event(EventKind.CONFIRMED, 1, alternatives={"a": 1.0}), "the alternatives of confirmed"),
    ],
)
def test_an_event_that_cannot_be_told_is_one_sentence(event, sentence):
    with pytest.raises(UserError, match=f"^mine:Own: step returned {sentence}"):
        told(event)


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        ("home", r"'home'; return a Command\(mode, waypoint, events\)"),
        (Command("SPIRAL", GOAL), r"the mode 'SPIRAL'; return Mode\.SCAN or Mode\.CHECK"),
        (Command(Mode.RETURN, GOAL), "the mode <Mode.RETURN"),
        (Command(None, GOAL), "the mode None"),
        (Command(Mode.SCAN, (1.0, 2.0)), r"the waypoint \(1\.0, 2\.0\); return a Waypoint, or None"),
        (Command(Mode.SCAN, GOAL, None), "the events None; return a tuple of Event"),
        (Command(Mode.SCAN, GOAL, Event(EventKind.FINISHED)), "the events Event"),
    ],
)
def test_what_is_no_command_is_one_sentence(command, sentence):
    with pytest.raises(UserError, match=f"^mine:Own: step returned {sentence}"):
        answer(command)


def test_the_words_of_modes_are_modes():
    assert answer(Command("CHECK", GOAL, [])) == Command(Mode.CHECK, GOAL)


def test_a_search_that_flies_on_is_not_finished():
    finished = Event(EventKind.FINISHED)
    assert answer(Command(Mode.SCAN, GOAL, (finished,))).events == ()
    assert answer(Command(Mode.SCAN, None, (finished,))).events == (finished,)


def test_what_it_raises_is_one_sentence_with_its_line():
    def raises(_seen):
        return next(iter(np.array([1.0, 2.0]).reshape(3)))

    line = raises.__code__.co_firstlineno + 1
    with pytest.raises(
        UserError, match=f"^mine:Own: step raises ValueError: .* at test_checked.py:{line}; mend"
    ):
        answer(raises)


def test_an_exit_is_a_failure_and_does_not_end_the_program_without_a_word():
    def leaves(*_):
        raise SystemExit(0)

    with pytest.raises(
        UserError, match=r"^mine:Own: step raises SystemExit: 0 at test_checked\.py:\d+; mend"
    ):
        answer(leaves)
    with pytest.raises(UserError, match=r"^mine:Own: cannot be made of a MissionContext \(SystemExit: 0"):
        make_checked(leaves, "mine:Own", context_of())


def test_what_is_seen_cannot_be_written_to():
    seen = observed()

    def writes(given):
        vehicle, (look,), candidate = given.vehicle, given.looks, given.candidates.pop(1)
        cameras = (*vehicle.camera, *look.camera)
        moves = vehicle.position_enu_m, vehicle.velocity_enu_mps, vehicle.R_body_to_enu
        places = candidate.position_enu_m, candidate.covariance_m2, look.hits[0].position_enu_m
        for array in (*moves, *cameras, *places):
            with pytest.raises(ValueError, match="read-only"):
                array += 1.0
        return Command(Mode.SCAN, GOAL)

    Checked(Answers(writes), "mine:Own").step(seen)
    assert list(seen.candidates) == [1]
    seen.vehicle.position_enu_m[0] = 5.0  # the vehicle's own


def test_a_snapshot_is_what_the_journal_gives_back():
    state = {"to_scan": [(1.0, 2.0)], "found": np.array([3]), 4: "word"}
    plain = Checked(Answers(None, state), "mine:Own").snapshot()
    assert plain == {"to_scan": [[1.0, 2.0]], "found": [3], "4": "word"}


class Forgets(Answers):
    def restore(self, snapshot):
        self.state = snapshot["never there"]


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (
            lambda _context: Answers(None, {"found": {1}}),
            r"snapshot returned what JSON cannot hold \(a set\)",
        ),
        (lambda _context: Answers(None, [1]), r"snapshot returned \[1\]; return a dict"),
        (lambda _context: Forgets(None), r"restore raises KeyError: 'never there' at test_checked\.py:\d+"),
    ],
)
def test_one_that_could_not_be_gone_on_with_is_refused_before_take_off(make, sentence):
    with pytest.raises(UserError, match=f"^mine:Own: {sentence}"):
        make_checked(make, "mine:Own", context_of())


def test_the_tutorials_strategy_goes_on_from_the_journal():
    (code,) = re.findall(r'title="my_strategy.py"\n(.*?)```', TUTORIAL.read_text("utf-8"), re.DOTALL)
    names = {}
    exec(code, names)
    context = context_of([(50.0, 0.0), (100.0, 0.0)])
    first, second = names["SeenTwice"](context), names["SeenTwice"](context)
    before = first.step(observed())
    second.restore(json.loads(json.dumps(first.snapshot())))
    assert second.step(observed()) == before
    hash(before.waypoint)
