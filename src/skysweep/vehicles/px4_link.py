"""The link to a PX4: what it says, telling it something, and believing only what it then does.

MAVSDK carries the bytes (``mavlink_direct``). Its own commands are not used: they wait for an
acknowledgement, by the wall clock, and PX4 acknowledges what it then refuses.
"""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

from skysweep.errors import MissingExtraError, UserError
from skysweep.vehicles.mavlink.dialect import mavlink as m

try:
    from mavsdk.component_type import ComponentType
    from mavsdk.connection_result import ConnectionResult
    from mavsdk.logging import log_subscribe
    from mavsdk.mavsdk import Configuration, Mavsdk
    from mavsdk.plugins.mavlink_direct.mavlink_direct import MavlinkDirect, MavlinkMessage
except ImportError:
    raise MissingExtraError("flying a PX4", "px4") from None

Fields = dict[str, Any]

CONNECT_S = 10.0
ORDER_S = 10.0  # until an order has to show in what the vehicle does
_REPEAT_S = 0.5
_AUTOPILOT = 1  # component id
_OF_ANY_COMPONENT = (
    "GIMBAL_MANAGER_INFORMATION",
    "GIMBAL_MANAGER_STATUS",
    "GIMBAL_DEVICE_ATTITUDE_STATUS",
)
_HEARD = (
    "HEARTBEAT",
    "LOCAL_POSITION_NED",
    "ATTITUDE_QUATERNION",
    "EXTENDED_SYS_STATE",
    "SYS_STATUS",
    "BATTERY_STATUS",
    "GPS_RAW_INT",
    "HOME_POSITION",
    "ESTIMATOR_STATUS",
    "WIND_COV",
    "AUTOPILOT_VERSION",
    "COMMAND_ACK",
    "STATUSTEXT",
    "PARAM_VALUE",
    *_OF_ANY_COMPONENT,
)
_WARNING = 4  # MAV_SEVERITY; smaller is worse
_RESULTS = {1: "not now", 2: "denied", 3: "unsupported", 4: "failed"}  # MAV_RESULT


class Link:
    """Hears one vehicle and speaks to it. Raises UserError where nothing answers at ``url`` in ``timeout_s``.

    ``url``: ``udpin://0.0.0.0:14540``, ``tcpout://HOST:PORT``, ``serial:///dev/ttyUSB0:57600``. Messages are
    dictionaries of their fields, NaN is None.
    """

    def __init__(self, url: str, timeout_s: float = CONNECT_S) -> None:
        self.url = url
        self._news = threading.Condition()
        self._newest: dict[str, Fields] = {}
        self._heard_s: dict[str, float] = {}
        self._listeners: dict[str, list[Callable[[Fields], None]]] = {}
        self._texts: deque[str] = deque(maxlen=5)
        self._results: dict[int, int] = {}
        log_subscribe(lambda *_: True)
        configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        self.own_ids = (int(configuration.system_id), int(configuration.component_id))
        self._mavsdk = Mavsdk(configuration)
        try:
            self._connect(url, timeout_s)
        except BaseException:
            self.close()
            raise

    def _connect(self, url: str, timeout_s: float) -> None:
        opened = self._mavsdk.add_any_connection(url)
        if opened is not ConnectionResult.SUCCESS:
            why = opened.name.lower().replace("_", " ")
            raise UserError(
                f"--connection {url}: cannot be opened ({why}); write udpin://0.0.0.0:14540, "
                "tcpout://HOST:PORT or serial:///dev/ttyUSB0:57600"
            )
        self.system = self._mavsdk.first_autopilot(timeout_s)
        if self.system is None:
            raise UserError(
                f"--connection {url}: no vehicle was heard in {timeout_s:g} s; switch it on, or write the "
                "address that it sends to"
            )
        self.system_id = int(self.system.get_system_id())
        self._direct = MavlinkDirect(self.system)
        for name in _HEARD:
            self._direct.subscribe_message(name, self._hear)
        if not self.wait(lambda: "HEARTBEAT" in self._newest, timeout_s):
            raise UserError(f"--connection {url}: the vehicle sent no heartbeat in {timeout_s:g} s")

    # ---- hearing -------------------------------------------------------------------------------------

    def newest(self, name: str) -> Fields | None:
        """The last message of a kind."""
        return self._newest.get(name)

    def on(self, name: str, listener: Callable[[Fields], None]) -> None:
        """Calls ``listener`` with every message of a kind, in the thread that receives."""
        self._listeners.setdefault(name, []).append(listener)

    def silent_s(self, name: str) -> float:
        """Seconds on the wall since a kind was last heard; inf where it never was."""
        heard = self._heard_s.get(name)
        return float("inf") if heard is None else time.monotonic() - heard

    def wait(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Until ``condition`` is true after some message; False when ``seconds`` on the wall are over."""
        with self._news:
            return self._news.wait_for(condition, seconds)

    def _hear(self, message: MavlinkMessage, _: object) -> None:
        name = message.message_name
        if message.system_id != self.system_id:
            return
        if message.component_id != _AUTOPILOT and name not in _OF_ANY_COMPONENT:
            return
        fields = json.loads(message.fields_json)
        with self._news:
            self._newest[name] = fields
            self._heard_s[name] = time.monotonic()
            if name == "STATUSTEXT" and fields["severity"] <= _WARNING:
                self._texts.append(str(fields["text"]).strip())
            elif name == "COMMAND_ACK":
                self._results[fields["command"]] = fields["result"]
            for listener in self._listeners.get(name, ()):
                listener(fields)
            self._news.notify_all()

    # ---- speaking ------------------------------------------------------------------------------------

    def send(self, name: str, **fields: Any) -> None:
        """Says something to the vehicle, once."""
        everything = {"target_system": self.system_id, "target_component": _AUTOPILOT, **fields}
        self._direct.send_message(
            MavlinkMessage(name, 0, 0, self.system_id, _AUTOPILOT, json.dumps(everything))
        )

    def command(self, number: int, *params: float | None) -> None:
        """A COMMAND_LONG, once. None is NaN: the vehicle's own choice."""
        padded = (*params, *[0.0] * (7 - len(params)))
        self.send(
            "COMMAND_LONG",
            command=number,
            confirmation=0,
            **{f"param{i}": p for i, p in enumerate(padded, 1)},
        )

    def order(
        self,
        what: str,
        number: int,
        params: Iterable[float | None],
        done: Callable[[], bool],
        timeout_s: float = ORDER_S,
    ) -> None:
        """Says a command again and again until ``done``, which looks at what the vehicle reports.

        Raises UserError with the vehicle's own reasons where it does not come to that in ``timeout_s``.
        """
        self._texts.clear()
        self._results.pop(number, None)
        params = tuple(params)
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            self.command(number, *params)
            if self.wait(done, _REPEAT_S):
                return
        reasons = list(dict.fromkeys(self._texts))
        result = self._results.get(number)
        if result is None:
            reasons.append("no answer")
        elif result in _RESULTS:
            reasons.append(_RESULTS[result])
        raise UserError(
            f"the vehicle does not {what} ({timeout_s:g} s): {'; '.join(reasons) or 'acknowledged, not done'}"
        )

    def every(self, name: str, rate_hz: float) -> None:
        """Asks for a message at a rate of vehicle time."""
        number = getattr(m, f"MAVLINK_MSG_ID_{name}")
        self.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz)

    def ask(self, name: str, seconds: float) -> Fields | None:
        """Asks for a message; None where it does not come in ``seconds``."""
        number = getattr(m, f"MAVLINK_MSG_ID_{name}")
        self._newest.pop(name, None)
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and name not in self._newest:
            self.command(m.MAV_CMD_REQUEST_MESSAGE, number)
            self.wait(lambda: name in self._newest, min(_REPEAT_S, seconds))
        return self._newest.get(name)

    def close(self) -> None:
        """Let go of the connection."""
        self._mavsdk.destroy()
