"""The vehicle as MAVLink shows it: datagrams in and out, time in ticks; no sockets, no clock."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable

from skysweep.scenarios.model import Scenario
from skysweep.types import Vehicle
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import AUTOPILOT, CAMERA, SYSTEM_ID, TICK_S, PX4Mode, Refused, Site
from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.mavlink.wire import Message, read_frames
from skysweep.vehicles.served.authority import Authority
from skysweep.vehicles.served.autopilot import Autopilot
from skysweep.vehicles.served.commands import Commands
from skysweep.vehicles.served.items import FENCE, MISSION, RALLY, Item, fence_of
from skysweep.vehicles.served.link import CRITICAL, Address, Peer, Sender, status_texts
from skysweep.vehicles.served.offboard import setpoint_of
from skysweep.vehicles.served.parameters import Parameters
from skysweep.vehicles.served.payload import Payload
from skysweep.vehicles.served.peers import Peers
from skysweep.vehicles.served.telemetry import Moment, Streams, reports
from skysweep.vehicles.served.transfer import Transfers

log = logging.getLogger(__name__)
_SILENT_S = 5.0  # on the wall, of a program; heartbeats come every second
_FOR_CAMERA = ("COMMAND_LONG", "COMMAND_INT")
_REFUSAL_EVERY_S = 1.0  # of setpoints, which come many times a second
_REFUSALS_REMEMBERED = 64


class Face:
    """Makes ``vehicle`` look like a PX4.

    ``transmit(datagram, address)`` sends. ``listeners`` always hear it, others while they speak (``Peers``).
    ``unix_start_s`` is its clock at the start, ``speed`` its time over that of programs. ``faulty`` are the
    kinds of messages that it could not handle because of a mistake of ours.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        scenario: Scenario,
        transmit: Callable[[bytes, Address], None],
        listeners: Iterable[Address] = (),
        signing: Signing | None = None,
        unix_start_s: float = 0.0,
        speed: float = 1.0,
        system_id: int = SYSTEM_ID,
    ) -> None:
        self._system_id = system_id
        self.signing = signing or Signing(None)
        self.payload = Payload(scenario.camera, getattr(vehicle, "look", None), system_id)
        self.parameters = Parameters(scenario.vehicle, system_id)
        site = Site(scenario.frame, vehicle.state().position_enu_m)
        self.pilot = Autopilot(vehicle, site, self.parameters, self.say)
        silent_s = _SILENT_S * max(speed, 1.0)
        self.authority = Authority(self.pilot, silent_s)
        self.transfers = Transfers(self._take_items, lambda sender: self.authority.may_plan(sender.key))
        self._unix_start_s = unix_start_s
        self._reports = reports(self.payload)
        self._commands = Commands(self.pilot, self.authority, self.payload, self)
        self.peers = Peers(
            listeners,
            lambda address: Peer(address, transmit, self.signing, system_id),
            self._reports,
            silent_s,
        )
        self.faulty: set[str] = set()
        self._refused: dict[tuple[Address, int, int], float] = {}
        self._camera_next_s = 0.0
        self._energy_wh, self._power_w, self._power_next_s = 0.0, 0.0, 1.0
        self._handle: dict[str, Callable[[Message, Sender], None]] = {
            "COMMAND_LONG": self._commands.receive,
            "COMMAND_INT": self._commands.receive,
            "SET_MODE": self._set_mode,
            "SET_POSITION_TARGET_LOCAL_NED": self._follow,
            "SET_POSITION_TARGET_GLOBAL_INT": self._follow,
            "MANUAL_CONTROL": self._hear_sticks,
            "PARAM_REQUEST_LIST": self._list_parameters,
            "PARAM_REQUEST_READ": lambda message, sender: _reply(sender, self.parameters.read(message)),
            "PARAM_SET": self._write_parameter,
            "MISSION_COUNT": self.transfers.count,
            "MISSION_ITEM": self.transfers.item,
            "MISSION_ITEM_INT": self.transfers.item,
            "MISSION_CLEAR_ALL": self.transfers.clear,
            "MISSION_REQUEST_LIST": self.transfers.list,
            "MISSION_REQUEST_INT": self.transfers.request,
            "MISSION_REQUEST": self.transfers.request,
            "MISSION_SET_CURRENT": self._set_current,
            "TIMESYNC": self._timesync,
            "PING": self._ping,
        }

    # ---- in ------------------------------------------------------------------------------------------

    def receive(self, datagram: bytes, address: Address) -> None:
        """Acts on every valid and authentic frame for this vehicle."""
        for message in read_frames(datagram, self.signing):
            system, component = message.get_srcSystem(), message.get_srcComponent()
            if system == self._system_id and component in (AUTOPILOT, CAMERA):
                continue
            sender = Sender(self.peers.hear(address, self.pilot.time_s), system, component)
            self.authority.hear(sender.key)
            if getattr(message, "target_system", 0) not in (0, self._system_id):
                continue
            to = getattr(message, "target_component", 0)
            if to not in (0, AUTOPILOT) and not (to == CAMERA and message.get_type() in _FOR_CAMERA):
                continue
            handle = self._handle.get(message.get_type())
            if handle is not None:
                try:
                    handle(message, sender)
                except Refused as why:
                    sender.tell(str(why))
                except Exception:  # a mistake of ours: a flight must not end with one datagram
                    self._admit(message.get_type())

    def _admit(self, kind: str) -> None:
        """Reports a mistake of ours, once for each kind of message."""
        if kind not in self.faulty:
            self.faulty.add(kind)
            log.exception("%s was not handled: a mistake in skysweep, please report it", kind)
            self.say(f"internal error: {kind} was not handled", CRITICAL)

    def _set_mode(self, message: Message, sender: Sender) -> None:
        if message.base_mode & m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            self._commands.set_mode(message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24, sender)

    def _follow(self, message: Message, sender: Sender) -> None:
        pilot = self.pilot
        idle = PX4Mode.OFFBOARD not in (pilot.mode, pilot.intended)
        if idle and pilot.offboard.owner != sender.key and self.authority.commands(sender.key):
            pilot.offboard.owner = None
        try:
            pilot.offboard.follow(sender.key, setpoint_of(message, pilot), pilot)
        except Refused as why:
            if pilot.time_s >= self._refused.get(sender.key, 0.0):
                if len(self._refused) >= _REFUSALS_REMEMBERED:
                    self._refused.clear()
                self._refused[sender.key] = pilot.time_s + _REFUSAL_EVERY_S
                sender.tell(str(why))

    def _hear_sticks(self, message: Message, sender: Sender) -> None:
        if message.target in (0, self._system_id):
            in_mode = int(self.parameters["COM_RC_IN_MODE"])
            self.pilot.sticks.hear(message, sender.key, in_mode, self.pilot.time_s)

    def _list_parameters(self, _: Message, sender: Sender) -> None:
        listener = self.peers.get(sender.peer.address)
        if listener is not None:
            listener.parameters = self.parameters.list()

    def _write_parameter(self, message: Message, sender: Sender) -> None:
        try:
            self.authority.must_command(sender.key)
            self.parameters.write(message)
        finally:  # the current value, whether the write was taken or not
            _reply(sender, self.parameters.answer(message.param_id))

    def _set_current(self, message: Message, sender: Sender) -> None:
        self.authority.must_command(sender.key)
        if not self.set_mission_item(message.seq):
            sender.tell("no such mission item")

    def _timesync(self, message: Message, sender: Sender) -> None:
        if message.tc1 == 0:
            now_ns = round(self.pilot.time_s * 1e9)
            sender.reply(m.MAVLink_timesync_message(now_ns, message.ts1))

    def _ping(self, message: Message, sender: Sender) -> None:
        if message.target_system == 0:
            to = sender.system, sender.component
            sender.reply(m.MAVLink_ping_message(message.time_usec, message.seq, *to))

    # ---- commands.Answering --------------------------------------------------------------------------

    def set_mission_item(self, index: int) -> bool:
        if not 0 <= index < len(self.pilot.mission.items):
            return False
        self.pilot.mission.go_to(index)
        for listener in self.peers.listening(self.pilot.time_s):
            listener.streams.now(m.MAVLINK_MSG_ID_MISSION_CURRENT)
        return True

    def send_once(self, kind: int, sender: Sender) -> bool:
        report = self._reports.get(kind)
        if report is None or (message := report.make(self._picture())) is None:
            return False
        sender.reply(message, report.component)
        return True

    def streams_of(self, sender: Sender) -> Streams | None:
        listener = self.peers.get(sender.peer.address)
        return None if listener is None else listener.streams

    def say(self, text: str, severity: int) -> None:
        for listener in self.peers.listening(self.pilot.time_s):
            for message in status_texts(text, severity):
                listener.peer.send(message)

    # ---- time ----------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Lets TICK_S of vehicle time pass and sends the due messages."""
        self.pilot.advance(TICK_S)
        self.authority.tick()
        self.transfers.tick()
        self._measure_power()
        picture = self._picture()
        camera_speaks = self.pilot.time_s >= self._camera_next_s
        if camera_speaks:
            self._camera_next_s += 1.0
        reached, self.pilot.mission.reached = self.pilot.mission.reached, []
        for listener in self.peers.listening(self.pilot.time_s):
            peer, streams = listener.peer, listener.streams
            streams.send_due(peer, picture)
            if camera_speaks:
                peer.send(self.payload.camera_heartbeat(), CAMERA)
            for index in reached:
                peer.send(m.MAVLink_mission_item_reached_message(index))
                streams.now(m.MAVLINK_MSG_ID_MISSION_CURRENT)
            for message in next(listener.parameters, ()):
                peer.send(message)

    def _picture(self) -> Moment:
        return Moment(self.pilot, self._power_w, self._unix_start_s)

    def _measure_power(self) -> None:
        if self.pilot.time_s >= self._power_next_s:
            used = self.pilot.state.energy_used_wh
            self._power_w, self._energy_wh = (used - self._energy_wh) * 3600.0, used
            self._power_next_s += 1.0

    def _take_items(self, kind: int, items: tuple[Item, ...]) -> None:
        """Takes a mission, fence or list of rally points.

        Raises Refused for an invalid fence, and for a mission that may not replace the one being flown.
        """
        pilot, site = self.pilot, self.pilot.site
        if kind == MISSION:
            if items and pilot.armed and PX4Mode.MISSION in (pilot.mode, pilot.intended):
                why = pilot.mission.why_not(pilot, items)
                if why is not None:
                    raise Refused(f"Mission denied: {why}")
            pilot.mission.load(items)
        elif kind == FENCE:
            pilot.fence = fence_of(items, site)
        elif kind == RALLY:
            pilot.rally_enu_m = tuple(item.position_enu_m(site, pilot.home_enu_m) for item in items)


def _reply(sender: Sender, message: Message | None) -> None:
    if message is not None:
        sender.reply(message)
