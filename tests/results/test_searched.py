"""How well a run searched a map: what its looks saw, and no more."""

import math

import numpy as np
import pytest
from results_data import state, write_run

from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.prior.maps import ProbabilityMap, grid_over
from skysweep.results.pod import coverage_of, coverage_of_flights
from skysweep.results.run_folder import PHOTOGRAPHED, Run, load_flown
from skysweep.results.searched import coverage_of_runs, scanned_paths

CALIBRATED = {"width_px": 640, "height_px": 360, "hfov_rad": 1.4}
UP = [1, 0, 0, 0, 0.7071, 0.7071, 0, -0.7071, 0.7071]  # and ahead


def start(strategy="scan-check", sensor="statistical"):
    return [
        {"t": 0, "kind": "setup", "seed": 3, "sensor": sensor, "plan": "none"},
        {"t": 0, "kind": "start", "scenario": "tiny", "strategy": strategy, "seed": 3, "sensor": sensor},
    ]


def along(from_s, until_s, x_m=0.0, mode="SCAN", **fields):
    """East at 2 m/s from x on, 10 m up."""
    times_s = np.arange(from_s, until_s + 0.1, 0.5).tolist()
    return [state(t, [x_m + 2.0 * (t - from_s), 10, 10], mode, **fields) for t in times_s]


def run_of(folder, records, **changes) -> Run:
    return load_flown(write_run(folder, records, **({"camera": CALIBRATED} | changes)))


def cells_of(run, cell_m) -> ProbabilityMap:
    return grid_over(run.scenario.area_enu_m, cell_m, run.scenario.frame)


def missed(run, cells):
    return np.exp(-coverage_of_runs([run], cells))


def test_a_cell_of_the_pod_map_has_its_pod(tmp_path):
    run = run_of(tmp_path / "run", [*start(), *along(0, 12)])
    searched = coverage_of(run)
    cells = cells_of(run, searched.cell_m)
    rows, columns = cells.poa.shape
    assert 1 - missed(run, cells) == pytest.approx(searched.pod()[:rows, :columns], abs=1e-6)
    assert missed(run, cells).min() < 0.1 < 0.9 < missed(run, cells).max()


def high(aside_m):
    """So far above that a target is often missed."""
    return [state(t, [2.0 * t, 10.0 + aside_m, 70.0]) for t in np.arange(0.0, 20.0, 0.5)]


def test_flights_that_share_a_map_count_as_one(tmp_path):
    """As ``plan --gaps`` counts them; with another camera they are independent, and none is counted twice."""
    one, other = (run_of(tmp_path / name, [*start(), *high(k)]) for k, name in enumerate("ab"))
    searched = coverage_of_flights([one, other])
    cells = cells_of(one, searched.cell_m)
    rows, columns = cells.poa.shape
    together = 1 - np.exp(-coverage_of_runs([one, other], cells))
    assert together == pytest.approx(searched.pod()[:rows, :columns], abs=1e-6)
    independent = 1 - missed(one, cells) * missed(other, cells)
    assert together.sum() < 0.99 * independent.sum()
    lens = run_of(tmp_path / "c", [*start(), *high(1)], camera={**CALIBRATED, "rate_hz": 5})
    apart = 1 - np.exp(-coverage_of_runs([one, lens], cells))
    assert apart == pytest.approx(1 - missed(one, cells) * missed(lens, cells))
    copied = Run(one.scenario, one.records[:-2], tmp_path / "copied")
    with pytest.raises(UserError, match="is the same flight as"):
        coverage_of_runs([one, copied], cells)


def test_cells_of_any_size_and_another_frame_say_the_same(tmp_path):
    run = run_of(tmp_path / "run", [*start(), *along(0, 12)])
    pod, cell_m = coverage_of(run).pod(), coverage_of(run).cell_m
    here = run.scenario.frame
    elsewhere = LocalFrame(here.latitude_deg + 0.03, here.longitude_deg - 0.05)
    shifted = elsewhere.enu_from_geodetic(here.geodetic_from_enu(np.zeros((1, 3))))[0, :2]
    for across_m, frame, origin in ((0.6, here, (0, 0)), (40.0, here, (0, 0)), (5.0, elsewhere, shifted)):
        n = math.ceil(40.0 / across_m), math.ceil(40.0 / across_m)
        cells = ProbabilityMap(np.full(n, 1.0 / math.prod(n)), across_m, np.array(origin), frame)
        found_m2 = np.sum(1 - missed(run, cells)) * across_m**2
        assert found_m2 == pytest.approx(pod.sum() * cell_m**2, rel=0.05)


def test_who_was_missed_is_in_the_wood(tmp_path):
    """Crowns hide the ground there; what lies open was searched."""
    wood = {"polygon_enu_m": [[20, 0], [40, 0], [40, 20], [20, 20]], "trees_per_hectare": 2000}
    run = run_of(tmp_path / "run", [*start(), *along(0, 20)], forests=[wood | {"height_m": [4, 6]}])
    below = missed(run, cells_of(run, 2.0))[4:6]
    assert below[:, 1:9].max() < 0.2
    assert below[:, 11:].mean() > 0.5


@pytest.mark.parametrize("gap_s", [0.0, 60.0])
def test_nothing_is_searched_in_a_gap(tmp_path, gap_s):
    """The line from the last state before a gap to the first one after it was not flown."""
    early, late = along(0, 4), along(4.5 + gap_s, 8 + gap_s, 32.0 if gap_s else 9.0)
    run = run_of(tmp_path / "run", [*start(), *early, *late])
    paths = scanned_paths(run, run.scenario.frame)
    length_m = sum(np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in paths)
    assert length_m == pytest.approx(15.0 if gap_s else 16.0, abs=0.01)
    coverage = coverage_of_runs([run], cells_of(run, 2.0), 4.0)
    assert coverage[4:6, :4].min() > 0.9
    assert coverage[:, 9:15].max() == 0.0


def test_a_camera_that_looks_up_searches_no_track(tmp_path):
    run = run_of(tmp_path / "run", [*start(), *along(0, 12, R=UP)])
    assert scanned_paths(run, run.scenario.frame) == []


def test_pictures_count_where_they_were_taken(tmp_path):
    """Minutes apart, with nothing between them, and no track."""
    there = [state(0.0, [8, 10, 10]), state(600.0, [32, 10, 10])]
    looks = [{"t": s["t"], "kind": "look"} for s in there]
    records = [*start(PHOTOGRAPHED, "imaging"), there[0], looks[0], there[1], looks[1]]
    run = run_of(tmp_path / "run", records, camera=CALIBRATED | {"latency_s": 0.0})
    cells = cells_of(run, 1.0)
    seen = missed(run, cells) < 0.9
    assert seen[10, 8]
    assert seen[10, 32]
    assert not seen[:, 19:21].any()
    with pytest.raises(UserError, match="--sweep-width-m"):
        coverage_of_runs([run], cells, 4.0)
