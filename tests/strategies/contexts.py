"""Mission contexts and observations for strategies that are tested without a mission."""

from dataclasses import replace

import numpy as np

from skysweep.geometry.camera import CameraPose, Lens
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Model
from skysweep.strategies.context import MissionContext
from skysweep.strategies.spec import NoParameters
from skysweep.types import Candidate, Look, Observation, Sighting, VehicleState
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


def observed(xy=(0.0, 0.0)):
    """One candidate, seen in the newest look."""
    place = np.array([*xy, 30.0])
    camera = CameraPose(place.copy(), np.eye(3))
    state = VehicleState(1.0, place, np.zeros(3), np.eye(3), camera, 1.0, 0.0, True)
    seen = Candidate(1, "stop sign", np.array([7.0, 8.0, 0.5]), np.eye(2), 0.0, 0.0, (0.9,))
    hit = Sighting(1, False, 0.9, np.array([7.0, 8.0, 0.5]), 0.9, 30.0)
    return Observation(state, 30.0, (Look(0.9, camera, Lens(640, 360, 1.4), (hit,)),), {1: seen})
