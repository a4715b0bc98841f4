from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import pytest
from results_data import EAST_RIGHT, scenario_data, state
from scipy.stats import beta

from skysweep.flights.fly import fly_unwritten
from skysweep.flights.rig import Rig
from skysweep.results.pod import CoverageMap
from skysweep.results.run_folder import Run
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Scenario

CALIBRATED = {"width_px": 640, "height_px": 360, "hfov_rad": 1.4}


def tiny(**changes) -> Scenario:
    return Scenario.model_validate(scenario_data(**({"camera": CALIBRATED} | changes)))


def over_the_middle(until_s: float = 20.0, mode: str = "SCAN") -> list[dict]:
    """East along y = 10, 10 m up, at 2 m/s."""
    return [state(t, [2 * t, 10, 10], mode) for t in np.arange(0, until_s + 0.1, 0.5).tolist()]


def coverage_after(lines: list[dict], sensor: str = "statistical", **changes) -> CoverageMap:
    coverage = CoverageMap.of(tiny(**changes))
    assert coverage is not None
    coverage.add({"t": 0, "kind": "setup", "sensor": sensor})
    for line in lines:
        coverage.add(line)
    return coverage


def look(t: float, **fields) -> dict:
    """A look that was exposed at ``t``; its answer comes 0.2 s later."""
    return {"t": t + 0.2, "kind": "look"} | fields


def merged(*parts: list[dict]) -> list[dict]:
    return sorted((line for part in parts for line in part), key=lambda line: line["t"])


def test_the_grid_spans_the_area_from_its_south_western_corner():
    coverage = coverage_after([])
    west, south, east, north = coverage.bounds_enu_m
    rows, columns = coverage.pod().shape
    assert (west, south) == (0, 0)
    assert east >= 40
    assert north >= 20
    assert (east - west, north - south) == pytest.approx((columns * coverage.cell_m, rows * coverage.cell_m))
    assert coverage.inside.all()
    assert not coverage.pod().any()


def test_it_grows_from_line_to_line_where_the_camera_was():
    coverage, before = CoverageMap.of(tiny()), 0.0
    for line in over_the_middle(5.0):
        coverage.add(line)
        assert (coverage.pod() >= before).all()
        before = coverage.pod()
    seen_from, seen_to = 0.0, 10.0 + 10 * 320 / 640 * 2 * math.tan(0.7)
    columns = np.flatnonzero(before.max(axis=0) > 0)
    assert columns[0] == seen_from
    assert columns[-1] * coverage.cell_m == pytest.approx(seen_to, abs=2.0)
    assert before[:, columns[2]].max() > 0.9


@pytest.mark.parametrize("mode", ["TAKEOFF", "HOLD", "RETURN", "LAND"])
def test_only_a_search_counts(mode):
    assert not coverage_after(over_the_middle(mode=mode)).pod().any()


def test_cells_outside_the_area_stay_empty():
    corner = {"polygon_enu_m": [[0, 0], [40, 0], [0, 20]]}
    coverage = coverage_after(over_the_middle(), area=corner)
    assert not coverage.inside[-1, -1]
    assert not coverage.pod()[~coverage.inside].any()
    assert coverage.pod()[coverage.inside].max() > 0.9


def test_with_pictures_the_answered_looks_alone_count():
    states = over_the_middle()
    assert not coverage_after(states, "imaging").pod().any()
    exposed_s = np.arange(0.4, 19, 0.4).tolist()
    every = coverage_after(merged(states, [look(t) for t in exposed_s]), "imaging")
    regular = coverage_after([s for s in states if s["t"] <= 19], "statistical")
    assert every.pod() == pytest.approx(regular.pod(), abs=1e-9)
    failed = [look(t) if t < 5 else look(t, failure="no answer") for t in exposed_s]
    some = coverage_after(merged(states, failed), "imaging")
    assert some.pod()[:, : int(8 / some.cell_m)] == pytest.approx(
        every.pod()[:, : int(8 / some.cell_m)], abs=0.05
    )
    assert not some.pod()[:, int(25 / some.cell_m) :].any()


def test_looks_that_turn_out_not_to_be_trusted_are_taken_back():
    states, exposed_s = over_the_middle(), np.arange(0.4, 10, 0.4).tolist()
    doubt = look(10.0, doubt=["the picture stands still", 5.0])
    taken = coverage_after(merged(states, [look(t) for t in exposed_s], [doubt]), "imaging")
    never = coverage_after(merged(states, [look(t) for t in exposed_s if t < 5.0]), "imaging")
    assert np.array_equal(taken.pod(), never.pod())


def test_nothing_is_known_of_a_gap_and_of_a_lost_position():
    early, late = over_the_middle(1.0), [state(30, [38, 10, 10]), state(30.5, [39, 10, 10])]
    alone = coverage_after(early)
    looked = coverage_after([*early, *late]).pod() > 0
    assert not looked[:, int(25 / alone.cell_m)].any()
    lost = state(1.5, ["nan", "nan", "nan"], R=EAST_RIGHT)
    assert np.array_equal(coverage_after([*early, lost]).pod(), alone.pod())


def test_a_detector_without_a_model_has_no_map():
    assert CoverageMap.of(tiny(camera=CALIBRATED | {"noise_std": 9.0})) is None


def test_fifteen_minutes_take_about_a_second_at_most():
    wide = {"polygon_enu_m": [[0, 0], [300, 0], [300, 300], [0, 300]]}
    wilderness = load_scenario("person-wilderness").model_dump(by_alias=True)
    coverage = CoverageMap.of(Scenario.model_validate(wilderness | {"area": wide, "geofence_enu_m": None}))
    lines = [state(t, [t / 3, 150 + 100 * math.sin(t / 40), 30]) for t in np.arange(0, 900, 0.5).tolist()]
    coverage.add(lines[0])
    coverage.add(lines[1])
    begun_s = time.process_time()
    for line in lines[2:]:
        coverage.add(line)
    took_s = time.process_time() - begun_s
    assert coverage.pod().max() > 0.9
    assert took_s < 8.0  # 0.6 s, but more on a busy machine


def test_targets_are_reported_as_often_as_their_cells_say(capsys):
    """Calibration: of the targets in cells of about the same final POD, that share is reported.

    A little less is: a cell's POD is that of a target that stands alone, and here are eighty.
    """
    rows = []
    for height_m, surface in ((50.0, "grass"), (70.0, "grass"), (80.0, "sand")):
        flown = _searched_from(height_m, surface)
        for seed in range(2):
            run = fly_unwritten(flown, seed, Rig("statistical", threads=1), Path("no pictures"))
            rows += _targets_of(run)
    pod, reported = np.array(rows).T
    with capsys.disabled():
        print("\n  POD of the cell   targets   mean POD   reported   95 % interval")
        for low, high in ((0.0, 0.5), (0.5, 0.7), (0.7, 0.8), (0.8, 0.9), (0.9, 1.0)):
            there = (pod > low) & (pod <= high)
            n, k = int(there.sum()), int(reported[there].sum())
            if n < 5:
                continue
            least, most = beta.ppf(0.025, max(k, 1e-9), n - k + 1), beta.ppf(0.975, k + 1, max(n - k, 1e-9))
            mean = pod[there].mean()
            print(f"  {low:.1f} to {high:.1f} {n:15d} {mean:10.3f} {k / n:10.3f}   {least:.3f} to {most:.3f}")
            assert least - 0.03 <= mean <= most + 0.07
    assert len(pod) > 300
    assert reported.mean() - 0.01 < pod.mean() < reported.mean() + 0.06


def _searched_from(height_m: float, surface: str) -> Scenario:
    """Eighty people in a wood, from so high that many are missed."""
    data = load_scenario("person-wilderness").model_dump(by_alias=True)
    people = {"pattern": "uniform", "count": 80, "min_separation_m": 12, "size_m": 1.75}
    data["generators"] = [people | {"class": "person", "poses": ["lying", "standing"]}]
    data["targets"] = data["distractors"] = []
    data["terrain"]["surface"] = surface
    data["search"] |= {"strategy": "scan-only", "scan_altitude_agl_m": height_m}
    return Scenario.model_validate(data)


def _targets_of(run: Run) -> list[tuple[float, bool]]:
    """POD of its cell, and whether it was reported during the search, of each target in the area."""
    coverage = CoverageMap.of(run.scenario)
    for line in run.records:
        coverage.add(line)
    pod, (west, south, _, _) = coverage.pod(), coverage.bounds_enu_m
    seen = np.array(
        [r["p"][:2] for r in run.events("sighting") if r["t"] <= run.search_end_s], dtype=float
    ).reshape(-1, 2)
    rows = []
    for target in run.world.targets:
        x, y, _ = target.position_enu_m
        away_m = np.hypot(seen[:, 0] - x, seen[:, 1] - y).min(initial=math.inf)
        cell = int((y - south) / coverage.cell_m), int((x - west) / coverage.cell_m)
        rows.append((float(pod[cell]), bool(away_m < 6.0)))
    return rows
