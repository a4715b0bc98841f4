"""Where the sun stands, to a tenth of a degree: as NOAA's solar calculator has it.

The formulas are those of J. Meeus, "Astronomical Algorithms", chapter 25 (low accuracy), without refraction.
"""

from __future__ import annotations

import math
from datetime import datetime, timezone
from typing import NamedTuple

from skysweep.errors import UserError

LOW_DEG = 15.0  # below, shadows are four times as long as what throws them
_J2000 = datetime(2000, 1, 1, 12, tzinfo=timezone.utc)


class Sun(NamedTuple):
    """The sun's direction."""

    elevation_deg: float  # above the horizon
    heading_deg: float

    @property
    def shadow_ratio(self) -> float:
        """Length of a shadow on level ground over the height of what throws it; infinite at night."""
        return 1.0 / math.tan(math.radians(self.elevation_deg)) if self.elevation_deg > 0.0 else math.inf


def sun_at(when: datetime, latitude_deg: float, longitude_deg: float) -> Sun:
    """The sun at a moment, which has a time zone, and a place."""
    days = (when - _J2000).total_seconds() / 86400.0
    mean_longitude = math.radians((280.46646 + 0.98564736 * days) % 360.0)
    anomaly = math.radians((357.52911 + 0.98560028 * days) % 360.0)
    centre = 1.914602 * math.sin(anomaly) + 0.019993 * math.sin(2.0 * anomaly)
    longitude = mean_longitude + math.radians(centre - 0.00569)
    obliquity = math.radians(23.439291 - 3.563e-7 * days)
    right_ascension = math.atan2(math.cos(obliquity) * math.sin(longitude), math.cos(longitude))
    declination = math.asin(math.sin(obliquity) * math.sin(longitude))
    sidereal = math.radians((280.46061837 + 360.98564737 * days + longitude_deg) % 360.0)
    hour, latitude = sidereal - right_ascension, math.radians(latitude_deg)
    up = math.sin(latitude) * math.sin(declination)
    up += math.cos(latitude) * math.cos(declination) * math.cos(hour)
    east = -math.cos(declination) * math.sin(hour)
    north = math.cos(latitude) * math.sin(declination)
    north -= math.sin(latitude) * math.cos(declination) * math.cos(hour)
    return Sun(math.degrees(math.asin(up)), math.degrees(math.atan2(east, north)) % 360.0)


def moment_of(text: str, option: str) -> datetime:
    """A moment written as in ISO 8601, with its time zone. Raises UserError, naming the option, otherwise."""
    try:
        when = datetime.fromisoformat(text.replace("Z", "+00:00"))
    except ValueError:
        raise UserError(
            f"{option}: '{text}' is no date and time; write one as 2026-10-03T15:30+02:00"
        ) from None
    if when.tzinfo is None:
        raise UserError(f"{option}: '{text}' has no time zone; write it at the end, as in {text}+02:00")
    return when
