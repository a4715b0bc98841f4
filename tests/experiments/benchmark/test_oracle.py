"""The oracle flies a shortest way past every target, in the mission's own loop."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skysweep.experiments.benchmark.oracle import Oracle, oracle_spec, shortest_order
from skysweep.experiments.benchmark.suite import ORACLE
from skysweep.flights.build import build_mission
from skysweep.flights.fly import fly_in_memory
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import project
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.strategies import StrategySpec
from skysweep.types import EventKind, Mode
from skysweep.worlds.world import build_world

LOOK_M = 9.0


def scenario(name="clusters", **changes):
    return change_scenario(load_scenario(name), {"search.strategy": ORACLE, "scatter_m": 5.0, **changes})


def flown(flying, seed=1, look_m=LOOK_M):
    """Looks that the oracle got, and the journal."""
    looks = []
    spec = oracle_spec(flying, seed, look_m)

    def make(context):
        oracle = spec.make(context)
        step = oracle.step

        def watched(seen):
            looks.extend(seen.looks)
            return step(seen)

        oracle.step = watched
        return oracle

    journal = MemoryJournal()
    mission = build_mission(flying, seed, Rig("statistical", strategy=StrategySpec(make)))
    assert fly(mission, journal) == "completed"
    return looks, journal.lines


def shown_from_m(looks, targets):
    """The height above each target from which it was first shown low enough; inf: never."""
    heights = np.full(len(targets), math.inf)
    for look in looks:
        uv, depth = project(look.lens, look.camera, targets)
        inside = (uv >= 0).all(axis=1) & (uv <= (look.lens.width_px, look.lens.height_px)).all(axis=1)
        above = look.camera.position_enu_m[2] - targets[:, 2]
        heights = np.where(inside & (depth > 0), np.minimum(heights, above), heights)
    return heights


@pytest.mark.parametrize(("name", "look_m"), [("clusters", 9.0), ("person-wilderness", 16.0)])
def test_every_target_is_looked_at_from_near_enough_then_the_search_ends(name, look_m):
    flying = scenario(name)
    looks, lines = flown(flying, look_m=look_m)
    targets = np.array([t.position_enu_m for t in build_world(flying, 1).targets])
    # beside a tree a place is looked at from as low as obstacles allow
    near = shown_from_m(looks, targets) <= look_m
    assert near.all() if name == "clusters" else near.sum() >= len(targets) - 1
    assert not (shown_from_m(looks[:-1], targets) <= look_m).all(), "it went on after the last picture"
    kinds = [line["kind"] for line in lines]
    assert EventKind.CONFIRMED not in kinds
    assert 1 <= kinds.count(EventKind.CHECK_STARTED) <= len(targets)


def test_it_scans_everything_first_and_does_not_stop_at_targets():
    _, lines = flown(scenario())
    states = [line for line in lines if line["kind"] == "state"]
    modes = [line["mode"] for line in states]
    first = modes.index(Mode.CHECK)
    assert Mode.SCAN not in modes[first:]
    corners = len(next(line for line in lines if line["kind"] == "plan")["waypoints_enu_m"])
    assert sum(line["kind"] == EventKind.WAYPOINT_REACHED for line in lines) == corners
    checks = [line["t"] for line in lines if line["kind"] == EventKind.CHECK_STARTED]
    speeds = [math.hypot(*line["v"][:2]) for line in states if checks[2] < line["t"] < checks[-1]]
    assert min(speeds) > 0.5


def test_a_lower_look_takes_longer_and_a_look_from_the_scan_takes_no_time():
    def time_s(look_m):
        flying = scenario()
        summary = fly_in_memory(flying, 1, strategy=oracle_spec(flying, 1, look_m))
        assert summary["n_confirmed"] == 0
        return summary["mission_time_s"]

    near, high, scan = time_s(5.0), time_s(12.0), time_s(40.0)
    assert near > high + 2.0
    assert high > scan + 20.0


def test_the_same_seed_gives_the_same_mission():
    flying = scenario("sparse")

    def summary():
        found = dict(fly_in_memory(flying, 4, strategy=oracle_spec(flying, 4, LOOK_M)))
        return {key: value for key, value in found.items() if key not in ("wall_time_s", "real_time_factor")}

    assert summary() == summary()


def test_a_snapshot_restores_the_whole_state():
    flying = scenario()
    kept = []

    def make(context):
        kept.append(context)
        return oracle_spec(flying, 1, LOOK_M).make(context)

    mission = build_mission(flying, 1, Rig("statistical", strategy=StrategySpec(make)))
    fly(mission, MemoryJournal())
    fresh = Oracle(kept[0], np.zeros((8, 3)), LOOK_M)
    assert fresh.snapshot() != mission.strategy.snapshot()
    fresh.restore(mission.strategy.snapshot())
    assert fresh.snapshot() == mission.strategy.snapshot()


def length_m(here, places, order):
    path = np.vstack([[here], places[list(order)]])
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


places_of = st.lists(st.tuples(*[st.floats(-100, 100)] * 2), max_size=6)


@settings(max_examples=60)
@given(places_of, st.tuples(*[st.floats(-100, 100)] * 2))
def test_the_order_of_few_places_is_a_shortest(points, here):
    places = np.array(points).reshape(-1, 2)
    order = shortest_order(here, places)
    assert sorted(order) == list(range(len(places)))
    least = min(length_m(here, places, p) for p in permutations(range(len(places))))
    assert length_m(here, places, order) <= least + 1e-6


def test_the_order_of_many_places_is_short():
    """Places on a line: there and no further is the shortest way, whatever their order was."""
    rng = np.random.default_rng(3)
    x = rng.permutation(np.arange(1.0, 21.0))
    places = np.column_stack([5.0 * x, np.zeros(20)])
    assert length_m((0.0, 0.0), places, shortest_order((0.0, 0.0), places)) == pytest.approx(100.0)
