import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from maps_of_all_kinds import MAPS, gaussian, mixture

from skysweep.errors import UserError
from skysweep.planning.prior import plan_search
from skysweep.planning.prior.allocation import ideal_pos
from skysweep.planning.prior.checks import way_to_map
from skysweep.planning.prior.coverage import beginning, coverage_of
from skysweep.planning.prior.lattice import diagonal, lattice_over
from skysweep.planning.prior.patterns import parallel_track

CELL_M = 10.0
ORIGIN = np.zeros(2)
INSIDE, OUTSIDE = (600.0, 600.0), (-50.0, -50.0)


def length(path):
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def pos_of(poa, paths, width_m, origin=ORIGIN, cell_m=CELL_M):
    coverage = coverage_of(paths, poa.shape, cell_m, origin, width_m)
    return float(np.sum(poa / poa.sum() * -np.expm1(-coverage)))


def bound_of(poa, budget_m, width_m, cell_m=CELL_M):
    return ideal_pos(poa / poa.sum(), budget_m * width_m / cell_m**2)


def check_paths(paths, start, budget_m, n):
    assert len(paths) == n
    for path in paths:
        assert path.ndim == 2
        assert path.shape[1] == 2
        assert len(path) >= 2
        assert np.isfinite(path).all()
        assert path[0] == pytest.approx(start, abs=1e-6)
        assert length(path) <= budget_m / n * (1 + 1e-9)


@st.composite
def searches(draw):
    """A map of some peaks, and what searches it: of any size in any units."""
    rows, columns = draw(st.integers(1, 40)), draw(st.integers(1, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    row, column = np.mgrid[0:rows, 0:columns]
    poa = np.zeros((rows, columns))
    for _ in range(draw(st.integers(1, 4))):
        spread = rng.uniform(0.3, 10.0)
        place = rng.uniform(0, rows), rng.uniform(0, columns)
        poa += rng.random() * np.exp(-((row - place[0]) ** 2 + (column - place[1]) ** 2) / spread**2)
    poa[rng.random((rows, columns)) < draw(st.sampled_from([0.0, 0.3]))] = 0.0
    assume(poa.max() > 0)
    cell_m = draw(st.sampled_from([0.5, 10.0, 150.0]))
    extent_m = cell_m * max(rows, columns)
    start = np.array([draw(st.floats(-0.5, 1.5)), draw(st.floats(-0.5, 1.5))]) * extent_m
    width_m = cell_m * draw(st.sampled_from([0.1, 0.5, 1.0, 1.7, 4.0, 100.0]))
    budget_m = extent_m * draw(st.floats(0.01, 20.0))
    return poa, cell_m, np.zeros(2), start, budget_m, width_m, draw(st.integers(1, 6))


@settings(max_examples=60)
@given(searches())
def test_paths_begin_at_the_start_and_are_within_the_budget(search):
    try:
        paths = plan_search(*search)
    except UserError:
        poa, cell_m, origin, start, budget_m, width_m, n = search
        assert budget_m / n <= max(way_to_map(poa, cell_m, origin, start), cell_m, width_m)
        return
    check_paths(paths, search[3], search[4], search[6])


@settings(max_examples=10)
@given(searches(), st.integers(-100, 100), st.integers(-100, 100))
def test_a_moved_map_gives_moved_paths(search, east, north):
    poa, cell_m, origin, start, budget_m, width_m, n = search
    start, moved = np.round(start), np.array([east, north]) * 64.0
    try:
        here = plan_search(poa, cell_m, origin, start, budget_m, width_m, n)
    except UserError:
        return
    there = plan_search(poa, cell_m, origin + moved, start + moved, budget_m, width_m, n)
    for a, b in zip(here, there, strict=True):
        assert a + moved == pytest.approx(b, abs=1e-6)


@settings(max_examples=10)
@given(searches(), st.integers(0, 10))
def test_one_seed_gives_one_plan(search, seed):
    try:
        first, second = (plan_search(*search, seed=seed) for _ in range(2))
    except UserError:
        return
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_the_seed_chooses_among_equals():
    plans = [plan_search(np.ones((40, 40)), 10, ORIGIN, (200, 200), 3000, 10, 1, seed=s) for s in (0, 1)]
    assert not np.array_equal(*plans)
    flat = [pos_of(np.ones((40, 40)), plan, 10.0) for plan in plans]
    assert flat[0] == pytest.approx(flat[1], rel=0.03)


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("start", [INSIDE, OUTSIDE])
def test_a_longer_budget_finds_more(name, start):
    """Within 1 %: paths are planned by rules of thumb, each budget anew."""
    poa = MAPS[name]
    found = [pos_of(poa, plan_search(poa, CELL_M, ORIGIN, start, b, 10.0, 1), 10.0)
             for b in (2e3, 4e3, 8e3, 16e3, 32e3)]  # fmt: skip
    assert all(more >= 0.99 * less for less, more in pairwise(found)), found


@pytest.mark.parametrize(
    ("name", "width_m", "budget_m", "share"),
    [
        ("peak", 10.0, 21_600, 0.95),
        ("peak", 5.0, 27_000, 0.95),
        ("wide", 10.0, 57_600, 0.95),
        ("long", 10.0, 21_600, 0.95),
        ("three", 5.0, 27_000, 0.95),
        ("three", 10.0, 57_600, 0.97),
        ("ring", 5.0, 27_000, 0.95),
        ("ring", 10.0, 57_600, 0.97),
        ("rough", 10.0, 57_600, 0.95),
        ("peak", 20.0, 28_800, 0.95),
    ],
)
@pytest.mark.parametrize("start", [INSIDE, OUTSIDE])
def test_a_path_comes_near_the_ideal_allocation(name, width_m, budget_m, share, start):
    poa = MAPS[name]
    paths = plan_search(poa, CELL_M, ORIGIN, start, budget_m, width_m, 1)
    check_paths(paths, start, budget_m, 1)
    found, bound = pos_of(poa, paths, width_m), bound_of(poa, budget_m, width_m)
    assert share * bound <= found <= bound


@pytest.mark.parametrize("name", ["peak", "wide", "long", "three", "ring"])
def test_five_find_nearly_as_much_as_one(name):
    poa = MAPS[name]
    one, five = (plan_search(poa, CELL_M, ORIGIN, INSIDE, 57_600, 10.0, n) for n in (1, 5))
    check_paths(five, INSIDE, 57_600, 5)
    assert pos_of(poa, five, 10.0) >= 0.97 * pos_of(poa, one, 10.0)


@pytest.mark.parametrize("n", [1, 5])
def test_a_map_of_120_by_120_takes_less_than_a_second(n):
    plan_search(MAPS["three"], CELL_M, ORIGIN, INSIDE, 20_000, 10.0, n)
    for budget_m in (5_000, 29_000, 50_000):
        took_s = []
        for _ in range(3):  # on a busy machine
            begin = time.process_time()
            plan_search(MAPS["three"], CELL_M, ORIGIN, INSIDE, budget_m, 10.0, n)
            took_s.append(time.process_time() - begin)
            if took_s[-1] < 1.0:
                break
        assert min(took_s) < 2.0


@pytest.mark.parametrize(
    ("width_m", "budget_m", "share", "of_one"),
    [
        (10.0, 20e3, 0.93, 0.965),
        (10.0, 40e3, 0.95, 0.98),
        (20.0, 20e3, 0.92, 0.965),
        (20.0, 40e3, 0.95, 0.98),
    ],
)
def test_mixtures_of_peaks_come_near_the_ideal_allocation(width_m, budget_m, share, of_one):
    """The mean of four maps; the bound knows no ways between peaks and no whole passes."""
    found = []
    for seed in range(4):
        poa = mixture(seed)
        bound = bound_of(poa, budget_m, width_m)
        plans = [plan_search(poa, CELL_M, ORIGIN, INSIDE, budget_m, width_m, n) for n in (1, 5)]
        one, five = (pos_of(poa, plan, width_m) for plan in plans)
        found.append([one / bound, five / one])
    assert (np.mean(found, axis=0) >= [share, of_one]).all(), found


def test_where_effort_is_small_a_path_covers_more_cells_less():
    """One pass along a row covers its cells 1 time: no path made of those finds more than 0.63 of them."""
    poa = np.ones((60, 60))
    paths = plan_search(poa, CELL_M, ORIGIN, (300.0, 300.0), 5_000, 10.0, 1)
    assert pos_of(poa, paths, 10.0) > 1.04 * 500 * -np.expm1(-1.0) / poa.size


def test_a_budget_for_no_more_than_the_way_leads_towards_the_map():
    (path,) = plan_search(gaussian(60, 60, 12), CELL_M, ORIGIN, (-100.0, 600.0), 105.0, 30.0, 1)
    assert length(path) == pytest.approx(105.0)
    assert path[-1] == pytest.approx([5.0, 600.0], abs=20.0)


def test_large_coordinates_do_not_lengthen_paths():
    """As of UTM: each path begins at the start, bit for bit, and is no longer than its share."""
    start = (500_123.4, 6_700_432.1)
    paths = plan_search(gaussian(60, 60, 12), 10.0, (500_000.0, 6_700_000.0), start, 9_000.0, 30.0, 3, seed=2)
    for path in paths:
        assert tuple(path[0]) == start
        assert length(path) <= 3_000.0


def test_a_budget_of_one_sweep_is_planned():
    (path,) = plan_search(np.ones((9, 9)), CELL_M, ORIGIN, (45.0, 45.0), 20.0, 20.0, 1)
    assert 0.0 < length(path) <= 20.0


def test_an_endless_budget_is_flown_as_far_as_it_finds_anything():
    poa = gaussian(6, 6, 2, cells=12)
    (path,) = plan_search(poa, CELL_M, ORIGIN, (0, 0), 1e9, 10.0, 1)
    assert length(path) < 50_000
    assert pos_of(poa, [path], 10.0) > 0.99


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"poa": np.zeros((0, 5))}, "poa: is 0x5"),
        ({"poa": np.ones(5)}, "rows and columns"),
        ({"poa": "map"}, "no table of numbers"),
        ({"poa": [[1.0, -0.1]]}, "holds -0.1"),
        ({"poa": [[1.0, float("nan")]]}, "1 cell is NaN or infinite"),
        ({"poa": np.zeros((3, 3))}, "0 everywhere"),
        ({"poa": np.ones((3000, 3000))}, "at most 4,000,000"),
        ({"cell_size_m": 0.0}, "cell_size_m"),
        ({"origin_xy_m": (0.0, float("nan"))}, "origin_xy_m"),
        ({"start_xy_m": (0.0,)}, "start_xy_m"),
        ({"budget_m": -5.0}, "budget_m: is -5"),
        ({"budget_m": float("inf")}, "budget_m: is inf"),
        ({"start_xy_m": (-500.0, 0.0), "budget_m": 400.0}, "do not reach the map, which begins 500 m"),
        ({"start_xy_m": (-500.0, 0.0), "budget_m": 800.0, "n_uavs": 2}, "write more than 1000"),
        ({"budget_m": 5.0}, "5 m for each vehicle are less than .* wide; write metres, at least 10$"),
        ({"budget_m": 40.0, "n_uavs": 2, "sweep_width_m": 30.0}, "write metres, at least 60$"),
        ({"sweep_width_m": 0.0}, "sweep_width_m"),
        ({"n_uavs": 0}, "n_uavs"),
        ({"n_uavs": 1.5}, "n_uavs"),
        ({"n_uavs": float("nan")}, "n_uavs"),
        ({"seed": -1}, "seed"),
        ({"seed": 1.5}, "seed: is 1.5"),
        ({"seed": None}, "seed: is None"),
        ({"poa": np.ma.masked_array([[1.0, 9.0]], mask=[[False, True]])}, "real and unmasked"),
        ({"poa": np.ones((3, 3), complex)}, "real and unmasked"),
        ({"cell_size_m": (10.0, 20.0)}, r"cell_size_m: is \(10.0, 20.0\)"),
        ({"start_xy_m": "ab"}, "start_xy_m: is no place"),
        ({"budget_m": "500"}, "budget_m: is '500'"),
        ({"n_uavs": None}, "n_uavs: is None"),
        ({"sweep_width_m": 1e5, "budget_m": 1e6}, "is 10000 cells wide; write cells of at least 100 m"),
    ],
)
def test_bad_input_is_told_in_one_sentence(changed, word):
    good = {
        "poa": np.ones((9, 9)),
        "cell_size_m": 10.0,
        "origin_xy_m": (0.0, 0.0),
        "start_xy_m": (0.0, 0.0),
        "budget_m": 500.0,
        "sweep_width_m": 10.0,
        "n_uavs": 1,
    }
    plan_search(**good)
    with pytest.raises(UserError, match=word) as told:
        plan_search(**{**good, **changed})
    assert "\n" not in str(told.value)


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 1000))
def test_a_diagonal_path_covers_both_cells_of_each_pair_alike(rows, columns, seed):
    rng = np.random.default_rng(seed)
    poa = rng.random((rows, columns))
    pairs = diagonal(lattice_over(poa, CELL_M, ORIGIN, CELL_M, 100.0))
    assert pairs.poa.sum() == pytest.approx(poa.sum())
    nodes = np.argwhere(pairs.poa > 0.0)
    for node, place in zip(nodes, pairs.xy_m(nodes), strict=True):
        leg = place + 0.5 * pairs.pitch_m * np.outer([-1.0, 1.0], pairs.axes[rng.integers(2)])
        covered = coverage_of([leg], poa.shape, CELL_M, ORIGIN, CELL_M)
        assert np.sum(poa * covered) == pytest.approx(pairs.step * pairs.poa[tuple(node)])


@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("start", [(200.0, 300.0), (1500.0, 1500.0)])
@pytest.mark.parametrize(("side", "width_m"), [(10, 30.0), (10, 100.0), (20, 60.0)])
def test_a_square_among_zeros_is_searched_the_more_the_longer_the_budget(side, width_m, start, n):
    """From beside it and from within; up to all of it."""
    poa = np.pad(np.ones((side, side)), 75 - side // 2)
    found = [pos_of(poa, plan_search(poa, 20.0, ORIGIN, start, b, width_m, n), width_m, cell_m=20.0)
             for b in (8e3, 16e3, 40e3, 80e3)]  # fmt: skip
    assert all(more >= 0.99 * less for less, more in pairwise(found)), found
    assert found[0] > 0.2
    assert found[-1] > 0.98


@pytest.mark.parametrize(("sigma_m", "width_m"), [(100.0, 200.0), (30.0, 60.0)])
def test_a_peak_that_is_smaller_than_a_sweep_is_found_from_far_away(sigma_m, width_m):
    poa = gaussian(75.5, 75.5, sigma_m / 20.0, cells=150)
    for start in ((200.0, 300.0), (1510.0, 1510.0)):
        paths = plan_search(poa, 20.0, ORIGIN, start, 20e3, width_m, 1)
        assert pos_of(poa, paths, width_m, cell_m=20.0) > 0.97


@pytest.mark.parametrize("width_m", [30.0, 50.0, 100.0, 200.0])
def test_one_bright_cell_is_searched_as_well_as_by_legs_back_and_forth_over_it(width_m):
    poa = np.zeros((21, 21))
    poa[10, 10] = 1.0
    legs = 40.0 * np.array([[0, 0], *([[-1, 0], [1, 0]] * 12)]) + 1050.0
    by_hand = pos_of(poa, [legs], width_m, cell_m=100.0)
    paths = plan_search(poa, 100.0, ORIGIN, (1050.0, 1050.0), 2e3, width_m, 1)
    assert pos_of(poa, paths, width_m, cell_m=100.0) >= 0.99 * by_hand
    two = poa + np.roll(poa, 5, axis=1)
    paths = plan_search(two, 100.0, ORIGIN, (1300.0, 1050.0), 6e3, width_m, 2)
    assert pos_of(two, paths, width_m, cell_m=100.0) > 0.97


@pytest.mark.parametrize(("rows", "columns", "width_m"), [(36, 56, 50.0), (24, 47, 30.0), (40, 40, 20.0)])
def test_an_even_map_is_searched_as_well_as_by_parallel_tracks(rows, columns, width_m):
    """Legs along the longer side, of the spacing that finds most within one whole coverage."""
    poa, (long, short) = np.ones((rows, columns)), (10.0 * columns, 10.0 * rows)
    budget_m, best = long * short / width_m, 0.0
    for spacing in np.linspace(width_m / 2.0, 3.0 * width_m, 40):
        track = parallel_track((long / 2, short / 2), long, short, spacing, 90.0)
        path = beginning(np.concatenate([[(5.0, 5.0)], track]), budget_m)
        best = max(best, pos_of(poa, [path], width_m))
    (path,) = plan_search(poa, 10.0, ORIGIN, (5.0, 5.0), budget_m, width_m, 1)
    assert length(path) <= budget_m
    assert pos_of(poa, [path], width_m) >= 0.98 * best


@settings(max_examples=10)
@given(searches(), st.integers(0, 30), st.integers(0, 30))
def test_zeros_around_a_map_change_nothing(search, below, beside):
    poa, cell_m, origin, start, budget_m, width_m, n = search
    wider = np.pad(poa, ((below, 3), (beside, 5)))
    try:
        here = plan_search(poa, cell_m, origin, start, budget_m, width_m, n)
    except UserError:
        return
    there = plan_search(
        wider, cell_m, origin - cell_m * np.array([beside, below]), start, budget_m, width_m, n
    )
    found = [pos_of(poa, paths, width_m, cell_m=cell_m) for paths in (here, there)]
    assert found[1] == pytest.approx(found[0], rel=0.05, abs=0.01)


@pytest.mark.parametrize("n", [1, 3])
def test_steps_are_counted_to_their_end(n):
    told = []
    plan_search(
        MAPS["three"], CELL_M, ORIGIN, INSIDE, 20_000, 10.0, n, on_step=lambda *step: told.append(step)
    )
    of = told[0][1]
    assert told == [(done, of) for done in range(1, of + 1)]
