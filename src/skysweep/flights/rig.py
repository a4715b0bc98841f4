"""The parts and the people of a flight."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from skysweep.mission.mission import Mission, Watch
from skysweep.mission.orders import Operator
from skysweep.strategies import StrategySpec
from skysweep.types import Camera, Detector, Truth, Vehicle

if TYPE_CHECKING:
    from skysweep.worlds.rendering.renderer import Backend
    from skysweep.worlds.world import World

Say = Callable[[str], None]


def nothing(*_arguments: object) -> None:
    """Does nothing."""


@dataclass(frozen=True, slots=True)
class Rig:
    """The parts of a flight beside its scenario, and the people who watch and operate it.

    A part that is None is made from the scenario: the embedded ``vehicle``, a rendering ``camera``, the
    ``detector``, the ``strategy``. ``make_camera`` makes a camera from the mission's world and its
    vehicle's truth. ``vehicle_waits``: the time of the ``vehicle`` stops while a detector works, as in a
    simulation.
    """

    sensor: str = "imaging"  # or statistical
    renderer: Backend = "auto"  # gl, embree, gazebo or gz
    threads: int = 2  # of the detector
    vehicle: Vehicle | None = None
    vehicle_waits: bool = False
    camera: Camera | None = None
    make_camera: Callable[[World, Truth], Camera] | None = None
    detector: Detector | None = None
    strategy: StrategySpec | None = None
    unit: int = 0  # number of the vehicle in its world: each has its own errors and looks
    watch: Watch = nothing  # gets every tick
    operator: Operator = nothing  # asked at every tick for an order
    say: Say = nothing  # gets a sentence for each find and alarm
    film: bool = False  # whether the run folder gets pictures of the camera all along, for page and video
    hear: Callable[[Mapping[str, Any]], None] = nothing  # gets every line of the journal
    prepare: Callable[[Mission], None] = nothing  # called once, right before take-off
    on_results: Callable[[int, int], None] = nothing  # gets parts done and total while results are written
