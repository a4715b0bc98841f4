"""One vehicle's mission, from take-off to landing, flown a decision at a time."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import cached_property
from typing import Any

import numpy as np

from skysweep.arrays import F32
from skysweep.errors import UserError
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.gym.belief import Belief
from skysweep.gym.follower import AgentOrder, Follower
from skysweep.gym.spaces import EMPTY, N_CANDIDATE, OPEN, Chart, Observed, as_numbers
from skysweep.mission.journal import MemoryJournal, line_of
from skysweep.mission.loop import Flight
from skysweep.mission.mission import Mission
from skysweep.mission.notes import OPERATOR
from skysweep.mission.orders import RETURN, Order
from skysweep.planning.flight_plan import plan_scenario
from skysweep.results.metrics import Matches, compute_summary, match
from skysweep.results.run_folder import Run
from skysweep.results.summary import Summary
from skysweep.scenarios.model import Scenario
from skysweep.strategies import StrategySpec
from skysweep.types import SEARCHING, Candidate, EventKind, Mode, VehicleState
from skysweep.worlds.world import World, build_world

LEARNER = "learner"  # the strategy's name, in summaries
_NOT_CALLED = (Mode.TAKEOFF, Mode.RETURN, Mode.LAND)  # home: it climbs to altitude first, or comes anyway
_EPS_S = 1e-6
_MANY_LOOKS = 10.0
_NO_ROW = np.zeros(0, dtype=np.float32)


class Sortie:
    """One mission with the statistical sensor that follows orders. It begins at the scan altitude.

    ``unit`` is its number among several in the same world; ``belief_of`` returns the belief that its looks
    update. Raises UserError if the mission cannot be flown.
    """

    def __init__(
        self, scenario: Scenario, seed: int, chart: Chart, belief_of: Callable[[Mission], Belief], unit: int
    ) -> None:
        search = scenario.search.model_copy(update={"strategy": LEARNER, "parameters": {}})
        self._scenario, self._seed = scenario.model_copy(update={"search": search}), seed
        self._chart = chart
        rig = Rig("statistical", strategy=StrategySpec(Follower), unit=unit)
        mission = build_mission(self._scenario, seed, rig)
        assert isinstance(mission.strategy, Follower)
        self._follower = mission.strategy
        self.plan = tuple(chart.on_square(x, y) for x, y in mission.waypoints_xy_enu_m.tolist())
        self.belief = belief_of(mission)
        self._logbook = _Logbook()
        self._order: Order | None = None
        self._rows: dict[int, tuple[Candidate | None, F32]] = {}  # of candidates, as last observed
        self.searches = self.is_over = False
        self._open = ExitStack()
        self._open.callback(mission.sensor.close)
        self._flight = self._open.enter_context(Flight(mission, self._logbook, self._operator))
        for tick in self._flight:
            self.state: VehicleState = tick.state
            if tick.mode == Mode.SCAN:
                self.searches = True
                break
        if not self.searches:
            self.close()
            why = " ".join(self._logbook.alarms)
            raise UserError(f"scenario {scenario.name}: the mission ends before its search begins; {why}")

    def fly(self, order: AgentOrder, duration_s: float, time_limit_s: float) -> float:
        """Follow an order, or return and land if it ends the search. Returns the seconds searched.

        At ``time_limit_s`` of the mission, also between two batteries, it is called home.
        """
        self._follower.follow(order)
        began_s = ended_s = self.state.time_s
        for tick in self._flight:
            self.state = tick.state
            if tick.mode in (Mode.RETURN, Mode.LAND):
                self.searches = False
            elif tick.mode in SEARCHING:  # again, with another battery
                self.searches = True
            if tick.mode not in _NOT_CALLED and tick.state.time_s > time_limit_s - _EPS_S:
                self._order = Order(RETURN)
            if not self.searches:
                continue
            ended_s = tick.state.time_s
            if tick.detections is not None:
                self.belief.look(tick.detections.camera)
            if ended_s >= began_s + duration_s - _EPS_S:
                return ended_s - began_s
        self.searches, self.is_over = False, True
        return ended_s - began_s

    @property
    def was_called_home(self) -> bool:
        """Whether the time limit ended the search; known once it is over."""
        return self._flight.end_reason == OPERATOR

    def close(self) -> None:
        """Release the mission."""
        self._open.close()

    @property
    def mode(self) -> Mode:
        """SCAN or CHECK."""
        return Mode.CHECK if self._follower.checks else Mode.SCAN

    def alarms(self) -> list[str]:
        """Safety alarms since the last call."""
        said, self._logbook.alarms = self._logbook.alarms, []
        return said

    def matches(self) -> Matches:
        """The candidates confirmed so far, matched with the truth."""
        return match(Run(self._scenario, tuple(self._logbook.verdicts), known_world=self._world))

    @property
    def n_confirmed(self) -> int:
        """Number of candidates confirmed so far."""
        return self._logbook.n_confirmed

    def summary(self) -> Summary:
        """The numbers of ``summary.json``; they use the truth."""
        run = Run(self._scenario, tuple(self._logbook.lines), known_world=self._world)
        return compute_summary(run, scan_only_time_s=plan_scenario(self._scenario)[1].search_time_s)

    @cached_property
    def _world(self) -> World:
        return build_world(self._scenario, self._seed)

    def _operator(self) -> Order | None:
        order, self._order = self._order, None
        return order

    def observe(self, slots: int, time_limit_s: float) -> Observed:
        """This vehicle's observation, as in docs/gym.md."""
        seen = self._follower.seen
        assert seen is not None
        state, search = self.state, self._scenario.search
        x, y, _ = state.position_enu_m.tolist()
        vehicle = (
            *self._chart.on_square(x, y),
            seen.altitude_agl_m / search.scan_altitude_agl_m,
            *(state.velocity_enu_mps / search.scan_speed_mps).tolist(),
            state.battery_remaining,
            state.time_s / time_limit_s,
            self.belief.covered,
            float(self._follower.checks),
        )
        candidates = np.zeros((slots, N_CANDIDATE), dtype=np.float32)
        status = np.full(slots, EMPTY)
        for slot, (number, what) in enumerate(self._shown(slots)):
            candidates[slot], status[slot] = self._row(seen.candidates[number]), what
        return {
            "belief": self.belief.unseen.copy(),
            "vehicle": as_numbers(vehicle),
            "candidates": candidates,
            "candidate_status": status,
            "candidate_mask": (status != EMPTY).astype(np.int8),
        }

    def _shown(self, slots: int) -> list[tuple[int, int]]:
        """Number and status of candidates with a slot; if slots run out, the oldest settled ones go."""
        listed = self._follower.listed
        too_many = max(0, len(listed) - slots)
        gone = set(sorted(listed, key=lambda k: (listed[k] == OPEN, k))[:too_many]) if too_many else set()
        return [(k, what) for k, what in listed.items() if k not in gone]

    def _row(self, candidate: Candidate) -> F32:
        """A candidate's row; recomputed after each new sighting."""
        known, row = self._rows.get(candidate.id, (None, _NO_ROW))
        if known is not candidate:
            x, y, _ = candidate.position_enu_m.tolist()
            (east_m2, across_m2), (_, north_m2) = candidate.covariance_m2.tolist()
            seen = candidate.confidences
            looks = len(seen) / _MANY_LOOKS
            place = self._chart.on_square(x, y)
            row = as_numbers((*place, east_m2, across_m2, north_m2, max(seen), seen[-1], looks))
            self._rows[candidate.id] = candidate, row
        return row


class _Logbook(MemoryJournal):
    """A journal that also collects what is asked for in flight: alarms, and verdicts with their sightings."""

    def __init__(self) -> None:
        super().__init__()
        self.alarms: list[str] = []
        self.verdicts: list[dict[str, Any]] = []  # the start, and each verdict after its newest sighting
        self.n_confirmed = 0
        self._sighted: dict[int, tuple[float, dict[str, Any]]] = {}

    def write(self, time_s: float, kind: str, **fields: Any) -> None:
        """Keep one line."""
        super().write(time_s, kind, **fields)
        if kind == "sighting":
            self._sighted[fields["candidate"]] = time_s, fields
        elif kind == "safety":
            self.alarms.append(fields["sentence"])
        elif kind == "start":
            self.verdicts.append(line_of(time_s, kind, fields))
        elif kind in (EventKind.CONFIRMED, EventKind.REJECTED):
            sighted_s, sighting = self._sighted[fields["candidate"]]
            self.verdicts.append(line_of(sighted_s, "sighting", sighting))
            self.verdicts.append(line_of(time_s, kind, fields))
            self.n_confirmed += kind == EventKind.CONFIRMED
