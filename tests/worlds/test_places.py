"""Places at random: evenly, in the area, as far apart as asked, and soon."""

import time

import numpy as np
import pytest
import shapely
import shapely.affinity

from skysweep.scenarios.model import Generator, Scenario
from skysweep.worlds.places import Ground, generate_positions, scattered
from skysweep.worlds.world import build_world

FIELD = shapely.Polygon([(0, 0), (200, 0), (200, 100), (120, 100), (120, 40), (0, 40)])
STRIP = shapely.Polygon([(0, 0), (9000, 9000), (9000, 9004), (0, 4)], [[(10, 11), (50, 51), (50, 52)]])


def generator(pattern, count=2000, **fields):
    return Generator(**{"class": "person"}, pattern=pattern, count=count, **fields)


@pytest.mark.parametrize("polygon", [FIELD, STRIP])
def test_the_same_places_however_many_at_a_time(polygon):
    ground, one, many = Ground(polygon), np.random.default_rng(3), np.random.default_rng(3)
    singly = np.concatenate([ground.draw(1, one) for _ in range(50)])
    np.testing.assert_array_equal(singly, ground.draw(50, many))
    assert one.random() == many.random()


@pytest.mark.parametrize("polygon", [FIELD, STRIP])
def test_places_are_even(polygon):
    places = Ground(polygon).draw(20_000, np.random.default_rng(0))
    assert shapely.distance(polygon, shapely.points(places)).max() < 1e-6
    west, south, east, north = polygon.bounds
    for half in (
        shapely.box(west, south, (west + east) / 2, north),
        shapely.box(west, south, east, (south + north) / 3),
    ):
        share = shapely.intersection(polygon, half).area / polygon.area
        assert shapely.intersects_xy(half, places).mean() == pytest.approx(share, abs=0.015)


@pytest.mark.parametrize(
    "drawn",
    [
        generator("uniform", min_separation_m=0),
        generator("uniform", min_separation_m=1000),
        generator("clustered", min_separation_m=0),
        generator("clustered", spread_m=1000),
        generator("sparse"),
    ],
    ids=["uniform", "crowded", "clustered", "hardly met", "sparse"],
)
@pytest.mark.parametrize("polygon", [FIELD, STRIP])
def test_two_thousand_are_placed_soon(drawn, polygon):
    begun_s = time.process_time()
    places = generate_positions(drawn, Ground(polygon), np.random.default_rng(1))
    assert time.process_time() - begun_s < 10.0
    assert len(places) == 2000
    assert shapely.distance(polygon, shapely.points(places)).max() < 1e-6


def test_what_is_scattered_farther_than_the_area_stays_in_it():
    small = Ground(shapely.box(0, 0, 1, 1))
    for seed in range(20):
        moved = scattered((0.5, 0.5), 1000.0, small, np.random.default_rng(seed))
        assert small.covers(moved)
    assert not small.covers(scattered((5.0, 5.0), 1000.0, small, np.random.default_rng(0)))


@pytest.mark.parametrize("pattern", ["uniform", "clustered", "sparse"])
def test_what_is_placed_at_random_stays_clear_of_buildings(pattern):
    """A house takes most of the area; what is written to be in it stays there."""
    house = {"position_enu_m": [20, 15], "size_m": [34, 20], "yaw_deg": 10}
    scenario = Scenario.model_validate(
        {
            "name": "house",
            "area": {"polygon_enu_m": [[0, 0], [40, 0], [40, 30], [0, 30]]},
            "home": {"position_enu_m": [-5, -5]},
            "buildings": [house],
            "targets": [{"class": "person", "position_enu_m": [20, 15]}],
            "generators": [{"class": "person", "pattern": pattern, "count": 40, "seed": None}],
        }
    )
    inside, *placed = build_world(scenario, 3).objects
    assert inside.position_enu_m[:2].tolist() == [20.0, 15.0]
    walls = shapely.affinity.rotate(shapely.box(3, 5, 37, 25), 10)
    gaps_m = shapely.distance(walls, shapely.points([o.position_enu_m[:2] for o in placed]))
    assert gaps_m.min() >= 0.999
