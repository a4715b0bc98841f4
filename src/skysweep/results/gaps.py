"""The gaps that missions left: ground where a target would probably have been missed, and a path over it."""

from __future__ import annotations

import itertools
import json
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from skysweep.arrays import F64, I64
from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.coverage import CoveragePlan, plan_coverage
from skysweep.results.exports import xml_document
from skysweep.results.pod import CoverageMap
from skysweep.results.rings import add_polygons, polygons_lon_lat
from skysweep.scenarios.files import NULL, change_scenario
from skysweep.scenarios.model import Scenario
from skysweep.strategies.covering import as_covered

_LEAST_SHARE = 0.01  # of the ground in a picture: a smaller patch is not worth a way of its own
_SLIVER = 0.01  # of a cell that only touches the ground
_CORNER = 0.1  # of a cell
_BELOW = 0.99  # of the height of a scan: checks, of which scan-only has none


class Gap(NamedTuple):
    """Patches of the area with too low a probability of detection, and the ground that joins them."""

    polygon: shapely.Polygon  # ENU metres, holes kept
    area_m2: float  # of the patches
    mean_pod: float  # there


class Gaps(NamedTuple):
    """All ground of an area with too low a probability of detection, the largest first."""

    to_fly: list[Gap]
    small: list[Gap]  # not worth flying to
    no_fly: list[Gap]  # inside ``safety.no_fly_enu_m``

    def drawn(self) -> Iterator[tuple[str, Gap]]:
        """What somebody should search, in the air or on foot, with its name."""
        for name, gaps in (("gap", self.to_fly), ("no-fly", self.no_fly)):
            yield from ((f"{name} {k}", gap) for k, gap in enumerate(gaps, 1))


def flown_again(scenario: Scenario) -> Scenario:
    """The scenario, with scan-only at the height of its strategy where that flies no drawn plan."""
    covered_from_m = as_covered(scenario).search.scan_altitude_agl_m
    if covered_from_m == scenario.search.scan_altitude_agl_m:
        return scenario
    changes = {
        "search.strategy": "scan-only",
        "search.parameters": {},
        "search.plan": NULL,
        "search.scan_altitude_agl_m": covered_from_m,
        "search.check_altitude_agl_m": min(scenario.search.check_altitude_agl_m, _BELOW * covered_from_m),
    }
    return change_scenario(scenario, changes)


class _Low(NamedTuple):
    """The cells below a POD, and ``joined``: the same with the ground between those near to each other."""

    cells: Any  # (N,) squares, ENU metres
    pod: F64  # (N,)
    group: I64  # (N,) number of the patches within reach of each other
    joined: shapely.Geometry


def gaps_of(coverage: CoverageMap, scenario: Scenario, least_pod: float) -> Gaps:
    """Where the POD is below ``least_pod`` (0..1).

    Patches nearer to each other than half a swath are a group, and one gap where one pass shows all of them.
    A group is small below a hundredth of a picture from the scan's height.
    """
    swath_m, along_m = scenario.camera.lens.footprint_m(scenario.search.scan_altitude_agl_m)
    low = _low_cells(coverage, least_pod, swath_m / 4.0)
    area = scenario.area_enu_m
    no_fly = shapely.union_all([shapely.Polygon(ring) for ring in scenario.safety.no_fly_enu_m])

    def is_worth(group: list[Gap]) -> bool:
        return sum(gap.area_m2 for gap in group) >= _LEAST_SHARE * swath_m * along_m

    groups = _groups_on(area.difference(no_fly), low, swath_m)
    kinds = (
        filter(is_worth, groups),
        itertools.filterfalse(is_worth, groups),
        _groups_on(area.intersection(no_fly), low, swath_m),
    )
    return Gaps(*(sorted(itertools.chain(*kind), key=lambda gap: -gap.area_m2) for kind in kinds))


def _low_cells(coverage: CoverageMap, least_pod: float, reach_m: float) -> _Low:
    low = coverage.inside & (coverage.pod() < least_pod)
    r = round(reach_m / coverage.cell_m)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * r + 1, 2 * r + 1))
    wide = cv2.dilate(np.pad(low, r + 1).astype(np.uint8), disc)
    group = cv2.connectedComponents(wide)[1][r + 1 : -r - 1, r + 1 : -r - 1][low]
    edges = np.diff(cv2.erode(wide, disc).astype(int), axis=1)
    (rows, starts), (_, ends) = np.nonzero(edges == 1), np.nonzero(edges == -1)
    joined = shapely.union_all(_boxes(coverage, rows - r - 1, starts - r, ends - r))
    margin_m = _CORNER * coverage.cell_m  # connects cells that touch at a corner
    joined = joined.buffer(margin_m, join_style="mitre").simplify(margin_m)
    rows, columns = np.nonzero(low)
    return _Low(_boxes(coverage, rows, columns, columns + 1), coverage.pod()[low], group, joined)


def _boxes(coverage: CoverageMap, rows: I64, starts: I64, ends: I64) -> Any:
    """The ground (N,) of cells of a row, from one column up to another."""
    west, south = coverage.bounds_enu_m[:2]
    x, to_x = west + starts * coverage.cell_m, west + ends * coverage.cell_m
    y, to_y = south + rows * coverage.cell_m, south + (rows + 1) * coverage.cell_m
    return shapely.box(x, y, to_x, to_y)


def _groups_on(ground: shapely.Geometry, low: _Low, swath_m: float) -> list[list[Gap]]:
    """The gaps of each group on some ground."""
    patches = shapely.intersection(low.cells, ground)
    told = shapely.area(patches) > _SLIVER * shapely.area(low.cells)
    if not told.any():
        return []
    patches, pod, group = patches[told], low.pod[told], low.group[told]
    area_m2 = shapely.area(patches)
    parts = shapely.get_parts(low.joined.intersection(ground))
    part = shapely.STRtree(parts).nearest(patches)

    def gap(polygon: shapely.Polygon, held: NDArray[np.bool_]) -> Gap:
        return Gap(polygon, float(area_m2[held].sum()), float(np.average(pod[held], weights=area_m2[held])))

    groups = []
    for number in np.unique(group):
        held = group == number
        hull = shapely.convex_hull(shapely.union_all(patches[held])).intersection(ground)
        if hull.geom_type == "Polygon" and _across_m(hull) <= swath_m:
            groups.append([gap(hull, held)])
        else:
            groups.append([gap(parts[k], held & (part == k)) for k in np.unique(part[held])])
    return groups


def _across_m(polygon: shapely.Polygon) -> float:
    """The shorter side of the rectangle around it."""
    corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(polygon))
    return float(np.linalg.norm(np.diff(corners[:3], axis=0), axis=1).min())


def path_over(gaps: Sequence[Gap], scenario: Scenario) -> CoveragePlan:
    """One path over all gaps along the largest one's heading, on to the nearest one that is left."""
    if not gaps:
        raise UserError("gaps: there are none, so there is nothing to fly again; write a higher --pod")
    search, lens = scenario.search, scenario.camera.lens
    here: F64 = np.array(scenario.home.position_enu_m, dtype=float)

    def over(gap: Gap, heading_deg: float | None) -> CoveragePlan:
        return plan_coverage(gap.polygon, lens, search.scan_altitude_agl_m, search.sidelap, heading_deg, here)

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


def gaps_geojson(gaps: Gaps, frame: LocalFrame) -> bytes:
    """A FeatureCollection of polygons; ``class`` and ``title`` are what CalTopo imports."""
    features = [
        {
            "type": "Feature",
            "geometry": _geometry(gap, frame),
            "properties": {"class": "Shape", "title": name, **_figures(gap)},
        }
        for name, gap in gaps.drawn()
    ]
    return (json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n").encode()


def gaps_kml(gaps: Gaps, frame: LocalFrame, mission: str) -> bytes:
    """Placemarks of polygons."""
    root = ET.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ET.SubElement(root, "Document")
    ET.SubElement(document, "name").text = f"{mission}: gaps"
    for name, gap in gaps.drawn():
        placemark = ET.SubElement(document, "Placemark")
        ET.SubElement(placemark, "name").text = name
        figures = _figures(gap)
        words = f"{figures['area_m2']:,.0f} m2, mean POD {figures['mean_pod']:.0%}"
        ET.SubElement(placemark, "description").text = words
        polygons = polygons_lon_lat(gap.polygon, frame)
        add_polygons(placemark if len(polygons) == 1 else ET.SubElement(placemark, "MultiGeometry"), polygons)
    return xml_document(root)


def _geometry(gap: Gap, frame: LocalFrame) -> dict[str, Any]:
    polygons = polygons_lon_lat(gap.polygon, frame)
    if len(polygons) == 1:  # which more programs read
        return {"type": "Polygon", "coordinates": polygons[0]}
    return {"type": "MultiPolygon", "coordinates": polygons}


def _figures(gap: Gap) -> dict[str, float]:
    return {"area_m2": round(gap.area_m2, 1), "mean_pod": round(gap.mean_pod, 3)}
