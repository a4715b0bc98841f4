"""Maps made of distances, drift and terrain."""

import numpy as np
import pytest
import shapely

from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.prior.drift import Weather, drifted, map_of_particles
from skysweep.planning.prior.lost_person import (
    KOESTER_2008,
    SHARES,
    Distances,
    around_last_known_position,
    distances_of,
)
from skysweep.planning.prior.maps import grid_over
from skysweep.planning.prior.terrain import factors_near, factors_within, slope_deg, slope_factors
from skysweep.scenarios.leeway import LEEWAY

FRAME = LocalFrame(60.2, 22.1)
HOUR_S = 3600.0


def around(distance_m, cell_m):
    return grid_over(shapely.box(-distance_m, -distance_m, distance_m, distance_m), cell_m, FRAME)


@pytest.mark.parametrize("row", KOESTER_2008)
def test_published_shares_lie_within_published_distances(row):
    """Of those within three quarters' distance: a map for all would have too coarse cells for the first."""
    near, half, far, _ = row.within_m
    cells = around(1.02 * far, near / 15)
    lost = around_last_known_position(cells, (0.0, 0.0), row)
    away_m = np.linalg.norm(lost.centres_xy_m, axis=-1)
    first, second = (float(lost.poa[away_m <= m].sum() / lost.poa[away_m <= far].sum()) for m in (near, half))
    assert (first, second) == pytest.approx((SHARES[0] / SHARES[2], SHARES[1] / SHARES[2]), abs=0.02)
    assert distances_of(row.category, row.ecoregion) is row


@pytest.mark.parametrize("within_m", [(1.0, 2.0, 2.0, 3.0), (0.0, 1.0, 2.0, 3.0), (1.0, 2.0, 3.0)])
def test_distances_that_do_not_rise_are_refused(within_m):
    with pytest.raises(UserError, match="within_m"):
        around_last_known_position(around(100, 10), (0, 0), Distances("own", "own", within_m))


def test_a_category_that_is_not_there_is_said_with_those_that_are():
    with pytest.raises(UserError, match="write one of hiker, temperate mountainous; "):
        distances_of("astronaut", "dry flat")


def test_a_map_too_far_away_is_said():
    with pytest.raises(UserError, match="position_xy_m"):
        around_last_known_position(around(100, 10), (1e6, 0), distances_of("dementia", "urban"))


def drift(leeway, wind, current, hours=3, **errors):
    weather = Weather(
        HOUR_S,
        np.tile(np.array(wind, dtype=float), (hours, 1)),
        np.tile(np.array(current, dtype=float), (hours, 1)),
        **{"wind_std_mps": 0.0, "current_std_mps": 0.0, **errors},
    )
    return drifted(LEEWAY[leeway], weather, (100.0, 50.0), 0.0, np.random.default_rng(1))


def test_particles_drift_down_the_wind_and_to_both_sides():
    """A runabout, 10 m/s of wind for three hours: 3.15 % down, 1.29 % aside, offsets 0."""
    xy = drift("SKIFF-1", (0.0, 10.0), (0.0, 0.0)) - (100.0, 50.0)
    down, aside = 0.0315 * 10 * 3 * HOUR_S, 0.0129 * 10 * 3 * HOUR_S
    assert xy[:, 1].mean() == pytest.approx(down, rel=0.01)
    right = xy[xy[:, 0] > 0]
    assert len(right) == pytest.approx(len(xy) / 2, rel=0.03)
    assert right[:, 0].mean() == pytest.approx(aside, rel=0.01)
    assert xy[:, 1].std() == pytest.approx(0.022 * 3 * HOUR_S, rel=0.03)  # 2.2 cm/s at 10 m/s


def test_a_current_carries_everything_along():
    still, carried = drift("PIW-1", (5.0, 0.0), (0.0, 0.0)), drift("PIW-1", (5.0, 0.0), (0.2, -0.1))
    assert carried - still == pytest.approx(np.tile([0.2 * 3 * HOUR_S, -0.1 * 3 * HOUR_S], (len(still), 1)))


def test_errors_of_wind_and_current_spread_the_map():
    sure, unsure = (drift("PIW-1", (5.0, 0.0), (0.1, 0.0), current_std_mps=s) for s in (0.0, 0.25))
    assert unsure.std() > 1.5 * sure.std()


@pytest.mark.parametrize("name", LEEWAY)
def test_every_class_makes_a_map(name):
    particles = drift(name, (4.0, 3.0), (0.1, 0.1))
    cells = map_of_particles(around(6000, 100), particles, smooth_m=100.0)
    assert cells.poa.sum() == pytest.approx(1.0)
    mean = np.sum(cells.poa[..., None] * cells.centres_xy_m, axis=(0, 1))
    assert mean == pytest.approx(particles.mean(axis=0), abs=30.0)


def test_a_drift_off_the_map_is_said():
    with pytest.raises(UserError, match="no particle drifts onto the map"):
        map_of_particles(around(100, 10), np.array([[5e4, 0.0]]))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"wind_mps": [[1.0, 2.0, 3.0]]}, "wind_mps"),
        ({"current_mps": [[0.0, 0.0], [0.0, 0.0]]}, "as many steps"),
        ({"step_s": 0.0}, "step_s: is 0; write seconds above 0"),
        ({"wind_std_mps": -1.0}, "wind_std_mps"),
        ({"current_std_mps": float("nan")}, "current_std_mps"),
    ],
)
def test_bad_weather_is_told_in_one_sentence(change, word):
    good = {"step_s": 60.0, "wind_mps": [[1.0, 2.0]], "current_mps": [[0.0, 0.0]],
            "wind_std_mps": 1.0, "current_std_mps": 0.1}  # fmt: skip
    with pytest.raises(UserError, match=word):
        drifted(LEEWAY["PIW-1"], Weather(**{**good, **change}), (0, 0), 0.0, np.random.default_rng(1))


def test_terrain_makes_some_cells_more_probable():
    cells = around(100, 10)
    trail, lake = shapely.LineString([(-100, 3), (100, 3)]), shapely.box(-100, -100, 0, -50)
    likely = cells.times(factors_near(cells, trail, 10.0, 4.0)).times(factors_within(cells, lake, 0.0))
    assert likely.poa[10, 5] == pytest.approx(4.0 * likely.poa[15, 5])
    assert likely.poa[0, 0] == 0.0
    assert likely.poa.sum() == pytest.approx(1.0)


def test_slopes_have_factors_by_class():
    x, _ = np.meshgrid(np.arange(5.0), np.arange(4.0))
    slopes = slope_deg(10.0 * np.tan(np.radians(30.0)) * x, 10.0)
    assert slopes == pytest.approx(np.full((4, 5), 30.0))
    assert (slope_factors(slopes, [15, 35, 90], [1.0, 0.5, 0.1]) == 0.5).all()
    assert (slope_factors(np.array([[95.0]]), [15, 35, 90], [1.0, 0.5, 0.1]) == 0.1).all()


@pytest.mark.parametrize(
    ("call", "word"),
    [
        (lambda: slope_deg([[1.0, 2.0]], 10.0), "heights_m"),
        (lambda: slope_factors(np.zeros((2, 2)), [30, 15], [1, 1]), "upto_deg"),
        (lambda: slope_factors(np.zeros((2, 2)), [30], [-1]), "factor"),
        (lambda: factors_near(around(50, 10), shapely.Point(0, 0), 0.0, 2.0), "within_m"),
        (lambda: factors_within(around(50, 10), shapely.box(0, 0, 1, 1), float("inf")), "factor"),
    ],
)
def test_bad_terrain_is_told_in_one_sentence(call, word):
    with pytest.raises(UserError, match=word):
        call()
