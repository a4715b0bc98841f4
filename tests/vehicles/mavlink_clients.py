"""A vehicle behind its MAVLink face, in virtual time or over UDP, and programs that talk to it."""

from __future__ import annotations

import contextlib
import socket
import time

import numpy as np
from pymavlink.dialects.v20 import development as m

from skysweep.scenarios.model import Scenario
from skysweep.vehicles.embedded.at_home import embedded_vehicle
from skysweep.vehicles.mavlink.modes import TICK_S
from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.mavlink.wire import Voice
from skysweep.vehicles.served.face import Face
from skysweep.vehicles.served.items import Item
from skysweep.vehicles.served.server import LOOPBACK, VehicleServer

CALM = {
    "name": "calm",
    "area": {"polygon_enu_m": [[0, 0], [120, 0], [120, 80], [0, 80]]},
    "wind": {"mean_speed_mps": 0.0, "gust_std_mps": 0.0},
    "vehicle": {"position_noise_m": 0.0, "attitude_noise_deg": 0.0},
    "search": {"scan_altitude_agl_m": 20.0},
}
OFFBOARD, HOLD, MISSION, RETURN, LAND = (6, 0), (4, 3), (4, 4), (4, 5), (4, 6)
POSITION, ALTITUDE, STABILIZED, TERMINATION = (3, 0), (2, 0), (7, 0), (10, 0)
POSITION_ONLY, VELOCITY_ONLY = 0b1101_1111_1000, 0b1101_1100_0111


def scenario(**changes) -> Scenario:
    return Scenario.model_validate(CALM | changes)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]


def wait(condition, seconds: float = 60.0, what: str = "it never came true"):
    """Until ``condition`` gives something true, on the wall clock."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end, what
        time.sleep(0.02)
    return value


@contextlib.contextmanager
def served(of: Scenario | None = None, speed: float = 20.0, ports: int = 1):
    """A server and the URLs at which programs hear it."""
    of = of or scenario()
    chosen = [free_port() for _ in range(ports)]
    with VehicleServer(embedded_vehicle(of, 0), of, [(LOOPBACK, p) for p in chosen], speed) as server:
        yield server, [f"udpin://{LOOPBACK}:{p}" for p in chosen]


class Sky:
    """The face of the vehicle of a scenario; time passes when ``fly`` is called."""

    def __init__(self, of: Scenario | None = None, signing_key: bytes | None = None) -> None:
        self.scenario = of or scenario()
        self.programs: dict = {}
        self.vehicle = embedded_vehicle(self.scenario, 0)
        self.face = Face(self.vehicle, self.scenario, self._deliver, signing=Signing(signing_key))
        self.pilot = self.face.pilot
        self._beat_s = 0.0

    def _deliver(self, datagram, address):
        if address in self.programs:
            self.programs[address].hear(datagram)

    def tick(self) -> None:
        """TICK_S passes; programs that once spoke send their heartbeat every second."""
        if self.pilot.time_s >= self._beat_s:
            self._beat_s = self.pilot.time_s + 1.0
            for program in list(self.programs.values()):
                program.beat()
        self.face.tick()

    def fly(self, seconds: float = 1e9, until=lambda: False) -> float:
        """Lets time pass; returns how much. Fails when ``until`` does not come true within 1000 s."""
        start = self.pilot.time_s
        limit = min(seconds, 1000.0)
        while self.pilot.time_s - start < limit - 1e-6:
            if until():
                return self.pilot.time_s - start
            self.tick()
        assert seconds < 1e9, "it never came true"
        return limit

    def fly_streaming(self, program, message, seconds: float) -> None:
        """Lets time pass while a program sends a setpoint at 10 Hz."""
        for i in range(round(seconds / TICK_S)):
            if i % 5 == 0:
                program.say(message)
            self.tick()

    @property
    def ned(self):
        return self.pilot.site.ned_from_enu(self.vehicle.true_position_enu_m)

    def geodetic(self, ned):
        """Latitude, longitude and altitude of a local NED."""
        return self.pilot.site.geodetic(self.pilot.site.enu_from_ned(np.array(ned)))


class Program:
    """A ground station or companion at an address of its own."""

    def __init__(self, sky: Sky, port: int = 1, system: int = 245, component: int = 190, key=None) -> None:
        self.address = ("10.0.0.1", port)
        self._datagrams: list[bytes] = []
        self._sky, self._decoder = sky, m.MAVLink(None)
        self._voice = Voice(component, Signing(key))
        self._voice._encoder.srcSystem = system
        self.beats = False  # from its first word on; a test makes it silent
        sky.programs[self.address] = self

    def hear(self, datagram: bytes) -> None:
        self._datagrams.append(datagram)

    def forget(self) -> None:
        """What was heard until now."""
        self._datagrams.clear()

    @property
    def heard(self) -> list:
        """Every message since the last ``forget``."""
        return [self._decoder.decode(bytearray(d)) for d in self._datagrams]

    def say(self, message):
        self.beats = True
        self._sky.face.receive(self._voice.pack(message), self.address)

    def beat(self) -> None:
        if self.beats:
            self.say(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))

    def answers(self, message, kind: str) -> list:
        """Says something; the messages of a kind that come back at once."""
        self.forget()
        self.say(message)
        return self.of(kind)

    def of(self, kind: str) -> list:
        number = getattr(m, f"MAVLINK_MSG_ID_{kind}").to_bytes(3, "little")
        wanted = (d for d in self._datagrams if d[7:10] == number)
        return [self._decoder.decode(bytearray(d)) for d in wanted]

    def texts(self) -> str:
        return " ".join(h.text for h in self.of("STATUSTEXT"))

    def command(self, number: int, *params: float, component: int = 1) -> int:
        """The last result of a COMMAND_LONG: PX4's link accepts a mode before its commander looks."""
        params = (*params, *[0.0] * (7 - len(params)))
        acks = self.answers(m.MAVLink_command_long_message(1, component, number, 0, *params), "COMMAND_ACK")
        *accepted, last = acks
        assert {a.command for a in acks} == {number}
        assert [a.result for a in accepted] in ([], [m.MAV_RESULT_ACCEPTED])
        assert not accepted or number == m.MAV_CMD_DO_SET_MODE
        return last.result

    def mode(self, main: int, sub: int) -> int:
        return self.command(m.MAV_CMD_DO_SET_MODE, 1, main, sub)

    def arm(self) -> int:
        return self.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def set(self, name: str, value: float) -> float:
        """What a parameter is after it was written."""
        kind = m.MAV_PARAM_TYPE_REAL32
        (answer,) = self.answers(m.MAVLink_param_set_message(1, 1, name.encode(), value, kind), "PARAM_VALUE")
        return answer.param_value

    def take_off(self, altitude_m: float) -> None:
        """Arms, takes off and waits until it holds there."""
        self.set("MIS_TAKEOFF_ALT", altitude_m)
        assert self.arm() == m.MAV_RESULT_ACCEPTED
        nan = float("nan")
        assert self.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, nan) == m.MAV_RESULT_ACCEPTED
        self._sky.fly(until=lambda: self._sky.pilot.mode.name == "HOLD")

    def upload(self, items: list[Item], kind: int = 0) -> int:
        """The result of sending a mission, a fence or rally points."""
        self.forget()
        self.say(m.MAVLink_mission_count_message(1, 1, len(items), kind))
        while not self.of("MISSION_ACK"):
            asked = self.of("MISSION_REQUEST_INT")[-1]
            i = items[asked.seq]
            place = (i.x, i.y, i.z, kind)
            self.say(
                m.MAVLink_mission_item_int_message(
                    1, 1, asked.seq, i.frame, i.command, 0, i.autocontinue, *i.params, *place
                )
            )
        return self.of("MISSION_ACK")[-1].type

    def download(self, kind: int = 0) -> list[Item]:
        (count,) = self.answers(m.MAVLink_mission_request_list_message(1, 1, kind), "MISSION_COUNT")
        ask = [m.MAVLink_mission_request_int_message(1, 1, seq, kind) for seq in range(count.count)]
        return [Item.of(self.answers(a, "MISSION_ITEM_INT")[0]) for a in ask]


def item(sky: Sky, command: int, east=None, north=0.0, up=0.0, params=(0.0, 0.0, 0.0, float("nan"))) -> Item:
    """A mission item, at a place in ENU where one is given, above home."""
    x = y = 0
    if east is not None:
        latitude, longitude, _ = sky.geodetic([north, east, 0.0])
        x, y = round(latitude * 1e7), round(longitude * 1e7)
    frame = m.MAV_FRAME_MISSION if east is None else m.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
    return Item(frame, command, 1, params, x, y, up)


def local(north, east, down, mask=POSITION_ONLY, velocity=(0.0, 0.0, 0.0), yaw=0.0, rate=0.0, frame=1):
    """SET_POSITION_TARGET_LOCAL_NED."""
    return m.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, mask, north, east, down, *velocity, 0, 0, 0, yaw, rate
    )
