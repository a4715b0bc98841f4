"""Which CRSs may be taken for WGS 84 where PROJ knows no transformation."""

import pyproj
import pytest

from skysweep.geometry.datums import may_be_wgs84


@pytest.mark.parametrize(
    ("crs", "may_be"),
    [
        ("EPSG:3067", True),  # EUREF-FIN
        ("EPSG:4979", True),
        ("EPSG:3067+5717", True),
        ("+proj=utm +zone=33 +ellps=GRS80 +units=m", True),
        ("+proj=sinu +R=6371007.181 +units=m", True),  # MODIS
        ("EPSG:3857", True),
        ("+proj=tmerc +lon_0=24 +ellps=intl", False),
        ("+proj=tmerc +lon_0=12 +ellps=bessel", False),
        ('LOCAL_CS["x",UNIT["metre",1]]', False),
    ],
)
def test_only_geocentric_datums_and_spheres_may_be_taken_for_wgs84(crs, may_be):
    assert may_be_wgs84(pyproj.CRS.from_user_input(crs)) is may_be
