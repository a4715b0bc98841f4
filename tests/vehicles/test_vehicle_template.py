import numpy as np
import pytest

from skysweep.types import Setpoint, Vehicle
from skysweep.vehicles.template import PointVehicle


def test_flies_a_whole_flight() -> None:
    vehicle: Vehicle = PointVehicle([0.0, 0.0, 2.0])
    vehicle.takeoff(10.0)
    for _ in range(100):
        vehicle.advance(0.1)
    assert vehicle.state().position_enu_m == pytest.approx([0.0, 0.0, 12.0])
    vehicle.command(Setpoint(np.array([30.0, 40.0, 12.0]), 5.0, 0.0))
    for _ in range(50):
        vehicle.advance(0.1)
    assert vehicle.state().position_enu_m == pytest.approx([15.0, 20.0, 12.0])
    vehicle.land()
    for _ in range(70):
        vehicle.advance(0.1)
    assert not vehicle.state().airborne
    assert vehicle.state().position_enu_m == pytest.approx([15.0, 20.0, 2.0])
