"""The coverage of a mission as polygons of equal probability of detection: GeoJSON (RFC 7946) and KML 2.2."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
import shapely

from skysweep.results.exports import xml_document
from skysweep.results.pod import CoverageMap, coverage_of
from skysweep.results.rings import add_polygons, polygons_lon_lat
from skysweep.results.run_folder import Run

EDGES = (0.0, 0.25, 0.5, 0.75, 0.9, 1.0)  # of the bands
_RGB = ("d7191c", "fdae61", "ffffbf", "a6d96a", "1a9641")  # ColorBrewer's RdYlGn, from missed to found
_OPACITY = 0.5


class Band(NamedTuple):
    """The parts of the area whose probability of detection is within ``least`` and ``most``."""

    least: float
    most: float
    parts: tuple[shapely.Polygon, ...]  # ENU metres, holes kept
    area_m2: float
    mean_pod: float
    rgb: str  # hexadecimal

    @property
    def title(self) -> str:
        return f"POD {100 * self.least:.0f} to {100 * self.most:.0f} %"


def bands_of(coverage: CoverageMap, area_enu_m: shapely.Polygon) -> list[Band]:
    """The bands between EDGES that occur, from the lowest on; together they are the area."""
    pod, cell_m = coverage.pod(), coverage.cell_m
    number = np.searchsorted(EDGES[1:-1], pod, side="right")
    bands = []
    for k, (least, most) in enumerate(pairwise(EDGES)):
        mine = coverage.inside & (number == k)
        rows, columns = np.nonzero(mine)
        west, south = coverage.bounds_enu_m[0] + columns * cell_m, coverage.bounds_enu_m[1] + rows * cell_m
        cells = shapely.box(west, south, west + cell_m, south + cell_m)
        whole = shapely.union_all(cells, grid_size=cell_m / 1000.0).intersection(area_enu_m)
        parts = tuple(part for part in shapely.get_parts(whole) if part.geom_type == "Polygon")
        if parts:
            area_m2 = sum(part.area for part in parts)
            bands.append(Band(least, most, parts, area_m2, float(pod[mine].mean()), _RGB[k]))
    return bands


def geojson(run: Run) -> bytes:
    """A feature for each band, with its figures and simplestyle's colours. Raises UserError as ``kml``."""
    frame = run.scenario.frame
    features = [
        {
            "type": "Feature",
            "geometry": {
                "type": "MultiPolygon",
                "coordinates": [rings for part in band.parts for rings in polygons_lon_lat(part, frame)],
            },
            "properties": {
                "title": band.title,
                **_figures(band),
                "fill": f"#{band.rgb}",
                "fill-opacity": _OPACITY,
                "stroke": f"#{band.rgb}",
            },
        }
        for band in _bands(run)
    ]
    return (json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n").encode()


def kml(run: Run) -> bytes:
    """A placemark for each band. Raises UserError where detector and camera have no sensor model."""
    root = ET.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ET.SubElement(root, "Document")
    ET.SubElement(document, "name").text = f"{run.scenario.name}: probability of detection"
    for band in _bands(run):
        placemark = ET.SubElement(document, "Placemark")
        ET.SubElement(placemark, "name").text = band.title
        ET.SubElement(placemark, "description").text = f"{band.area_m2 / 1e4:.2f} ha"
        style = ET.SubElement(placemark, "Style")
        red, green, blue = band.rgb[:2], band.rgb[2:4], band.rgb[4:]
        colour = f"{round(255 * _OPACITY):02x}{blue}{green}{red}"
        ET.SubElement(ET.SubElement(style, "LineStyle"), "width").text = "0"
        ET.SubElement(ET.SubElement(style, "PolyStyle"), "color").text = colour
        data = ET.SubElement(placemark, "ExtendedData")
        for key, value in _figures(band).items():
            ET.SubElement(ET.SubElement(data, "Data", name=key), "value").text = str(value)
        geometry = ET.SubElement(placemark, "MultiGeometry")
        for part in band.parts:
            add_polygons(geometry, polygons_lon_lat(part, run.scenario.frame))
    return xml_document(root)


def _bands(run: Run) -> list[Band]:
    return bands_of(coverage_of(run), run.scenario.area_enu_m)


def _figures(band: Band) -> dict[str, Any]:
    return {
        "pod_min": band.least,
        "pod_max": band.most,
        "pod_mean": round(band.mean_pod, 3),
        "area_m2": round(band.area_m2, 1),
    }
