import itertools

import numpy as np
import pytest

from skysweep.planning import routing
from skysweep.planning.routing import visit_order

FORTH_AND_BACK = np.array([1, 0])


def segments(count, seed):
    """Places that are segments: entered at one end, left at the other."""
    rng = np.random.default_rng(seed)
    ends = rng.uniform(0, 100, (count, 2, 2))
    lengths = np.repeat(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)[:, None], 2, axis=1)
    return ends, ends[:, ::-1], lengths, np.tile(FORTH_AND_BACK, (count, 1))


def cost(order, entries, exits, lengths, start):
    total, here = 0.0, start
    for place, way in order:
        if here is not None:
            total += float(np.linalg.norm(entries[place, way] - here))
        total += lengths[place, way]
        here = exits[place, way]
    return total


@pytest.mark.parametrize("start", [None, np.array([0.0, 0.0])])
@pytest.mark.parametrize("seed", range(5))
def test_few_places_are_ordered_best_of_all(seed, start):
    entries, exits, lengths, reverse = segments(4, seed)
    order = visit_order(entries, exits, lengths, reverse, start)
    best = min(
        cost(list(zip(places, ways, strict=True)), entries, exits, lengths, start)
        for places in itertools.permutations(range(4))
        for ways in itertools.product(range(2), repeat=4)
    )
    assert cost(order, entries, exits, lengths, start) == pytest.approx(best)


@pytest.mark.parametrize("seed", range(5))
def test_many_places_are_ordered_close_to_best(seed, monkeypatch):
    entries, exits, lengths, reverse = segments(7, seed)
    start = np.array([0.0, 0.0])
    exact = visit_order(entries, exits, lengths, reverse, start)
    monkeypatch.setattr(routing, "EXACT_MAX", 0)
    quick = visit_order(entries, exits, lengths, reverse, start)
    assert sorted(place for place, _ in quick) == list(range(7))
    best = cost(exact, entries, exits, lengths, start)
    assert best <= cost(quick, entries, exits, lengths, start) + 1e-9
    assert cost(quick, entries, exits, lengths, start) <= 1.25 * best


def test_sixty_places_in_a_row_are_visited_in_a_row():
    x = np.arange(60.0)
    shuffled = np.random.default_rng(0).permutation(60)
    points = np.column_stack([x, np.zeros(60)])[shuffled][:, None, :]
    order = visit_order(points, points, np.zeros((60, 1)), np.zeros((60, 1), dtype=int), np.zeros(2))
    assert [int(shuffled[place]) for place, _ in order] == list(range(60))
