"""Missions flown from Python."""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Literal

from skysweep.api import checks, parts
from skysweep.api.progress import Show, progress
from skysweep.api.runs import Run, load_run
from skysweep.api.scenarios import ScenarioLike, change_scenario, load_scenario
from skysweep.errors import UserError
from skysweep.flights.fly import fly_to_folder, fly_unwritten
from skysweep.flights.rig import Rig
from skysweep.mission.mission import Watch
from skysweep.planning.flight_plan import plan_scenario
from skysweep.results.metrics import whole_summary
from skysweep.types import Detections, Mode, VehicleState

if TYPE_CHECKING:
    from skysweep.worlds.rendering.renderer import Backend

_DETECTOR_THREADS = 2


def run(
    scenario: ScenarioLike,
    strategy: parts.StrategyLike | None = None,
    sensor: Literal["imaging", "statistical"] = "imaging",
    seed: int = 0,
    out: str | Path | None = None,
    *,
    detector: parts.DetectorLike | None = None,
    camera: parts.CameraLike | None = None,
    vehicle: parts.VehicleLike | None = None,
    renderer: Backend = "auto",
    watch: Watch | None = None,
    show_progress: bool = True,
) -> Run:
    """Fly one mission. The same arguments give the same mission, bit for bit.

    Args:
        scenario: a name, the path of a file, or a ``Scenario``.
        strategy: replaces the scenario's: a name, "module:Name", or a class or function that makes a
            ``Strategy`` from a ``MissionContext``.
        sensor: "imaging", rendered pictures and a real detector, or "statistical", fast and without pictures.
        seed: seeds everything random.
        out: a new folder for journal, results and report; nothing is written without one.
        detector: replaces the scenario's: a model's path, a ``Detector``, or a function of (scenario).
        camera: replaces the embedded one: a ``Camera``, or a function of (scenario, world, truth).
        vehicle: replaces the embedded one: a ``Vehicle``, or a function of (scenario, seed).
        renderer: "gl", "embree", or "auto", whichever is available.
        watch: called at every tick with the vehicle's state, the mode, and new detections or None.
        show_progress: in a notebook, or on standard error if it is a terminal.

    Raises:
        UserError: an argument is invalid, or the mission cannot be flown.
    """
    seed, folder = checks.whole_seed(seed), checks.folder(out)
    if watch is not None and not callable(watch):
        raise UserError(f"watch: is {watch!r:.60}; give a function of (state, mode, detections)")
    chosen = load_scenario(scenario)
    spec = None
    if strategy is not None:
        name, spec = parts.strategy_of(strategy)
        chosen = change_scenario(chosen, {"search.strategy": name})
    if isinstance(detector, str | Path):
        chosen, detector = change_scenario(chosen, {"detector.model": str(detector)}), None
    if sensor == "statistical" and (camera is not None or detector is not None):
        raise UserError("sensor: the statistical one takes no pictures; leave camera and detector out")
    flying = None if vehicle is None else parts.part_of("vehicle", vehicle, chosen, seed)
    with progress(show_progress) as show:
        rig = Rig(
            sensor,
            renderer,
            _DETECTOR_THREADS,
            flying,
            vehicle_waits=flying is not None and flying.truth is not None,
            make_camera=None if camera is None else parts.camera_maker(camera, chosen),
            detector=None if detector is None else parts.detector_of(detector, chosen),
            strategy=spec,
            watch=_watched(show, plan_scenario(chosen)[1].time_s, watch),
            film=True,
        )
        if folder is not None:
            fly_to_folder(chosen, seed, folder, rig)
            return load_run(folder)
        started = time.perf_counter()
        with TemporaryDirectory(prefix="skysweep-") as pictures:
            told = fly_unwritten(chosen, seed, rig, Path(pictures))
            return Run(told, whole_summary(told, time.perf_counter() - started))


def _watched(show: Show, planned_s: float, own: Watch | None) -> Watch:
    def watch(state: VehicleState, mode: Mode, new: Detections | None) -> None:
        share = min(state.time_s / planned_s, 1.0)
        show(share, f"{mode:8s} t = {state.time_s:.0f} s, {state.position_enu_m[2]:.0f} m up")
        if own is not None:
            own(state, mode, new)

    return watch
