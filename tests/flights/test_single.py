"""What a journal's first line says of how a mission is flown."""

from contextlib import closing

import numpy as np
import pytest

from skysweep.flights.build import build_mission
from skysweep.flights.fly import setup_of
from skysweep.flights.rig import Rig
from skysweep.scenarios.model import Scenario
from skysweep.types import Detections
from skysweep.vehicles.embedded.multirotor import Multirotor
from skysweep.worlds.world import build_terrain

SCENARIO = Scenario.model_validate(
    {
        "name": "short",
        "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
        "targets": [{"class": "stop sign", "position_enu_m": [20, 20]}],
    }
)


class Outside:
    """A vehicle that is not simulated here, a camera and a detector that are somewhere else."""

    def __init__(self, **attributes):
        vehicle = Multirotor(
            SCENARIO.vehicle,
            SCENARIO.wind,
            SCENARIO.camera,
            np.zeros(3),
            build_terrain(SCENARIO).height_at_m,
            0,
        )
        self.state = vehicle.state
        self.truth = self.renderer = None
        self.__dict__.update(attributes)

    def detect(self, frame):
        return Detections(frame.time_s, np.zeros((0, 4)), np.zeros(0), (), frame.camera, frame.lens)

    def close(self):
        pass


@pytest.mark.parametrize(
    ("sensor", "parts", "truth"),
    [
        ("statistical", {"vehicle": Outside()}, None),
        ("imaging", {"vehicle": Outside(), "camera": Outside(), "detector": Outside()}, False),
        ("imaging", {"vehicle": Outside(), "camera": Outside(renderer="gz"), "detector": Outside()}, None),
        ("imaging", {"vehicle": Outside(), "camera": Outside(renderer="gl"), "detector": Outside()}, None),
        ("imaging", {"camera": Outside(), "detector": Outside()}, None),
    ],
)
def test_only_a_real_vehicle_with_a_real_camera_has_no_truth(sensor, parts, truth):
    mission = build_mission(SCENARIO, 0, Rig(sensor, **parts))
    with closing(mission.sensor):
        assert setup_of(mission, 1).get("truth") is truth
