"""What keeps a scenario on the ground, as far as it is known without flying."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

from skysweep.errors import UserError
from skysweep.flights.build import build_mission, refuse_unseeable
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import Flight
from skysweep.planning.flight_plan import plan_scenario
from skysweep.scenarios.model import Scenario
from skysweep.types import Detections, Frame, VehicleState
from skysweep.worlds.rendering.renderer import refuse_unrenderable


def refuse_unflyable(scenario: Scenario) -> None:
    """Raises UserError if a scenario cannot be planned, or no mission in it may take off."""
    plan_scenario(scenario)
    mission = build_mission(scenario, 0, Rig(camera=_Blind(), detector=_Blind()))
    with closing(mission.sensor):
        Flight(mission, MemoryJournal())


def unusable_sensors(scenario: Scenario) -> Iterator[str]:
    """A sentence for each sensor of a scenario that cannot be flown with; the mission may have the other."""
    try:
        refuse_unrenderable(scenario.camera)
    except UserError as error:
        yield str(error)
    named = {"imaging": "model", "statistical": "statistical_model"}
    for sensor, field in named.items():
        if getattr(scenario.detector, field) is not None:
            try:
                refuse_unseeable(scenario, sensor)
            except UserError as error:
                yield f"detector.{field}: {error}"


class _Blind:
    """Camera and detector of a mission that is not flown. Implements ``types.Camera`` and ``.Detector``."""

    renderer: str | None = None
    class_names: tuple[str, ...] = ()

    def capture(self, state: VehicleState) -> Frame:
        raise AssertionError("a mission took off")

    def detect(self, frame: Frame) -> Detections:
        raise AssertionError("a mission took off")

    def close(self) -> None:
        pass
