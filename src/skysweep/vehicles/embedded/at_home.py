"""The embedded vehicle of a scenario, standing at its home."""

from __future__ import annotations

from skysweep.scenarios.model import Scenario
from skysweep.vehicles.embedded.multirotor import Multirotor
from skysweep.worlds.world import build_terrain


def embedded_vehicle(scenario: Scenario, seed: int) -> Multirotor:
    """The same one that a mission of this scenario and seed flies."""
    terrain = build_terrain(scenario)
    east_m, north_m = scenario.home.position_enu_m
    home = (east_m, north_m, terrain.height_at_m(east_m, north_m))
    return Multirotor(scenario.vehicle, scenario.wind, scenario.camera, home, terrain.height_at_m, seed)
