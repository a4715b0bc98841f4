"""What a plug-in strategy says of its decisions can be read again, whatever it says."""

import math

from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import Flight
from skysweep.results.journal_lines import can_be_told
from skysweep.scenarios.model import Scenario
from skysweep.strategies.spec import StrategySpec
from skysweep.types import Command, Event, EventKind, Mode

SMALL = {
    "name": "small",
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
    "targets": [{"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9}],
}
COSTS = (("confirm", math.inf), ("look", math.nan), ("reject", 3.0))


class Says:
    """Says the same of each of these probabilities, and finishes."""

    def __init__(self, *probabilities):
        self.events = tuple(
            Event(EventKind.CHECK_STARTED, probability=p, reason="why", alternatives=COSTS)
            for p in probabilities
        )

    def step(self, _seen):
        return Command(Mode.SCAN, None, (*self.events, Event(EventKind.FINISHED)))

    def snapshot(self):
        return {}

    def restore(self, snapshot):
        pass


def test_probabilities_and_costs_that_are_none_are_left_out():
    spec = StrategySpec(lambda _context: Says(0.25, math.nan, 1.5))
    mission = build_mission(Scenario.model_validate(SMALL), 0, Rig("statistical", strategy=spec))
    journal = MemoryJournal()
    with Flight(mission, journal) as flight:
        for _ in flight:
            pass
    told = [line for line in journal.lines if line["kind"] == EventKind.CHECK_STARTED]
    assert {line.get("probability") for line in told} == {0.25, None}
    assert [line["alternatives"] for line in told] == [[["reject", 3.0]]] * len(told)
    assert all(can_be_told(line) for line in journal.lines)
