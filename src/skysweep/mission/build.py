"""Puts a mission together: the only place that picks concrete parts."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import TYPE_CHECKING

import numpy as np

from skysweep.errors import UserError
from skysweep.geometry.frames import yaw_from_heading
from skysweep.mission.loop import Mission
from skysweep.planning.flight_plan import plan_scenario
from skysweep.scenarios.model import Scenario
from skysweep.scenarios.world import World, build_world
from skysweep.sensing.schedule import Exposures
from skysweep.sensing.statistical import StatisticalSensor
from skysweep.sensing.statistical_model import model_for
from skysweep.strategies import strategy_spec
from skysweep.tracking.tracker import GroundTracker
from skysweep.types import Detector, Sensor
from skysweep.vehicles.multirotor import Multirotor

if TYPE_CHECKING:
    from skysweep.sensing.render import Backend
    from skysweep.sensing.rendered_camera import TruePose

SENSORS = ("imaging", "statistical")


def build_mission(
    scenario: Scenario, seed: int, sensor_name: str = "imaging", renderer: Backend = "auto", threads: int = 2
) -> Mission:
    """A mission with the embedded vehicle, ready to fly.

    ``renderer`` is auto, gl or embree; ``threads`` is for the detector. Raises UserError on what the
    scenario asks for and is not there.
    """
    if sensor_name not in SENSORS:
        raise UserError(f"sensor: there is no sensor '{sensor_name}'; write one of {', '.join(SENSORS)}")
    search = scenario.search
    spec = strategy_spec(search.strategy)
    cover_altitude_agl_m = spec.cover_altitude_agl_m(search)
    plan, _ = plan_scenario(scenario, cover_altitude_agl_m)
    world = build_world(scenario, seed)
    home_xy = np.array(scenario.home.position_enu_m, dtype=float)
    home = np.array([*home_xy, world.terrain.height_m(home_xy)[0]])
    vehicle = Multirotor(scenario.vehicle, scenario.wind, scenario.camera, home, world.terrain.height_m, seed)
    camera = scenario.camera
    detector_rate_hz = min(scenario.detector.rate_hz, camera.rate_hz)
    exposures = Exposures(detector_rate_hz, camera.pose_delay_s)
    sensor: Sensor
    if sensor_name == "statistical":
        sensor = StatisticalSensor(
            world,
            camera,
            vehicle.true_camera_pose,
            vehicle.true_camera_motion,
            exposures,
            scenario.target_classes,
            scenario.detector.confidence_min,
            seed,
            model_for(scenario),
        )
    else:
        sensor = _imaging_sensor(scenario, world, vehicle, exposures, seed, renderer, threads)
    look_s = camera.latency_s + camera.pose_delay_s + 2.0 / detector_rate_hz
    waypoints = plan.waypoints_xy_enu_m
    return Mission(
        scenario,
        seed,
        sensor_name,
        vehicle,
        sensor,
        GroundTracker(world.terrain.height_m),
        spec.make(search, [(float(x), float(y)) for x, y in waypoints], look_s),
        waypoints,
        cover_altitude_agl_m,
        yaw_from_heading(plan.heading_deg),
        world.terrain.height_m,
    )


def _imaging_sensor(
    scenario: Scenario,
    world: World,
    vehicle: Multirotor,
    exposures: Exposures,
    seed: int,
    renderer: Backend,
    threads: int,
) -> Sensor:
    """Renderer and detector are imported here, so that missions without pictures stay small."""
    from skysweep.sensing.imaging import ImagingSensor
    from skysweep.sensing.rendered_camera import RenderedCamera

    detector = _detector(scenario, threads)
    pictures = RenderedCamera(world, scenario.camera, lambda: _true_camera(vehicle), seed, renderer)
    return ImagingSensor(pictures, detector, exposures, scenario.camera.latency_s)


def _detector(scenario: Scenario, threads: int) -> Detector:
    """Ours, an ONNX file, or what a third party registered as ``skysweep.detectors`` under this name.

    A registered detector is a callable that takes the scenario and returns a ``types.Detector``.
    """
    from skysweep.sensing.detector import YoloDetector

    d = scenario.detector
    for entry in entry_points(group="skysweep.detectors"):
        if entry.name == d.model:
            made: Detector = entry.load()(scenario)
            return made
    return YoloDetector(
        d.model,
        scenario.target_classes,
        confidence_min=d.confidence_min,
        iou_max=d.iou_max,
        tiles=d.tiles,
        threads=threads,
    )


def _true_camera(vehicle: Multirotor) -> TruePose:
    """Where the camera really is and how it moves, in ENU."""
    from skysweep.sensing.rendered_camera import TruePose

    pose, motion = vehicle.true_camera_pose(), vehicle.true_camera_motion()
    R = pose.R_camera_to_enu
    return TruePose(pose, R @ motion.velocity_mps, R @ motion.rates_radps)
