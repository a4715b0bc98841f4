"""The embedded vehicle of a scenario, standing at its home."""

from __future__ import annotations

from skysweep.scenarios.model import Scenario
from skysweep.vehicles.embedded.multirotor import Multirotor
from skysweep.worlds.world import TerrainSurface, build_terrain


def embedded_vehicle(
    scenario: Scenario, seed: int, unit: int = 0, terrain: TerrainSurface | None = None
) -> Multirotor:
    """The vehicle that flies a mission of this scenario and seed. ``terrain``: the scenario's, if known."""
    ground_at_m = (terrain or build_terrain(scenario)).height_at_m
    east_m, north_m = scenario.home.position_enu_m
    home = (east_m, north_m, ground_at_m(east_m, north_m))
    return Multirotor(scenario.vehicle, scenario.wind, scenario.camera, home, ground_at_m, seed, unit=unit)
