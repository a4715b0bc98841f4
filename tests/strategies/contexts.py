"""Mission contexts for strategies that are tested without a mission."""

from dataclasses import replace

import numpy as np

from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Model
from skysweep.strategies.context import MissionContext
from skysweep.strategies.spec import NoParameters
from skysweep.worlds.obstacles import known_obstacles

PARAMETERS = NoParameters()


def context_of(
    waypoints=((0.0, 0.0),), look_s=1.0, parameters: Model = PARAMETERS, scenario="clusters", **search
) -> MissionContext:
    """What a strategy of this scenario may know, with another F and other parameters of the search."""
    made = load_scenario(scenario) if isinstance(scenario, str) else scenario
    made = made.with_search(**search) if search else made
    context = MissionContext.of(
        made, np.array(waypoints, dtype=float), 0.0, known_obstacles(made), parameters
    )
    return replace(context, look_s=look_s)
