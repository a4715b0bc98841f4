"""Everything that a finished mission leaves in its folder."""

from __future__ import annotations

import json
from pathlib import Path

from skysweep.planning.flight_plan import plan_scenario
from skysweep.results.exports import write_exports
from skysweep.results.figures import run_map
from skysweep.results.metrics import Summary, compute_summary
from skysweep.results.recording import write_recording
from skysweep.results.run_folder import Run
from skysweep.results.run_report import write_run_report


def write_results(run: Run, wall_time_s: float | None = None) -> Summary:
    """Write summary, map, found positions, recording and report into the run's folder.

    Returns:
        What ``summary.json`` holds. It is written last: a folder that has it is complete.
    """
    assert run.folder is not None, "a run from memory has no folder"
    folder: Path = run.folder
    summary = compute_summary(
        run, scan_only_time_s=plan_scenario(run.scenario)[1].search_time_s, wall_time_s=wall_time_s
    )
    run_map(run, folder / "map.png")
    write_exports(run, folder)
    write_recording(run, folder / "mission.mcap")
    write_run_report(run, summary, folder)
    (folder / "summary.json").write_text(
        json.dumps(summary, indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )
    return summary
