"""The link to a PX4: its messages, and orders that count only when the vehicle's state confirms them.

MAVSDK carries the messages (``mavlink_direct``). Its own commands are not used: they wait for an
acknowledgement by the wall clock, and PX4 acknowledges orders that it then refuses.
"""

from __future__ import annotations

import json
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from skysweep.errors import MissingExtraError, UserError
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.px4.serial_ports import serial_ports

try:
    from mavsdk.component_type import ComponentType
    from mavsdk.connection_result import ConnectionResult
    from mavsdk.exceptions import MavsdkError
    from mavsdk.logging import log_subscribe
    from mavsdk.mavsdk import Configuration, Mavsdk
    from mavsdk.plugins.mavlink_direct.mavlink_direct import MavlinkDirect, MavlinkMessage
    from mavsdk.plugins.param.param import Param
    from mavsdk.system import System
except ImportError:
    raise MissingExtraError("flying a PX4", "px4") from None

Fields = dict[str, Any]

CONNECT_S = 10.0
ORDER_S = 10.0  # until the vehicle's state must confirm an order
_REPEAT_S = 0.5
_NEIGHBOURS_S = 1.5  # until every vehicle on the link has sent a heartbeat
_STREAM_S = 0.05  # longest time between setpoints
_AUTOPILOT = 1  # component id
CURRENT_MODE = 436  # message id; not yet in every dialect
_OF_ANY_COMPONENT = ("GIMBAL_MANAGER_INFORMATION", "GIMBAL_MANAGER_STATUS", "GIMBAL_DEVICE_ATTITUDE_STATUS")
HEARD = (
    "HEARTBEAT", "CURRENT_MODE", "LOCAL_POSITION_NED", "ATTITUDE_QUATERNION", "EXTENDED_SYS_STATE",
    "SYS_STATUS", "BATTERY_STATUS", "DISTANCE_SENSOR", "GPS_RAW_INT", "HOME_POSITION", "ESTIMATOR_STATUS",
    "WIND_COV", "AUTOPILOT_VERSION", "COMMAND_ACK", "STATUSTEXT", "PARAM_VALUE", *_OF_ANY_COMPONENT,
)  # fmt: skip
_TEXTS = 20  # of the newest
_TEXT_CHARACTERS = 50  # in one message
_WARNING = 4  # MAV_SEVERITY; smaller is worse
_ACCEPTED = 0  # MAV_RESULT
_RESULTS = {1: "not now", 2: "denied", 3: "unsupported", 4: "failed"}  # MAV_RESULT


class PX4Link:
    """Receives messages of one vehicle and sends to it.

    ``url``: ``udpin://0.0.0.0:14540``, ``tcpout://HOST:PORT``, ``serial:///dev/ttyUSB0:57600``. Messages are
    dictionaries of their fields, NaN is None. ``system_id`` selects one of several vehicles on the link.

    Raises UserError if no vehicle answers in ``timeout_s``, or several do and none is selected.
    """

    def __init__(self, url: str, timeout_s: float = CONNECT_S, system_id: int | None = None) -> None:
        self.url = url
        self._news = threading.Condition()
        self._newest: dict[str, Fields] = {}
        self._heard_s: dict[str, float] = {}
        self._listeners: dict[str, list[Callable[[Fields], None]]] = {}
        self._texts: deque[tuple[float, str]] = deque(maxlen=_TEXTS)
        self._parts: dict[int, str] = {}  # of texts that come in several messages, by their id
        self._results: dict[int, tuple[int, float]] = {}  # of commands, and when they came
        log_subscribe(lambda *_: True)
        configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        self.own_ids = (int(configuration.system_id), int(configuration.component_id))
        self._mavsdk = Mavsdk(configuration)
        try:
            self._connect(url, timeout_s, system_id)
        except BaseException:
            self.close()
            raise

    def _connect(self, url: str, timeout_s: float, system_id: int | None) -> None:
        port = _serial_port(url)
        if port is not None and not port.exists():
            raise UserError(f"--connection {url}: there is no serial port {port}; {_ports()}")
        opened = self._mavsdk.add_any_connection(url)
        if opened is not ConnectionResult.SUCCESS:
            why = opened.name.lower().replace("_", " ")
            raise UserError(
                f"--connection {url}: cannot be opened ({why}); write udpin://0.0.0.0:14540, "
                "tcpout://HOST:PORT or serial:///dev/ttyUSB0:57600"
            )
        self.system = self._find_vehicle(url, timeout_s, system_id)
        self.system_id = int(self.system.get_system_id())
        self._direct = MavlinkDirect(self.system)
        for name in HEARD:
            self._direct.subscribe_message(name, self._hear)
        if not self.wait(lambda: "HEARTBEAT" in self._newest, timeout_s):
            raise UserError(f"--connection {url}: the vehicle sent no heartbeat in {timeout_s:g} s")

    def _find_vehicle(self, url: str, timeout_s: float, system_id: int | None) -> System:
        first = self._mavsdk.first_autopilot(timeout_s)
        if first is None:
            raise UserError(
                f"--connection {url}: no vehicle was heard in {timeout_s:g} s; switch it on, or write the "
                "address that it sends to"
            )
        end_s = self.now_s() + (_NEIGHBOURS_S if system_id is None else timeout_s)
        found: dict[int, System] = {}
        while self.now_s() < end_s and system_id not in found:
            time.sleep(_STREAM_S)
            found = {int(s.get_system_id()): s for s in self._mavsdk.get_systems() if s.has_autopilot()}
        ids = ", ".join(map(str, sorted(found)))
        if system_id is None and len(found) > 1:
            raise UserError(f"--connection {url}: several vehicles answer; choose one: --system-id {ids}")
        if system_id is not None and system_id not in found:
            raise UserError(f"--system-id {system_id}: no such vehicle was heard at {url}; heard: {ids}")
        return first if system_id is None else found[system_id]

    # ---- receiving -----------------------------------------------------------------------------------

    def newest(self, name: str) -> Fields | None:
        """The last message of a kind; None before the first."""
        return self._newest.get(name)

    def on(self, name: str, listener: Callable[[Fields], None]) -> None:
        """Calls ``listener`` with every message of a kind, in the receiving thread."""
        self._listeners.setdefault(name, []).append(listener)

    def now_s(self) -> float:
        """This computer's monotonic clock."""
        return time.monotonic()

    def heard_s(self, name: str) -> float:
        """When a kind was last received, by ``now_s``; -inf if it never was."""
        return self._heard_s.get(name, -math.inf)

    @property
    def is_answered(self) -> bool:
        """Whether the vehicle has answered any command."""
        return "COMMAND_ACK" in self._newest

    def warnings(self, since_s: float) -> tuple[str, ...]:
        """The vehicle's warnings since then by ``now_s``, oldest first, without repetitions."""
        texts = tuple(self._texts)  # the receiving thread may add more meanwhile
        return tuple(dict.fromkeys(text for heard_s, text in texts if heard_s >= since_s))

    def parameter(self, name: str) -> float | None:
        """A parameter of the vehicle; None without an answer to two requests, because radios lose."""
        parameters = Param(self.system)
        for get in (parameters.get_param_float, parameters.get_param_int) * 2:
            with suppress(MavsdkError):
                return float(get(name))
        return None

    def parameters(self, seconds: float) -> dict[str, float]:
        """All parameters of the vehicle by name; none if they do not come in that time."""
        found: dict[str, float] = {}

        def fetch() -> None:
            with suppress(MavsdkError):
                said = Param(self.system).get_all_params()
                found.update({p.name: p.value for p in (*said.int_params, *said.float_params)})

        thread = threading.Thread(target=fetch, name="parameters", daemon=True)
        thread.start()
        thread.join(seconds)
        return dict(sorted(found.items()))

    def wait(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Waits until a message makes ``condition`` true; False after ``seconds`` on the wall."""
        with self._news:
            return self._news.wait_for(condition, seconds)

    def _hear(self, message: MavlinkMessage, _: object) -> None:
        name = message.message_name
        if message.system_id != self.system_id:
            return
        if message.component_id != _AUTOPILOT and name not in _OF_ANY_COMPONENT:
            return
        self._take(name, json.loads(message.fields_json))

    def _take(self, name: str, fields: Fields) -> None:
        with self._news:
            self._newest[name] = fields
            self._heard_s[name] = self.now_s()
            if name == "STATUSTEXT" and fields["severity"] <= _WARNING:
                self._take_text(fields)
            elif name == "COMMAND_ACK":
                self._results[fields["command"]] = fields["result"], self.now_s()
            for listener in self._listeners.get(name, ()):
                listener(fields)
            self._news.notify_all()

    def _take_text(self, fields: Fields) -> None:
        part, number = str(fields["text"]), int(fields.get("id", 0))
        if number:
            first = fields.get("chunk_seq", 0) == 0
            part = self._parts[number] = part if first else self._parts.get(number, "") + part
            if len(self._parts) > _TEXTS:
                del self._parts[next(iter(self._parts))]
            if len(str(fields["text"])) == _TEXT_CHARACTERS:
                return
        if part.strip():
            self._texts.append((self.now_s(), part.strip()))

    # ---- sending -------------------------------------------------------------------------------------

    def send(self, name: str, **fields: Any) -> None:
        """Sends a message to the vehicle, once."""
        text = json.dumps({"target_system": self.system_id, "target_component": _AUTOPILOT, **fields})
        with suppress(MavsdkError):  # like a lost message: the vehicle's state will show it
            self._direct.send_message(MavlinkMessage(name, 0, 0, self.system_id, _AUTOPILOT, text))

    def command(self, number: int, *params: float | None) -> None:
        """Sends a COMMAND_LONG, once. None is NaN: the vehicle's own choice."""
        padded = (*params, *[0.0] * (7 - len(params)))
        fields = {f"param{i}": p for i, p in enumerate(padded, 1)}
        self.send("COMMAND_LONG", command=number, confirmation=0, **fields)

    def order(
        self,
        what: str,
        number: int,
        params: Iterable[float | None],
        done: Callable[[], bool],
        timeout_s: float = ORDER_S,
        given_up: Callable[[], bool] = lambda: False,
        may_repeat: Callable[[float], bool] = lambda _: True,
    ) -> bool:
        """Repeats a command until ``done``, which checks the vehicle's state; False once ``given_up``.

        ``given_up`` is checked before each repetition, so that nobody else's order is overruled, and
        ``may_repeat`` is told when the command was sent last, by ``now_s``: False waits. Raises UserError
        with the vehicle's reasons if it is neither done nor given up in ``timeout_s``.
        """
        params = tuple(params)
        self._results.pop(number, None)
        begun_s = self.now_s()
        end_s, sent_s = begun_s + timeout_s, -math.inf
        while self.now_s() < end_s:
            if given_up():
                return False
            if may_repeat(sent_s):
                self._results.pop(number, None)
                sent_s = self.now_s()
                self.command(number, *params)
            if self.wait(lambda: done() or given_up(), _REPEAT_S):
                return done()
        reasons = list(self.warnings(begun_s))
        result = self._results.get(number)
        if result is None:
            reasons.append("no answer")
        elif result[0] in _RESULTS:
            reasons.append(_RESULTS[result[0]])
        raise UserError(
            f"the vehicle does not {what} ({timeout_s:g} s): {'; '.join(reasons) or 'acknowledged, not done'}"
        )

    def answer_s(self, number: int) -> float:
        """When the vehicle answered the newest command of a kind, by ``now_s``; inf if it did not."""
        return self._results.get(number, (-1, math.inf))[1]

    def accepted_s(self, number: int) -> float:
        """As ``answer_s``; inf also if it was refused."""
        result, said_s = self._results.get(number, (-1, math.inf))
        return said_s if result == _ACCEPTED else math.inf

    def every(self, name: str, rate_hz: float) -> None:
        """Requests a message at a rate in vehicle time."""
        self.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, message_id(name), 1e6 / rate_hz)

    def request(self, name: str) -> None:
        self.command(m.MAV_CMD_REQUEST_MESSAGE, message_id(name))

    def stream(self, say: Callable[[], None]) -> Callable[[], None]:
        """Calls ``say`` from a thread for every new position, at least 20 times a second.

        Returns the function that ends it.
        """
        running = threading.Event()
        running.set()

        def run() -> None:
            last_s = -math.inf

            def has_moved() -> bool:
                return self.heard_s("LOCAL_POSITION_NED") > last_s

            while running.is_set():
                last_s = self.heard_s("LOCAL_POSITION_NED")
                self.wait(has_moved, _STREAM_S)
                say()

        thread = threading.Thread(target=run, name="setpoints", daemon=True)
        thread.start()

        def end() -> None:
            running.clear()
            thread.join()

        return end

    def ask(self, name: str, seconds: float) -> Fields | None:
        """Requests a message until it comes; None after ``seconds``."""
        self._newest.pop(name, None)
        end_s = self.now_s() + seconds
        while self.now_s() < end_s and name not in self._newest:
            self.request(name)
            self.wait(lambda: name in self._newest, min(_REPEAT_S, seconds))
        return self._newest.get(name)

    def close(self) -> None:
        self._mavsdk.destroy()


def message_id(name: str) -> int:
    """The MAVLink number of a message."""
    return CURRENT_MODE if name == "CURRENT_MODE" else int(getattr(m, f"MAVLINK_MSG_ID_{name}"))


def _serial_port(url: str) -> Path | None:
    """The port of ``serial:///dev/ttyUSB0:57600``; None for other connections."""
    kind, _, rest = url.partition("://")
    return Path(rest.rpartition(":")[0] or rest) if kind.startswith("serial") else None


def _ports() -> str:
    there = serial_ports()
    return f"write one of {', '.join(there)}" if there else "plug the radio in (none is there now)"
