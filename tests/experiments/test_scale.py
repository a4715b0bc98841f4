"""Missions of one kind over areas of any size."""

from __future__ import annotations

import pytest

from skysweep.experiments import scale


@pytest.mark.parametrize("hectares", scale.HECTARES)
def test_the_valley_has_its_area_and_is_a_valid_scenario(hectares: float) -> None:
    scenario = scale.valley(hectares)
    assert scenario.area_enu_m.area == pytest.approx(hectares * 1e4)
    assert scenario.target_classes == ("person",)


@pytest.mark.slow
def test_a_mission_at_4k_keeps_to_its_memory() -> None:
    cost = scale.rendered(2)
    assert cost["look_s"] > 0.1
    assert 500 < cost["memory_mb"] < 4000
