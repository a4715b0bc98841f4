"""One mission into one run folder."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skysweep.errors import UserError
from skysweep.mission.build import build_mission
from skysweep.mission.journal import FileJournal, MemoryJournal
from skysweep.mission.loop import fly
from skysweep.planning.flight_plan import plan_scenario
from skysweep.results.metrics import compute_summary
from skysweep.results.run_folder import CONFIG_FILE, JOURNAL_FILE, Run, load_run
from skysweep.scenarios.files import write_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.imaging import ImagingSensor
from skysweep.types import Detections, VehicleState

if TYPE_CHECKING:
    from skysweep.sensing.render import Backend

Watch = Callable[[VehicleState, str, Detections | None], None]


def fly_to_folder(
    scenario: Scenario,
    seed: int,
    out: Path,
    sensor_name: str = "imaging",
    renderer: Backend = "auto",
    threads: int = 2,
    watch: Watch | None = None,
) -> dict[str, Any]:
    """Fly one mission, write its run folder and return its summary.

    Raises UserError when ``out`` already holds a mission: nothing is ever overwritten.
    """
    from skysweep.experiments.pictures import PictureBook
    from skysweep.results.writing import write_results

    journal_path = out / JOURNAL_FILE
    if journal_path.exists():
        raise UserError(f"{out}: holds a mission already; write another --out")
    mission = build_mission(scenario, seed, sensor_name, renderer, threads)
    out.mkdir(parents=True, exist_ok=True)
    write_scenario(scenario, out / CONFIG_FILE)
    watchers = [watch] if watch else []
    if isinstance(mission.sensor, ImagingSensor):
        watchers.append(PictureBook(out / "pictures", mission.sensor).watch)

    def watch_all(state: VehicleState, mode: str, new: Detections | None) -> None:
        for watcher in watchers:
            watcher(state, mode, new)

    started = time.perf_counter()
    with closing(FileJournal(journal_path)) as journal, closing(mission.sensor):
        fly(mission, journal, watch_all)
    return write_results(load_run(out), time.perf_counter() - started)


def fly_in_memory(scenario: Scenario, seed: int, sensor_name: str = "statistical") -> dict[str, Any]:
    """Fly one mission and return its summary; nothing is written."""
    started = time.perf_counter()
    mission = build_mission(scenario, seed, sensor_name, threads=1)
    journal = MemoryJournal()
    with closing(mission.sensor):
        fly(mission, journal)
    run = Run(scenario, tuple(journal.lines))
    return compute_summary(
        run,
        scan_only_time_s=plan_scenario(scenario)[1].search_time_s,
        wall_time_s=time.perf_counter() - started,
    )
