"""Takes the operator's orders: gives them to the guard, keeps verdicts, and sends the vehicle to look."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from skysweep.mission.clearance import Clearance
from skysweep.mission.mission import Mission
from skysweep.mission.notes import Notes
from skysweep.mission.orders import CONTINUE, LOOK, ORDER, STEERING, TAKE_BACK, VERDICTS, Order
from skysweep.mission.safety import RETURN_ENERGY, Action, Alarm, Guard, Phase
from skysweep.scenarios.model import ALTITUDE_TOLERANCE_M
from skysweep.types import XY, Detections, EventKind, VehicleState, Waypoint

_LOOKS = 2  # at each place
_THERE_M, _AWAY_M = 1.0, 3.0  # nearer: arrived; farther: no longer there
_BUSY = {
    Phase.RETURN: "the vehicle is on its way home",
    Phase.LAND: "the vehicle is landing",
    Phase.SWAP: "the vehicle is on the ground",
}


class Desk:
    """The orders of one mission, and what of them is still to be done.

    The newest verdict on a candidate counts. Places are looked at in the order in which they were asked for.
    Each is kept until the strategy has the looks, so that a mission that resumes before looks there again.
    ``may_change_battery`` tells whether a place that is too far for this battery waits for another one.
    """

    def __init__(
        self,
        mission: Mission,
        guard: Guard,
        clearance: Clearance,
        notes: Notes,
        may_change_battery: Callable[[], bool],
    ) -> None:
        self._m, self._guard, self._clearance, self._notes = mission, guard, clearance, notes
        self._may_change_battery = may_change_battery
        self.verdicts: Mapping[int, EventKind] = {}  # by candidate
        self._places: list[XY] = []
        self._n_seen = 0  # of the places
        self._goal: Waypoint | None = None  # from where the first place that is not yet seen is looked at
        self._arrived_s, self._looks = math.inf, 0
        self._is_away = False

    def take(self, order: Order, phase: Phase, state: VehicleState, altitude_agl_m: float) -> None:
        """Record an order and do it, or say why not."""
        order = order.as_recorded()
        place = {} if order.xy_enu_m is None else {"p": self._on_ground(order.xy_enu_m)}
        who = {} if order.candidate_id is None else {"candidate": order.candidate_id}
        holder = {} if order.holder is None else {"holder": order.holder}
        self._notes.order(state.time_s, order.word, who | place | holder)
        self._do(order, phase, state, altitude_agl_m)

    def _do(self, order: Order, phase: Phase, state: VehicleState, altitude_agl_m: float) -> None:
        why = ""
        if order.word in STEERING:
            why = self._steer(order, state)
        elif order.word in (*VERDICTS, LOOK) and self._notes.failed is not None:
            why = f"The order to {order.word} cannot be recorded, as the journal ends: say it after resuming."
        elif order.word in VERDICTS:
            why = self._decide(order, state.time_s)
        elif order.word == LOOK:
            why = self._refusal(order.xy_enu_m, phase, state, altitude_agl_m)
            if order.xy_enu_m is not None and not why:
                self._places.append(order.xy_enu_m)
        else:
            words = ", ".join((*STEERING, *VERDICTS))
            why = f"There is no order '{order.word}'; write {words} or {LOOK}."
        self._refuse(state.time_s, why)

    def _steer(self, order: Order, state: VehicleState) -> str:
        """Give a word to the guard, or say why not.

        The wait for a battery ends with a ``continue`` that can be followed.
        """
        word, waits = order.word, self._guard.waits_for_battery
        if word == TAKE_BACK:
            why = "" if self._m.regain is None else self._m.regain(order.holder)
            if not (why or waits):
                self._guard.heed(CONTINUE)
            return f"Not taken back: {why}." if why else ""
        if word == CONTINUE and waits:
            why = self._guard.refuses_take_off(state)
            if why:
                self._notes.stays_down(state.time_s, why)
                return ""
        elif word == CONTINUE and state.taken_over:
            return "Somebody else flies the vehicle: say take back."
        self._guard.heed(word)
        return ""

    def _decide(self, order: Order, time_s: float) -> str:
        candidate = self._m.tracker.candidates().get(order.candidate_id or 0)
        if order.candidate_id is None or candidate is None:
            return f"There is no candidate {order.candidate_id} to {order.word}."
        verdict = VERDICTS[order.word]
        self.verdicts = {**self.verdicts, candidate.id: verdict}
        self._notes.verdict(time_s, verdict, candidate)
        return ""

    def _refusal(self, xy: XY | None, phase: Phase, state: VehicleState, altitude_agl_m: float) -> str:
        if xy is None:
            return "The order to look has no place; give east and north in metres from home."
        why = "somebody else flies the vehicle" if state.taken_over else _BUSY.get(phase, "")
        if not why:
            _, cause, why = self._judge(xy, state, altitude_agl_m)
            why = "" if self._waits_for_battery(cause) else why
        return _not_looked_at(xy, why)

    def _judge(self, xy: XY, state: VehicleState, altitude_agl_m: float) -> tuple[Waypoint | None, str, str]:
        """From where to look at a place; cause and reason of the guard's objection, if there is one."""
        scenario = self._m.scenario
        there = Waypoint(xy, scenario.search.check_altitude_agl_m, scenario.vehicle.cruise_speed_mps)
        lookout = self._clearance.lookout(there)
        return lookout, *self._guard.objection(state, altitude_agl_m, there, lookout)

    def _waits_for_battery(self, cause: str) -> bool:
        return cause == RETURN_ENERGY and self._may_change_battery()

    def _refuse(self, time_s: float, sentence: str) -> None:
        if sentence:
            self._notes.safety(time_s, Alarm(Action.CONTINUE, "operator", sentence))

    # ---- places to look at -------------------------------------------------------------------------------

    @property
    def has_places(self) -> bool:
        """Whether places are still to be looked at."""
        return self._n_seen < len(self._places)

    def goal(
        self, state: VehicleState, altitude_agl_m: float, new: Detections | None
    ) -> Waypoint | Alarm | None:
        """Where to fly for the operator now, or that it takes another battery; None: no place is left.

        ``new`` are the newest detections.
        """
        while self.has_places:
            xy = self._places[self._n_seen]
            if self._goal is None:
                self._goal, cause, why = self._judge(xy, state, altitude_agl_m)
                self._arrived_s, self._looks = math.inf, 0
                if self._waits_for_battery(cause):
                    self._goal = None
                    sentence = f"{_place(xy)} waits for another battery: {why}."
                    return Alarm(Action.RETURN, cause, sentence)
                if why or self._goal is None:
                    self._refuse(state.time_s, _not_looked_at(xy, why))
                    self._places.pop(self._n_seen)
                    self._goal = None
                    continue
            if not self._is_seen(self._goal, state, altitude_agl_m, new):
                self._is_away = True
                return self._goal
            self._notes.looked(state.time_s, self._on_ground(xy))
            self._n_seen, self._goal = self._n_seen + 1, None
        return None

    def _is_seen(
        self, goal: Waypoint, state: VehicleState, altitude_agl_m: float, new: Detections | None
    ) -> bool:
        away_m = math.dist(state.position_enu_m[:2].tolist(), goal.xy_enu_m)
        low = altitude_agl_m <= goal.altitude_agl_m + ALTITUDE_TOLERANCE_M
        if away_m > _AWAY_M:
            self._arrived_s, self._looks = math.inf, 0
        elif away_m <= _THERE_M and low:
            self._arrived_s = min(self._arrived_s, state.time_s)
        self._looks += new is not None and new.time_s >= self._arrived_s
        return self._looks >= _LOOKS

    def start_over(self) -> None:
        """The vehicle was flown elsewhere: judge the present place again."""
        self._goal = None

    def hand_over(self) -> bool:
        """Whether the vehicle was away since the last call. The strategy gets the looks now."""
        del self._places[: self._n_seen]
        self._n_seen = 0
        was_away, self._is_away = self._is_away, False
        return was_away

    def give_up(self, time_s: float) -> None:
        """The search is over: say which places were not looked at."""
        for xy in self._places[self._n_seen :]:
            self._refuse(time_s, _not_looked_at(xy, "the search is over"))
        self._places, self._n_seen = [], 0

    def _on_ground(self, xy: XY) -> tuple[float, float, float]:
        return (*xy, self._m.ground_at_m(*xy))

    # ---- resuming ----------------------------------------------------------------------------------------

    def snapshot(self) -> dict[str, Any]:
        """What lasts, as JSON holds it; empty without any."""
        verdicts = [[k, str(verdict)] for k, verdict in self.verdicts.items()]
        lasts = {"verdicts": verdicts, "places": [list(xy) for xy in self._places]}
        return lasts if any(lasts.values()) else {}

    def resume(self, before: Sequence[Mapping[str, Any]], state: VehicleState, altitude_agl_m: float) -> None:
        """Continue from the newest snapshot of a journal, and do what was ordered since."""
        newest = max((k for k, line in enumerate(before) if line["kind"] == "snapshot"), default=-1)
        kept = before[newest].get("operator", {}) if newest >= 0 else {}
        self.verdicts = {k: EventKind(verdict) for k, verdict in kept.get("verdicts", ())}
        self._places = [(x, y) for x, y in kept.get("places", ())]
        for line in before[newest + 1 :]:
            if line["kind"] == ORDER and line["word"] not in STEERING:
                self._do(Order.of_line(line), Phase.TAKEOFF, state, altitude_agl_m)


def _not_looked_at(xy: XY, why: str) -> str:
    return f"{_place(xy)} is not looked at: {why}." if why else ""


def _place(xy: XY) -> str:
    return f"The place {xy[0]:.0f} m east, {xy[1]:.0f} m north"
