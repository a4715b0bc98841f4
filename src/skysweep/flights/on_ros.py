"""A mission as a ROS 2 node."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from skysweep.errors import UserError
from skysweep.files.writing import free_folder
from skysweep.flights.fly import fly_to_folder, refuse_other_mission
from skysweep.flights.pace import paced
from skysweep.flights.rig import Rig
from skysweep.mission.mission import Mission
from skysweep.results.summary import RunSummary
from skysweep.ros.face import MissionFace
from skysweep.ros.link import RosLink
from skysweep.ros.parts import RosCamera, RosDetector, RosPoseVehicle
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.types import Camera, Detections, Detector, Mode, Vehicle, VehicleState
from skysweep.vehicles.embedded.at_home import embedded_vehicle

Parts = tuple[Vehicle | None, Camera | None, Detector | None]


@dataclass(frozen=True, slots=True)
class Settings:
    """The settings of a flight. Each is a parameter of the node with the same name."""

    scenario: str = "clusters"
    seed: int = 0
    sensor: str = "imaging"
    speed: float = 1.0  # vehicle time over wall time, at most
    autostart: bool = True  # else the service ~/start begins
    out: str = ""  # run folder; empty: a new one, runs/SCENARIO-ros-seedN
    camera: str = ""  # topic of pictures; empty: rendered
    detector: str = ""  # topic of detections; empty: the scenario's detector
    pose: str = ""  # topic of odometry; empty: the vehicle's own


@dataclass(frozen=True, slots=True)
class RosFlight:
    """A mission that a node is about to fly; of ``ros_flight``."""

    link: RosLink
    settings: Settings
    scenario: Scenario

    @property
    def folder(self) -> Path:
        """The run folder."""
        return Path(self.settings.out)

    def fly(self, rig: Rig) -> RunSummary:
        """Fly the mission with everything on topics; the summary of its run folder.

        The sensor and the parts are those of the settings. Orders come from the services and the operator of
        ``rig``. Raises UserError, before take-off, if a part is missing.
        """
        settings, link = self.settings, self.link
        face = MissionFace(link, publish_looks=not settings.detector)
        vehicle, camera, detector = _parts(link, self.scenario, settings)

        def watch(state: VehicleState, mode: Mode, new: Detections | None) -> None:
            face.watch(state, mode, new)
            rig.watch(state, mode, new)

        def prepare(mission: Mission) -> None:
            rig.prepare(mission)
            face.prepare(mission)
            if not settings.autostart:
                rig.say(f"waiting for {link.node.get_fully_qualified_name()}/start")
                face.wait_for_start(rig.operator)
            face.begin()

        on_topics = replace(
            rig,
            sensor=settings.sensor,
            vehicle=vehicle,
            camera=camera,
            detector=detector,
            watch=watch,
            operator=lambda: face.operator() or rig.operator(),
            hear=face.note,
            prepare=prepare,
        )
        summary = fly_to_folder(self.scenario, settings.seed, self.folder, paced(on_topics, settings.speed))
        face.end(summary["end_reason"])
        return summary


@contextmanager
def ros_flight(
    settings: Settings, changes: Mapping[str, Any] | None = None, arguments: tuple[str, ...] = ()
) -> Iterator[RosFlight]:
    """A mission as a node, which lives as long as the context.

    ``changes`` are to the scenario's fields. ``arguments`` are ROS arguments; their parameters override
    ``settings``. Raises UserError if a setting is wrong.
    """
    with closing(RosLink("mission", arguments=arguments)) as link:
        settings = _parameters(link, settings)
        if not settings.speed > 0.0:  # NaN
            raise UserError("speed: must be above 0; 1 is real time")
        if settings.seed < 0:
            raise UserError(f"seed: is {settings.seed}; write 0 or more")
        if not settings.out:
            name = f"{Path(settings.scenario).stem}-ros-seed{settings.seed}"
            settings = replace(settings, out=str(free_folder(Path("runs"), name)))
        refuse_other_mission(Path(settings.out))
        scenario = change_scenario(load_scenario(settings.scenario), dict(changes or {}))
        yield RosFlight(link, settings, scenario)


@contextmanager
def parts_on_topics(
    scenario: Scenario, seed: int, sensor: str, camera: str = "", detector: str = "", pose: str = ""
) -> Iterator[Parts]:
    """Vehicle, camera and detector of a mission from the named topics; None for each without a topic.

    Without any topic ROS is not used. Raises UserError as the parts do.
    """
    if not (camera or detector or pose):
        yield None, None, None
        return
    with closing(RosLink("mission")) as link:
        topics = Settings(seed=seed, sensor=sensor, camera=camera, detector=detector, pose=pose)
        yield _parts(link, scenario, topics)


def _parts(link: RosLink, scenario: Scenario, of: Settings) -> Parts:
    if of.sensor != "imaging" and (of.camera or of.detector):
        raise UserError("sensor: a camera or a detector on a topic needs the sensor 'imaging'")
    camera = RosCamera(link, of.camera, scenario.camera.lens) if of.camera else None
    detector = None
    if of.detector:
        detector = RosDetector(link, of.detector, scenario.target_classes, scenario.detector.confidence_min)
    vehicle = RosPoseVehicle(embedded_vehicle(scenario, of.seed), link, of.pose) if of.pose else None
    return vehicle, camera, detector


def _parameters(link: RosLink, settings: Settings) -> Settings:
    given = {f.name: link.parameter(f.name, getattr(settings, f.name)) for f in fields(settings)}
    return replace(settings, **given)
