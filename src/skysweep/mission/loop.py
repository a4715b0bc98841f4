"""The one mission loop: sense, track, decide, fly. The same for every vehicle, sensor and strategy.

:class:`Flight` steps a mission tick by tick; :func:`fly` runs one to its end.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np

from skysweep.errors import UserError
from skysweep.mission.believable import Believable, has_place
from skysweep.mission.clearance import Clearance, too_high
from skysweep.mission.desk import Desk
from skysweep.mission.energy import ReturnEnergy, wind_xy
from skysweep.mission.fence import Fence, Router
from skysweep.mission.journal import Journal
from skysweep.mission.looks import Looks
from skysweep.mission.mission import Mission, Watch
from skysweep.mission.notes import NEXT_SORTIE, SORTIE, Notes
from skysweep.mission.orders import CONTINUE, MOST_WAITING, Operator, Order
from skysweep.mission.safety import (
    BATTERY_CHANGE,
    CHECK_PERIOD_S,
    LOST,
    LOW_BATTERY,
    RETURN_ENERGY,
    Action,
    Alarm,
    Guard,
    Phase,
    not_finite,
)
from skysweep.planning.flight_plan import CHARGED, POSITION_GAIN, landing_time_s
from skysweep.planning.following import LOOK_AHEAD_S, Planned
from skysweep.scenarios.model import ALTITUDE_TOLERANCE_M
from skysweep.strategies.failures import failure_words
from skysweep.types import (
    F64,
    SEARCHING,
    SETTLING,
    XY,
    Candidate,
    Command,
    Detections,
    Event,
    EventKind,
    Look,
    Mode,
    Observation,
    Setpoint,
    VehicleState,
    Waypoint,
)

_Result = TypeVar("_Result")
_Part: TypeAlias = Generator["Tick", None, _Result]  # of a flight, and its result

_TICK_MAX_S = 0.5  # also of a camera that is slower
_HOME_ACCEPTANCE_M = 1.0
_TAKE_OFF_LONGEST_S = 60.0  # and twice the climb
_LANDING_LONGEST_S = 60.0  # and twice the way down
_LANDING_ORDERS = 3
_STANDS_MPS = 0.5  # vertically: what moves faster has not landed
_CLIMBS_MPS = 1.0  # horizontally
_DISPLACED_M = 10.0  # by somebody else, or by what the autopilot did while the link was lost
_BACK_M = 2.0
_AT_HOME_M = 20.0  # near enough to change the battery
_LONGEST_WAIT_S = 600.0  # of a simulated vehicle, on the ground
_REFUSED_LONGEST_S = 10.0  # without a waypoint that is flown to
_REFUSALS_TOLD = 5  # one after the other
_BROKEN_OFF = "broken off"  # why a sortie ended in which our program did
_ALL_WELL = Alarm(Action.CONTINUE, "completed", "")


class Tick(NamedTuple):
    """The mission at one tick, before time advances."""

    state: VehicleState
    mode: Mode
    detections: Detections | None  # new ones


class Flight:
    """One mission from take-off to landing, as an iterator of ticks.

    Mission time 0 is the take-off command. ``end_reason`` is None during the flight, then ``completed`` or a
    safety cause. As a context manager it makes the vehicle hold if anything ends the flight early.

    ``operator`` is asked at every tick. ``before`` holds the journal of an interrupted mission that this one
    continues.

    Raises UserError, with the vehicle untouched, if the mission must not take off.
    """

    def __init__(
        self,
        mission: Mission,
        journal: Journal,
        operator: Operator = lambda: None,
        before: Sequence[Mapping[str, Any]] = (),
    ) -> None:
        scenario = mission.scenario
        self._heard = Believable(mission.vehicle)
        self._m = replace(mission, vehicle=self._heard)
        self._operator, self._before = operator, before
        self._notes = Notes(journal)
        picture_s = 1.0 / scenario.camera.rate_hz
        self._tick_s = picture_s / math.ceil(picture_s / _TICK_MAX_S)
        self._looks = Looks(scenario, mission.look_period, mission.cover_altitude_agl_m)
        self._looks.take_blind(mission.blind_legs)
        state = self._heard.state()
        high = too_high(scenario, mission.obstacles)
        stands = has_place(state) and not state.airborne
        own = state.position_enu_m[None, :2] if stands else np.zeros((0, 2))
        self._fence = Fence(scenario, high, np.vstack([mission.waypoints_xy_enu_m, own]))
        self._router = Router(self._fence)
        self._clearance = Clearance(scenario, mission.obstacles, self._fence, mission.yaw_rad)
        energy = ReturnEnergy(
            scenario,
            self._fence,
            mission.obstacles.terrain,
            mission.return_altitude_agl_m,
            2.0 * self._looks.usual_age_s,
        )
        self._guard = Guard(scenario, self._fence, energy, self._looks, mission.obstacles, state.airborne)
        self._desk = Desk(
            self._m, self._guard, self._clearance, self._notes, lambda: self._may_change_battery
        )
        self._was_asked = False  # the operator, at this tick
        self._worst = _ALL_WELL
        self._next_check_s = 0.0
        self._mode = Mode.TAKEOFF
        self._holding = False
        self._asked: Waypoint | None = None  # by the strategy
        self._flown_to: Waypoint | None = None  # that waypoint, or its lookout
        self._refusal: Alarm | None = None
        self._refusals, self._refused_since_s = 0, 0.0  # one after the other, with nothing settled between
        self._failure = ""  # of the strategy, in a sentence: it is asked no more
        self._unanswered: tuple[tuple[XY, XY], ...] = ()  # legs flown blind of which it was told then
        self._sent: tuple[tuple[float, ...], Setpoint] | None = None  # the newest setpoint, and its inputs
        self._above_ground: tuple[VehicleState | None, float] = None, math.nan  # a state, and its height
        self._waiting: tuple[Look, ...] = ()  # not yet passed to the strategy
        self._untold: tuple[Look, ...] = ()  # not yet in the journal
        self._left_enu_m = state.position_enu_m  # at the search's last step
        self._interrupted = self._going_back = False
        self._seen_until_enu_m: F64 | None = None  # flown back to before that place, after a sortie
        self._sortie = 1 + sum(line["kind"] == NEXT_SORTIE for line in before)
        self._begun_wh = 0.0  # used before this sortie
        self._gets_on = any(r.get("mode") in SEARCHING for r in _of_sortie(before))  # in this sortie
        self._transits = False  # to where the sortie before has left the search
        self._was_away = bool(before)  # since the strategy's last step: home, or where somebody else flew it
        self.end_reason: str | None = None
        self._refuse_before_take_off()
        self._ticks = self._fly()

    def __next__(self) -> Tick:
        """Advance the vehicle's time to the next tick. Raises StopIteration after landing."""
        return next(self._ticks)

    def __iter__(self) -> Iterator[Tick]:
        return self._ticks

    def __enter__(self) -> Flight:
        return self

    def __exit__(self, *_: object) -> None:
        if self.end_reason is None:
            self._m.vehicle.hold()

    def _refuse_before_take_off(self) -> None:
        state, safety = self._m.vehicle.state(), self._m.scenario.safety
        if not has_place(state):
            raise UserError("position: the vehicle has none; wait for its GNSS fix")
        if math.isnan(state.battery_remaining) and not (state.airborne or safety.battery_estimated):
            raise UserError(
                "battery: the vehicle does not report its charge; make it do so, or write "
                "safety.battery_estimated: true to fly a full battery by estimate"
            )
        limit_mps = safety.wind_max_mps
        wind_mps = math.hypot(*wind_xy(state))
        if wind_mps > limit_mps:
            raise UserError(
                f"wind: blows at {wind_mps:.1f} m/s, above safety.wind_max_mps ({limit_mps:g}); wait, or "
                "write a higher limit"
            )
        x, y, _ = state.position_enu_m.tolist()
        outside_m = self._fence.outside_m((x, y))
        if not state.airborne and outside_m > safety.fence_tolerance_m:
            raise UserError(
                f"position: the vehicle stands {outside_m:.0f} m inside a no-fly area or beyond the fence; "
                "carry it to home.position_enu_m"
            )
        home = self._m.scenario.home.position_enu_m
        for x, y in self._m.waypoints_xy_enu_m.tolist():
            if not self._fence.way(home, (x, y)):
                raise UserError(
                    f"safety.no_fly_enu_m: the path's waypoint [{x:.1f}, {y:.1f}] cannot be flown to; cut "
                    "the no-fly area, or what is higher than safety.altitude_max_agl_m, out of the search "
                    "area (area.holes_enu_m), or widen geofence_enu_m"
                )

    def _fly(self) -> Iterator[Tick]:
        if self._before:
            self._notes.go_on(self._before)
            state = self._m.vehicle.state()
            self._desk.resume(self._before, state, self._altitude_agl_m(state))
        else:
            self._notes.start(self._m)
        stood = not self._m.vehicle.state().airborne
        self._take_off(Phase.TAKEOFF)
        if self._has_changed_battery(stood):
            self._resume_between_sorties()
        while True:
            end = yield from self._climb()
            if end is _ALL_WELL:
                end = yield from self._search()
            is_last = not self._asks_for_battery(end)
            if is_last:
                self._give_up(end)
            else:
                self._leave_for_battery()
            if end.action < Action.LAND:
                yield from self._return()
            in_the_air = yield from self._land()
            landed = in_the_air is _ALL_WELL
            if is_last or not landed:
                break
            stays = yield from self._change_battery(end)
            if stays is not _ALL_WELL:
                end = stays
                break
        if not is_last:
            self._give_up(end)
        reason = end.cause if landed else in_the_air.cause
        self._notes.end(self._m.vehicle.state().time_s, reason, self._m.witness, landed)
        self.end_reason = reason

    def _give_up(self, end: Alarm) -> None:
        """Say what the search leaves undone."""
        state, candidates = self._m.vehicle.state(), self._m.tracker.candidates()
        if end is not _ALL_WELL:
            self._looks.give_up(state.time_s)
            blind = (*self._unanswered, *self._looks.blind_legs())
            self._notes.left_behind(state.time_s, end.cause, candidates, blind)
            self._desk.give_up(state.time_s)
        self._notes.left_outside(state.time_s, [c for c in candidates.values() if not self._is_searched(c)])
        if end is _ALL_WELL:
            self._notes.left_undecided(state.time_s, candidates)

    def _take_off(self, phase: Phase) -> None:
        """Raises UserError if it fails, or the operator of a vehicle that is not simulated calls it off."""
        m = self._m
        may_call_off = m.change_battery is None and not m.vehicle.state().airborne
        if may_call_off and self._is_called_off(phase):
            raise UserError("the operator called the take-off off: nothing was armed")
        try:
            m.vehicle.takeoff(m.cover_altitude_agl_m)
        except UserError:
            if may_call_off:
                self._is_called_off(phase)  # perhaps meanwhile, and the journal says so
            raise

    def _is_called_off(self, phase: Phase) -> bool:
        """Whether the waiting orders, which are taken, are against a take-off."""
        state = self._m.vehicle.state()
        if phase is Phase.TAKEOFF:  # which begins the vehicle's time
            state = state._replace(time_s=max((r["t"] for r in self._before), default=0.0))
        for _ in range(MOST_WAITING):
            self._was_asked = False
            if not self._hear(state, phase):
                break
        if self._guard.calls_off:
            sentence = "The operator calls the take-off off."
            self._notes.safety(state.time_s, Alarm(Action.HOLD, "operator", sentence))
        return self._guard.calls_off

    # ---- the phases of a sortie; each returns what ended it early ----------------------------------------

    def _climb(self) -> _Part[Alarm]:
        altitude, vehicle = self._m.cover_altitude_agl_m, self._m.vehicle
        state = vehicle.state()
        longest_s = _TAKE_OFF_LONGEST_S + 2.0 * altitude / self._m.scenario.vehicle.climb_speed_mps
        latest_s, given_back = state.time_s + longest_s, False
        while self._altitude_agl_m(state) < altitude - 1.0:
            alarm = self._look_after(state, Phase.TAKEOFF)
            if alarm.action is Action.KEEP_OUT:
                state = yield from self._keep_out(state, Phase.TAKEOFF)
                if not state.airborne:
                    return alarm
                given_back, latest_s = True, math.inf
                continue
            if state.time_s + state.silent_s > latest_s:
                alarm = Alarm(Action.LAND, "take-off", f"Not at altitude after {longest_s:.0f} s: landing.")
                self._notes.safety(state.time_s, alarm)
            if alarm.action > Action.HOLD:
                return alarm
            if given_back and alarm.action < Action.HOLD:
                x, y, _ = state.position_enu_m.tolist()
                vehicle.command(self._setpoint(state, Waypoint((x, y), altitude, _CLIMBS_MPS)))
                given_back, latest_s = False, state.time_s + longest_s
            state = yield from self._pass_time(state, Mode.TAKEOFF)
        return _ALL_WELL

    def _search(self) -> _Part[Alarm]:
        state = self._m.vehicle.state()
        self._looks.begin(state.time_s)
        if not self._transits:
            self._mode = Mode.SCAN
            self._left_enu_m = state.position_enu_m
        done_s = math.inf  # when the strategy finished
        while True:
            alarm = self._look_after(state, Phase.SEARCH)
            if alarm.action > Action.HOLD:
                if alarm.action is not Action.KEEP_OUT:
                    return alarm
                self._interrupted = True
                state = yield from self._keep_out(state, Phase.SEARCH)
                if not state.airborne:
                    return alarm
                continue
            detections = self._look(state)
            if alarm.action is Action.HOLD:
                self._interrupted = True
                self._hold()
                self._tell(state)
                state = yield from self._pass_time(state, Mode.HOLD, detections)
                continue
            self._holding = False
            end = self._looks_for_operator(state, detections)
            if end is not None and end is not _ALL_WELL:
                return end
            if end is _ALL_WELL:
                state = yield from self._pass_time(state, Mode.LOOK, detections)
                continue
            if self._goes_back(state):
                mode = Mode.TRANSIT if self._transits else Mode.HOLD
                self._tell(state)
                state = yield from self._pass_time(state, mode, detections)
                continue
            observation = self._observation(state)
            answer = self._answer(observation)
            if answer is None:
                self._tell(state)
                continue
            command = self._of_the_undecided(answer)
            self._mode = command.mode
            done_s = min(done_s, state.time_s) if command.waypoint is None else math.inf
            if command.waypoint is None and self._looks.are_due(state.time_s, done_s):
                going_on = tuple(e for e in command.events if e.kind != EventKind.FINISHED)
                command = command._replace(events=going_on)
            elif command.waypoint is None:
                self._note(observation, command.events)
                self._notes.state(state, command.mode)
                yield Tick(state, command.mode, detections)
                return _ALL_WELL
            self._note(observation, command.events)
            end = self._fly_to(observation, command)
            if end is not _ALL_WELL:
                return end
            state = yield from self._pass_time(state, command.mode, detections)

    def _return(self) -> _Part[None]:
        m = self._m
        home = m.scenario.home.position_enu_m
        back = Waypoint(home, m.return_altitude_agl_m, m.scenario.vehicle.cruise_speed_mps)
        self._mode = Mode.RETURN
        self._guard.heed(CONTINUE)  # an operator's hold does not outlive the search
        state = m.vehicle.state()
        while math.dist(state.position_enu_m[:2].tolist(), home) > _HOME_ACCEPTANCE_M:
            alarm = self._look_after(state, Phase.RETURN)
            if alarm.action is Action.KEEP_OUT:
                state = yield from self._keep_out(state, Phase.RETURN)
                if not state.airborne:
                    return
                continue
            if alarm.action is Action.LAND:
                return
            if alarm.action is Action.HOLD:
                self._hold()
            else:
                self._holding = False
                m.vehicle.command(self._setpoint(state, back))
            state = yield from self._pass_time(state, Mode.RETURN)

    def _land(self) -> _Part[Alarm]:
        """Repeat an order to land that has no effect, then give up: that is returned, or _ALL_WELL."""
        vehicle = self._m.vehicle
        vehicle.land()
        self._next_check_s = -math.inf
        state = vehicle.state()
        altitude_m, sinks_mps = self._altitude_agl_m(state), self._m.scenario.vehicle.descent_speed_mps
        longest_s = _LANDING_LONGEST_S + 2.0 * landing_time_s(max(0.0, altitude_m), sinks_mps)
        ordered_s, orders, waits = state.time_s, 1, False
        while state.airborne or abs(state.velocity_enu_mps.item(2)) > _STANDS_MPS:
            alarm = self._look_after(state, Phase.LAND)
            if alarm.cause == LOST:
                return alarm
            if alarm.action is Action.KEEP_OUT:
                state, waits = (yield from self._keep_out(state, Phase.LAND)), True
                continue
            if alarm.action is Action.HOLD and not waits:
                self._hover(state)
                waits = True
            late = state.time_s > ordered_s + longest_s and not waits
            if late:
                alarm = _not_down(longest_s, orders == _LANDING_ORDERS)
                self._notes.safety(state.time_s, alarm)
                if orders == _LANDING_ORDERS:
                    return alarm
            if late or (waits and alarm.action is not Action.HOLD):
                vehicle.land()
                ordered_s, orders, waits = state.time_s, orders + 1 if late else 1, False
            state = yield from self._pass_time(state, Mode.LAND)
        return _ALL_WELL

    # ---- between two sorties -----------------------------------------------------------------------------

    def _asks_for_battery(self, end: Alarm) -> bool:
        """Whether the search ends for its battery alone, and another one would let it go on."""
        is_for_battery = end.action is Action.RETURN and end.cause in (LOW_BATTERY, RETURN_ENERGY)
        return is_for_battery and self._may_change_battery

    @property
    def _may_change_battery(self) -> bool:
        return self._has_another_battery and self._gets_on

    @property
    def _has_another_battery(self) -> bool:
        is_wanted = not self._guard.calls_home
        return is_wanted and self._sortie < self._m.scenario.vehicle.batteries

    def _has_changed_battery(self, stood: bool) -> bool:
        """Whether an interrupted mission has gone on with another battery.

        It landed for one, or it stood, and has a charged one after a flight that ended, untold, with less.
        """
        lines, left = _of_sortie(self._before), self._m.vehicle.state().battery_remaining
        if any(line["kind"] == SORTIE for line in lines):
            return True
        told = [r["battery"] for r in lines if isinstance(r.get("battery"), float)]
        is_another = bool(told) and told[-1] < CHARGED <= left
        if not (stood and is_another and self._has_another_battery):
            return False
        used_wh = (max(told) - told[-1]) * self._m.scenario.vehicle.battery_wh
        self._notes.sortie(lines[-1]["t"], told[-1], self._sortie, _BROKEN_OFF, used_wh)
        return True

    def _resume_between_sorties(self) -> None:
        """Begin the next sortie of a mission that was interrupted between two of them."""
        searched = (r for r in reversed(self._before) if r.get("mode") in SEARCHING)
        self._left_enu_m = next((np.array(r["p"]) for r in searched), self._left_enu_m)
        self._begin_sortie()

    def _leave_for_battery(self) -> None:
        """Keep in mind from where on the ground was perhaps not looked at."""
        self._looks.give_up(self._m.vehicle.state().time_s)
        if not self._interrupted:
            self._seen_until_enu_m = self._looks.seen_until_enu_m()

    def _change_battery(self, end: Alarm) -> _Part[Alarm]:
        """Wait on the ground for another battery, and take off with it; or what ends the mission there.

        A simulated vehicle gets it after ``swap_s``. Any other one waits for a person's word, and for a
        charge that is good for a sortie.
        """
        m, guard = self._m, self._guard
        state = m.vehicle.state()
        away_m = math.dist(state.position_enu_m[:2].tolist(), m.scenario.home.position_enu_m)
        if away_m > _AT_HOME_M:
            sentence = f"It landed {away_m:.0f} m from home, where nobody changes its battery."
            self._notes.safety(state.time_s, Alarm(Action.CONTINUE, BATTERY_CHANGE, sentence))
            return end
        used_wh = state.energy_used_wh - self._begun_wh
        self._notes.sortie(state.time_s, state.battery_remaining, self._sortie, end.cause, used_wh)
        self._snapshot(state.time_s)
        self._mode, self._sent = Mode.SWAP, None
        landed_s, is_changed = state.time_s, False
        if m.change_battery is None:
            guard.wait_for_battery()
        self._next_check_s = -math.inf
        while True:
            alarm = self._look_after(state, Phase.SWAP)
            if alarm.action in (Action.RETURN, Action.LAND):
                return alarm
            if alarm.action >= Action.HOLD and m.change_battery is None:
                guard.wait_for_battery()  # no word lasts beyond what keeps it down
            if alarm.action < Action.HOLD:
                if m.change_battery is None:
                    is_changed = self._takes_off_for_a_person(state)
                elif state.time_s >= landed_s + m.scenario.vehicle.swap_s:
                    m.change_battery()
                    m.vehicle.takeoff(m.cover_altitude_agl_m)
                    is_changed = True
                if is_changed:
                    self._begin_sortie()
                    return _ALL_WELL
            elif m.change_battery and state.time_s > landed_s + m.scenario.vehicle.swap_s + _LONGEST_WAIT_S:
                return alarm
            state = yield from self._pass_time(state, Mode.SWAP)

    def _takes_off_for_a_person(self, state: VehicleState) -> bool:
        """Whether the vehicle takes off with the battery that a person has put in."""
        try:
            self._take_off(Phase.SWAP)
            return True
        except UserError as error:
            if self._m.vehicle.state().airborne:
                raise
            self._notes.stays_down(state.time_s, f"No take-off: {error}.")
        self._guard.wait_for_battery()
        self._next_check_s = -math.inf
        return False

    def _begin_sortie(self) -> None:
        """Another sortie has taken off: the search is gone on with where it was left."""
        state = self._m.vehicle.state()
        self._sortie, self._begun_wh, self._gets_on = self._sortie + 1, state.energy_used_wh, False
        self._notes.next_sortie(state, self._sortie)
        self._guard.begin_sortie()
        self._desk.start_over()
        self._start_over()
        self._mode, self._holding, self._sent = Mode.TRANSIT, False, None
        self._transits = self._was_away = True
        self._asked = self._flown_to = self._refusal = None
        self._interrupted = self._going_back = True
        self._next_check_s = -math.inf

    def _hover(self, state: VehicleState) -> None:
        """Interrupt a landing, which continues if the vehicle refuses."""
        try:
            self._m.vehicle.command(Setpoint(state.position_enu_m, _CLIMBS_MPS, self._m.yaw_rad))
        except UserError as error:
            self._guard.heed(CONTINUE)
            sentence = f"The landing cannot be held: {error}."
            self._notes.safety(state.time_s, Alarm(Action.CONTINUE, "operator", sentence))

    # ---- the steps ---------------------------------------------------------------------------------------

    def _look_after(self, state: VehicleState, phase: Phase) -> Alarm:
        """The most severe alarm. All rules are checked once a second, and at once if it is urgent."""
        ordered = self._hear(state, phase)
        now_s = state.time_s + state.silent_s
        given_back = self._worst.action is Action.KEEP_OUT and not state.taken_over
        at_once = self._guard.is_urgent(state) or given_back or ordered
        if not at_once and now_s < self._next_check_s:
            return self._worst
        self._next_check_s = now_s + CHECK_PERIOD_S
        goal = self._sent[1] if self._sent is not None else None
        alarms = self._guard.alarms(state, self._altitude_agl_m(state), phase, goal)
        if self._heard.went_back_s > 0.0:
            sentence = f"The vehicle's clock went back by {self._heard.went_back_s:.0f} s."
            alarms += (Alarm(Action.CONTINUE, "clock", sentence),)
        if self._notes.failed is not None:
            alarms += (Alarm(Action.RETURN, "journal", f"The journal ends here: {self._notes.failed}."),)
        if self._failure:
            alarms += (Alarm(Action.RETURN, "strategy", self._failure),)
        self._worst = max(alarms, key=partial(_weight, phase), default=_ALL_WELL)
        self._notes.alarms(now_s, alarms, self._guard.not_judged(state, phase, goal))
        covers = self._mode in SEARCHING and self._m.covers_from(self._altitude_agl_m(state))
        self._looks.keep_track(state, covers and not state.taken_over)
        return self._worst

    def _hear(self, state: VehicleState, phase: Phase) -> bool:
        """Whether the operator, who is asked once a tick, has ordered something, which is taken."""
        order = None if self._was_asked else self._operator()
        self._was_asked = True
        if order is None:
            return False
        self._tell(state)
        if not isinstance(order, Order):  # a program may answer its word alone
            order = Order(str(order))
        self._desk.take(order, phase, state, self._altitude_agl_m(state))
        self._snapshot(state.time_s)
        return True

    def _look(self, state: VehicleState) -> Detections | None:
        """New detections; None also if the sensor fails. Their sightings wait for the strategy."""
        try:
            detections = self._m.sensor.sense(state)
        except UserError:
            raise
        except Exception as error:  # third-party code: the mission continues without this look
            self._looks.failure = f"{type(error).__name__}: {error}"
            return None
        if detections is None or not self._looks.take(state.time_s, detections):
            return None
        hits = self._m.tracker.update(detections)
        look = Look(detections.time_s, detections.camera, detections.lens, hits)
        self._waiting += (look,)
        self._untold += (look,)
        return detections

    def _answer(self, seen: Observation) -> Command | None:
        """What the strategy answers; None where it fails, and the vehicle has to come home."""
        try:
            return self._m.strategy.step(self._of_the_area(seen))
        except Exception as error:  # third-party code
            self._fail(error)
            self._unanswered = seen.unsearched
            return None

    def _fail(self, error: Exception) -> None:
        """A strategy that fails ends a simulation; any other vehicle comes home without it."""
        if self._m.vehicle.truth is not None:
            raise error
        words = str(error) if isinstance(error, UserError) else failure_words(error)
        self._failure = f"The strategy fails: {words}."
        self._next_check_s = -math.inf

    def _observation(self, state: VehicleState) -> Observation:
        looks, self._waiting = self._waiting, ()
        was_away, self._was_away = self._was_away, False
        return Observation(
            state,
            self._altitude_agl_m(state),
            looks,
            self._m.tracker.candidates(),
            self._looks.blind_legs(),
            self._refusal.cause if self._refusal is not None else "",
            self._flown_to if self._flown_to is not self._asked else None,
            self._desk.verdicts,
            self._desk.hand_over() or was_away,
        )

    def _of_the_area(self, seen: Observation) -> Observation:
        """The observation without sightings outside the searched area."""
        hits = seen.sightings
        if not hits or all(self._is_searched(seen.candidates[hit.candidate_id]) for hit in hits):
            return seen
        return seen._replace(looks=tuple(self._look_in_the_area(look, seen) for look in seen.looks))

    def _look_in_the_area(self, look: Look, seen: Observation) -> Look:
        hits = tuple(hit for hit in look.hits if self._is_searched(seen.candidates[hit.candidate_id]))
        return look._replace(hits=hits)

    def _is_searched(self, candidate: Candidate) -> bool:
        x, y, _ = candidate.position_enu_m.tolist()
        return self._guard.searched.covers((x, y))

    def _of_the_undecided(self, command: Command) -> Command:
        """The command without events of candidates on which the operator has decided."""
        verdicts = self._desk.verdicts
        if not verdicts:
            return command
        return command._replace(events=tuple(e for e in command.events if e.candidate_id not in verdicts))

    def _note(self, seen: Observation, events: tuple[Event, ...]) -> None:
        untold, self._untold = self._untold, ()
        if not (seen.sightings or seen.unsearched or events or seen.elsewhere):
            return
        self._notes.step(seen._replace(looks=untold), events)
        self._snapshot(seen.time_s)

    def _tell(self, state: VehicleState) -> None:
        """Journal at once what is seen while the strategy is not asked."""
        looks, self._untold = self._untold, ()
        if any(look.hits for look in looks):
            candidates = self._m.tracker.candidates()
            self._notes.step(Observation(state, self._altitude_agl_m(state), looks, candidates), ())
            self._snapshot(state.time_s)

    def _snapshot(self, time_s: float) -> None:
        if self._m.replays or self._failure:
            return
        try:
            decided = self._m.strategy.snapshot()
        except Exception as error:  # third-party code
            self._fail(error)
        else:
            self._notes.snapshot(time_s, decided, self._m.tracker, self._desk.snapshot())

    def _fly_to(self, seen: Observation, command: Command) -> Alarm:
        """Command the vehicle, unless the guard refuses; each waypoint is judged once.

        A strategy that repeats a refused waypoint has nothing left to do, which ends the search. So does one
        that asks for others that are refused for ``_REFUSED_LONGEST_S``, and settles no candidate.
        """
        waypoint = command.waypoint
        if waypoint is None:
            return _ALL_WELL
        if any(event.kind in SETTLING for event in command.events):
            self._refusals = 0
        if waypoint != self._asked and not (self._refusal and repr(waypoint) == repr(self._asked)):  # NaN
            self._asked = waypoint
            looks = waypoint.to_look and not not_finite(waypoint)
            self._flown_to = self._clearance.lookout(waypoint) if looks else waypoint
            if self._flown_to is not None and self._flown_to.xy_enu_m != waypoint.xy_enu_m:
                self._flown_to = self._flown_to._replace(
                    then_xy_enu_m=None, yaw_rad=None, gimbal_pitch_rad=None
                )
            self._refusal = self._guard.refusal(seen.vehicle, seen.altitude_agl_m, waypoint, self._flown_to)
            if self._refusal is not None:
                end = replace(self._refusal, action=Action.RETURN)
                if self._asks_for_battery(end) and waypoint.to_look:
                    self._notes.safety(seen.time_s, end)
                    self._left_enu_m, self._interrupted = self._above(waypoint), True
                    return end
                if (
                    self._refusal.cause == RETURN_ENERGY
                    and self._has_another_battery
                    and not waypoint.to_look
                ):
                    self._refusal = None  # what is covered on the way counts, as far as the battery lasts
                else:
                    return self._refuse(seen.time_s, self._refusal)
        elif self._refusal is not None:
            end = replace(self._refusal, action=Action.RETURN)
            self._notes.safety(seen.time_s, end)
            return end
        if self._refusal is None and self._flown_to is not None:
            self._m.vehicle.command(self._setpoint(seen.vehicle, self._paced(self._flown_to)))
            self._gets_on, self._refusals = True, 0
        return _ALL_WELL

    def _refuse(self, time_s: float, refusal: Alarm) -> Alarm:
        """Journal one of a few refused waypoints in a row; what ends the search, where there are many."""
        if self._refusals == 0:
            self._refused_since_s = time_s
        self._refusals += 1
        if self._refusals <= _REFUSALS_TOLD:
            self._notes.safety(time_s, refusal)
        elif time_s >= self._refused_since_s + _REFUSED_LONGEST_S:
            sentence = f"{refusal.sentence} It is the last of {self._refusals} that were refused in a row."
            end = Alarm(Action.RETURN, refusal.cause, sentence)
            self._notes.safety(time_s, end)
            return end
        return _ALL_WELL

    def _above(self, waypoint: Waypoint) -> F64:
        """The place (3,) above a waypoint at the height from which ground is covered."""
        x, y = waypoint.xy_enu_m
        return np.array([x, y, self._m.ground_at_m(x, y) + self._m.cover_altitude_agl_m])

    def _paced(self, waypoint: Waypoint) -> Waypoint:
        """The waypoint; ground is covered no faster than the looks allow."""
        if not self._looks.scan_is_slowed or not self._m.covers_from(waypoint.altitude_agl_m):
            return waypoint
        return waypoint._replace(speed_mps=min(waypoint.speed_mps, self._looks.scan_speed_mps))

    def _setpoint(self, state: VehicleState, waypoint: Waypoint) -> Setpoint:
        """Terrain following: as planned, else the waypoint's height above the ground here and ahead."""
        x, y, z = state.position_enu_m.tolist()
        planned = self._planned((x, y), waypoint)
        if planned is not None:
            is_low = z < planned.height_m - ALTITUDE_TOLERANCE_M
            speed_mps = min(waypoint.speed_mps, _CLIMBS_MPS if is_low else planned.speed_mps)
            waypoint = waypoint._replace(speed_mps=speed_mps)
        way = self._way((x, y), waypoint, None if planned is None else planned.ahead_xy_enu_m)
        to_x, to_y = way[0]
        distance = math.hypot(to_x - x, to_y - y)
        share = min(1.0, waypoint.speed_mps * LOOK_AHEAD_S / max(distance, 1e-6))
        ground_at_m = self._m.ground_at_m
        ground = max(ground_at_m(x, y), ground_at_m(x + (to_x - x) * share, y + (to_y - y) * share))
        if planned is not None:
            ground = max(ground, planned.ahead_height_m - waypoint.altitude_agl_m)
        place = self._clearance.over(state.position_enu_m, way, ground, waypoint)
        yaw_rad = self._m.yaw_rad if waypoint.yaw_rad is None else waypoint.yaw_rad
        pitch_rad = waypoint.gimbal_pitch_rad
        if pitch_rad is None:
            pitch_rad = self._m.scenario.camera.gimbal.pitch_rad
        asked = (*place, waypoint.speed_mps, yaw_rad, pitch_rad)
        if self._sent is None or self._sent[0] != asked:
            self._sent = asked, Setpoint(np.array(place), waypoint.speed_mps, yaw_rad, None, pitch_rad)
        return self._sent[1]

    def _planned(self, here: XY, waypoint: Waypoint) -> Planned | None:
        """What the plan has for this place on the way to the waypoint."""
        following = self._m.following
        if following is None or not self._m.covers_from(waypoint.altitude_agl_m):
            return None
        return following.at(here, waypoint.xy_enu_m, waypoint.speed_mps * LOOK_AHEAD_S)

    def _way(self, here: XY, waypoint: Waypoint, ahead: XY | None) -> list[XY]:
        """Where to fly straight to, one after the other.

        First to the place ``ahead`` on a transect; round the corner where the waypoint is flown through.
        """
        to, then = self._router.next_xy(here, waypoint.xy_enu_m), waypoint.then_xy_enu_m
        if to != waypoint.xy_enu_m:
            return [to]
        if ahead not in (None, to) and self._router.is_straight(here, ahead):
            return [ahead, to]
        ahead_m = waypoint.speed_mps / POSITION_GAIN - math.dist(here, to)
        if then is None or ahead_m <= 0.0:
            return [to]
        share = min(1.0, ahead_m / max(math.dist(to, then), 1e-6))
        beyond = to[0] + share * (then[0] - to[0]), to[1] + share * (then[1] - to[1])
        return [beyond if self._router.is_straight(here, beyond) else to]

    def _keep_out(self, state: VehicleState, phase: Phase) -> _Part[VehicleState]:
        """Command nothing while somebody else flies. Returns the state on hand-back or on the ground."""
        self._sent, self._was_away = None, True
        self._desk.start_over()
        while state.taken_over and state.airborne:
            self._look_after(state, phase)
            detections = self._look(state)
            self._tell(state)
            state = yield from self._pass_time(state, Mode.HOLD, detections)
        self._look_after(state, phase)
        self._start_over()
        return state

    def _start_over(self) -> None:
        """The vehicle is elsewhere: ways begin anew."""
        self._router = Router(self._fence)
        self._clearance.start_over()

    def _looks_for_operator(self, state: VehicleState, new: Detections | None) -> Alarm | None:
        """_ALL_WELL on the way to a place that the operator asked for, and there; None if there is none.

        Another alarm says that it takes another battery.
        """
        if self._desk.has_places or self._mode is Mode.LOOK:
            self._tell(state)
        goal = self._desk.goal(state, self._altitude_agl_m(state), new)
        if isinstance(goal, Alarm):
            self._notes.safety(state.time_s, goal)
            return goal
        if goal is None:
            return None
        self._mode = Mode.LOOK
        self._interrupted = self._going_back = self._gets_on = True
        self._m.vehicle.command(self._setpoint(state, goal))
        return _ALL_WELL

    def _goes_back(self, state: VehicleState) -> bool:
        """Whether it flies back to where covering was interrupted, as the ground in between was not seen."""
        if not self._interrupted:
            self._left_enu_m = state.position_enu_m
            return False
        place = self._left_enu_m if self._seen_until_enu_m is None else self._seen_until_enu_m
        x, y, z = place.tolist()
        away_m = math.dist(state.position_enu_m[:2].tolist(), (x, y))
        limit_m = _BACK_M if self._going_back else _DISPLACED_M
        covered = self._transits or self._m.covers_from(z - self._m.ground_at_m(x, y))
        below_m = self._m.cover_altitude_agl_m - self._altitude_agl_m(state)
        too_low = self._going_back and below_m > _BACK_M
        self._going_back = self._interrupted = covered and (away_m > limit_m or too_low)
        if not self._going_back and self._seen_until_enu_m is not None:
            self._seen_until_enu_m, self._going_back, self._interrupted = None, True, True
            return self._goes_back(state)
        self._transits = self._transits and self._going_back
        if self._going_back:
            speed_mps = self._m.scenario.vehicle.cruise_speed_mps
            back = Waypoint((x, y), self._m.cover_altitude_agl_m, speed_mps)
            self._m.vehicle.command(self._setpoint(state, back))
        return self._going_back

    def _hold(self) -> None:
        if not self._holding:
            self._m.vehicle.hold()
            self._holding, self._sent = True, None

    def _pass_time(
        self, state: VehicleState, mode: Mode, detections: Detections | None = None
    ) -> _Part[VehicleState]:
        """Advance by one tick; the state after it."""
        self._notes.state(state, mode)
        yield Tick(state, mode, detections)
        self._heard.advance(self._tick_s)
        self._was_asked = False
        if self._m.witness is not None:
            self._m.witness.see(mode)
        return self._heard.state()

    def _altitude_agl_m(self, state: VehicleState) -> float:
        """Asked for several times a tick."""
        if self._above_ground[0] is not state:
            x, y, z = state.position_enu_m.tolist()
            self._above_ground = state, float(z - self._m.ground_at_m(x, y))
        return self._above_ground[1]


def fly(
    mission: Mission,
    journal: Journal,
    watch: Watch = lambda _state, _mode, _new: None,
    operator: Operator = lambda: None,
    before: Sequence[Mapping[str, Any]] = (),
) -> str:
    """Fly the mission from take-off to landing; returns its ``end_reason``.

    ``watch`` sees every tick (state, mode, new detections). The rest, and what is raised, is as in
    :class:`Flight`.
    """
    with Flight(mission, journal, operator, before) as flight:
        for tick in flight:
            watch(*tick)
    return str(flight.end_reason)


def _of_sortie(lines: Sequence[Mapping[str, Any]]) -> Sequence[Mapping[str, Any]]:
    """The lines of a journal that belong to its last sortie."""
    begun = [k for k, line in enumerate(lines) if line["kind"] == NEXT_SORTIE]
    return lines[begun[-1] :] if begun else lines


def _weight(phase: Phase, alarm: Alarm) -> Action:
    """What an alarm demands in a phase: a reason to come home outweighs no hold on the way there."""
    comes_already = alarm.action is Action.RETURN and phase in (Phase.RETURN, Phase.LAND)
    return Action.CONTINUE if comes_already else alarm.action


def _not_down(after_s: float, given_up: bool) -> Alarm:
    what = "take over by hand" if given_up else "ordering it again"
    return Alarm(
        Action.LAND, "landing", f"Not on the ground {after_s:.0f} s after the order to land: {what}."
    )
