"""Whole missions through MAVLink: our executor and MAVSDK on one side, the embedded vehicle on the other."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from mavlink_clients import served

pytest.importorskip("mavsdk.mavsdk")

from skysweep.errors import UserError
from skysweep.flights.fly import fly_in_memory
from skysweep.flights.on_px4 import Px4Flight
from skysweep.flights.rig import Rig
from skysweep.mission.journal import read_journal
from skysweep.mission.orders import Order
from skysweep.results.run_folder import load_run
from skysweep.scenarios.files import write_scenario
from skysweep.scenarios.model import Scenario
from skysweep.vehicles.mavlink.modes import PX4Mode

SMALL = {
    "name": "small",
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
    "home": {"position_enu_m": [-5, -5]},
    "targets": [
        {"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9},
        {"class": "stop sign", "position_enu_m": [45, 12], "size_m": 0.9},
    ],
    "camera": {"hfov_rad": 1.2},
    "geofence_enu_m": [[-20, -20], [80, -20], [80, 60], [-20, 60]],
}
SPEED = 4.0  # Offboard is lost after a second of the vehicle's time, which a busy machine may need


def small() -> Scenario:
    return Scenario.model_validate(SMALL)


def test_a_mission_through_mavlink_finds_what_the_embedded_one_finds(tmp_path):
    embedded = fly_in_memory(small(), 0)
    with served(small(), SPEED) as (server, (url,)), Px4Flight(small(), url, 30.0) as flight:
        checks = flight.preflight(True, tmp_path / "run")
        assert not [check for check in checks if check.passed is False]
        modes = set()

        def watch(_state, mode, _new):
            modes.add(mode)

        rig = Rig("statistical", threads=1, watch=watch)
        summary = flight.fly(0, tmp_path / "run", "rendered", rig)
        assert not server.face.pilot.armed
        landed = server.face.pilot.state.position_enu_m
    assert summary["end_reason"] == "completed"
    assert modes >= {"TAKEOFF", "SCAN", "CHECK", "RETURN", "LAND"}
    assert summary["n_confirmed"] == embedded["n_confirmed"] == 2
    assert summary["mission_time_s"] == pytest.approx(embedded["mission_time_s"], rel=0.1)
    assert np.hypot(landed[0] + 5.0, landed[1] + 5.0) < 4.0
    run = load_run(tmp_path / "run")
    assert run.scenario.home.latitude_deg == pytest.approx(small().home.latitude_deg, abs=1e-4)


def test_a_hold_while_it_arms_disarms_it(tmp_path):
    with served(small(), SPEED) as (server, (url,)), Px4Flight(small(), url, 30.0) as flight:
        pilot, waiting = server.face.pilot, [Order("hold")]

        def operator():
            return waiting.pop() if waiting and pilot.armed else None

        with pytest.raises(UserError, match="the vehicle is disarmed again"):
            flight.fly(0, tmp_path / "run", "rendered", Rig("statistical", threads=1, operator=operator))
        assert not pilot.armed
    assert [line["word"] for line in read_journal(tmp_path / "run/journal.jsonl") if "word" in line] == [
        "hold"
    ]


@pytest.fixture
def file(tmp_path):
    return write_scenario(small(), tmp_path / "small.yaml")


def fly_command(file, url, *more):
    command = [sys.executable, "-m", "skysweep.cli", "fly", str(file), "--connection", url]
    return [*command, "--sensor", "statistical", *more]


def test_a_dry_run_shows_the_list_and_leaves_the_vehicle_alone(file):
    with served(small()) as (server, (url,)):
        done = subprocess.run(
            fly_command(file, url, "--dry-run"), capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr
        assert not server.face.pilot.armed
        assert server.face.pilot.fence.inside == ()
    for name in ("position", "home", "battery", "fence", "mode"):
        assert name in done.stderr
    assert "Traceback" not in done.stderr


def test_a_folder_that_holds_a_mission_is_left_as_it_is(file, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "journal.jsonl").write_text('{"t": 0.0, "kind": "start"}\n')
    with served(small()) as (server, (url,)):
        done = subprocess.run(
            fly_command(file, url, "--yes", "--out", str(folder)), capture_output=True, text=True, timeout=300
        )
        assert not server.face.pilot.armed
    assert done.returncode == 2, done.stderr
    assert [path.name for path in folder.iterdir()] == ["journal.jsonl"]


def test_nobody_answers_is_one_sentence_and_exit_code_2(file):
    done = subprocess.run(
        fly_command(file, "udpin://127.0.0.1:1", "--timeout", "1"),
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("error: --connection udpin://127.0.0.1:1")


def wait_for(condition, what, seconds=180.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.05)


def test_ctrl_c_holds_and_a_second_one_returns_and_lands(file, tmp_path):
    with served(small(), SPEED) as (server, (url,)):
        out = tmp_path / "run"
        program = subprocess.Popen(
            fly_command(file, url, "--yes", "--out", str(out)),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        pilot = server.face.pilot
        wait_for(lambda: pilot.mode is PX4Mode.OFFBOARD, "never in Offboard")
        program.send_signal(signal.SIGINT)
        wait_for(lambda: np.linalg.norm(pilot.state.velocity_enu_mps) < 0.3, "no hold")
        held_s = pilot.time_s
        wait_for(lambda: pilot.time_s > held_s + 5.0, "no time")
        assert np.linalg.norm(pilot.state.velocity_enu_mps) < 0.3
        program.send_signal(signal.SIGINT)
        _, said = program.communicate(timeout=150)
        assert program.returncode == 0, said
        assert not pilot.armed
    kinds = [json.loads(line)["kind"] for line in (out / "journal.jsonl").read_text().splitlines()]
    assert kinds[-1] == "end"


@pytest.mark.skipif(os.name != "posix", reason="sends signals")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_program_that_is_ended_leaves_the_vehicle_in_hold(file, tmp_path, number):
    slowly = 2.0  # a busy machine must not be late enough for the vehicle's own failsafe
    with served(small(), slowly) as (server, (url,)):
        server.face.parameters.set("COM_OBL_RC_ACT", 5)
        out = tmp_path / "run"
        program = subprocess.Popen(
            fly_command(file, url, "--yes", "--out", str(out)),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),  # under nohup it is ignored
        )
        pilot = server.face.pilot
        wait_for(lambda: pilot.mode is PX4Mode.OFFBOARD, "never in Offboard")
        program.send_signal(number)
        program.wait(60)
        wait_for(lambda: pilot.mode is PX4Mode.HOLD, "no hold")
        assert pilot.armed
        assert pilot.failsafe == (number is signal.SIGKILL)
    assert (out / "journal.jsonl").exists()


@pytest.mark.skipif(os.name != "posix", reason="opens a pseudo-terminal")
def test_a_terminal_that_nobody_reads_does_not_hold_up_the_flight(file, tmp_path):
    ours, terminal = os.openpty()
    with served(small(), SPEED) as (server, (url,)):
        out = tmp_path / "run"
        program = subprocess.Popen(
            fly_command(file, url, "--yes", "--out", str(out)),
            stdin=subprocess.DEVNULL,
            stdout=terminal,
            stderr=terminal,
        )
        try:
            wait_for(lambda: server.face.pilot.armed, "never armed")
            os.set_blocking(terminal, False)
            with contextlib.suppress(BlockingIOError):
                while True:
                    os.write(terminal, b"#" * 64)
            os.set_blocking(terminal, True)
            wait_for((out / "report.html").exists, "no results", 150.0)
            wait_for(lambda: not server.face.pilot.armed, "still armed")
        finally:
            program.kill()
            program.wait()
            os.close(ours)
            os.close(terminal)
