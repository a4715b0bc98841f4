"""All results that are made from a mission's journal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from skysweep.files.writing import whole_files
from skysweep.results.exports import write_exports
from skysweep.results.figures import run_map
from skysweep.results.film import FilmedLooks
from skysweep.results.foxglove import LAYOUT_FILE, layout_json
from skysweep.results.metrics import whole_summary
from skysweep.results.pictures_report import write_pictures_report
from skysweep.results.recording import write_recording
from skysweep.results.run_folder import SUMMARY_FILE, Run
from skysweep.results.run_report import write_run_report
from skysweep.results.summary import RunSummary
from skysweep.results.summary_file import write_summary

_PARTS = 3  # map, recording and report take most of the time, and about the same


def write_results(
    run: Run,
    out: Path,
    wall_time_s: float | None = None,
    on_step: Callable[[int, int], None] = lambda _done, _of: None,
) -> RunSummary:
    """Write summary, map, positions, recording and report of a mission into ``out``, whole or not at all.

    The mission may have been broken off, or still fly: then ``ended`` is false in the summary, which is
    written last and returned without its checksums. ``on_step`` is called with parts done and total. Raises
    CannotWriteError where ``out`` cannot be written to.
    """
    on_step(0, _PARTS)
    summary = whole_summary(run, wall_time_s)
    with whole_files(out) as unfinished:
        run_map(run, unfinished / "map.png")
        on_step(1, _PARTS)
        write_exports(run, unfinished)
        write_recording(run, unfinished / "mission.mcap")
        layout = layout_json(FilmedLooks(run).has_pictures, bool(run.movers))
        (unfinished / LAYOUT_FILE).write_text(layout, encoding="utf-8")
        on_step(2, _PARTS)
        report = write_pictures_report if run.is_photographed else write_run_report
        report(run, summary, unfinished)
        on_step(3, _PARTS)
    with whole_files(out) as unfinished:
        write_summary(unfinished / SUMMARY_FILE, summary, run.seal)
    return summary
