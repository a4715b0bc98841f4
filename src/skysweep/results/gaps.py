"""The gaps that a mission left: ground where a target would probably have been missed, and a path over it."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.coverage import CoveragePlan, plan_coverage
from skysweep.results.exports import xml_document
from skysweep.results.pod import CoverageMap
from skysweep.scenarios.model import Scenario

_LEAST_CELLS = 4.0  # of a gap that is worth flying to


class Gap(NamedTuple):
    """Connected ground of the area with too low a probability of detection."""

    polygon: shapely.Polygon  # ENU metres, holes kept
    mean_pod: float


def gaps_of(coverage: CoverageMap, scenario: Scenario, least_pod: float) -> list[Gap]:
    """Where the POD is below ``least_pod`` (0..1), the largest first.

    Patches of a few cells are left out. Those nearer to each other than half a swath are one gap, since a path
    over one shows the other.
    """
    pod, cell_m = coverage.pod(), coverage.cell_m
    low = coverage.inside & (pod < least_pod)
    rows, columns = np.nonzero(low)
    west, south = coverage.bounds_enu_m[0] + columns * cell_m, coverage.bounds_enu_m[1] + rows * cell_m
    cells = shapely.box(west, south, west + cell_m, south + cell_m)
    patches = shapely.get_parts(shapely.union_all(cells, grid_size=cell_m / 1000.0))
    patches = patches[shapely.area(patches) >= _LEAST_CELLS * cell_m**2]
    near_m = scenario.camera.lens.footprint_m(scenario.search.scan_altitude_agl_m)[0] / 4.0
    joined = shapely.union_all(shapely.buffer(patches, near_m, join_style="mitre")).buffer(
        -near_m, join_style="mitre"
    )
    within = joined.simplify(0.5 * cell_m).intersection(scenario.area_enu_m)
    middles = shapely.points(west + 0.5 * cell_m, south + 0.5 * cell_m)
    gaps = []
    for part in shapely.get_parts(within):
        if part.geom_type == "Polygon" and part.area >= _LEAST_CELLS * cell_m**2:
            held = shapely.intersects(part, middles)
            gaps.append(Gap(part, float(pod[rows[held], columns[held]].mean()) if held.any() else 0.0))
    return sorted(gaps, key=lambda gap: -gap.polygon.area)


def path_over(gaps: Sequence[Gap], scenario: Scenario) -> CoveragePlan:
    """One path over all gaps, from home to the nearest one that is left, each along the largest one's heading."""
    if not gaps:
        raise UserError("gaps: there are none, so there is nothing to fly again; write a higher --pod")
    search, lens = scenario.search, scenario.camera.lens
    here: F64 = np.array(scenario.home.position_enu_m, dtype=float)

    def over(gap: Gap, heading_deg: float | None) -> CoveragePlan:
        return plan_coverage(
            gap.polygon, lens, search.scan_altitude_agl_m, search.sidelap, heading_deg, here
        )

    heading_deg = over(gaps[0], search.transect_heading_deg).heading_deg
    left, plans = list(gaps), []
    while left:
        nearest = min(range(len(left)), key=lambda k: left[k].polygon.distance(shapely.Point(here)))
        plans.append(over(left.pop(nearest), heading_deg))
        here = plans[-1].waypoints_xy_enu_m[-1]
    waypoints = np.concatenate([plan.waypoints_xy_enu_m for plan in plans])
    return CoveragePlan(
        waypoints,
        tuple(leg for plan in plans for leg in plan.transects),
        max(plan.spacing_m for plan in plans),
        plans[0].swath_m,
        heading_deg,
        float(np.linalg.norm(np.diff(waypoints, axis=0), axis=1).sum()),
    )


def gaps_geojson(gaps: Sequence[Gap], frame: LocalFrame) -> bytes:
    """A FeatureCollection of polygons; ``class`` and ``title`` are what CalTopo imports."""
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Polygon", "coordinates": _rings_lon_lat(gap, frame)},
            "properties": {"class": "Shape", "title": f"gap {k}", **_figures(gap)},
        }
        for k, gap in enumerate(gaps, 1)
    ]
    return (json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n").encode()


def gaps_kml(gaps: Sequence[Gap], frame: LocalFrame, name: str) -> bytes:
    """Placemarks of polygons."""
    root = ET.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ET.SubElement(root, "Document")
    ET.SubElement(document, "name").text = f"{name}: gaps"
    for k, gap in enumerate(gaps, 1):
        placemark = ET.SubElement(document, "Placemark")
        ET.SubElement(placemark, "name").text = f"gap {k}"
        figures = _figures(gap)
        words = f"{figures['area_m2']:,.0f} m2, mean POD {figures['mean_pod']:.0%}"
        ET.SubElement(placemark, "description").text = words
        polygon = ET.SubElement(placemark, "Polygon")
        for i, ring in enumerate(_rings_lon_lat(gap, frame)):
            boundary = ET.SubElement(polygon, "innerBoundaryIs" if i else "outerBoundaryIs")
            corners = " ".join(f"{lon:.8f},{lat:.8f}" for lon, lat in ring)
            ET.SubElement(ET.SubElement(boundary, "LinearRing"), "coordinates").text = corners
    return xml_document(root)


def _figures(gap: Gap) -> dict[str, float]:
    return {"area_m2": round(gap.polygon.area, 1), "mean_pod": round(gap.mean_pod, 3)}


def _rings_lon_lat(gap: Gap, frame: LocalFrame) -> list[list[list[float]]]:
    """The outer ring, then the holes, closed."""
    oriented = shapely.geometry.polygon.orient(gap.polygon)
    rings = []
    for ring in (oriented.exterior, *oriented.interiors):
        xy = shapely.get_coordinates(ring)
        places = frame.geodetic_from_enu(np.column_stack([xy, np.zeros(len(xy))]))
        rings.append([[round(float(lon), 8), round(float(lat), 8)] for lat, lon, _ in places])
    return rings
