"""Looks at what a strategy of a user's own code answers, so that the loop gets what ``types`` promises."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose
from skysweep.strategies.context import MissionContext
from skysweep.strategies.failures import failure_words
from skysweep.types import (
    F64,
    SEARCHING,
    SETTLING,
    XY,
    Candidate,
    Command,
    Event,
    EventKind,
    Look,
    Mode,
    Observation,
    Strategy,
    VehicleState,
    Waypoint,
)

_Answer = TypeVar("_Answer")

_METHODS = ("step", "snapshot", "restore")
_FARTHEST_M = 1e6  # of an event's place from home, along each axis


def make_checked(make: Callable[[MissionContext], Any], where: str, context: MissionContext) -> Checked:
    """A strategy whose answers are looked at; ``where`` begins the errors.

    Raises UserError where none can be made, or another one cannot go on from its snapshot: then no flight
    could be resumed.
    """
    strategy, another = (Checked(_made(make, where, context), where) for _ in range(2))
    another.restore(strategy.snapshot())
    return strategy


def refuse_lacking(given: Any, what: str, where: str) -> None:
    """Raises UserError where an object or class has not all the methods of a strategy."""
    missing = [name for name in _METHODS if not callable(getattr(given, name, None))]
    if missing:
        raise UserError(f"{where}: {what} has no {' and no '.join(missing)}; write what is missing")


def _made(make: Callable[[MissionContext], Any], where: str, context: MissionContext) -> Strategy:
    try:
        made = make(context)
    except UserError:
        raise
    except (Exception, SystemExit) as error:
        raise UserError(
            f"{where}: cannot be made of a MissionContext ({failure_words(error)}); mend it"
        ) from error
    refuse_lacking(made, f"the {type(made).__name__} that it makes", where)
    checked: Strategy = made
    return checked


class Checked:
    """A strategy that fails in one sentence. Implements ``types.Strategy``.

    Each method raises UserError, with the line of the user's code, where the strategy's own raises something
    else, and where its answer is none.
    """

    def __init__(self, strategy: Strategy, where: str) -> None:
        self.strategy, self._where = strategy, where

    def step(self, observation: Observation) -> Command:
        """What the strategy answers, in plain numbers. It cannot write into what the mission knows."""
        command = self._call("step", self.strategy.step, _read_only(observation))
        if not isinstance(command, Command):
            raise UserError(
                f"{self._where}: step returned {command!r:.60}; return a Command(mode, waypoint, events)"
            )
        if not isinstance(command.mode, str) or command.mode not in SEARCHING:
            raise UserError(
                f"{self._where}: step returned the mode {command.mode!r:.60}; return Mode.SCAN or Mode.CHECK"
            )
        waypoint = None if command.waypoint is None else self._waypoint(command.waypoint)
        if not isinstance(command.events, tuple | list):
            raise UserError(
                f"{self._where}: step returned the events {command.events!r:.60}; return a tuple of Event"
            )
        events = [self._event(event, observation) for event in command.events]
        if waypoint is not None:  # it flies on: the search is not over
            events = [event for event in events if event.kind is not EventKind.FINISHED]
        return Command(Mode(command.mode), waypoint, tuple(events))

    def snapshot(self) -> dict[str, Any]:
        """The strategy's state, as it will be read from the journal."""
        state = self._call("snapshot", self.strategy.snapshot)
        if not isinstance(state, dict):
            raise UserError(f"{self._where}: snapshot returned {state!r:.60}; return a dict of plain data")
        try:
            plain: dict[str, Any] = json.loads(json.dumps(state, default=_plain))
        except (TypeError, ValueError) as error:
            raise UserError(
                f"{self._where}: snapshot returned what JSON cannot hold ({error}); return numbers, words, "
                "lists and dicts of them"
            ) from error
        return plain

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a state that ``snapshot`` gave."""
        self._call("restore", self.strategy.restore, snapshot)

    def _call(self, name: str, method: Callable[..., _Answer], *arguments: Any) -> _Answer:
        try:
            return method(*arguments)
        except UserError:
            raise
        except (Exception, SystemExit) as error:
            raise UserError(f"{self._where}: {name} raises {failure_words(error)}; mend it") from error

    def _waypoint(self, waypoint: Any) -> Waypoint:
        if not isinstance(waypoint, Waypoint):
            raise self._odd("waypoint", waypoint, "a Waypoint, or None when the search is over")
        xy, altitude_agl_m, speed_mps, to_look, then_xy, yaw_rad, pitch_rad = waypoint
        return Waypoint(
            self._xy("xy_enu_m", xy),
            self._number("altitude_agl_m", altitude_agl_m),
            self._number("speed_mps", speed_mps),
            self._truth("to_look", to_look),
            None if then_xy is None else self._xy("then_xy_enu_m", then_xy),
            None if yaw_rad is None else self._number("yaw_rad", yaw_rad),
            None if pitch_rad is None else self._number("gimbal_pitch_rad", pitch_rad),
        )

    def _xy(self, field: str, value: Any) -> XY:
        try:
            x, y = value
        except (TypeError, ValueError):
            raise self._odd(f"waypoint's {field}", value, "two numbers, east and north in metres") from None
        return self._number(field, x), self._number(field, y)

    def _truth(self, field: str, value: Any) -> bool:
        try:
            return bool(value)
        except Exception:
            raise self._odd(f"waypoint's {field}", value, "True or False") from None

    def _number(self, field: str, value: Any) -> float:
        try:
            if isinstance(value, Real):
                return float(value)
        except OverflowError:  # an integer beyond any float
            pass
        raise self._odd(f"waypoint's {field}", value, "a number")

    def _event(self, event: Any, seen: Observation) -> Event:
        """The event with plain numbers, and with its candidate's place where it has none."""
        if not isinstance(event, Event):
            raise self._odd("event", event, "an Event(kind, candidate_id)")
        try:
            kind = EventKind(event.kind)
        except ValueError:
            raise self._odd("event's kind", event.kind, "an EventKind") from None
        number, place = event.candidate_id, event.position_enu_m
        if number is None and kind in SETTLING:
            raise self._odd(f"candidate_id of {kind}", None, "the candidate that it decides on")
        if number is not None and (not isinstance(number, Integral) or number not in seen.candidates):
            raise self._odd(f"candidate_id of {kind}", number, "a key of observation.candidates")
        if place is None and number is not None:
            place = seen.candidates[number].position_enu_m
        probability = event.probability
        if probability is not None:
            if not isinstance(probability, Real) or not 0.0 <= probability <= 1.0:
                raise self._odd(f"probability of {kind}", probability, "a number from 0 to 1")
            probability = float(probability)
        if not isinstance(event.reason, str):
            raise self._odd(f"reason of {kind}", event.reason, "words")
        return replace(
            event,
            kind=kind,
            candidate_id=None if number is None else int(number),
            position_enu_m=None if place is None else self._place(kind, place),
            probability=probability,
            alternatives=self._alternatives(kind, event.alternatives),
        )

    def _place(self, kind: EventKind, place: Any) -> tuple[float, float, float]:
        try:
            x, y, z = map(float, place)
        except (TypeError, ValueError):
            x = y = z = math.nan
        if not all(abs(along) <= _FARTHEST_M for along in (x, y, z)):  # nor is NaN
            raise self._odd(f"position_enu_m of {kind}", place, "three numbers, in metres from home")
        return x, y, z

    def _alternatives(self, kind: EventKind, given: Any) -> tuple[tuple[str, float], ...]:
        try:
            return tuple((str(what), float(cost_s)) for what, cost_s in given)
        except (TypeError, ValueError, OverflowError):
            raise self._odd(f"alternatives of {kind}", given, "pairs of words and seconds") from None

    def _odd(self, what: str, value: Any, instead: str) -> UserError:
        return UserError(f"{self._where}: step returned the {what} {value!r:.60}; return {instead}")


def _plain(value: Any) -> Any:
    """NumPy's numbers and arrays, as the journal writes them."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"a {type(value).__name__}")


def _read_only(seen: Observation) -> Observation:
    """The observation with arrays that cannot be written to, and a dict of candidates of its own."""
    return seen._replace(
        vehicle=_of_vehicle(seen.vehicle),
        looks=tuple(_of_look(look) for look in seen.looks),
        candidates={k: _of_candidate(candidate) for k, candidate in seen.candidates.items()},
    )


def _of_vehicle(state: VehicleState) -> VehicleState:
    wind = state.wind_enu_mps
    return state._replace(
        position_enu_m=_locked(state.position_enu_m),
        velocity_enu_mps=_locked(state.velocity_enu_mps),
        R_body_to_enu=_locked(state.R_body_to_enu),
        camera=CameraPose(*map(_locked, state.camera)),
        wind_enu_mps=None if wind is None else _locked(wind),
    )


def _of_look(look: Look) -> Look:
    hits = tuple(hit._replace(position_enu_m=_locked(hit.position_enu_m)) for hit in look.hits)
    return look._replace(camera=CameraPose(*map(_locked, look.camera)), hits=hits)


def _of_candidate(candidate: Candidate) -> Candidate:
    """Itself: the tracker makes a new one for each sighting, and never writes into an old one."""
    for array in (candidate.position_enu_m, candidate.covariance_m2):
        array.setflags(write=False)
    return candidate


def _locked(array: F64) -> F64:
    """A view that cannot be written to; a vehicle may still write to its own array."""
    view = np.asarray(array).view()
    view.setflags(write=False)
    return view
