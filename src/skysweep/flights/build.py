"""Assembles a mission: the only place that chooses concrete parts."""

from __future__ import annotations

import math
from importlib.metadata import entry_points
from typing import TYPE_CHECKING

import numpy as np

from skysweep.detection.halving import HalvingDetector, halved_below_m
from skysweep.detection.layouts import Told
from skysweep.detection.model_files import existing_model_file
from skysweep.detection.model_trial import try_out
from skysweep.detection.tiling import takes_any_size
from skysweep.errors import UserError
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import CameraMotion, CameraPose
from skysweep.geometry.frames import yaw_from_heading
from skysweep.mission.mission import Mission
from skysweep.mission.witness import Witness
from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.following import Following
from skysweep.scenarios.model import Scenario
from skysweep.sensing.exposures import Exposures
from skysweep.sensing.statistical.model import model_for
from skysweep.sensing.statistical.sensor import StatisticalSensor
from skysweep.strategies import strategy_spec
from skysweep.strategies.context import MissionContext
from skysweep.tracking.tracker import GroundTracker
from skysweep.types import F64, Camera, Detector, Sensor, Truth, Vehicle
from skysweep.vehicles.embedded.at_home import embedded_vehicle
from skysweep.worlds.obstacles import Obstacles
from skysweep.worlds.world import World, build_terrain, build_world

if TYPE_CHECKING:
    from skysweep.worlds.rendering.renderer import Backend, Painter

SENSORS = ("imaging", "statistical")
DEFAULT_RIG = Rig()


def build_mission(scenario: Scenario, seed: int, rig: Rig = DEFAULT_RIG) -> Mission:
    """A mission ready to fly. Raises UserError if a part that scenario or rig ask for is missing."""
    if rig.sensor not in SENSORS:
        raise UserError(f"sensor: there is no sensor '{rig.sensor}'; write one of {', '.join(SENSORS)}")
    search = scenario.search
    spec = rig.strategy or strategy_spec(search.strategy)
    cover_altitude_agl_m = spec.cover_altitude_of(scenario)
    plan, _ = plan_scenario(scenario, cover_altitude_agl_m)
    world = build_world(scenario, seed)
    vehicle = rig.vehicle or embedded_vehicle(scenario, seed, rig.unit, world.terrain)
    obstacles = Obstacles(world.terrain, world.trees, world.buildings)
    truth = vehicle.truth
    witness = Witness(truth, obstacles) if truth is not None and obstacles.exist else None
    eye: Truth = truth or _Believed(vehicle)
    camera_model = scenario.camera
    detector_rate_hz = min(scenario.detector.rate_hz, camera_model.rate_hz)
    exposures = Exposures(detector_rate_hz, camera_model.pose_delay_s)
    sensor: Sensor
    pictures = None
    if rig.sensor == "statistical":
        sensor = StatisticalSensor(
            world,
            camera_model,
            scenario.detector,
            eye,
            exposures,
            scenario.target_classes,
            seed,
            model_for(scenario),
            rig.unit,
            scenario.smallest_size_m,
        )
    else:
        from skysweep.sensing.camera_watch import CameraWatch
        from skysweep.sensing.imaging import PATIENCE_S, ImagingSensor

        sensor = pictures = ImagingSensor(
            _camera(scenario, world, eye, seed, rig),
            rig.detector or make_detector(scenario, rig.threads),
            exposures,
            camera_model.latency_s,
            PATIENCE_S if rig.vehicle is None or rig.vehicle_waits else 0.0,
            CameraWatch(obstacles, camera_model.kind),
        )
    waypoints, yaw_rad = plan.waypoints_xy_enu_m, yaw_from_heading(plan.heading_deg)
    as_seen = scenario if rig.detector is None else _with_whole_pictures(scenario)
    context = MissionContext.of(as_seen, waypoints, yaw_rad, obstacles, spec.parameters_of(search))
    needs_model = spec.needs_sensor_model or rig.sensor == "statistical"
    caveat = context.sensor_model.beyond_calibration(scenario) if needs_model else ""
    if rig.sensor == "statistical":
        caveat = " ".join(filter(None, [caveat, _stand_ins(world, context)]))
    return Mission(
        scenario,
        seed,
        rig.sensor,
        vehicle,
        sensor,
        GroundTracker(world.terrain.height_m, scenario.target_sizes_m, speed_mps=search.target_speed_mps),
        spec.make(context),
        waypoints,
        cover_altitude_agl_m,
        yaw_rad,
        world.terrain.height_at_m,
        exposures,
        obstacles,
        pictures,
        witness,
        caveat,
        replays=all(p is None for p in (rig.vehicle, rig.camera, rig.make_camera, rig.detector)),
        change_battery=getattr(vehicle, "change_battery", None),
        regain=getattr(vehicle, "regain", None),
        following=Following(plan.transects, plan.profiles, scenario.vehicle.climb_speed_mps),
    )


def _with_whole_pictures(scenario: Scenario) -> Scenario:
    """One whose pictures are not halved: a detector that is given gets them as they are."""
    whole = scenario.detector.model_copy(update={"halve_above_px": math.inf})
    return scenario.model_copy(update={"detector": whole})


def _stand_ins(world: World, context: MissionContext) -> str:
    """A sentence if the sensor model never looked at some of the objects; empty if it did."""
    told = context.sensor_model.stand_ins((o.kind, o.pose) for o in world.objects)
    return told and (
        f"The sensor model was not measured with everything here: {told}; "
        "add what is missing with 'skysweep calibrate --add-to'."
    )


class _Believed:
    """The estimates of a vehicle in place of its unknown truth; its camera is steady."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle

    @property
    def true_position_enu_m(self) -> F64:
        return self._vehicle.state().position_enu_m

    def true_camera_pose(self) -> CameraPose:
        return self._vehicle.state().camera

    def true_camera_motion(self) -> CameraMotion:
        state = self._vehicle.state()
        return CameraMotion(state.camera.R_camera_to_enu.T @ state.velocity_enu_mps, np.zeros(3))


def _camera(scenario: Scenario, world: World, eye: Truth, seed: int, rig: Rig) -> Camera:
    """The rig's camera, or one that renders, imported here so that other missions stay small."""
    if rig.camera is not None:
        return rig.camera
    if rig.make_camera is not None:
        return rig.make_camera(world, eye)
    from skysweep.sensing.cameras.rendered import RenderedCamera
    from skysweep.worlds.rendering.renderer import refuse_unrenderable

    refuse_unrenderable(scenario.camera)
    return RenderedCamera(world, scenario.camera, eye, seed, _painter(scenario, world, rig.renderer))


def _painter(scenario: Scenario, world: World, renderer: Backend) -> Backend | Painter:
    """A simulator renders at the detector's rate, what is visible."""
    if renderer in ("gazebo", "gz") and scenario.camera.kind == "thermal":
        raise UserError(
            f"--renderer {renderer}: draws no thermal pictures; write --renderer auto, or a scenario with "
            "camera.kind: visible"
        )
    looks_hz = min(scenario.detector.rate_hz, scenario.camera.rate_hz)
    if renderer == "gazebo":
        from skysweep.gazebo.lockstep import GazeboRenderer

        return GazeboRenderer(world, scenario, looks_hz)
    if renderer == "gz":
        from skysweep.gazebo.gz_sim import GzRenderer

        return GzRenderer(world, scenario, looks_hz)
    return renderer


def refuse_unseeable(scenario: Scenario, sensor_name: str) -> None:
    """Raises UserError if the sensor's or the detector's file is missing or of another kind.

    So it does if the statistical sensor was not calibrated for the search.
    """
    if sensor_name == "statistical":
        if beyond := model_for(scenario).beyond_calibration(scenario):
            raise UserError(f"search: {beyond[0].lower()}{beyond[1:].rstrip('.')}")
        return
    model = scenario.detector.model
    if model not in entry_points(group="skysweep.detectors").names:
        d = scenario.detector
        try_out(existing_model_file(model), Told(d.boxes, d.pixels, d.channels))


def make_detector(scenario: Scenario, threads: int) -> Detector:
    """The detector of a scenario: ours, an ONNX file, or the entry point ``skysweep.detectors`` of this name.

    The entry point is a callable that takes the scenario and returns a ``types.Detector``.
    """
    from skysweep.detection.yolo import YoloDetector

    d = scenario.detector
    for entry in entry_points(group="skysweep.detectors", name=d.model):
        made: Detector = entry.load()(scenario)
        return made
    found = YoloDetector(
        d.model,
        scenario.target_classes,
        confidence_min=d.confidence_min,
        iou_max=d.iou_max,
        tiles=d.tiles,
        threads=threads,
        boxes=d.boxes,
        pixels=d.pixels,
        channels=d.channels,
    )
    below_m = halved_below_m(scenario.camera, d, scenario.smallest_size_m)
    if not below_m or not takes_any_size(found.network.fixed_hw):
        return found
    return HalvingDetector(found, below_m, build_terrain(scenario).height_at_m)
