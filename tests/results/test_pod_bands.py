from __future__ import annotations

import json
from itertools import pairwise
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import shapely
from results_data import EAST_RIGHT, state, write_run

from skysweep.errors import UserError
from skysweep.results.pod import coverage_of
from skysweep.results.pod_bands import EDGES, bands_of, geojson, kml
from skysweep.results.run_folder import load_run

CALIBRATED = {"width_px": 640, "height_px": 360, "hfov_rad": 1.4}
CORNER = {"polygon_enu_m": [[0, 0], [40, 0], [0, 20]]}
START = {"t": 0, "kind": "start", "scenario": "tiny", "strategy": "scan-check", "seed": 3}
KML = {"": "http://www.opengis.net/kml/2.2"}


def flown(folder, **camera):
    states = [state(t, [2 * t, 6, 10], R=EAST_RIGHT) for t in np.arange(0, 10, 0.5).tolist()]
    return load_run(write_run(folder, [START, *states], camera=CALIBRATED | camera, area=CORNER))


@pytest.fixture
def run(tmp_path):
    return flown(tmp_path / "run")


def test_the_bands_are_the_area_and_each_holds_the_cells_of_its_probability(run):
    coverage, area = coverage_of(run), run.scenario.area_enu_m
    bands = bands_of(coverage, area)
    assert len(bands) > 1
    assert sum(band.area_m2 for band in bands) == pytest.approx(area.area, rel=1e-3)
    pod, (west, south, _, _) = coverage.pod(), coverage.bounds_enu_m
    for band in bands:
        for part in band.parts:
            assert part.difference(area.buffer(0.01)).is_empty
            at = part.representative_point()
            value = pod[int((at.y - south) / coverage.cell_m), int((at.x - west) / coverage.cell_m)]
            assert band.least <= value <= band.most
        assert band.least <= band.mean_pod <= band.most


def test_geojson_and_kml_lie_where_the_area_is(run):
    features = json.loads(geojson(run))["features"]
    placed = shapely.union_all([shapely.geometry.shape(f["geometry"]) for f in features])
    corners = run.scenario.frame.geodetic_from_enu([[0, 0, 0], [40, 0, 0], [0, 20, 0]])[:, 1::-1]
    area = shapely.Polygon(corners)
    assert placed.symmetric_difference(area).area < 1e-3 * area.area
    assert {(f["properties"]["pod_min"], f["properties"]["pod_max"]) for f in features} <= {*pairwise(EDGES)}
    root = ET.fromstring(kml(run))
    rings = [ring.text for ring in root.iterfind(".//outerBoundaryIs/LinearRing/coordinates", KML)]
    polygons = [shapely.Polygon([[*map(float, c.split(","))] for c in text.split()]) for text in rings]
    assert shapely.union_all(polygons).symmetric_difference(area).area < 1e-3 * area.area
    assert [p.text for p in root.iterfind(".//Placemark/name", KML)] == [
        f["properties"]["title"] for f in features
    ]


def test_without_a_sensor_model_there_are_none(tmp_path):
    with pytest.raises(UserError, match="was made for another detector or camera"):
        geojson(flown(tmp_path / "noisy", noise_std=20.0))
