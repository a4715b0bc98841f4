"""The formats of ``skysweep export``: the usual name of each one's file, and what makes its content."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timezone

from skysweep.results import pod_bands
from skysweep.results.cot import events_xml
from skysweep.results.exports import csv_table, geojson, gpx, kml, kmz
from skysweep.results.pod_raster import geotiff
from skysweep.results.run_folder import Run


def _cot(run: Run) -> bytes:
    return events_xml(run, datetime.now(timezone.utc))


FORMATS: dict[str, tuple[str, Callable[[Run], bytes]]] = {
    "cot": ("targets.cot", _cot),
    "coverage-geojson": ("coverage.geojson", pod_bands.geojson),
    "coverage-kml": ("coverage.kml", pod_bands.kml),
    "csv": ("targets.csv", csv_table),
    "geojson": ("targets.geojson", geojson),
    "geotiff": ("coverage.tif", geotiff),
    "gpx": ("targets.gpx", gpx),
    "kml": ("targets.kml", kml),
    "kmz": ("targets.kmz", kmz),
}
