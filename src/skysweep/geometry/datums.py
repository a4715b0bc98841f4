"""Whether a CRS's places are those of WGS 84, give or take a metre or two."""

from __future__ import annotations

import math

import pyproj


def is_geocentric(crs: pyproj.CRS) -> bool:
    """Whether it is on the ellipsoid of WGS 84 or GRS 80, as all geocentric datums are.

    Where PROJ knows no transformation to WGS 84 it takes the datums for one (``allow_ballpark``). For these
    that errs by a metre or two; on any other ellipsoid it would err by 100 m and more.
    """
    ellipsoid = crs.ellipsoid
    return (
        ellipsoid is not None
        and ellipsoid.semi_major_metre == 6378137.0
        and math.isclose(ellipsoid.inverse_flattening, 298.257, abs_tol=1e-3)
    )
