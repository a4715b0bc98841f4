from __future__ import annotations

import numpy as np
import pyproj
import pytest
from results_data import EAST_RIGHT, state, write_run

from skysweep.errors import UserError
from skysweep.results.pod import coverage_of
from skysweep.results.pod_raster import geotiff
from skysweep.results.run_folder import load_run

rasterio = pytest.importorskip("rasterio")
CALIBRATED = {"width_px": 640, "height_px": 360, "hfov_rad": 1.4}
CORNER = {"polygon_enu_m": [[0, 0], [40, 0], [0, 20]]}
START = {"t": 0, "kind": "start", "scenario": "tiny", "strategy": "scan-check", "seed": 3}


@pytest.fixture
def run(tmp_path):
    states = [state(t, [2 * t, 6, 10], R=EAST_RIGHT) for t in np.arange(0, 10, 0.5).tolist()]
    return load_run(write_run(tmp_path / "run", [START, *states], camera=CALIBRATED, area=CORNER))


def test_rasterio_reads_the_coverage_where_it_is_on_earth(run):
    coverage = coverage_of(run)
    with rasterio.MemoryFile(geotiff(run)) as memory, memory.open() as file:
        band, crs, transform, nodata = file.read(1), file.crs, file.transform, file.nodata
    assert np.isnan(nodata)
    assert np.isnan(band[::-1][~coverage.inside]).all()
    assert np.array_equal(band[::-1][coverage.inside], coverage.pod()[coverage.inside])
    assert band[::-1][coverage.inside].max() > 0.9
    row, column = 2, 5
    x = transform.c + transform.a * (column + 0.5)
    y = transform.f + transform.e * (band.shape[0] - row - 0.5)
    to_wgs84 = pyproj.Transformer.from_crs(pyproj.CRS.from_wkt(crs.to_wkt()), "EPSG:4326", always_xy=True)
    longitude, latitude = to_wgs84.transform(x, y)
    west, south, _, _ = coverage.bounds_enu_m
    east_m, north_m = west + (column + 0.5) * coverage.cell_m, south + (row + 0.5) * coverage.cell_m
    there = run.scenario.frame.geodetic_from_enu([east_m, north_m, 0.0])[0]
    assert (latitude, longitude) == pytest.approx((there[0], there[1]), abs=1e-8)


def test_without_a_sensor_model_there_is_no_coverage(tmp_path):
    noisy = load_run(write_run(tmp_path / "run", [START], camera=CALIBRATED | {"noise_std": 20.0}))
    with pytest.raises(UserError, match="was made for another detector or camera"):
        geotiff(noisy)
