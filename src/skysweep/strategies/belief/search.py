"""The belief strategy: scan, decide wherever the odds are decided, and come down only where that pays.

It differs from Algorithm 1 in three ways. A candidate is confirmed by its probability, from any height
(``search.confirm_height_max_m`` limits that), and not by one confidence from close by. The scan is left only
where waiting would cost more than the detour; what is in doubt after it is looked at in one tour. And nothing
is looked at that costs more time than a wrong verdict would cost on average (Bayes risk; Wald, Sequential
Analysis, 1947).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, TypeAlias

import numpy as np

from skysweep.scenarios.model import ALTITUDE_TOLERANCE_M
from skysweep.strategies.belief.candidates import Suspects
from skysweep.strategies.belief.checks import LOOKS_THERE, VIEW_S, Checks
from skysweep.strategies.belief.goal import Goal, View
from skysweep.strategies.belief.ground import LOOKS_AGAIN, Ground
from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.strategies.belief.timing import Timing
from skysweep.strategies.context import MissionContext
from skysweep.strategies.passing import is_past
from skysweep.types import XY, Command, Event, EventKind, Mode, Observation, Waypoint

_THERE_M = 1.5
_BACK_M = 2.0  # where the scan was left, at its height
_LEVEL_M = 1.6
_HOVERS_MPS = 0.4
_LOOKS_AT_LEAST = 2  # that tell something, before a verdict
_LOOKS_AT_MOST = 10  # from above a candidate, whatever they tell
_SMALL_DOUBT_S = 5.0  # is no reason for one
_SUPPOSED, _SUPPOSED_SHARE = 5.0, 0.1  # targets of a search before any is found, and how much that weighs
_TURNS = 3  # to a candidate that is not worth the way after all, then to another: not for ever
_MOST_URGENT = 10  # candidates that are priced at one look
_VIEWS = 5  # of a candidate
_NEARER = 0.6  # of the way to the goal: for a place this near the goal is changed
_PATIENCE = 0.5  # share of the doubt with which a candidate in view is confirmed; the next look is free

_Options: TypeAlias = tuple[tuple[str, float], ...]  # ``Event.alternatives``


class BeliefSearch:
    """Implements ``types.Strategy``."""

    def __init__(self, context: MissionContext) -> None:
        assert isinstance(context.parameters, BeliefParameters)
        self._search, self._p = context.search, context.parameters
        self._suspects = Suspects(context, self._p)
        self._checks = Checks(context, self._p)
        self._timing = Timing(context, self._p)
        self._ground = Ground(context, self._p)
        self._again: XY | None = None  # where weakly searched ground is looked at again
        self._looks_again = 0  # from there
        self._to_scan: list[XY] = list(context.waypoints_xy_enu_m)
        self._scan_lasts_s = max(self._timing.scan_s(self._to_scan), 1.0)
        self._scan_left_s = self._scan_lasts_s
        self._searched_s = 0.0  # so far
        self._seen_s = math.nan  # the vehicle's time at the last step
        self._left: XY | None = None  # where the scan was left and has to go on
        self._settled: dict[int, EventKind] = {}
        self._looked: set[int] = set()  # at enough, and left open until the scan's end
        self._route: list[int] = []  # candidates to look at, the goal first
        self._goal: Goal | None = None
        self._turns: dict[int, int] = {}  # how often each candidate became the goal
        self._said = ""  # of what does not fit

    def step(self, observation: Observation) -> Command:
        """Take in the looks, decide what can be decided, and fly on."""
        seen, events = observation, list[Event]()
        self._searched_s += max(seen.time_s - self._seen_s, 0.0) if math.isfinite(self._seen_s) else 0.0
        self._seen_s = seen.time_s
        for leg in seen.unsearched:
            if not self._to_scan:
                self._left = leg[0]  # first up to the height of the scan
            self._to_scan += [xy for xy in leg if self._to_scan[-1:] != [xy]]
        self._heed(seen.verdicts)
        for look in seen.looks:
            self._ground.take(look)
            for k in self._suspects.take(look, seen.candidates, self._settled):
                events.append(self._told(EventKind.SCANNED, seen, k, "found at the edge of a picture"))
            for k in self._suspects.moved(self._settled):
                events.append(
                    self._told(EventKind.REASSESSED, seen, k, "more or fewer are targets elsewhere")
                )
        if seen.looks:
            self._confirm_the_sure(seen, events)
        enough = self._enough()
        if enough:
            return self._finish(seen, events, enough)
        x, y, _ = seen.vehicle.position_enu_m.tolist()
        if self._to_scan:
            waypoint = self._detour(seen, (x, y), events)
            if waypoint is not None:
                return Command(Mode.CHECK, waypoint, tuple(events))
            self._go_on(seen, (x, y), events)
        if not self._to_scan:
            return self._check(seen, (x, y), events)
        s, then = self._search, next(iter(self._to_scan[1:]), None)
        to, then = (self._to_scan[0], then) if self._left is None else (self._left, None)
        waypoint = Waypoint(to, s.scan_altitude_agl_m, s.scan_speed_mps, then_xy_enu_m=then)
        return Command(Mode.SCAN, waypoint, tuple(events))

    def _go_on(self, seen: Observation, here: XY, events: list[Event]) -> None:
        """Take note of what was reached of the scan."""
        up = seen.altitude_agl_m >= self._search.scan_altitude_agl_m - ALTITUDE_TOLERANCE_M
        if self._left is not None and up and math.dist(here, self._left) <= _BACK_M:
            self._left = None
            events.append(Event(EventKind.SCAN_RESUMED))
        if self._left is None and is_past(seen, self._to_scan[0]):
            self._to_scan.pop(0)
            events.append(Event(EventKind.WAYPOINT_REACHED))
            if not self._to_scan:
                self._scan_left_s = 0.0
                self._say_misfit(events)

    def _enough(self) -> str:
        """Why the search ends before all of it is flown; empty while it goes on."""
        after_s, at = self._p.end_after_s, self._p.end_at_success
        if after_s is not None and self._searched_s >= after_s:
            return f"it has lasted {self._searched_s:.0f} s"
        if at is not None and (success := self._success()) >= at:
            return f"its probability of success is {success:.2f}"
        return ""

    def _success(self) -> float:
        """Expected share of the missing that is confirmed.

        How many are missing, where nobody knows, is estimated from the candidates, the share of the scan that
        was flown, and how surely it reports a target.
        """
        p = {k: self._suspects.probability(k) for k in self._suspects.all}
        found = sum(p[k] for k in p if self._settled.get(k) is EventKind.CONFIRMED)
        if self._p.n_missing is not None:
            return found / self._p.n_missing
        flown = 1.0 - min(self._scan_left_s / self._scan_lasts_s, 1.0)
        return found * flown * self._suspects.reported / sum(p.values()) if found else 0.0

    def _finish(self, seen: Observation, events: list[Event], reason: str = "") -> Command:
        """Decide what is open, by the odds."""
        for k in self._open():
            self._decide(seen, k, events)
        self._say_misfit(events)
        return Command(Mode.CHECK, None, (*events, Event(EventKind.FINISHED, reason=reason)))

    def _say_misfit(self, events: list[Event]) -> None:
        misfit = self._suspects.fit.misfit()
        if misfit and misfit != self._said:
            self._said = misfit
            events.append(Event(EventKind.MISFIT, reason=misfit))

    # ---- verdicts ----------------------------------------------------------------------------------------

    def _heed(self, verdicts: Mapping[int, EventKind]) -> None:
        """Take over the operator's verdicts, which are for good."""
        self._settled.update(verdicts)
        self._route = [k for k in self._route if k not in verdicts]
        if self._goal is not None and self._goal.id in verdicts:
            self._goal = None

    def _open(self) -> list[int]:
        return [k for k in self._suspects.all if k not in self._settled]

    def _confirm_the_sure(self, seen: Observation, events: list[Event]) -> None:
        for k in self._open():
            doubt = 1.0 - self._p.confirm_probability
            if self._suspects.all[k].in_view:
                doubt *= _PATIENCE
            sure = 1.0 - self._suspects.probability(k) <= doubt
            if sure and self._may_confirm(k) and not self._may_be_told_apart(seen, k):
                self._confirm(seen, k, events)

    def _may_confirm(self, k: int) -> bool:
        return self._search.may_confirm_from(self._suspects.all[k].lowest_m)

    def _confirm(self, seen: Observation, k: int, events: list[Event]) -> None:
        """Unless it is the same thing as one that was confirmed before."""
        twin = self._twins(seen, [k]).get(k)
        if twin is not None:
            self._settle(seen, k, EventKind.REJECTED, events, f"the same thing as candidate {twin}")
        else:
            found = f"found from {self._suspects.all[k].lowest_m:.0f} m and higher"
            reason = f"{found}; {self._mistake(k, 'confirm')}"
            self._settle(seen, k, EventKind.CONFIRMED, events, reason, self._options(seen, k))

    def _may_be_told_apart(self, seen: Observation, k: int) -> bool:
        """Whether it may be one thing with a confirmed candidate, and the next look may show both."""
        return self._suspects.all[k].in_view and k in self._twins(seen, [k])

    def _twins(self, seen: Observation, of: list[int]) -> dict[int, int]:
        """Those that may be one thing with a confirmed candidate, and with which."""
        return self._suspects.twins(of, self._confirmed(), seen.candidates)

    def _shadowed(self, seen: Observation, of: list[int]) -> set[int]:
        """Those that may be one thing with a confirmed candidate, or with a likelier one."""
        return self._suspects.shadowed(of, self._confirmed(), seen.candidates)

    def _confirmed(self) -> list[int]:
        return [
            k for k, kind in self._settled.items() if kind is EventKind.CONFIRMED and k in self._suspects.all
        ]

    def _settle(
        self,
        seen: Observation,
        k: int,
        kind: EventKind,
        events: list[Event],
        reason: str,
        options: _Options = (),
    ) -> None:
        events.append(self._event(kind, seen, k, reason, options))
        self._settled[k] = kind
        if self._goal is not None and k == self._goal.id:
            self._goal = None

    def _verdicts_s(self, k: int) -> dict[str, float]:
        """What each verdict without another look costs on average."""
        p = self._suspects.probability(k)
        costs_s = {"reject": p * self._p.missed_cost_s}
        if self._may_confirm(k):
            costs_s["confirm"] = (1.0 - p) * self._p.alarm_cost_s
        return costs_s

    def _loss_s(self, k: int) -> float:
        """What a verdict without another look costs on average."""
        return min(self._verdicts_s(k).values())

    def _saves_s(self, seen: Observation, k: int) -> float:
        """What looks at it save on average at most: the less, the more crowns or walls may hide it."""
        return self._loss_s(k) * self._checks.shown(seen.candidates[k].position_enu_m)

    def _decide(self, seen: Observation, k: int, events: list[Event]) -> None:
        """By the odds, and by what either mistake costs."""
        p = self._suspects.probability(k)
        if p * self._p.missed_cost_s < (1.0 - p) * self._p.alarm_cost_s:
            reason = self._mistake(k, "reject")
            self._settle(seen, k, EventKind.REJECTED, events, reason, self._options(seen, k))
        elif self._may_confirm(k):
            self._confirm(seen, k, events)
        else:
            reason = f"likely, but not found from {self._search.confirm_height_max_m:g} m or lower"
            self._settle(seen, k, EventKind.UNCHECKED, events, reason, self._options(seen, k))

    def _mistake(self, k: int, verdict: str) -> str:
        """What being wrong costs, and after how many looks from the newest side."""
        looked = ""
        goal = self._goal
        if goal is not None and k == goal.id and goal.looks_before is not None:
            n = self._suspects.all[k].n_looks - goal.looks_before
            if n:
                looked = f"after {n} more look{'' if n == 1 else 's'} from {goal.view.height_m:.0f} m "
        return f"{looked}a mistake costs {self._verdicts_s(k)[verdict]:.0f} s on average"

    # ---- checks ------------------------------------------------------------------------------------------

    def _detour(self, seen: Observation, here: XY, events: list[Event]) -> Waypoint | None:
        """To a candidate for which the scan does not wait, if there is one."""
        if seen.looks:
            self._scan_left_s = self._timing.scan_s([self._left or here, *self._to_scan])
        self._attend(seen, here, events)
        if seen.looks and self._goal is None:
            self._turn_to_the_urgent(seen, here, events)
        return None if self._goal is None else self._way_to(seen, self._goal, self._left)

    def _turn_to_the_urgent(self, seen: Observation, here: XY, events: list[Event]) -> None:
        """To the candidate where a look now saves most against one later, unless a verdict costs less."""
        open_ = [k for k in self._open() if k not in self._looked and not self._suspects.all[k].in_view]
        if not open_ or self._p.waiting_cost == 0.0:
            return
        scan = [self._left or here, *self._to_scan]
        places = np.array([self._xy(seen, k) for k in open_])
        waiting = self._p.waiting_cost * np.array([self._suspects.probability(k) for k in open_])
        dear = 1.0 + self._p.waiting_cost * self._still_waiting()
        visits = self._timing.visits(here, seen.altitude_agl_m, scan, places, waiting, dear)
        saved_s = visits.saved_s
        if saved_s.max() <= 0.0:
            return
        shadowed = self._shadowed(seen, open_)
        urgent = [i for i in np.argsort(-saved_s).tolist() if saved_s[i] > 0.0 and open_[i] not in shadowed]
        for i in urgent[:_MOST_URGENT]:
            k, waits_s = open_[i], self._waiting_s(open_[i])
            if self._look_costs_s(seen, k, self._height_m(seen, k)) < self._saves_s(seen, k) + waits_s:
                self._left = self._left or here
                looks_s = {
                    "look now": float(visits.now_s[i]),
                    "look when the scan is nearest": float(visits.nearest_s[i]),
                    "look after the scan": float(visits.after_s[i]),
                }
                self._turn_to(seen, k, events, looks_s, f", and waiting for the scan's end {waits_s:.0f} s")
                return

    def _still_waiting(self) -> float:
        """Targets that a detour keeps waiting: open ones, and as many ahead as were found behind."""
        p = {k: self._suspects.probability(k) for k in self._suspects.all}
        found = sum(0.0 if self._settled.get(k) is EventKind.REJECTED else p[k] for k in p)
        ahead = min(self._scan_left_s / self._scan_lasts_s, 1.0)
        per_scan = (found + _SUPPOSED * _SUPPOSED_SHARE) / (1.0 - ahead + _SUPPOSED_SHARE)
        return per_scan * ahead + sum(p[k] for k in self._open())

    def _waiting_s(self, k: int) -> float:
        """What it costs on average to leave a candidate open until the scan ends."""
        return self._p.waiting_cost * self._suspects.probability(k) * self._scan_left_s

    def _check(self, seen: Observation, here: XY, events: list[Event]) -> Command:
        self._attend(seen, here, events)
        if seen.looks or self._goal is None:
            self._choose_goal(seen, here, events)
        if self._goal is None:
            return self._look_again(seen, here, events)
        then = next((self._xy(seen, k) for k in self._route if k != self._goal.id), None)
        return Command(Mode.CHECK, self._way_to(seen, self._goal, then), tuple(events))

    def _look_again(self, seen: Observation, here: XY, events: list[Event]) -> Command:
        """To ground that was searched too weakly, where that buys more than going home."""
        height_m = self._search.scan_altitude_agl_m
        if self._again is not None:
            arrived = math.dist(here, self._again) <= _THERE_M and seen.altitude_agl_m > height_m - _LEVEL_M
            if not seen.elsewhere and (arrived or _hovers(seen)):
                self._looks_again += len(seen.looks)
            if seen.refused or self._looks_again >= LOOKS_AGAIN:
                self._again = None
        if self._again is None:
            found = sum(self._suspects.probability(k) for k in self._suspects.all)
            worth = self._ground.again(here, seen.altitude_agl_m, found)
            if worth is None:
                return self._finish(seen, events)
            (x, y, z), buys_s, takes_s = worth
            self._again, self._looks_again = (x, y), 0
            reason = f"another look takes {takes_s:.0f} s and saves {buys_s:.0f} s on average"
            options = _cheapest_first({"look again": takes_s, "go home": buys_s})
            events.append(
                Event(EventKind.LOOKS_AGAIN, position_enu_m=(x, y, z), reason=reason, alternatives=options)
            )
        waypoint = Waypoint(self._again, height_m, self._p.check_speed_mps, to_look=True)
        return Command(Mode.SCAN, waypoint, tuple(events))

    def _attend(self, seen: Observation, here: XY, events: list[Event]) -> None:
        """What the newest looks say of the goal, and of what may be one thing with a confirmed candidate."""
        above = View(0.0, 0.0, self._search.check_altitude_agl_m)
        if seen.refused and self._goal is not None and self._goal.view != above:
            self._goal.look_from(above)  # a view is refused, not the candidate
        elif seen.refused and self._goal is not None:
            self._settle(seen, self._goal.id, EventKind.UNCHECKED, events, seen.refused)
        if seen.looks:
            if not self._to_scan:
                for k in self._twins(seen, [k for k in self._open() if not self._suspects.all[k].in_view]):
                    self._confirm(seen, k, events)
            self._judge_goal(seen, here, events)

    def _way_to(self, seen: Observation, goal: Goal, then: XY | None) -> Waypoint:
        to = self._beside(seen, goal)
        x, y, _ = seen.vehicle.position_enu_m.tolist()
        return Waypoint(
            to,
            goal.view.height_m,
            self._checks.speed_mps(math.dist((x, y), to), goal.view.height_m),
            to_look=True,
            then_xy_enu_m=None if goal.stops else then,
        )

    def _choose_goal(self, seen: Observation, here: XY, events: list[Event]) -> None:
        """The next candidate of the route; the goal is kept unless another candidate is much nearer."""
        open_ = self._open()
        places = np.array([seen.candidates[k].position_enu_m[:2] for k in open_]).reshape(-1, 2)
        unwanted = self._looked | self._shadowed(seen, open_)
        losses_s = [0.0 if k in unwanted else self._saves_s(seen, k) for k in open_]
        route = self._checks.route(here, places, losses_s)
        self._route = [open_[i] for i in route]
        if self._goal is not None and self._goal.id not in self._route:
            if self._turns.get(self._goal.id, 0) >= _TURNS:
                self._decide(seen, self._goal.id, events)
            self._goal = None
        if not self._route:
            return
        first = self._route[0]
        if self._goal is not None and first != self._goal.id:
            goal_m = math.dist(here, self._xy(seen, self._goal.id))
            tired = self._turns.get(first, 0) >= _TURNS
            if tired or math.dist(here, self._xy(seen, first)) >= _NEARER * goal_m:
                return
        if self._goal is None or first != self._goal.id:
            self._turns[first] = self._turns.get(first, 0) + 1
            look_s = float(self._checks.visits_s(here, places[route])[0])
            self._turn_to(seen, first, events, {_a_look(self._height_m(seen, first)): look_s})

    def _turn_to(
        self, seen: Observation, k: int, events: list[Event], looks_s: Mapping[str, float], more: str = ""
    ) -> None:
        place = seen.candidates[k].position_enu_m
        self._goal = Goal(k, self._checks.first_view(place, self._height_m(seen, k)))
        reason = f"a verdict now costs {self._loss_s(k):.0f} s on average{more}"
        options = _cheapest_first({**self._verdicts_s(k), **looks_s})
        events.append(self._event(EventKind.CHECK_STARTED, seen, k, reason, options))

    def _height_m(self, seen: Observation, k: int) -> float:
        """Above a candidate, from which a closer look is taken."""
        if self._goal is not None and self._goal.id == k and self._goal.tried:
            return self._goal.view.height_m
        suspect, p = self._suspects.all[k], self._suspects.probability(k)
        doubt_s = min(p * self._p.missed_cost_s, (1.0 - p) * self._p.alarm_cost_s)
        return self._checks.height_m(
            self._suspects.hypotheses(suspect.class_name),
            suspect.belief,
            self._suspects.nothing(k),
            0.0 if p >= self._p.confirm_probability else doubt_s,
            seen.candidates[k].position_enu_m,
            math.dist(seen.vehicle.position_enu_m[:2].tolist(), self._xy(seen, k)),
            seen.altitude_agl_m,
        )

    def _look_costs_s(self, seen: Observation, k: int, height_m: float) -> float:
        """Price of a closer look from here, and of the doubt that it leaves; in the scan, there and back."""
        suspect = self._suspects.all[k]
        x, y, _ = seen.vehicle.position_enu_m.tolist()
        return self._checks.look_costs_s(
            self._suspects.hypotheses(suspect.class_name),
            suspect.belief,
            self._suspects.nothing(k),
            self._loss_s(k),
            seen.candidates[k].position_enu_m,
            math.dist((x, y), self._xy(seen, k)),
            seen.altitude_agl_m,
            height_m,
            ways=2 if self._to_scan else 1,
        )

    def _options(self, seen: Observation, k: int) -> _Options:
        """What could be decided of a candidate now, and what that costs in s on average, cheapest first."""
        back = " and back" if self._to_scan else ""
        height_m = self._height_m(seen, k)
        look_s = self._look_costs_s(seen, k, height_m)
        return _cheapest_first({**self._verdicts_s(k), _a_look(height_m) + back: look_s})

    def _judge_goal(self, seen: Observation, here: XY, events: list[Event]) -> None:
        """Once it was looked at enough from there: look from elsewhere, or decide."""
        if self._goal is None:
            return
        goal, k = self._goal, self._goal.id
        height_m = self._height_m(seen, k)
        if height_m != goal.view.height_m:
            goal.view = self._checks.first_view(seen.candidates[k].position_enu_m, height_m)
        to, height_m = self._beside(seen, goal), goal.view.height_m
        if seen.lookout is not None:
            to, height_m = seen.lookout.xy_enu_m, seen.lookout.altitude_agl_m
        above_m = seen.altitude_agl_m - height_m
        if (above_m > _LEVEL_M or (goal.tried and above_m < -_LEVEL_M)) and not _hovers(seen):
            return
        told = self._suspects.all[k].n_looks
        if goal.looks_before is None:
            goal.looks_before = told
        goal.stops |= is_past(seen, to)
        if not seen.elsewhere and (math.dist(here, to) <= _THERE_M or _hovers(seen)):
            goal.looks_above += len(seen.looks)
        looks = told - goal.looks_before
        is_clear = looks >= _LOOKS_AT_LEAST and self._loss_s(k) < _SMALL_DOUBT_S
        if not is_clear and looks < LOOKS_THERE and goal.looks_above < _LOOKS_AT_MOST:
            return
        view = self._another_view(seen, goal)
        if view is not None:
            goal.look_from(view)
            events.append(
                self._stays_open(seen, k, f"another view, from {view.height_m:.0f} m, may show more")
            )
        elif is_clear or not self._waits(k):
            self._decide(seen, k, events)
        else:
            self._looked.add(k)
            why = "more of the scan will tell how likely such a thing is a target"
            events.append(self._stays_open(seen, k, why))
            self._goal = None

    def _another_view(self, seen: Observation, goal: Goal) -> View | None:
        if self._loss_s(goal.id) <= VIEW_S or len(goal.tried) + 1 >= _VIEWS:
            return None
        suspect = self._suspects.all[goal.id]
        return self._checks.next_view(
            self._suspects.hypotheses(suspect.class_name),
            suspect.belief,
            self._suspects.nothing(goal.id),
            self._loss_s(goal.id),
            seen.candidates[goal.id].position_enu_m,
            seen.vehicle.position_enu_m,
            [*goal.tried, goal.view],
        )

    def _waits(self, k: int) -> bool:
        """Whether a verdict can wait for the end of the scan: by then it is known how many are targets."""
        if not self._to_scan:
            return False
        costs_s = self._verdicts_s(k)
        return costs_s.get("confirm", math.inf) > min(costs_s["reject"], self._waiting_s(k))

    def _beside(self, seen: Observation, goal: Goal) -> XY:
        """From where it is looked at."""
        x, y = self._xy(seen, goal.id)
        return x + goal.view.east_m, y + goal.view.north_m

    def _xy(self, seen: Observation, k: int) -> XY:
        x, y, _ = seen.candidates[k].position_enu_m.tolist()
        return x, y

    def _event(
        self, kind: EventKind, seen: Observation, k: int, reason: str, options: _Options = ()
    ) -> Event:
        x, y, z = seen.candidates[k].position_enu_m.tolist()
        return Event(kind, k, (x, y, z), self._suspects.probability(k), reason, options)

    def _told(self, kind: EventKind, seen: Observation, k: int, otherwise: str) -> Event:
        """Its probability, and the looks that moved it there, or what did without any that found it."""
        words = self._suspects.tell(k)
        if not words:
            words = otherwise
        elif kind is EventKind.SCANNED and not words.startswith("found"):
            words = f"{otherwise}; {words}"
        return self._event(kind, seen, k, words)

    def _stays_open(self, seen: Observation, k: int, why: str) -> Event:
        """That a candidate is not decided yet, and the looks since its probability was last told."""
        words = self._suspects.tell(k)
        return self._event(EventKind.REASSESSED, seen, k, f"{words}; {why}" if words else why)

    def snapshot(self) -> dict[str, Any]:
        """The whole state as plain data, but for the looks."""
        return {
            "to_scan": [list(p) for p in self._to_scan],
            "left_xy": None if self._left is None else list(self._left),
            "settled": [[k, str(kind)] for k, kind in self._settled.items()],
            "looked": sorted(self._looked),
            "suspects": self._suspects.snapshot(),
            "ground": self._ground.snapshot(),
            "again_xy": None if self._again is None else list(self._again),
            "route": list(self._route),
            "goal": None if self._goal is None else asdict(self._goal),
            "turns": [[k, n] for k, n in self._turns.items()],
            "said": self._said,
            "searched_s": self._searched_s,
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continue from a snapshot."""
        self._to_scan = [(x, y) for x, y in snapshot["to_scan"]]
        self._scan_left_s = self._timing.scan_s(self._to_scan)
        left, goal = snapshot["left_xy"], snapshot["goal"]
        self._left = None if left is None else (left[0], left[1])
        self._settled = {k: EventKind(kind) for k, kind in snapshot["settled"]}
        self._looked = set(snapshot["looked"])
        self._suspects.restore(snapshot["suspects"])
        self._ground.restore(snapshot["ground"])
        again = snapshot["again_xy"]
        self._again = None if again is None else (again[0], again[1])
        self._route, self._turns = list(snapshot["route"]), dict(snapshot["turns"])
        if goal is not None:
            views = {"view": View(*goal["view"]), "tried": [View(*view) for view in goal["tried"]]}
            goal = Goal(**{**goal, **views})
        self._goal, self._said = goal, snapshot["said"]
        self._searched_s = snapshot["searched_s"]


def _hovers(seen: Observation) -> bool:
    """Whether it stands in the air: as near as obstacles let it come."""
    return bool(np.linalg.norm(seen.vehicle.velocity_enu_mps) < _HOVERS_MPS)


def _a_look(height_m: float) -> str:
    return f"look from {height_m:.0f} m"


def _cheapest_first(costs_s: Mapping[str, float]) -> _Options:
    return tuple(
        (what, round(cost_s, 1)) for what, cost_s in sorted(costs_s.items(), key=lambda option: option[1])
    )
