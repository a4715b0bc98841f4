"""Puts a mission together: the only place that picks concrete parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import TYPE_CHECKING

import numpy as np

from skysweep.detection.model_files import existing_model_file
from skysweep.detection.model_trial import try_out
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraMotion, CameraPose
from skysweep.geometry.frames import yaw_from_heading
from skysweep.mission.mission import Mission
from skysweep.mission.witness import Witness
from skysweep.planning.flight_plan import plan_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.exposures import Exposures
from skysweep.sensing.statistical.model import model_for
from skysweep.sensing.statistical.sensor import StatisticalSensor
from skysweep.strategies import strategy_spec
from skysweep.tracking.tracker import GroundTracker
from skysweep.types import Camera, Detector, Sensor, Vehicle
from skysweep.vehicles.embedded.multirotor import Multirotor
from skysweep.worlds.obstacles import Obstacles
from skysweep.worlds.world import World, build_world

if TYPE_CHECKING:
    from skysweep.worlds.rendering.renderer import Backend, Painter

SENSORS = ("imaging", "statistical")


def build_mission(
    scenario: Scenario,
    seed: int,
    sensor_name: str = "imaging",
    renderer: Backend = "auto",
    threads: int = 2,
    vehicle: Vehicle | None = None,
    camera: Camera | None = None,
    detector: Detector | None = None,
) -> Mission:
    """A mission ready to fly, with the embedded vehicle or the one given.

    ``renderer`` is auto, gl, embree, gazebo or gz; ``threads`` is for the detector. Without a ``camera`` the
    pictures are rendered as the vehicle's would be; without a ``detector`` the scenario's looks at them.
    Raises UserError on what the scenario asks for and is not there.
    """
    if sensor_name not in SENSORS:
        raise UserError(f"sensor: there is no sensor '{sensor_name}'; write one of {', '.join(SENSORS)}")
    replays = vehicle is None and camera is None and detector is None
    waits = vehicle is None
    search = scenario.search
    spec = strategy_spec(search.strategy)
    cover_altitude_agl_m = spec.cover_altitude_agl_m(search)
    plan, _ = plan_scenario(scenario, cover_altitude_agl_m)
    world = build_world(scenario, seed)
    if vehicle is None:
        home_xy = np.array(scenario.home.position_enu_m, dtype=float)
        home = np.array([*home_xy, world.terrain.height_m(home_xy)[0]])
        vehicle = Multirotor(
            scenario.vehicle, scenario.wind, scenario.camera, home, world.terrain.height_m, seed
        )
    obstacles = Obstacles(world.terrain, world.trees, world.buildings)
    simulated = getattr(vehicle, "carrier", vehicle)
    witness = None
    if isinstance(simulated, Multirotor) and obstacles.exist:
        witness = Witness(lambda: simulated.true_position_enu_m, obstacles)
    eye = _eye(vehicle)
    camera_model = scenario.camera
    detector_rate_hz = min(scenario.detector.rate_hz, camera_model.rate_hz)
    exposures = Exposures(detector_rate_hz, camera_model.pose_delay_s)
    sensor: Sensor
    if sensor_name == "statistical":
        sensor = StatisticalSensor(
            world,
            camera_model,
            eye.pose,
            eye.motion,
            exposures,
            scenario.target_classes,
            scenario.detector.confidence_min,
            seed,
            model_for(scenario),
        )
    else:
        from skysweep.sensing.camera_watch import CameraWatch
        from skysweep.sensing.imaging import PATIENCE_S, ImagingSensor

        looks_with = detector or make_detector(scenario, threads)
        pictures = camera or _rendered_camera(scenario, world, eye, seed, renderer)
        patience_s = PATIENCE_S if waits else 0.0
        watch = CameraWatch(obstacles)
        sensor = ImagingSensor(pictures, looks_with, exposures, camera_model.latency_s, patience_s, watch)
    look_s = camera_model.latency_s + camera_model.pose_delay_s + 2.0 / detector_rate_hz
    waypoints = plan.waypoints_xy_enu_m
    return Mission(
        scenario,
        seed,
        sensor_name,
        vehicle,
        sensor,
        GroundTracker(world.terrain.height_m, scenario.target_sizes_m),
        spec.make(search, [(float(x), float(y)) for x, y in waypoints], look_s),
        waypoints,
        cover_altitude_agl_m,
        yaw_from_heading(plan.heading_deg),
        world.terrain.height_at_m,
        exposures,
        obstacles,
        witness,
        replays,
    )


@dataclass(frozen=True, slots=True)
class _Eye:
    """Where a simulated camera is and how it moves, now."""

    pose: Callable[[], CameraPose]
    motion: Callable[[], CameraMotion]


def _eye(vehicle: Vehicle) -> _Eye:
    """The truth, where the vehicle is simulated here; else what it believes, its camera held steady."""
    simulated = getattr(vehicle, "carrier", vehicle)
    if isinstance(simulated, Multirotor):
        return _Eye(simulated.true_camera_pose, simulated.true_camera_motion)

    def motion() -> CameraMotion:
        state = vehicle.state()
        return CameraMotion(state.camera.R_camera_to_enu.T @ state.velocity_enu_mps, np.zeros(3))

    return _Eye(lambda: vehicle.state().camera, motion)


def _rendered_camera(scenario: Scenario, world: World, eye: _Eye, seed: int, renderer: Backend) -> Camera:
    """The renderer is imported here, so that missions without pictures stay small."""
    from skysweep.sensing.cameras.rendered import RenderedCamera, TruePose
    from skysweep.worlds.rendering.renderer import refuse_unrenderable

    refuse_unrenderable(scenario.camera)

    def truth() -> TruePose:
        pose, motion = eye.pose(), eye.motion()
        R = pose.R_camera_to_enu
        return TruePose(pose, R @ motion.velocity_mps, R @ motion.rates_radps)

    return RenderedCamera(world, scenario.camera, truth, seed, _painter(scenario, world, renderer))


def _painter(scenario: Scenario, world: World, renderer: Backend) -> Backend | Painter:
    """A simulator draws as often as the detector looks."""
    looks_hz = min(scenario.detector.rate_hz, scenario.camera.rate_hz)
    if renderer == "gazebo":
        from skysweep.gazebo.lockstep import GazeboRenderer

        return GazeboRenderer(world, scenario, looks_hz)
    if renderer == "gz":
        from skysweep.gazebo.gz_sim import GzRenderer

        return GzRenderer(world, scenario, looks_hz)
    return renderer


def refuse_unseeable(scenario: Scenario, sensor_name: str) -> None:
    """Raises UserError where the sensor's or the detector's file is missing or made for something else."""
    if sensor_name == "statistical":
        model_for(scenario)
        return
    model = scenario.detector.model
    registered = {entry.name for entry in entry_points(group="skysweep.detectors")}
    if model not in registered:
        try_out(existing_model_file(model))


def make_detector(scenario: Scenario, threads: int) -> Detector:
    """Ours, an ONNX file, or what a third party registered as ``skysweep.detectors`` under this name.

    A registered detector is a callable that takes the scenario and returns a ``types.Detector``.
    """
    from skysweep.detection.yolo import YoloDetector

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
