"""Polygons as rings of longitude and latitude."""

import numpy as np
import pytest
import shapely

from skysweep.geometry.frames import LocalFrame
from skysweep.results.rings import on_earth, polygons_lon_lat

AREA = shapely.Polygon(
    [(0, 0), (300, 0), (300, 200), (0, 200)], holes=[[(150, 80), (250, 80), (250, 120), (150, 120)]]
)


def area_of(rings):
    """Square degrees of the outer ring less the holes, which are wound the other way."""
    return sum(shapely.LinearRing(r).is_ccw * shapely.Polygon(r).area for r in rings) - sum(
        shapely.Polygon(r).area for r in rings if not shapely.LinearRing(r).is_ccw
    )


def test_a_polygon_keeps_its_hole_and_its_winding():
    ((outer, hole),) = polygons_lon_lat(AREA, LocalFrame(60.0, 22.0, 0.0))
    assert outer[0] == outer[-1] == [22.0, 60.0]
    assert shapely.LinearRing(outer).is_ccw
    assert not shapely.LinearRing(hole).is_ccw


@pytest.mark.parametrize("longitude_deg", [179.998, -179.9985])
def test_the_antimeridian_cuts_it(longitude_deg):
    usual = polygons_lon_lat(AREA, LocalFrame(-17.0, 100.0, 0.0))
    polygon = AREA if longitude_deg > 0 else shapely.affinity.translate(AREA, -300.0)
    parts = polygons_lon_lat(polygon, LocalFrame(-17.0, longitude_deg, 0.0))
    assert len(parts) > 1
    for rings in parts:
        lon = np.array(rings[0])[:, 0]
        assert np.ptp(lon) < 1.0
        assert (np.abs(lon) <= 180.0).all()
    assert sum(map(area_of, parts)) == pytest.approx(area_of(usual[0]), rel=1e-4)


def test_a_path_is_cut_there_too():
    path = on_earth(AREA.exterior, LocalFrame(-17.0, 179.998, 0.0))
    assert path.geom_type == "MultiLineString"
    assert all(np.ptp(shapely.get_coordinates(part)[:, 0]) < 1.0 for part in path.geoms)
    usual = on_earth(AREA.exterior, LocalFrame(-17.0, 100.0, 0.0))
    assert path.length == pytest.approx(usual.length, rel=1e-4)
