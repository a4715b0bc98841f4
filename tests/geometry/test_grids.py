from __future__ import annotations

import mgrs
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.geometry.grids import mgrs_of, utm_of


@pytest.mark.parametrize(
    ("latitude", "longitude", "grid", "utm"),
    [
        (60.449, 22.2966, "34VEN7133502119", "34V 571335 6702119"),
        (-33.8568, 151.2153, "56HLH3490052288", "56H 334900 6252288"),
        (60.39, 5.32, "32VKN9723000510", "32V 297230 6700510"),  # the wide zone of western Norway
        (78.22, 15.65, "33XWG1481383004", "33X 514813 8683004"),  # Svalbard's zones
        (0.0, 0.0, "31NAA6602100000", "31N 166021 0"),
        (-9e-10, 0.0, "31NAA6602100000", "31N 166021 0"),
    ],
)
def test_known_places(latitude, longitude, grid, utm):
    assert mgrs_of(latitude, longitude) == grid
    assert utm_of(latitude, longitude) == utm


def test_the_poles_have_no_zone():
    assert utm_of(88.0, 10.0) is None
    assert mgrs_of(88.0, 10.0)[0] in "ABYZ"


@given(st.floats(-79.9, 83.9), st.floats(-179.99, 179.99))
def test_both_lead_back_to_the_place(latitude, longitude):
    there = mgrs.MGRS().toLatLon(mgrs_of(latitude, longitude))
    assert there[0] == pytest.approx(latitude, abs=2e-5)
    found = mgrs_of(latitude, longitude)
    _, *utm = utm_of(latitude, longitude).split()
    for metres, digits in zip(utm, (found[-10:-5], found[-5:]), strict=True):
        assert abs(int(metres) % 100_000 - int(digits)) in (0, 1, 99_999)
