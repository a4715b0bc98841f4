"""Places as map grids write them: UTM and MGRS of WGS 84."""

from __future__ import annotations

import math
from functools import lru_cache

import mgrs
import pyproj

_SOUTHERN = "CDEFGHJKLM"  # latitude bands
_ON_EQUATOR_DEG = 1e-8  # a millimetre; just south of it the library names a square that does not exist


def mgrs_of(latitude_deg: float, longitude_deg: float) -> str:
    """The place in the Military Grid Reference System, to the metre below: ``34VEN7133502119``."""
    return str(mgrs.MGRS().toMGRS(_exact(latitude_deg), longitude_deg, MGRSPrecision=5))


def utm_of(latitude_deg: float, longitude_deg: float) -> str | None:
    """Zone with its latitude band, easting and northing, to the metre below: ``34V 571335 6702119``.

    None near the poles, which have no zone.
    """
    zone, band = mgrs_of(latitude_deg, longitude_deg)[:2], mgrs_of(latitude_deg, longitude_deg)[2:3]
    if not zone.isdigit():
        return None
    easting_m, northing_m = _utm(int(zone), band in _SOUTHERN).transform(longitude_deg, _exact(latitude_deg))
    return f"{zone}{band} {math.floor(easting_m)} {math.floor(northing_m)}"


def _exact(latitude_deg: float) -> float:
    return 0.0 if abs(latitude_deg) < _ON_EQUATOR_DEG else latitude_deg


@lru_cache(maxsize=8)
def _utm(zone: int, is_southern: bool) -> pyproj.Transformer:
    code = (32700 if is_southern else 32600) + zone
    return pyproj.Transformer.from_crs("EPSG:4326", f"EPSG:{code}", always_xy=True)
