"""The speed of this machine. Rates are medians, timed after a warm-up."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from skysweep.detection.model_files import existing_model_file
from skysweep.errors import MissingExtraError, UserError
from skysweep.experiments.workers import Job, run_jobs
from skysweep.flights.build import build_mission
from skysweep.flights.fly import fly_in_memory, fly_unwritten
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.results.video.make import write_video
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.types import Command, Detector, Frame, Observation, Setpoint
from skysweep.vehicles.embedded.multirotor import Multirotor
from skysweep.worlds.world import World, build_world

if TYPE_CHECKING:
    from skysweep.detection.yolo import YoloDetector

SCENARIO = "clusters"
THREADS = 2
_VEHICLE_S = 600.0
_TICK_S = 0.1
_PICTURES = 60
_BENCH_LENS = Lens(640, 360, 1.2)
_NANO_LENS = Lens(416, 416, 1.2)
_NANO_MAX_BYTES = 6_000_000  # it has 0.9 million weights; the next larger YOLOX, of the same input, has 5
_FILMED_S = 150.0
_MISSION_S = 400.0  # what statistical_mission_s is scaled to
_MIX = ("clusters", "abundance", "sparse")
MEASUREMENTS = 8  # that are reported
_WARM_UP, _MEASURED = 12, 108  # missions of the mix


def bench(
    report: Callable[[str], None] = lambda doing: None, yolox_nano: Path | None = None
) -> dict[str, Any]:
    """Measure and return one flat mapping of names to numbers.

    Real-time factors (``_rtf``) are simulated seconds over wall seconds, for whole missions from take-off to
    landing without set-up. ``rendered_mission_rtf`` uses the scenario's detector rate, ``..._every_frame``
    runs the detector on each frame of the 10 Hz camera. ``detector_ms`` is one picture with the scenario's
    model on ``THREADS`` threads, ``render_fps`` counts clean pictures along the flight at scan altitude.

    ``statistical_mission_rtf`` and ``statistical_mission_s`` (seconds for a mission of 400 s) use one core
    and a sensor at 10 Hz. ``belief_mission_rtf`` is that of the belief strategy in a wood, at its detector's
    rate; ``belief_step_ms`` and ``belief_step_worst_ms`` are median and worst of its steps that get a look.
    ``missions_per_minute_2_workers`` counts whole missions, from scenario to summary, of the paper's three
    scenarios at their own detector rate. ``local_parallel_efficiency`` is the rate of two workers over twice
    that of one, ``worker_memory_mb`` the peak memory of a worker.

    ``video_rtf`` is that of making a video as ``skysweep video`` does, set-up included, of the first
    ``_FILMED_S`` seconds of a mission; None without the extra ``video``.

    With ``yolox_nano``, the public ``yolox_nano.onnx``, ``detector_vs_yolox_nano`` is the time of the
    scenario's model on a picture of 640 x 360 over that model's on one of 416 x 416, looked at in turn.

    ``report`` is called with the name of each measurement. Raises UserError when the detector or renderer
    cannot run, or ``yolox_nano`` is another model.
    """
    nano = None if yolox_nano is None else _yolox_nano(yolox_nano)
    scenario = load_scenario(SCENARIO)
    at_10_hz = {"camera.rate_hz": 10.0, "detector.rate_hz": 10.0}
    every_frame = change_scenario(scenario, at_10_hz)
    report("vehicle")
    result: dict[str, Any] = {"scenario": SCENARIO, "cpu_cores": os.cpu_count()}
    result["vehicle_rtf"] = _vehicle_rtf(scenario)
    report("missions with the statistical sensor")
    rtf = statistics.median(_mission_rtf(every_frame, seed, "statistical") for seed in (0, 0, 1, 2, 3))
    result |= {"statistical_mission_rtf": rtf, "statistical_mission_s": _MISSION_S / rtf}
    report("missions with belief")
    result |= _belief()
    report("many missions on two workers, and on one")
    two_per_s, memory_mb = _throughput(2)
    one_per_s, _ = _throughput(1)
    result |= {
        "missions_per_minute_2_workers": 60.0 * two_per_s,
        "local_parallel_efficiency": two_per_s / (2.0 * one_per_s),
        "worker_memory_mb": memory_mb,
    }
    report("renderer and detector")
    result |= _pictures(scenario, nano)
    report("mission with pictures")
    result["rendered_mission_rtf"] = _mission_rtf(scenario, 0, "imaging")
    report("mission with pictures, detector on every frame")
    result["rendered_mission_rtf_every_frame"] = _mission_rtf(every_frame, 0, "imaging")
    report("video of a mission")
    result["video_rtf"] = _video_rtf(scenario)
    return {key: float(f"{v:.4g}") if isinstance(v, float) else v for key, v in result.items()}


def _vehicle_rtf(scenario: Scenario) -> float:
    """The vehicle alone, flying squares, advanced in the mission's ticks."""
    parts = (scenario.vehicle, scenario.wind, scenario.camera)
    vehicle = Multirotor(*parts, (0, 0, 0), lambda _east_m, _north_m: 0.0, 0)
    vehicle.takeoff(30.0)
    vehicle.advance(20.0)
    corners = np.array([[0, 0, 30], [40, 0, 30], [40, 40, 30], [0, 40, 30]], dtype=float)
    ticks = round(_VEHICLE_S / _TICK_S)
    started = time.perf_counter()
    for k in range(ticks):
        vehicle.command(Setpoint(corners[k // 100 % 4], 5.0, 0.0))
        vehicle.advance(_TICK_S)
    return _VEHICLE_S / (time.perf_counter() - started)


def _mission_rtf(scenario: Scenario, seed: int, sensor_name: str) -> float:
    mission = build_mission(scenario, seed, Rig(sensor_name, threads=THREADS))
    journal = MemoryJournal()
    with closing(mission.sensor):
        started = time.perf_counter()
        fly(mission, journal)
        assert journal.lines
        return float(mission.vehicle.state().time_s) / (time.perf_counter() - started)


def _belief() -> dict[str, float]:
    scenario = load_scenario("person-wilderness").with_search(strategy="belief")
    _mission_rtf(scenario, 0, "statistical")
    rtf = statistics.median(_mission_rtf(scenario, seed, "statistical") for seed in (0, 1, 2))
    mission, took_s = build_mission(scenario, 0, Rig("statistical", threads=THREADS)), list[float]()
    step = mission.strategy.step

    def timed(seen: Observation) -> Command:
        started = time.perf_counter()
        command = step(seen)
        if seen.looks:
            took_s.append(time.perf_counter() - started)
        return command

    mission.strategy.step = timed  # type: ignore[assignment, method-assign]
    with closing(mission.sensor):
        fly(mission, MemoryJournal())
    return {
        "belief_mission_rtf": rtf,
        "belief_step_ms": 1e3 * statistics.median(took_s),
        "belief_step_worst_ms": 1e3 * max(took_s),
    }


def _video_rtf(scenario: Scenario) -> float | None:
    with TemporaryDirectory() as folder:
        whole = fly_unwritten(scenario, 0, Rig("statistical", threads=THREADS), Path(folder))
        run = replace(whole, records=tuple(r for r in whole.records if whole.since_start(r) <= _FILMED_S))
        started = time.perf_counter()
        try:
            write_video(run, Path(folder) / "mission.mp4")
        except MissingExtraError:
            return None
        return run.last_s / (time.perf_counter() - started)


def _throughput(workers: int) -> tuple[float, float]:
    """Missions a second once every worker is warm, and the peak memory of the largest worker in MB."""
    jobs = [(_MIX[k % len(_MIX)], k // len(_MIX)) for k in range(_WARM_UP + _MEASURED)]
    started, memory_mb = 0.0, 0.0
    for k, (_, held_mb) in enumerate(run_jobs(_fly_one_of_many, jobs, workers), start=1):
        memory_mb = max(memory_mb, held_mb)
        if k == _WARM_UP:
            started = time.perf_counter()
    return _MEASURED / (time.perf_counter() - started), memory_mb


def _fly_one_of_many(job: tuple[str, int]) -> float:
    """Fly a whole mission and return the peak memory of this process in MB."""
    name, seed = job
    fly_in_memory(load_scenario(name), seed)
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024.0


def _yolox_nano(path: Path) -> YoloDetector:
    from skysweep.detection.yolo import YoloDetector

    another = UserError(
        f"--yolox-nano {path}: is not the public yolox_nano.onnx (YOLOX, 416 x 416, less than "
        f"{_NANO_MAX_BYTES / 1e6:g} MB); give that file, or leave it out"
    )
    if existing_model_file(path).stat().st_size > _NANO_MAX_BYTES:
        raise another
    try:
        nano = YoloDetector(path, threads=THREADS)
    except UserError:
        raise another from None
    height, width = nano.network.fixed_hw
    is_nano = nano.layout.name in ("YOLOX", "YOLOX raw")
    if not is_nano or (width, height) != (_NANO_LENS.width_px, _NANO_LENS.height_px):
        raise another
    return nano


def _pictures(scenario: Scenario, nano: YoloDetector | None) -> dict[str, Any]:
    from skysweep.detection.yolo import YoloDetector
    from skysweep.worlds.rendering.renderer import make_renderer

    world = build_world(scenario, 0)
    renderer = make_renderer(world)
    detector = YoloDetector(scenario.detector.model, scenario.target_classes, threads=THREADS)
    poses = _flight(world, scenario.search.scan_altitude_agl_m)
    images = [renderer.render(_BENCH_LENS, pose) for pose in poses[:5]]
    assert images[0].shape == (_BENCH_LENS.height_px, _BENCH_LENS.width_px, 3)
    frames = [Frame(0.0, images[k % len(images)], poses[0], _BENCH_LENS) for k in range(_PICTURES)]
    render_s = _median_s(lambda pose: renderer.render(_BENCH_LENS, pose), poses)
    measured = {
        "renderer": type(renderer).__name__,
        "render_fps_640x360": 1.0 / render_s,
        "detector_ms_640x360": 1000.0 * _median_s(detector.detect, frames),
    }
    if nano is not None:
        square = Frame(0.0, renderer.render(_NANO_LENS, poses[0]), poses[0], _NANO_LENS)
        measured["detector_vs_yolox_nano"] = _time_ratio(detector, frames, nano, square)
    return measured


def _time_ratio(detector: Detector, frames: Sequence[Frame], other: Detector, frame: Frame) -> float:
    """Median time of a detector on a frame over that of another on its own, looked at in turn."""
    other.detect(frame)
    pairs = [(_median_s(detector.detect, [own]), _median_s(other.detect, [frame])) for own in frames]
    own_s, other_s = np.median(pairs, axis=0).tolist()
    return float(own_s / other_s)


def _median_s(work: Callable[[Job], object], jobs: Sequence[Job]) -> float:
    times_s = []
    for job in jobs:
        started = time.perf_counter()
        work(job)
        times_s.append(time.perf_counter() - started)
    return statistics.median(times_s)


def _flight(world: World, altitude_m: float) -> list[CameraPose]:
    """Nadir views along a diagonal of the world."""
    west, south, east, north = world.terrain.bounds_enu_m
    R = rotation_camera_to_enu(0.3, -np.pi / 2)
    return [
        CameraPose(np.array([west + s * (east - west), south + s * (north - south), altitude_m]), R)
        for s in np.linspace(0.3, 0.7, _PICTURES)
    ]
