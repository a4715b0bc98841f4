"""A mission as a ROS 2 node."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from skysweep.errors import UserError
from skysweep.files.writing import make_folder
from skysweep.flights.build import build_mission, make_detector
from skysweep.flights.fly import Watch, begin, finish, fly_in
from skysweep.mission.journal import FileJournal
from skysweep.results.run_folder import JOURNAL_FILE
from skysweep.results.summary import RunSummary
from skysweep.ros.face import MissionFace, RealTime
from skysweep.ros.link import Link
from skysweep.ros.parts import PublishedDetector, RosCamera, RosDetector, RosPoseVehicle
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.types import Camera, Detections, Detector, Vehicle, VehicleState
from skysweep.vehicles.embedded.at_home import embedded_vehicle

_DETECTOR_THREADS = 2

Parts = tuple[Vehicle | None, Camera | None, Detector | None]


@dataclass(frozen=True, slots=True)
class Settings:
    """What is flown, and how. Each is a parameter of the node with the same name."""

    scenario: str = "clusters"
    seed: int = 0
    sensor: str = "imaging"
    speed: float = 1.0  # vehicle time over wall time, at most
    autostart: bool = True  # else the service ~/start begins
    out: str = ""  # run folder
    camera: str = ""  # topic of pictures; empty: rendered
    detector: str = ""  # topic of detections; empty: the scenario's detector
    pose: str = ""  # topic of odometry; empty: the vehicle's own


def fly_on_ros(
    settings: Settings,
    changes: Mapping[str, Any] | None = None,
    arguments: tuple[str, ...] = (),
    watch: Watch = lambda _state, _mode, _new: None,
    say: Callable[[str], None] = lambda _words: None,
) -> RunSummary:
    """Fly one mission with everything on topics; write its run folder and return its summary.

    ``changes`` are to the scenario's fields; ``arguments`` ROS arguments, whose parameters win over
    ``settings``. ``say`` takes what a watcher waits for, as in ``fly_to_folder``. Raises UserError, before
    take-off, on what is not there or not as it should be.
    """
    with closing(Link("mission", arguments=arguments)) as link:
        settings = _parameters(link, settings)
        if settings.speed <= 0.0:
            raise UserError("speed: must be above 0; 1 is real time")
        folder = Path(settings.out)
        if not settings.out or (folder / JOURNAL_FILE).exists():
            raise UserError(f"out: '{settings.out}' holds a mission already or is empty; write a new folder")
        scenario = change_scenario(load_scenario(settings.scenario), dict(changes or {}))
        face = MissionFace(link)
        vehicle, camera, detector = _parts(
            link, scenario, settings.seed, settings.sensor, settings.camera, settings.detector, settings.pose
        )
        theirs = detector
        if settings.sensor == "imaging" and not settings.detector:
            detector = PublishedDetector(link, make_detector(scenario, _DETECTOR_THREADS))
        mission = build_mission(
            scenario,
            settings.seed,
            settings.sensor,
            threads=_DETECTOR_THREADS,
            vehicle=vehicle,
            camera=camera,
            detector=detector,
        )
        make_folder(folder)
        face.prepare(mission)
        pace = RealTime(settings.speed)

        def watch_all(state: VehicleState, mode: str, new: Detections | None) -> None:
            face.watch(state, mode, new)
            watch(state, mode, new)
            pace.keep(state.time_s)

        journal = FileJournal(folder / JOURNAL_FILE)
        journal.listeners.append(face.note)
        with closing(mission.sensor), closing(journal):
            begin(folder, mission, journal, _DETECTOR_THREADS, theirs)
            if not settings.autostart:
                say(f"waiting for {link.node.get_fully_qualified_name()}/start")
                face.wait_for_start()
            started = time.perf_counter()
            fly_in(folder, mission, journal, watch_all, face.operator, say=say)
            summary = finish(folder, started)
        face.end(summary["end_reason"])
        return summary


@contextmanager
def parts_on_topics(
    scenario: Scenario, seed: int, sensor: str, camera: str = "", detector: str = "", pose: str = ""
) -> Iterator[Parts]:
    """Vehicle, camera and detector of a mission from the topics named; None for each that is not.

    ROS is not touched when none is. Raises UserError.
    """
    if not (camera or detector or pose):
        yield None, None, None
        return
    with closing(Link("mission")) as link:
        yield _parts(link, scenario, seed, sensor, camera, detector, pose)


def _parts(
    link: Link, scenario: Scenario, seed: int, sensor: str, camera: str, detector: str, pose: str
) -> Parts:
    if sensor != "imaging" and (camera or detector):
        raise UserError("sensor: a camera or a detector on a topic needs the sensor 'imaging'")
    eye = RosCamera(link, camera, scenario.camera.lens) if camera else None
    finder = None
    if detector:
        finder = RosDetector(link, detector, scenario.target_classes, scenario.detector.confidence_min)
    vehicle = RosPoseVehicle(embedded_vehicle(scenario, seed), link, pose) if pose else None
    return vehicle, eye, finder


def _parameters(link: Link, settings: Settings) -> Settings:
    given = {f.name: link.parameter(f.name, getattr(settings, f.name)) for f in fields(settings)}
    return replace(settings, **given)
