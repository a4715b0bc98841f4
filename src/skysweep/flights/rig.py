"""With what a mission is flown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from skysweep.mission.mission import Mission, Operator, Watch
from skysweep.strategies import StrategySpec
from skysweep.types import Camera, Detections, Detector, Mode, Truth, Vehicle, VehicleState

if TYPE_CHECKING:
    from skysweep.worlds.rendering.renderer import Backend
    from skysweep.worlds.world import World

Say = Callable[[str], None]


def _watch(_state: VehicleState, _mode: Mode, _new: Detections | None) -> None:
    """Nobody watches."""


def _operator() -> None:
    """Nobody says a word."""


def _say(_words: str) -> None:
    """Nobody listens."""


def _hear(_record: Mapping[str, Any]) -> None:
    """Nobody listens."""


def _prepare(_mission: Mission) -> None:
    """Nothing is to be done."""


@dataclass(frozen=True, slots=True)
class Rig:
    """With what a mission is flown beside its scenario: the parts, and the people.

    What is None is made as the scenario says: the embedded ``vehicle``, the ``camera`` that renders what it
    would see, the ``detector``, the ``strategy``. A camera may also be made of the mission's world and of
    where its vehicle really is, by ``make_camera``. ``vehicle_waits`` says that the time of the ``vehicle``
    stands still while a detector thinks, which is so of a simulated one.
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
    unit: int = 0  # which of several in one world: errors and looks of each are its own
    watch: Watch = _watch  # sees every tick
    operator: Operator = _operator  # as in ``mission.loop.Flight``
    say: Say = _say  # takes a sentence for each find and alarm as it is made
    hear: Callable[[Mapping[str, Any]], None] = _hear  # takes every line of the journal
    prepare: Callable[[Mission], None] = _prepare  # called once, right before take-off
