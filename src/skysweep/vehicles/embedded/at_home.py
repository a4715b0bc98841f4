"""The embedded vehicle of a scenario, standing at its home."""

from __future__ import annotations

import numpy as np

from skysweep.scenarios.model import Scenario
from skysweep.vehicles.embedded.multirotor import Multirotor
from skysweep.worlds.world import build_terrain


def embedded_vehicle(scenario: Scenario, seed: int) -> Multirotor:
    """The same one that a mission of this scenario and seed flies."""
    terrain = build_terrain(scenario)
    xy = np.array(scenario.home.position_enu_m, dtype=float)
    home = np.array([*xy, terrain.height_m(xy)[0]])
    return Multirotor(scenario.vehicle, scenario.wind, scenario.camera, home, terrain.height_m, seed)
