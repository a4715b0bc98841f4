"""Fly a mission on a PX4."""

from __future__ import annotations

import shlex
import signal
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from skysweep.cli import completion
from skysweep.cli.answers import JsonOption, answer, figures_table, mark, print_table
from skysweep.cli.common import (
    FromSoundLinesOption,
    SeedOption,
    SensorOption,
    SetOption,
    changes_of,
    errors,
    friendly,
    refuse_unused_eye,
    status,
    warn,
    working,
)
from skysweep.cli.live import (
    LOOPBACK,
    HostOption,
    LiveOption,
    NoBrowserOption,
    PageOrders,
    PortOption,
    TilesOption,
    live_page,
)
from skysweep.cli.missions import StatusLine, answer_mission, answers_complete
from skysweep.cli.terminal import enter_pressed, has_keyboard, unblocked
from skysweep.errors import UserError
from skysweep.files.writing import free_folder
from skysweep.text import printable

if TYPE_CHECKING:
    from skysweep.mission.orders import Order
    from skysweep.types import Mode, VehicleState
    from skysweep.vehicles.px4.preflight import Check

_READ_S = 1.0  # to read that the vehicle was taken over
_HOLDING = ("operator", "taken over")  # causes of a hold that a word ends
_EXCUSED = ("mode", "ready", "battery")  # checks of a vehicle in the air; its reserve is watched in flight
_DETECTOR_THREADS = 2
_ENDING = (signal.SIGTERM, signal.SIGHUP) if hasattr(signal, "SIGHUP") else (signal.SIGTERM,)


@friendly
def fly(
    source: Annotated[
        str,
        typer.Argument(
            help="Scenario (name or YAML), QGroundControl .plan, or run folder to continue.",
            autocompletion=completion.scenarios_and_runs,
        ),
    ],
    connection: Annotated[
        str, typer.Option(help="udpin://0.0.0.0:PORT, tcpout://HOST:PORT or serial:///dev/ttyUSB0:BAUD.")
    ] = "udpin://127.0.0.1:14540",
    signing_key: Annotated[
        Path | None,
        typer.Option(help="File with 64 hexadecimal digits: sign every frame, accept only signed ones."),
    ] = None,
    system_id: Annotated[
        int | None, typer.Option("--system-id", min=1, max=255, help="One of several vehicles on one link.")
    ] = None,
    sensor: SensorOption = "imaging",
    camera: Annotated[
        str,
        typer.Option(
            help="rendered, a video (rtsp://HOST/STREAM, /dev/video0, a file), what Gazebo shows "
            "(gazebo:TOPIC, gz:TOPIC), or a ROS 2 image topic (ros:/TOPIC)."
        ),
    ] = "rendered",
    change: SetOption = None,
    seed: SeedOption = 0,
    yes: Annotated[bool, typer.Option("--yes", help="Arm without asking.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Stop after the preflight list.")] = False,
    timeout: Annotated[float, typer.Option(min=1, help="Seconds to wait for the vehicle.")] = 10.0,
    renderer: Annotated[
        Literal["auto", "gl", "embree"], typer.Option(help="Renderer of the rendered camera.")
    ] = "auto",
    out: Annotated[Path | None, typer.Option(help="Run folder. Default: runs/SCENARIO-...")] = None,
    from_sound_lines: FromSoundLinesOption = False,
    live: LiveOption = False,
    host: HostOption = LOOPBACK,
    port: PortOption = None,
    no_browser: NoBrowserOption = False,
    tiles: TilesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fly a mission on a PX4: a simulated one, or an aircraft.

    Shows the preflight list and asks before arming; reports each find at once. Before take-off, Ctrl-C ends
    it on the ground. In flight, Ctrl-C holds, Enter goes on, and a second Ctrl-C returns home and lands. A
    pilot, a ground station or a failsafe that takes the vehicle over keeps it until Enter is pressed. However
    this program ends, it leaves its vehicle in Hold; if it is killed outright, PX4 does what COM_OBL_RC_ACT
    says. With --live it can be watched and steered in the browser, too. Given the run folder of an
    interrupted flight, it continues from where the vehicle is; only --connection, --system-id, --signing-key,
    --camera and --from-sound-lines count then, and the options of the live page.

    Examples:

        skysweep fly clusters --dry-run

        skysweep fly clusters --sensor statistical --yes

        skysweep fly clusters --live

        skysweep fly runs/clusters-scan-check-seed0

        skysweep fly field.plan --connection serial:///dev/ttyUSB0:57600 --camera rtsp://10.0.0.5/live
    """
    from skysweep.flights.on_px4 import Px4Flight
    from skysweep.flights.outlook import Outlook
    from skysweep.flights.rehearsal import compile_ahead
    from skysweep.flights.resume import begun_scenario
    from skysweep.flights.rig import Rig
    from skysweep.planning.plan_files import scenario_from_plan
    from skysweep.results.run_folder import CONFIG_FILE
    from skysweep.scenarios.files import change_scenario, load_scenario
    from skysweep.vehicles.mavlink.signing import read_signing_key

    begun = Path(source) if (Path(source) / CONFIG_FILE).is_file() else None
    if begun is not None:
        if answers_complete(as_json, begun, from_sound_lines):
            return
        chosen = begun_scenario(begun, from_sound_lines, warn)
    elif from_sound_lines:
        raise UserError(f"--from-sound-lines: {source} is no run folder to go on with; leave it out")
    else:
        is_plan = Path(source).suffix.lower() == ".plan"
        given = scenario_from_plan(source) if is_plan else load_scenario(source)
        chosen = change_scenario(given, changes_of(change))
    refuse_unused_eye(sensor, camera)
    _end_on_signals()
    key = None if signing_key is None else read_signing_key(signing_key)
    name = f"{chosen.name}-{chosen.search.strategy}-seed{seed}"
    folder = begun or out or free_folder(Path("runs"), name)
    if not dry_run:  # before the vehicle's clock counts: one that is gone on with may be in the air
        with working("compiling, which takes a minute after an installation"):
            compile_ahead()
    with ExitStack() as page:
        with unblocked(), Px4Flight(chosen, connection, timeout, key, system_id) as flight:
            checks = flight.preflight(not dry_run, folder)
            if sensor == "imaging" and begun is None:
                checks += (flight.rehearse(camera, renderer, _DETECTOR_THREADS),)
            _print_checks(checks)
            excused = _EXCUSED if begun is not None and flight.vehicle.state().airborne else ()
            told = {"preflight": [asdict(check) for check in checks]}
            failed = [check for check in checks if check.passed is False and check.name not in excused]
            if failed or dry_run:
                answer(as_json, told | {"folder": None, "report": None, "summary": None})
            if failed:
                raise UserError("preflight: " + "; ".join(f"{check.name}: {check.said}" for check in failed))
            if dry_run:
                return
            question = "Arm and take off?" if begun is None else "Go on with the mission?"
            if not yes and not typer.confirm(question, err=True):
                raise typer.Exit(1)
            orders = page.enter_context(live_page(folder, live, host, port, no_browser, tiles))
            with status() as progress, _Operator(folder, orders) as operator:
                task = progress.add_task(chosen.name, doing="arming", total=None)
                line = StatusLine(Outlook(), lambda doing: progress.update(task, doing=doing))

                def watch(state: VehicleState, mode: Mode, new: Any) -> None:
                    operator.look(state, mode)
                    silent = f"   silent for {state.silent_s:.1f} s" if state.silent_s > 1.0 else ""
                    line(state, mode, new, f"   {operator.hint}{silent}")

                rig = Rig(sensor, renderer, _DETECTOR_THREADS, operator=operator, hear=operator.hear)
                rig = replace(line.over(rig), watch=watch)
                if begun is not None:
                    summary = flight.resume(begun, camera, rig, from_sound_lines)
                else:
                    summary = flight.fly(seed, folder, camera, rig)
        answer_mission(as_json, folder, summary, **told)


class _Operator:
    """The person at the keyboard: the first Ctrl-C holds, Enter goes on, the second Ctrl-C returns.

    A third one ends the program, which leaves the vehicle in Hold. Enter also takes the vehicle back after
    somebody else took it over, and says on the ground that its battery was changed. The orders of the page
    come from here, too, and count as those of the keys.
    """

    def __init__(self, folder: Path, page: PageOrders) -> None:
        self._folder, self._page = folder, page
        self._word: str | None = None
        self._presses = 0  # of Ctrl-C, or what other orders and the mission made of them
        self._taken, self._waits = "", False  # by whom; on the ground for a battery
        self._held = False  # because it is ours again without a word
        self._holds = set[str]()  # causes for which the mission holds until a person says continue
        self._shown_s = 0.0  # when one of them changed
        self._before: Any = None

    @property
    def hint(self) -> str:
        """The current meaning of the keys."""
        if self._taken:
            return "somebody else flies it; Enter: take it back"
        if self._waits and self._presses == 0:
            return "change the battery; Enter: take off, Ctrl-C: hold"
        meanings = "Ctrl-C: hold", "Enter: go on, Ctrl-C: return", "returning; Ctrl-C: leave it in Hold"
        return meanings[min(self._presses, 2)]

    def __call__(self) -> Order | None:
        order = self._of_the_keys() or self._page()
        if order is not None:
            self._note(order.word)
        return order

    def _of_the_keys(self) -> Order | None:
        from skysweep.mission.orders import CONTINUE, TAKE_BACK, Order

        asks = self._taken or self._waits or self._held
        if enter_pressed() and (not asks or time.monotonic() - self._shown_s > _READ_S):
            if self._taken:
                self._presses, self._word = 0, TAKE_BACK
            elif self._waits or self._holds or self._presses == 1:
                self._presses, self._word = 0, CONTINUE
        word, self._word = self._word, None
        return None if word is None else Order(word, holder=self._taken if word == TAKE_BACK else None)

    def _note(self, word: str) -> None:
        from skysweep.mission.orders import CONTINUE, HOLD, RETURN, TAKE_BACK

        if word in (HOLD, RETURN):
            self._presses = max(self._presses, 1 if word == HOLD else 2)
        elif word == CONTINUE or (word == TAKE_BACK and self._taken):
            self._presses = 0

    def hear(self, record: Mapping[str, Any]) -> None:
        """Take note of a line of the journal: the mission says when a hold begins and ends."""
        from skysweep.mission.safety import OVER

        if record["kind"] != "safety" or record["cause"] not in _HOLDING:
            return
        cause = record["cause"]
        if record["action"] == "HOLD":
            self._holds.add(cause)
        elif record["action"] != "CONTINUE" or record["sentence"] == OVER[cause]:
            self._holds.discard(cause)
            if self._presses == 1 and not self._holds:
                self._presses = 0

    def look(self, state: VehicleState, mode: Mode) -> None:
        """Take note of a state. Raises UserError if the vehicle waits for a word that cannot be said here."""
        taken, waits, held = state.taken_over, mode == "SWAP", bool(state.waits)
        if (taken, waits, held) != (self._taken, self._waits, self._held):
            self._shown_s = time.monotonic()
        if held and not self._held:
            self._presses = max(self._presses, 1)
        self._taken, self._waits, self._held = taken, waits, held
        is_alone = not (self._page.can_come or has_keyboard())
        if waits and is_alone:
            raise UserError(
                "the vehicle has landed for another battery, and there is no keyboard to say that it was "
                f"changed; when it is:  skysweep fly {shlex.quote(str(self._folder))}"
            )
        if taken and state.airborne and is_alone:
            raise UserError(
                f"somebody else flies the vehicle ({state.taken_over}), and there is no keyboard to take it "
                f"back; when it is free:  skysweep fly {shlex.quote(str(self._folder))}"
            )

    def __enter__(self) -> _Operator:
        self._before = signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGINT, self._before)

    def _interrupt(self, _number: int, _frame: FrameType | None) -> None:
        self._presses += 1
        if self._presses > 2:
            raise KeyboardInterrupt
        self._word = "hold" if self._presses == 1 else "return"


def _end_on_signals() -> None:
    """End cleanly at SIGTERM, and at SIGHUP (a closed terminal) unless started with nohup."""
    for number in _ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)


def _end(number: int, _frame: FrameType | None) -> None:
    """Raise SystemExit: a mission survives an ``Exception``. Later signals must not disturb the Hold."""
    for each in _ENDING:
        signal.signal(each, signal.SIG_IGN)
    raise SystemExit(128 + number)


def _print_checks(checks: tuple[Check, ...]) -> None:
    table = figures_table()
    for check in checks:
        table.add_row(mark(check.passed), check.name, printable(check.said))
    print_table(table, errors)
