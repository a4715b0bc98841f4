"""Plans and missions of one kind over areas of any size."""

import numpy as np
import pytest

from skysweep.experiments import scale
from skysweep.worlds.world import build_terrain


@pytest.mark.parametrize("hectares", scale.HECTARES)
def test_the_place_has_its_area_and_hills(hectares, tmp_path):
    scenario = scale.place(hectares, tmp_path)
    assert scenario.area_enu_m.area == pytest.approx(hectares * 1e4)
    terrain = build_terrain(scenario)
    west, south, east, north = terrain.bounds_enu_m
    rows, columns = terrain.heights_m.shape
    assert max((north - south) / (rows - 1), (east - west) / (columns - 1)) < 11.0
    assert 5.0 < np.ptp(terrain.heights_m) < 65.0


@pytest.mark.slow
def test_small_places_are_measured():
    told = []
    measured = scale.scale((0.5, 1), told.append, looks=1)
    assert told == [f"{part}, {size} ha" for size in (0.5, 1) for part in scale.PARTS]
    for row in measured["rows"]:
        assert min(row["plan_s"], row["statistical_s"]) > 0.0
        assert row["flown_km"] > row["planned_km"] > 0.05
        assert row["rendered_look_s"] > 0.02
        assert row["rendered_s"] > row["rendered_ready_s"] > row["rendered_look_s"]
        assert 100 < row["plan_mb"] < row["rendered_mb"] < 4000
    assert set(measured["slopes"]) == set(scale.PARTS)
