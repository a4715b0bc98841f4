"""Twenty flights in a row on one real PX4 at ten times real time, each killed twice and gone on with.

PX4_SITL=PX4-Autopilot/build/px4_sitl_default pytest -m slow tests/vehicles/test_flights_px4.py -s
"""

from __future__ import annotations

import json
import random
import struct
import subprocess
import sys
import threading
import time

import pytest
from px4_sitl import needs_px4, start_px4, stop_px4
from pymavlink import mavutil

from skysweep.flights.fly import fly_in_memory
from skysweep.scenarios.files import load_scenario
from skysweep.vehicles.mavlink.dialect import mavlink as m

pytestmark = [pytest.mark.slow, needs_px4]
_INSTANCE, _FACTOR = 3, 10
_URL = f"udpin://127.0.0.1:{14540 + _INSTANCE}"
_FLIGHTS = [("clusters", seed) for seed in range(12)] + [("sparse", seed) for seed in range(8)]
_ON_GROUND = m.MAV_LANDED_STATE_ON_GROUND
_LONGEST_S = 400.0  # on the wall


class Onlooker:
    """A ground station that sees the vehicle's clock, when it is armed and when it is in Offboard."""

    def __init__(self) -> None:
        self._link = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{18570 + _INSTANCE}", source_system=250, dialect="development"
        )
        self.boot_s, self.landed_s, self.armed, self.offboard = 0.0, 0.0, False, False
        threading.Thread(target=self._speak, daemon=True).start()
        threading.Thread(target=self._hear, daemon=True).start()
        hold = struct.unpack("<f", struct.pack("<i", 5))[0]
        for _ in range(10):
            self._link.mav.param_set_send(_INSTANCE + 1, 1, b"COM_OBL_RC_ACT", hold, m.MAV_PARAM_TYPE_INT32)
            time.sleep(0.2)

    def _speak(self) -> None:
        while True:
            self._link.mav.heartbeat_send(6, 8, 0, 0, 0)
            self._ask(m.MAVLINK_MSG_ID_HEARTBEAT)
            time.sleep(0.1)

    def _ask(self, number: int) -> None:
        self._link.mav.command_long_send(
            _INSTANCE + 1, 1, m.MAV_CMD_REQUEST_MESSAGE, 0, number, 0, 0, 0, 0, 0, 0
        )

    def _hear(self) -> None:
        while True:
            heard = self._link.recv_match(blocking=True)
            if heard.get_type() == "LOCAL_POSITION_NED":
                self.boot_s = heard.time_boot_ms * 1e-3
            elif heard.get_type() == "HEARTBEAT" and heard.get_srcComponent() == 1:
                self.armed = bool(heard.base_mode & m.MAV_MODE_FLAG_SAFETY_ARMED)
                self.offboard = heard.custom_mode >> 16 & 255 == 6
            elif heard.get_type() == "EXTENDED_SYS_STATE" and heard.landed_state != _ON_GROUND:
                self.landed_s = self.boot_s


@pytest.fixture(scope="module")
def onlooker(tmp_path_factory):
    px4 = start_px4(tmp_path_factory.mktemp("px4"), _INSTANCE, _FACTOR)
    yield Onlooker()
    stop_px4(px4)


def begin(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "skysweep.cli", "fly", *arguments, "--yes", "--connection", _URL],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def wait(condition, what, seconds=_LONGEST_S):
    end_s = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end_s, what
        time.sleep(0.02)


@pytest.mark.parametrize(("name", "seed"), _FLIGHTS)
def test_a_flight_killed_twice_finds_the_same_in_the_sum_of_its_parts(name, seed, onlooker, tmp_path):
    embedded = fly_in_memory(load_scenario(name), seed)
    chance = random.Random(f"{name} {seed}")
    kills_s = [chance.uniform(15.0, 0.45 * embedded["mission_time_s"]) for _ in range(2)]
    folder, parts_s = tmp_path / "run", []
    program = begin(name, "--seed", str(seed), "--sensor", "statistical", "--out", str(folder))
    wait(lambda: onlooker.armed, "never armed")
    for k, kill_s in enumerate((*kills_s, None)):
        if k:
            wait(lambda: not onlooker.offboard, "is still in Offboard")
            program = begin(str(folder))
            wait(lambda: onlooker.offboard, "never in Offboard again")
        begun_s = onlooker.boot_s
        if kill_s is None:
            said, _ = program.communicate(timeout=_LONGEST_S)
            assert program.returncode == 0, said
            break
        wait(lambda begun_s=begun_s, kill_s=kill_s: onlooker.boot_s > begun_s + kill_s, "no time")
        program.kill()
        program.communicate()
        parts_s.append(onlooker.boot_s - begun_s)
    summary = json.loads((folder / "summary.json").read_text())
    lines = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    parts_s.append(onlooker.landed_s - begun_s)
    ratio = summary["total_time_s"] / sum(parts_s)
    parts = " + ".join(f"{part:.1f}" for part in parts_s)
    print(
        f"\n{name} {seed}: {summary['n_confirmed']} of {summary['n_targets']}, "
        f"{summary['false_positives']} false positives, mission {summary['mission_time_s']:.1f} s, embedded "
        f"{embedded['mission_time_s']:.1f} s; in all {summary['total_time_s']:.1f} s, parts {parts} s: "
        f"{ratio - 1:+.1%}"
    )
    assert summary["n_confirmed"] == embedded["n_confirmed"] == summary["n_targets"]
    assert {line["action"] for line in lines if line["kind"] == "safety"} <= {"CONTINUE"}
    assert abs(ratio - 1.0) < 0.03
