"""Fly one mission, or the paper's."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.table import Table

from skysweep.cli import completion
from skysweep.cli.answers import JsonOption, answer, figures_table
from skysweep.cli.common import (
    MOST_SEEDS,
    FromSoundLinesOption,
    ScenarioArg,
    SeedOption,
    SensorOption,
    SetOption,
    WorkersOption,
    bar,
    changes_of,
    duration,
    friendly,
    number_or_inf,
    refuse_unused_eye,
    say,
    status,
    warn,
)
from skysweep.cli.live import (
    LIVE_SPEED,
    LOOPBACK,
    HostOption,
    LiveOption,
    NoBrowserOption,
    PortOption,
    SpeedOption,
    TilesOption,
    live_page,
)
from skysweep.cli.terminal import unblocked
from skysweep.errors import UserError
from skysweep.files.writing import free_folder

if TYPE_CHECKING:
    from skysweep.experiments.matrix import MissionJob
    from skysweep.flights.outlook import Outlook
    from skysweep.flights.rig import Rig
    from skysweep.results.summary import RunSummary, Summary
    from skysweep.types import Mode, VehicleState
    from skysweep.worlds.rendering.renderer import Backend


@friendly
def run(
    scenario: ScenarioArg,
    strategy: Annotated[
        str | None,
        typer.Option(
            help="scan-check, belief, scan-only, low-only, ... or your own: MODULE:NAME.",
            autocompletion=completion.strategies,
        ),
    ] = None,
    n_c: Annotated[
        float | None,
        typer.Option(
            "--n-c", parser=number_or_inf, help="Check after this many candidates; inf = once, at the end."
        ),
    ] = None,
    d_c: Annotated[
        float | None,
        typer.Option("--d-c", parser=number_or_inf, help="Check this far (m) after the last one, or inf."),
    ] = None,
    c_t: Annotated[float | None, typer.Option("--c-t", help="Confidence that confirms.")] = None,
    h_s: Annotated[float | None, typer.Option("--h-s", help="Scan altitude, m above ground.")] = None,
    h_c: Annotated[float | None, typer.Option("--h-c", help="Check altitude, m above ground.")] = None,
    change: SetOption = None,
    seed: SeedOption = 0,
    sensor: SensorOption = "imaging",
    camera: Annotated[
        str,
        typer.Option(help="rendered (ours), gazebo (Classic 11 draws), gz (gz-sim draws), or ros:/TOPIC."),
    ] = "rendered",
    detector: Annotated[
        str,
        typer.Option(
            help="The scenario's, one of ours by name, the path of an ONNX file, or ros:/TOPIC: another "
            "node's detections."
        ),
    ] = "scenario",
    pose: Annotated[
        str, typer.Option(help="The vehicle's own, or ros:/TOPIC: another node's odometry.")
    ] = "vehicle",
    renderer: Annotated[
        Literal["auto", "gl", "embree"], typer.Option(help="OpenGL, ray casting, or whichever is available.")
    ] = "auto",
    out: Annotated[Path | None, typer.Option(help="Run folder. Default: runs/SCENARIO-...")] = None,
    live: LiveOption = False,
    speed: SpeedOption = None,
    host: HostOption = LOOPBACK,
    port: PortOption = None,
    no_browser: NoBrowserOption = False,
    tiles: TilesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fly one mission and write its run folder with report.html.

    With --live it can be watched and steered in the browser while it flies.

    Examples:

        skysweep run clusters

        skysweep run person-wilderness --n-c 3 --d-c 60 --seed 7 --out my-run

        skysweep run my-scenario.yaml --strategy low-only --sensor statistical

        skysweep run clusters --strategy my_module:MyStrategy

        skysweep run clusters --live --speed 5

        skysweep run clusters --camera gazebo

        skysweep run clusters --detector yolo11n.onnx

        skysweep run clusters --detector ros:/my_model/detections
    """
    from skysweep.flights.fly import fly_to_folder, refuse_other_mission
    from skysweep.flights.on_ros import parts_on_topics
    from skysweep.flights.pace import paced
    from skysweep.flights.rig import Rig
    from skysweep.planning.advice import warnings_for
    from skysweep.scenarios.files import change_scenario, load_scenario
    from skysweep.scenarios.model import OWN_DETECTORS
    from skysweep.strategies import strategy_spec

    is_model = detector in OWN_DETECTORS.values() or detector.lower().endswith(".onnx")
    named = {
        "search.strategy": strategy,
        "search.n_c": n_c,
        "search.d_c_m": d_c,
        "search.c_t": c_t,
        "search.scan_altitude_agl_m": h_s,
        "search.check_altitude_agl_m": h_c,
        "detector.model": detector if is_model else None,
    }
    given = {field: value for field, value in named.items() if value is not None}
    chosen = change_scenario(load_scenario(scenario), changes_of(change) | given)
    cover_altitude_agl_m = strategy_spec(chosen.search.strategy).cover_altitude_of(chosen)
    for warning in warnings_for(chosen, cover_altitude_agl_m):
        warn(warning)
    folder = out or free_folder(Path("runs"), f"{chosen.name}-{chosen.search.strategy}-seed{seed}")
    refuse_unused_eye(sensor, camera)
    engines: dict[str, Backend] = {"gazebo": "gazebo", "gz": "gz"}
    engine = engines.get(camera, renderer)
    on_topics = (
        _topic("camera", camera, "rendered", *engines),
        "" if is_model else _topic("detector", detector, "scenario", *OWN_DETECTORS.values(), "FILE.onnx"),
        _topic("pose", pose, "vehicle"),
    )
    refuse_other_mission(folder)
    with live_page(folder, live, host, port, no_browser, tiles) as orders:
        with flying(chosen.name, folder) as watch, parts_on_topics(chosen, seed, sensor, *on_topics) as parts:
            vehicle, eye, finder = parts
            rig = Rig(sensor, engine, vehicle=vehicle, camera=eye, detector=finder, operator=orders)
            rig = watch.over(rig)
            rig = paced(rig, speed or (LIVE_SPEED if live else None))
            summary = fly_to_folder(chosen, seed, folder, rig)
        answer_mission(as_json, folder, summary)


@friendly
def resume(
    run_dir: Annotated[
        Path,
        typer.Argument(help="Run folder of a mission that was broken off.", autocompletion=completion.runs),
    ],
    from_sound_lines: FromSoundLinesOption = False,
    live: LiveOption = False,
    speed: SpeedOption = None,
    host: HostOption = LOOPBACK,
    port: PortOption = None,
    no_browser: NoBrowserOption = False,
    tiles: TilesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Resume a mission that was killed, stopped, or ran out of disk space.

    It ends as if never interrupted: same journal, same results. A complete mission does not change.

    Examples:

        skysweep resume runs/clusters-scan-check-seed0

        skysweep resume my-run --from-sound-lines
    """
    from skysweep.flights.pace import paced
    from skysweep.flights.resume import resume_folder
    from skysweep.flights.rig import Rig

    if answers_complete(as_json, run_dir, from_sound_lines):
        return
    with live_page(run_dir, live, host, port, no_browser, tiles) as orders:
        with flying(run_dir.name, run_dir) as watch:
            rig = paced(watch.over(Rig(operator=orders)), speed or (LIVE_SPEED if live else None))
            summary = resume_folder(run_dir, rig, from_sound_lines)
        answer_mission(as_json, run_dir, summary)


def answers_complete(as_json: bool, folder: Path, from_sound_lines: bool) -> bool:
    """Whether the mission of a run folder is complete; then that is the answer."""
    from skysweep.results.run_folder import summary_of_complete

    summary = summary_of_complete(folder, from_sound_lines)
    if summary is None:
        return False
    record = _record(folder, summary)
    answer(as_json, record, f"complete; nothing to do. Report: {folder / 'report.html'}")
    return True


def _topic(option: str, value: str, *others: str) -> str:
    """The topic of ``ros:TOPIC``; empty for one of ``others``."""
    if value in others:
        return ""
    kind, _, topic = value.partition(":")
    if kind != "ros" or not topic:
        raise UserError(f"--{option} {value}: write {', '.join(others)}, or ros:/TOPIC")
    return topic


class StatusLine:
    """The state of a mission in a line: a ``Watch`` that shows it, with the time left."""

    def __init__(self, outlook: Outlook, show: Callable[[str], None]) -> None:
        self._outlook, self._show = outlook, show
        self._flown_s = 0.0

    def __call__(self, state: VehicleState, mode: Mode, _new: Any, more: str = "") -> None:
        self._outlook.look(state, mode)
        charge, left_s = state.battery_remaining, self._outlook.left_s
        battery = "unknown" if math.isnan(charge) else f"{charge:4.0%}"
        left = "" if left_s is None else f"   about {duration(left_s)} left"
        n = self._outlook.batteries
        sortie = "" if n == 1 else f"sortie {self._outlook.sortie} of {n}   "
        self._show(
            f"{sortie}{mode:8s} t = {state.time_s:6.1f} s   {state.position_enu_m[2]:5.1f} m up   "
            f"battery {battery}{left}{more}"
        )

    def over(self, rig: Rig) -> Rig:
        """A flight that this line shows, that says what happens, and whose pictures are kept."""
        rig = replace(rig, watch=self, say=say, film=True)
        return replace(rig, prepare=self._outlook.prepare, on_results=self.writes)

    def writes(self, done: int, of: int) -> None:
        """Show how much of the results is written: ``Rig.on_results``."""
        now_s = time.monotonic()
        if done == 0:
            self._flown_s = now_s
        left = f"   about {duration((now_s - self._flown_s) * (of - done) / done)} left" if done else ""
        self._show(f"writing the results: {done} of {of} parts{left}" if done < of else "flown")


@contextmanager
def flying(name: str, folder: Path) -> Iterator[StatusLine]:
    """A status line that watches a mission without blocking it; after Ctrl-C it says how to go on."""
    from skysweep.flights.outlook import Outlook
    from skysweep.mission.journal import resume_command
    from skysweep.results.run_folder import JOURNAL_FILE

    with unblocked(), status() as progress:
        task = progress.add_task(name, doing="preparing", total=None)
        try:
            yield StatusLine(Outlook(), lambda doing: progress.update(task, doing=doing))
        except KeyboardInterrupt:
            progress.stop()
            journal = folder / JOURNAL_FILE
            begun = journal.is_file() and journal.stat().st_size > 0
            how = f"go on with:  {resume_command(folder)}" if begun else "nothing was flown"
            say(f"stopped; {how}")
            raise typer.Exit(130) from None


def answer_mission(as_json: bool, folder: Path, summary: RunSummary, **more: Any) -> None:
    """Answer with the figures of a mission and its report. ``more`` is said in JSON alone."""
    record = _record(folder, summary) | more
    answer(as_json, record, _summary_table(summary), f"report: {folder / 'report.html'}")


def _record(folder: Path, summary: Mapping[str, Any] | RunSummary) -> dict[str, Any]:
    return {"folder": str(folder), "report": str(folder / "report.html"), "summary": dict(summary)}


def _summary_table(summary: RunSummary) -> Table:
    """The figures of a mission, without unknown ones."""
    from skysweep.results.reporting.wording import share

    judged = summary["n_targets"] is not None
    confirmed = f"{summary['n_confirmed']} of {summary['n_targets']} targets"
    search = "completed" if summary["completed"] else f"not completed ({summary['end_reason']})"
    rows = [
        ("Search", search if summary["ended"] else "interrupted, or still flying"),
        ("Mission time", _figure(summary["mission_time_s"], "s")),
        ("Planned scan alone", _figure(summary["scan_only_time_s"], "s")),
        ("Confirmed", confirmed if judged else str(summary["n_confirmed"])),
        ("False positives", _figure(summary["false_positives"], "")),
        ("Decided", f"{summary['n_checked']} candidates"),
        ("False scans", _figure(summary["false_scans"], "")),
        ("Left unchecked", str(summary["n_unchecked"] or "")),
        ("Decided by the operator", str(summary["n_by_operator"] or "")),
        ("Area seen", share(summary["area_covered"])),
        ("Sorties", str(summary["sorties"]) if summary["sorties"] > 1 else ""),
        ("Path length", _figure(summary["path_length_m"], "m")),
        ("Energy", _figure(summary["energy_wh"], "Wh", 1)),
        ("Speed", _figure(summary["real_time_factor"], "x real time", 1)),
    ]
    table = figures_table()
    for name, figure in rows:
        if figure:
            table.add_row(name, figure)
    return table


def _figure(value: float | None, unit: str, decimals: int = 0) -> str:
    """A number with its unit, or nothing for None."""
    return "" if value is None else f"{value:.{decimals}f} {unit}".rstrip()


@friendly
def compare_paper_command(
    seeds: Annotated[int, typer.Option(min=1, max=MOST_SEEDS, help="Missions per row.")] = 5,
    sensor: SensorOption = "imaging",
    out: Annotated[
        Path, typer.Option(help="Folder for compare.json, baselines.json, figures, report, runs.")
    ] = Path("paper-run"),
    workers: WorkersOption = None,
    change: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fly the 8 rows of the paper's Tables 1-3, scan-only and belief, and print the paper's numbers beside.

    scan-only flies the same transects and never descends: the difference shows the cost and benefit of closer
    looks. belief is flown where the detector has a sensor model. The report also shows
    missions with pictures that lie in OUT/pictures/SCENARIO.

    The same command continues an interrupted comparison.

    Examples:

        skysweep compare paper --seeds 1

        skysweep compare paper --sensor statistical --seeds 100 --out paper-100

        skysweep compare paper --sensor statistical --seeds 30 --set camera.gimbal.lag_s=0.06 --out lag-60
    """
    from skysweep.experiments.paper.report import write_compare_report
    from skysweep.experiments.paper.run import compare_paper, folder_of, paper_matrices
    from skysweep.experiments.paper.tables import (
        baselines_json,
        choice,
        choice_of,
        compare_json,
        comparison_tables,
    )

    changes = changes_of(change)
    with bar() as progress:
        jobs = [job for matrix in paper_matrices(seeds, sensor, changes) for job in matrix.jobs()]
        task = progress.add_task("missions", total=len(jobs))

        def on_done(job: MissionJob, summary: Summary) -> None:
            progress.advance(task)
            if (folder := folder_of(job, out)) is not None:
                say(
                    f"{job.label} {choice(choice_of(summary))} seed {job.seed}: "
                    f"{summary['mission_time_s']:.0f} s, recall {summary['recall']:.2f}, "
                    f"picture {folder / 'map.png'}"
                )

        summaries = compare_paper(seeds, sensor, out, workers, changes, on_done)
    rows = write_compare_report(out, summaries, filter(None, (folder_of(job, out) for job in jobs)))
    report = out / "report.html"
    record = {"report": str(report), "rows": compare_json(rows), "baselines": baselines_json(rows)}
    answer(as_json, record, *comparison_tables(rows, summaries), f"report: {report}")
