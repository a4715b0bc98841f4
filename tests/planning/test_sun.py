from datetime import datetime, timedelta, timezone

import pytest

from skysweep.errors import UserError
from skysweep.planning.sun import moment_of, sun_at


@pytest.mark.parametrize(
    ("when", "latitude_deg", "longitude_deg", "elevation_deg", "heading_deg"),
    [
        # NREL's SPA paper (Reda and Andreas, 2004): zenith 50.11162, azimuth 194.34024
        ("2003-10-17T12:30:30-07:00", 39.742476, -105.1786, 39.888, 194.340),
        # the equator at an equinox noon, and the solstice noon at the tropic
        ("2026-03-20T12:07:30+00:00", 0.0, 0.0, 89.9, None),
        ("2026-06-21T12:01:50+00:00", 23.436, 0.0, 89.99, None),
    ],
)
def test_the_sun_stands_where_the_almanac_has_it(when, latitude_deg, longitude_deg, elevation_deg, heading_deg):
    sun = sun_at(datetime.fromisoformat(when), latitude_deg, longitude_deg)
    assert sun.elevation_deg == pytest.approx(elevation_deg, abs=0.15)
    if heading_deg is not None:
        assert sun.heading_deg == pytest.approx(heading_deg, abs=0.1)


def test_it_rises_in_the_east_and_sets_in_the_west():
    noon = datetime(2026, 9, 23, 12, tzinfo=timezone.utc)
    morning, evening = (sun_at(noon + timedelta(hours=h), 50.0, 0.0) for h in (-5, 5))
    assert morning.heading_deg < 180.0 < evening.heading_deg
    assert 0.0 < morning.elevation_deg < 15.0
    assert morning.shadow_ratio > 3.7
    assert sun_at(noon + timedelta(hours=12), 50.0, 0.0).shadow_ratio == float("inf")


@pytest.mark.parametrize(("text", "word"), [("tomorrow", "no date"), ("2026-10-03T15:30", "time zone")])
def test_a_moment_needs_date_time_and_zone(text, word):
    with pytest.raises(UserError, match=word):
        moment_of(text, "--at")


def test_moments_may_be_in_utc():
    assert moment_of("2026-10-03T15:30Z", "--at") == datetime(2026, 10, 3, 15, 30, tzinfo=timezone.utc)
