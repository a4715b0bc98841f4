from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from results_data import scenario_data, state, write_run

from skysweep.errors import UserError
from skysweep.planning.coverage import footprints
from skysweep.results.gaps import (
    flown_again,
    gaps_geojson,
    gaps_kml,
    gaps_of,
    path_over,
)
from skysweep.results.pod import CoverageMap, coverage_of_flights
from skysweep.results.reporting.wording import moving_words
from skysweep.results.run_folder import Run, load_run
from skysweep.results.run_report import _coverage
from skysweep.scenarios.model import Scenario

CALIBRATED = {"width_px": 640, "height_px": 360, "hfov_rad": 1.4}
FIELD = {"polygon_enu_m": [[0, 0], [120, 0], [120, 60], [0, 60]]}


PICTURE_M2 = 16.8 * 9.5  # of ground, from 10 m


def field(**changes) -> Scenario:
    return Scenario.model_validate(scenario_data(camera=CALIBRATED, area=FIELD) | changes)


def flight(
    y_m: list[float], name: str = "a", scenario: Scenario | None = None, height_m: float = 10.0
) -> Run:
    """East at 2 m/s along each of these ways; from 10 m a picture shows 5 m on both sides."""
    records = [{"t": 0, "kind": "setup", "sensor": "statistical"}]
    for k, y in enumerate(y_m):
        times_s = np.arange(0.0, 60.1, 0.5).tolist()
        records += [state(100.0 * k + t, [2 * t, y, height_m], "SCAN") for t in times_s]
    return Run(scenario or field(), tuple(records), Path(name))


def coverage_after(y_m: list[float]) -> CoverageMap:
    return coverage_of_flights([flight(y_m)])


def told(low, scenario: Scenario | None = None, pod: float = 0.95) -> SimpleNamespace:
    """A coverage of the field whose cells are never seen where ``low`` says so of rows and columns."""
    empty = CoverageMap.of(field())
    assert empty is not None
    pods = np.where(low(*np.indices(empty.inside.shape)), 0.0, pod)
    return SimpleNamespace(
        cell_m=empty.cell_m, bounds_enu_m=empty.bounds_enu_m, inside=empty.inside, pod=lambda: pods
    )


def test_the_gaps_are_what_lies_below_the_wanted_pod():
    coverage = coverage_after([5.0, 55.0])
    gaps = gaps_of(coverage, field(), 0.5).to_fly
    assert len(gaps) == 1
    west, south, east, north = gaps[0].polygon.bounds
    assert (west, east) == (pytest.approx(0.0, abs=1.0), pytest.approx(120.0, abs=1.0))
    assert (south, north) == (pytest.approx(10.0, abs=1.0), pytest.approx(50.0, abs=1.0))
    assert gaps[0].mean_pod < 0.1
    low = coverage.inside & (coverage.pod() < 0.5)
    rows, columns = np.nonzero(low)
    xy = (np.column_stack([columns, rows]) + 0.5) * coverage.cell_m
    held = shapely.contains_xy(shapely.union_all([g.polygon for g in gaps]).buffer(coverage.cell_m), xy)
    assert held.mean() > 0.99
    assert gaps_of(coverage, field(), 1e-6).to_fly[0].polygon.area <= gaps[0].polygon.area


def test_ground_that_was_seen_leaves_no_gaps():
    assert gaps_of(coverage_after([5.0, 12.0, 19.0, 26.0, 33.0, 40.0, 47.0, 55.0]), field(), 0.2) == (
        [],
        [],
        [],
    )


@pytest.mark.parametrize(
    "low",
    [lambda r, c: r == c, lambda r, c: r + c == 75, lambda r, c: (r + c) % 2 == 0],
    ids=["a diagonal of cells", "the other", "every other cell"],
)
def test_cells_that_touch_at_corners_are_one_gap(low):
    coverage = told(low)
    gaps = gaps_of(coverage, field(), 0.5)
    assert [len(part) for part in gaps] == [1, 0, 0]
    (gap,) = gaps.to_fly
    x, y = (n * coverage.cell_m for n in np.nonzero(coverage.inside & (coverage.pod() < 0.5))[::-1])
    cells = shapely.box(x, y, x + coverage.cell_m, y + coverage.cell_m)
    lost = shapely.union_all(shapely.intersection(cells, field().area_enu_m)).difference(gap.polygon)
    assert lost.area < 1e-6
    assert gap.mean_pod == 0.0


def test_what_is_too_small_to_be_flown_to_is_told():
    coverage = told(lambda r, c: (r % 20 == 10) & (c % 20 == 10))
    gaps = gaps_of(coverage, field(), 0.5)
    assert gaps.to_fly == []
    assert len(gaps.small) > 20
    cell_m2 = coverage.cell_m**2
    assert cell_m2 < 0.01 * PICTURE_M2
    assert sum(gap.area_m2 for gap in gaps.small) == pytest.approx(len(gaps.small) * cell_m2)
    near = gaps_of(told(lambda r, c: (r % 20 == 10) & (c % 20 < 9) & (c % 2 == 0)), field(), 0.5)
    assert near.small == []
    assert sum(gap.area_m2 for gap in near.to_fly) < sum(gap.polygon.area for gap in near.to_fly)


def test_no_fly_areas_are_apart_and_all_that_is_low_is_told_once():
    no_fly = [[20, 10], [40, 10], [40, 31], [20, 31]]
    scenario = field(safety={"no_fly_enu_m": [no_fly]})
    coverage = coverage_after([45.0])
    gaps = gaps_of(coverage, scenario, 0.5)
    (barred,) = gaps.no_fly
    assert barred.polygon.symmetric_difference(shapely.Polygon(no_fly)).area < 0.1
    assert barred.area_m2 == pytest.approx(20 * 21, abs=0.1)
    assert all(gap.polygon.intersection(barred.polygon).area < 1e-6 for gap in gaps.to_fly)
    all_m2 = sum(gap.area_m2 for part in gaps for gap in part)
    whole_m2 = sum(gap.area_m2 for part in gaps_of(coverage, field(), 0.5) for gap in part)
    assert all_m2 == pytest.approx(whole_m2, rel=1e-3)
    features = json.loads(gaps_geojson(gaps, scenario.frame))["features"]
    assert features[-1]["properties"]["title"] == "no-fly 1"
    assert b"<name>no-fly 1</name>" in gaps_kml(gaps, scenario.frame, "field")


def test_what_several_flights_saw_adds_up_but_not_as_if_they_were_independent():
    first, second = (flight(y_m, name, height_m=60.0) for y_m, name in (([20.0], "a"), ([21.0, 25.0], "b")))
    a, b, both = (coverage_of_flights(runs).pod() for runs in ([first], [second], [first, second]))
    assert (both >= np.maximum(a, b) - 1e-9).all()
    independent = 1.0 - (1.0 - a) * (1.0 - b)
    seen = (a > 0.0) & (b > 0.0)
    assert both[seen].mean() < independent[seen].mean()


def test_each_flight_has_the_shadows_of_its_own_sun():
    """A row of crowns throws its shadow to the north at noon, and to the west in the morning."""
    trees = [
        {"position_enu_m": [x, 30.0], "height_m": 12.0, "crown_radius_m": 2.0} for x in range(10, 120, 10)
    ]
    noon, dawn = (
        field(trees=trees, light={"sun_elevation_deg": 25.0, "sun_heading_deg": heading})
        for heading in (180.0, 90.0)
    )
    first, second = flight([40.0], "a", noon), flight([20.0, 38.0], "b", dawn)
    both = coverage_of_flights([first, second]).pod()
    under_one_sun = coverage_of_flights([first, flight([20.0, 38.0], "b", noon)]).pod()
    assert np.abs(both - under_one_sun).max() > 5e-4
    doubt = {"t": 170.0, "kind": "look", "doubt": ["the picture stands still", 90.0]}
    doubted = Run(second.scenario, (*second.records, doubt), second.folder)
    without = coverage_of_flights([first, flight([20.0], "b", dawn)]).pod()
    assert coverage_of_flights([first, doubted]).pod() == pytest.approx(without)


def test_a_doubt_takes_back_no_other_flights_looks():
    doubt = {"t": 70.0, "kind": "look", "doubt": ["the picture stands still", 0.0]}
    doubted = flight([45.0], "b")
    doubted = Run(doubted.scenario, (*doubted.records, doubt), doubted.folder)
    both = coverage_of_flights([flight([20.0]), doubted]).pod()
    assert both == pytest.approx(coverage_of_flights([flight([20.0])]).pod())


def test_flights_that_do_not_go_together_are_refused_by_name():
    other = {"polygon_enu_m": [[0, 0], [120, 0], [120, 61], [0, 61]]}
    refused = {
        "b: was flown with another area than a": field(area=other),
        "b: was flown with another camera than a": field(camera=CALIBRATED | {"hfov_rad": 1.3}),
        "b: was flown with another frame": field(home={"latitude_deg": 61.0}),
    }
    for sentence, scenario in refused.items():
        with pytest.raises(UserError, match=re.escape(sentence)):
            coverage_of_flights([flight([5.0]), flight([9.0], "b", scenario)])
    same = "c: is the same flight as b; name each once"
    with pytest.raises(UserError, match=re.escape(same)):
        coverage_of_flights([flight([5.0]), flight([9.0], "b"), flight([9.0], "c")])
    cut = Run(field(), flight([5.0]).records[:50], Path("c"))
    with pytest.raises(UserError, match="c: is the same flight as a"):
        coverage_of_flights([flight([5.0]), cut])


def test_a_strategy_that_flies_no_drawn_plan_is_replaced():
    kept = field().with_search(strategy="scan-only")
    assert flown_again(kept) is kept
    low = flown_again(field().with_search(strategy="low-only", check_altitude_agl_m=4.0))
    assert (low.search.strategy, low.search.scan_altitude_agl_m) == ("scan-only", 4.0)
    assert low.search.check_altitude_agl_m < 4.0


def test_only_targets_that_may_move_are_said():
    moving = {"position_enu_m": [5, 5], "motion": {"kind": "walk"}}
    assert moving_words(field()) == ""
    assert moving_words(field(distractors=[{"class": "red bucket", **moving}])) == ""
    assert "may move" in moving_words(field(targets=[{"class": "person", **moving}]))
    assert "may move" in moving_words(field().with_search(target_speed_mps=1.0))


def test_the_report_says_that_targets_may_move(tmp_path):
    target = {"class": "stop sign", "position_enu_m": [5, 10]}
    records = [{"t": 0, "kind": "start", "seed": 0}, state(1, [5, 10, 10]), state(1.5, [6, 10, 10])]
    for name, motion in (("still", {}), ("moving", {"motion": {"kind": "walk"}})):
        folder = write_run(tmp_path / name, records, camera=CALIBRATED, targets=[target | motion])
        (picture,) = _coverage(load_run(folder))
        assert picture.caption.endswith("not where they are now.") == bool(motion)
        assert picture.caption.endswith("The line is the path.") == (not motion)


def test_a_path_over_the_gaps_shows_them_and_little_else():
    gaps = gaps_of(coverage_after([30.0]), field(), 0.5).to_fly
    assert len(gaps) == 2
    plan = path_over(gaps, field())
    lens, altitude_m = field().camera.lens, field().search.scan_altitude_agl_m
    seen = footprints(plan, lens, altitude_m)
    for gap in gaps:
        assert gap.polygon.difference(seen).area < 1e-6 * gap.polygon.area
    assert plan.length_m == pytest.approx(shapely.LineString(plan.waypoints_xy_enu_m).length)
    y = np.array(plan.transects)[..., 1]
    assert not ((y > 27.0) & (y < 33.0)).any()
    with pytest.raises(UserError, match="write a higher --pod"):
        path_over([], field())


def test_gaps_are_written_for_other_tools():
    gaps = gaps_of(coverage_after([30.0]), field(), 0.5)
    features = json.loads(gaps_geojson(gaps, field().frame))["features"]
    assert [f["properties"]["title"] for f in features] == ["gap 1", "gap 2"]
    for feature, gap in zip(features, gaps.to_fly, strict=True):
        lon_lat = np.array(feature["geometry"]["coordinates"][0])
        back = field().frame.enu_from_geodetic(
            np.column_stack([lon_lat[:, ::-1], np.full(len(lon_lat), 30.0)])
        )
        assert shapely.Polygon(back[:, :2]).symmetric_difference(gap.polygon).area < 0.1
    root = ET.fromstring(gaps_kml(gaps, field().frame, "field"))
    assert len(root.findall(".//{http://www.opengis.net/kml/2.2}Polygon")) == 2
