"""The takeover matrix on the real PX4: its own simulator, MAVSDK, UDP, a ground station.

    PX4_SITL=PX4-Autopilot/build/px4_sitl_default pytest -m slow tests/vehicles/test_takeovers_px4.py

Each cell has a PX4 of its own that is started for it and flies in real time, about a minute.
"""

from __future__ import annotations

import contextlib
import struct
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from mavlink_clients import CALM
from px4_sitl import needs_px4, start_px4, stop_px4
from pymavlink import mavutil
from relay import Relay
from takeovers import ORDERS, Cell, cells_for_px4, play

from skysweep.scenarios.model import Scenario
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.px4.vehicle import Px4Vehicle

pytestmark = [pytest.mark.slow, needs_px4]
_PROGRAM, _STATION, _OURS = 14540, 18570, 24540  # ports of instance 0
_FIRST = 4  # instance: the ports of the lower ones are for whoever else flies here
_REAL = m.MAV_PARAM_TYPE_REAL32


class RealPx4:
    """A PX4 of its own with a link that can be cut and a ground station. Implements ``takeovers.Range``."""

    def __init__(self, folder: Path, instance: int, on_loss: int) -> None:
        self._folder, self._system = folder, instance + 1
        self._px4 = start_px4(folder, instance)
        self._relay = Relay(_OURS + instance, _PROGRAM + instance)
        self._station = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{_STATION + instance}", source_system=250, dialect="development"
        )
        self._speaking = threading.Lock()
        self._running, self._moving = True, None
        self._flown, self._parameters = ((0, 0), False), {}
        for talk in (self._hear, self._speak):
            threading.Thread(target=talk, daemon=True).start()
        integers = {
            "COM_OBL_RC_ACT": on_loss,
            "COM_RC_IN_MODE": 1,
            "COM_RC_OVERRIDE": 3,
            "COM_LOW_BAT_ACT": 3,
        }
        for name, value in integers.items():
            self._set(name, value)
        self.vehicle = Px4Vehicle(
            f"udpin://127.0.0.1:{_OURS + instance}",
            Scenario.model_validate(CALM),
            lambda xy: np.zeros(len(xy)),
            20.0,
        )

    # ---- what a cell needs ---------------------------------------------------------------------------

    def cut(self, seconds: float) -> None:
        self._relay.open = False
        threading.Timer(seconds, lambda: setattr(self._relay, "open", True)).start()

    def now_s(self) -> float:
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        self.vehicle.advance(seconds)
        time.sleep(max(end_s - time.monotonic(), 0.0))

    def command(self, number: int, *params: float) -> None:
        padded = (*params, *[0.0] * (7 - len(params)))
        with self._speaking:
            self._station.mav.command_long_send(self._system, 1, number, 0, *padded)

    def sticks(self, moving: bool | None) -> None:
        self._moving = moving

    def fail(self, what: str) -> None:
        if what == "geofence":
            self._set("GF_ACTION", 2)
            self._set("GF_MAX_HOR_DIST", 2.0)
            self._set("GF_MAX_VER_DIST", 2.0)
        elif what == "low battery":
            self._set("SIM_BAT_MIN_PCT", 3.0)
            self._set("SIM_BAT_DRAIN", 1.0)
        else:
            self._set("SIM_GPS_USED", 0)

    def flown(self):
        return self._flown

    def orders(self) -> list[int]:
        heard, self._relay.commands = self._relay.commands, []
        return [number for number in heard if number in ORDERS]

    def close(self) -> None:
        self._running = False
        with contextlib.suppress(Exception):
            self.vehicle.authority.keep_out("the cell is over")
            self.vehicle.close()
        self._relay.close()
        stop_px4(self._px4)
        self._station.close()

    # ---- the ground station --------------------------------------------------------------------------

    def _set(self, name: str, value: float) -> None:
        kind = _REAL if isinstance(value, float) else m.MAV_PARAM_TYPE_INT32
        if isinstance(value, int):
            value = struct.unpack("<f", struct.pack("<i", value))[0]
        end_s = time.monotonic() + 10.0
        while self._parameters.get(name) != value:
            assert time.monotonic() < end_s, name
            with self._speaking:
                self._station.mav.param_set_send(self._system, 1, name.encode(), value, kind)
            time.sleep(0.15)

    def _hear(self) -> None:
        while self._running:
            with contextlib.suppress(OSError):
                heard = self._station.recv_match(blocking=True, timeout=0.5)
                if heard is None or (heard.get_srcSystem(), heard.get_srcComponent()) != (self._system, 1):
                    continue
                if heard.get_type() == "HEARTBEAT":
                    mode = heard.custom_mode >> 16 & 255, heard.custom_mode >> 24 & 255
                    self._flown = mode, bool(heard.base_mode & m.MAV_MODE_FLAG_SAFETY_ARMED)
                elif heard.get_type() == "PARAM_VALUE":
                    self._parameters[heard.param_id] = heard.param_value

    def _speak(self) -> None:
        for k in range(10**9):
            if not self._running:
                return
            with self._speaking:
                if k % 20 == 0:
                    self._station.mav.heartbeat_send(6, 8, 0, 0, 0)
                if k % 4 == 0:  # to see a mode change soon
                    self._station.mav.command_long_send(
                        self._system, 1, m.MAV_CMD_REQUEST_MESSAGE, 0, 0, 0, 0, 0, 0, 0, 0
                    )
                if self._moving is not None:
                    forward = 400 if self._moving else 0
                    self._station.mav.manual_control_send(self._system, forward, 0, 500, 0, 0)
            time.sleep(0.05)


@pytest.mark.parametrize("cell", cells_for_px4(), ids=str)
def test_whoever_takes_the_real_px4_keeps_it(cell: Cell, tmp_path, worker_id):
    instance = _FIRST + (int(worker_id.removeprefix("gw")) if worker_id.startswith("gw") else 0)
    there = RealPx4(tmp_path, instance, cell.on_loss)
    try:
        outcome = play(cell, there)
    finally:
        there.close()
    assert outcome.faults(cell) == [], outcome
