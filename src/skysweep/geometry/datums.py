"""Whether a CRS's places are those of WGS 84, give or take a metre or two."""

from __future__ import annotations

import math

import pyproj


def may_be_wgs84(crs: pyproj.CRS) -> bool:
    """Whether its datum may be taken for WGS 84 where PROJ knows no transformation (``allow_ballpark``).

    On the ellipsoids of WGS 84 and GRS 80 that errs by a metre or two, as all their datums are geocentric. By
    convention the latitudes of a sphere (MODIS, say) are those of WGS 84. On any other ellipsoid it would err
    by 100 m and more.
    """
    ellipsoid = crs.ellipsoid
    if ellipsoid is None:
        return False
    flattening = ellipsoid.inverse_flattening
    is_geocentric = ellipsoid.semi_major_metre == 6378137.0 and math.isclose(
        flattening, 298.257, abs_tol=1e-3
    )
    return is_geocentric or flattening == 0.0
