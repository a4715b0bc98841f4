"""The day behind a moment: the sun's path follows from where it stands now."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.planning.sun import sun_at
from skysweep.scenarios.model import Light
from skysweep.worlds.weather import STEPS, past_day

LATITUDE_DEG = 60.45


@given(
    moment=st.datetimes(datetime(2025, 1, 1), datetime(2026, 12, 31)),
    latitude_deg=st.floats(-66, 66),
    hours=st.integers(0, 23),
)
def test_the_sun_stood_where_an_almanac_says(moment: datetime, latitude_deg: float, hours: int) -> None:
    when = moment.replace(tzinfo=timezone.utc)
    now, then = (sun_at(t, latitude_deg, 20.0) for t in (when, when - timedelta(hours=hours)))
    day = past_day(Light(sun_elevation_deg=now.elevation_deg, sun_heading_deg=now.heading_deg), latitude_deg)
    elevation, heading = np.radians(then.elevation_deg), np.radians(then.heading_deg)
    expected = [np.cos(elevation) * np.sin(heading), np.cos(elevation) * np.cos(heading), np.sin(elevation)]
    angle_deg = np.degrees(np.arccos(np.clip(day.sun_enu[hours * STEPS // 24] @ expected, -1, 1)))
    assert angle_deg < 0.6  # the declination changes by 0.4 degrees a day


def test_sunshine_at_noon_is_that_of_a_clear_or_a_grey_day() -> None:
    clear, grey = (
        past_day(Light(sun_elevation_deg=53, sun_heading_deg=180, cloud_cover=cloud), LATITUDE_DEG)
        for cloud in (0.0, 1.0)
    )
    assert 750 < clear.global_w_m2[0] < 900
    assert 0.2 < grey.global_w_m2[0] / clear.global_w_m2[0] < 0.3
    assert grey.direct_w_m2.max() == 0.0


def test_the_air_is_as_warm_as_told_and_was_coldest_before_sunrise() -> None:
    day = past_day(Light(sun_elevation_deg=45, sun_heading_deg=225, air_temperature_c=20.0), LATITUDE_DEG)
    assert day.air_c[0] == 20.0
    assert 7 < np.ptp(day.air_c) < 14
    coldest_h = (15.0 - (np.argmin(day.air_c) - np.argmax(day.air_c)) * 24 / STEPS) % 24
    assert coldest_h == pytest.approx(3.0, abs=0.1)


def test_a_clear_sky_is_cold_and_a_cloudy_one_is_not() -> None:
    skies = [past_day(Light(cloud_cover=cloud), LATITUDE_DEG).sky_c for cloud in (0.0, 0.5, 1.0)]
    assert -10 < skies[0] < 0
    assert skies == sorted(skies)
    assert skies[-1] == pytest.approx(15.0)
