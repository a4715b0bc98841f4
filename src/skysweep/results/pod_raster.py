"""The coverage of a mission as a GeoTIFF."""

from __future__ import annotations

import numpy as np

from skysweep.planning.prior.map_files import geotiff_of
from skysweep.planning.prior.maps import ProbabilityMap
from skysweep.results.pod import coverage_of
from skysweep.results.run_folder import Run


def geotiff(run: Run) -> bytes:
    """Probability of detection of each cell, 0..1, NaN outside the area (nodata).

    Raises UserError as ``coverage_of``, and MissingExtraError without rasterio.
    """
    coverage = coverage_of(run)
    west, south, _, _ = coverage.bounds_enu_m
    pod = np.where(coverage.inside, coverage.pod(), np.nan)
    cells = ProbabilityMap(pod, coverage.cell_m, np.array([west, south]), run.scenario.frame)
    return geotiff_of(cells, "--format geotiff")
