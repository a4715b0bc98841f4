from __future__ import annotations

import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import shapely
from results_data import scenario_data, state

from skysweep.errors import UserError
from skysweep.planning.coverage import footprints
from skysweep.results.gaps import gaps_geojson, gaps_kml, gaps_of, path_over
from skysweep.results.pod import CoverageMap
from skysweep.scenarios.model import Scenario

CALIBRATED = {"width_px": 640, "height_px": 360, "hfov_rad": 1.4}
FIELD = {"polygon_enu_m": [[0, 0], [120, 0], [120, 60], [0, 60]]}


def field() -> Scenario:
    return Scenario.model_validate(scenario_data(camera=CALIBRATED, area=FIELD))


def coverage_after(y_m: list[float]) -> CoverageMap:
    """10 m up, east at 2 m/s along each of these ways; a picture shows 5 m on both sides."""
    coverage = CoverageMap.of(field())
    assert coverage is not None
    coverage.add({"t": 0, "kind": "setup", "sensor": "statistical"})
    begin = 0.0
    for y in y_m:
        for t in np.arange(0.0, 60.1, 0.5).tolist():
            coverage.add(state(begin + t, [2 * t, y, 10], "SCAN"))
        begin += 100.0
    return coverage


def test_the_gaps_are_what_lies_below_the_wanted_pod():
    coverage = coverage_after([5.0, 55.0])
    gaps = gaps_of(coverage, field(), 0.5)
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
    assert gaps_of(coverage, field(), 1e-6)[0].polygon.area <= gaps[0].polygon.area


def test_ground_that_was_seen_leaves_no_gaps():
    assert gaps_of(coverage_after([5.0, 12.0, 19.0, 26.0, 33.0, 40.0, 47.0, 55.0]), field(), 0.2) == []


def test_a_path_over_the_gaps_shows_them_and_little_else():
    gaps = gaps_of(coverage_after([30.0]), field(), 0.5)
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
    for feature, gap in zip(features, gaps, strict=True):
        lon_lat = np.array(feature["geometry"]["coordinates"][0])
        back = field().frame.enu_from_geodetic(
            np.column_stack([lon_lat[:, ::-1], np.full(len(lon_lat), 30.0)])
        )
        assert shapely.Polygon(back[:, :2]).symmetric_difference(gap.polygon).area < 0.1
    root = ET.fromstring(gaps_kml(gaps, field().frame, "field"))
    assert len(root.findall(".//{http://www.opengis.net/kml/2.2}Polygon")) == 2
