"""Our side of a link to the look-alike in virtual time: no sockets, no threads, the same bits every time."""

from __future__ import annotations

import math
import threading
from collections import deque

from mavlink_clients import Sky

from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import TICK_S
from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.mavlink.wire import Voice
from skysweep.vehicles.px4.link import HEARD, PX4Link, message_id

_ADDRESS = ("10.0.0.9", 9)
_OURS = (245, 190)
_STREAM_S = 0.05
_AUTOPILOT = 1
_NUMBERS = {message_id(name) for name in HEARD}


class FaceLink(PX4Link):
    """A ``PX4Link`` to a ``Sky``; ``open`` cuts it both ways. ``orders`` are those that went through."""

    def __init__(self, sky: Sky) -> None:
        self._sky, self.open, self.orders = sky, True, []
        self._streams: list = []
        self._said_s = -math.inf
        self._inbox: list[bytes] = []
        self._decoder = m.MAVLink(None)
        self._voice = Voice(_OURS[1], Signing(None))
        self._voice._encoder.srcSystem = _OURS[0]
        self.others = []  # called at every tick: whoever else there is
        sky.programs[_ADDRESS] = self
        self._newest, self._heard_s, self._listeners = {}, {}, {}
        self._texts, self._results = deque(maxlen=5), {}
        self.own_ids, self.system_id, self.url = _OURS, 1, "virtual"
        self._news = threading.Condition()
        self._beat_s = -math.inf
        assert self.wait(lambda: "HEARTBEAT" in self._newest, 3.0)

    def drop(self) -> None:
        """The program at this end is gone, without a word."""
        self._streams.clear()
        self._listeners.clear()

    def hear(self, datagram: bytes) -> None:
        if self.open:
            self._inbox.append(datagram)

    def now_s(self) -> float:
        return self._sky.pilot.time_s

    def wait(self, condition, seconds: float) -> bool:
        end_s = self.now_s() + seconds
        while not condition():
            if self.now_s() >= end_s - 1e-9:
                return False
            self.tick()
        return True

    def tick(self) -> None:
        """TICK_S passes."""
        for other in self.others:
            other()
        if self.now_s() - self._beat_s >= 1.0:
            self._beat_s = self.now_s()
            self.beat()
        self._sky.face.tick()
        moved = False
        for datagram in self._inbox:
            if datagram[6] != _AUTOPILOT or int.from_bytes(datagram[7:10], "little") not in _NUMBERS:
                continue
            message = self._decoder.decode(bytearray(datagram))
            fields = {k: _plain(v) for k, v in message.to_dict().items()}
            self._take(message.get_type(), fields)
            moved |= message.get_type() == "LOCAL_POSITION_NED"
        self._inbox.clear()
        if moved or self.now_s() - self._said_s >= _STREAM_S - 0.5 * TICK_S:
            self._said_s = self.now_s()
            for say in self._streams:
                say()

    def beat(self) -> None:
        self._say(m.MAVLink_heartbeat_message(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))

    def _say(self, message) -> None:
        if self.open:
            self._sky.face.receive(self._voice.pack(message), _ADDRESS)

    def send(self, name: str, **fields) -> None:
        if name == "COMMAND_LONG" and self.open:
            self.orders.append(int(fields["command"]))
        everything = {"target_system": 1, "target_component": 1, **fields}
        made = {k: math.nan if v is None else v for k, v in everything.items()}
        self._say(getattr(m, f"MAVLink_{name.lower()}_message")(**made))

    def parameter(self, name: str) -> float | None:
        try:
            return float(self._sky.face.parameters[name])
        except KeyError:
            return None

    def stream(self, say):
        self._streams.append(say)
        return lambda: self._streams.clear()

    def close(self) -> None:
        self._sky.programs.pop(_ADDRESS, None)


def _plain(value):
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return list(value) if isinstance(value, list | tuple) else value
