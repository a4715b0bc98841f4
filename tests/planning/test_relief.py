"""What hills cost on ways that no profile was planned for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.planning.relief import over_hills
from skysweep.scenarios.model import VehicleLimits
from skysweep.worlds.world import TerrainSurface

VEHICLE = VehicleLimits()  # climbs at 3 m/s and sinks at 1.5 m/s
BOUNDS = (0.0, 0.0, 1000.0, 100.0)


def lost_s(profile_m, *places_m, speed_mps=5.0, above_m=30.0, altitude_m=30.0, keep_m=5.0):
    """Over heights at equal distances along 1000 m, from place to place."""
    terrain = TerrainSurface(np.tile(np.asarray(profile_m, dtype=float), (2, 1)), BOUNDS, "grass")
    way = np.array([[[x, 50.0] for x in places_m or (0.0, 1000.0)]])
    hills = over_hills(way, np.array([speed_mps]), above_m, altitude_m, keep_m, VEHICLE, terrain)
    return hills.lost_s.item()


def test_over_level_ground_nothing_is_lost():
    assert lost_s([7.0, 7.0, 7.0]) == 0.0


def test_hills_that_it_follows_cost_nothing():
    assert lost_s([0.0, 100.0, 0.0], speed_mps=5.0) == pytest.approx(0.0, abs=1e-9)


def test_it_waits_before_a_wall():
    """A plateau of 300 m, 50 m ahead: what is left of the climb when it is there, at 3 m/s."""
    steps = np.where(np.arange(1001) < 50, 0.0, 300.0)
    assert lost_s(steps) == pytest.approx((300.0 + 5.0 - 30.0 - 30.0) / 3.0, abs=1.5)


def test_what_it_cannot_sink_on_the_way_it_sinks_at_the_end():
    """From a plateau of 300 m that ends 50 m before home: 10 s of the way, then 1.5 m/s."""
    steps = np.where(np.arange(1001) < 950, 300.0, 0.0)
    assert lost_s(steps) == pytest.approx((300.0 - 15.0) / 1.5, abs=4.0)


def test_a_way_round_is_one_way():
    steps = np.where((np.arange(1001) > 400) & (np.arange(1001) < 600), 200.0, 0.0)
    assert lost_s(steps, 0.0, 500.0, 1000.0) == pytest.approx(lost_s(steps), abs=2.0)
    assert lost_s(steps, 0.0, 300.0) == pytest.approx(0.0, abs=1e-9)


def test_what_is_too_low_at_the_end_still_climbs():
    assert lost_s([0.0, 1.0], 0.0, 10.0, above_m=10.0) == pytest.approx(20.0 / 3.0 - 2.0, abs=1.0)


@given(
    st.lists(st.floats(0.0, 400.0), min_size=2, max_size=20),
    st.floats(0.5, 15.0),
    st.floats(5.0, 100.0),
)
def test_it_takes_as_long_as_it_rises_and_no_longer_than_all_slopes_one_by_one(
    profile_m, speed_mps, altitude_m
):
    lost = lost_s(profile_m, speed_mps=speed_mps, above_m=altitude_m, altitude_m=altitude_m)
    rises_m = profile_m[-1] - profile_m[0]
    upright_s = rises_m / VEHICLE.climb_speed_mps if rises_m > 0.0 else -rises_m / VEHICLE.descent_speed_mps
    steps_m = np.diff(profile_m)
    slopes_s = steps_m.clip(0.0).sum() / VEHICLE.climb_speed_mps
    slopes_s += (-steps_m).clip(0.0).sum() / VEHICLE.descent_speed_mps
    assert max(0.0, upright_s - 1000.0 / speed_mps) - 1e-6 <= lost <= slopes_s + 1e-6
