"""The embedded vehicle of a scenario, standing at its home."""

from __future__ import annotations

import numpy as np

from skysweep.scenarios.model import Scenario
from skysweep.vehicles.embedded.multirotor import Multirotor
from skysweep.worlds.world import TerrainSurface, build_terrain


def embedded_vehicle(
    scenario: Scenario, seed: int, unit: int = 0, terrain: TerrainSurface | None = None
) -> Multirotor:
    """The vehicle that flies a mission of this scenario and seed. ``terrain``: the scenario's, if known."""
    height_m = (terrain or build_terrain(scenario)).height_m
    xy = np.array(scenario.home.position_enu_m, dtype=float)
    home = np.array([*xy, height_m(xy)[0]])
    return Multirotor(scenario.vehicle, scenario.wind, scenario.camera, home, height_m, seed, unit=unit)
