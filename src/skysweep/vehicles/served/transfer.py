"""The mission protocol: upload and download of plans, fences and rally points.

Its timers use the wall clock at any speed of the simulation: they wait for the network, not the vehicle.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import Refused
from skysweep.vehicles.mavlink.wire import Message
from skysweep.vehicles.served.items import MAX_ITEMS, Item, refusal
from skysweep.vehicles.served.link import Sender

_ASK_AGAIN_S = 0.5
_GIVE_UP_S = 5.0
_TURN_S = 1.0  # without an item, then another client may begin


@dataclass(slots=True)
class _Upload:
    sender: Sender
    kind: int
    count: int
    heard_s: float  # when the last requested item came
    asked_s: float = 0.0
    items: list[Item] = field(default_factory=list)


class Transfers:
    """``stored`` holds the items by kind.

    ``take`` is called with each new list, ``may`` before one is sent or stored; both may raise Refused.
    """

    def __init__(self, take: Callable[[int, tuple[Item, ...]], None], may: Callable[[Sender], None]) -> None:
        self.stored: dict[int, tuple[Item, ...]] = {kind: () for kind in MAX_ITEMS}
        self._take, self._may = take, may
        self._upload: _Upload | None = None

    def count(self, message: Message, sender: Sender) -> None:
        """MISSION_COUNT: a client starts an upload."""
        kind = message.mission_type
        if kind not in MAX_ITEMS:
            _answer(sender, kind, m.MAV_MISSION_UNSUPPORTED)
        elif message.count > MAX_ITEMS[kind]:
            _answer(sender, kind, m.MAV_MISSION_NO_SPACE)
        elif self._is_busy_for(sender) or not self._is_allowed(sender):
            _answer(sender, kind, m.MAV_MISSION_DENIED)
        elif message.count == 0:
            self._store(sender, kind, ())
        else:
            before = self._upload
            if before is not None and before.sender.key != sender.key:
                _answer(before.sender, before.kind, m.MAV_MISSION_OPERATION_CANCELLED)
                before = None
            heard_s = time.monotonic() if before is None else before.heard_s
            self._upload = _Upload(sender, kind, message.count, heard_s)
            self._ask()

    def item(self, message: Message, sender: Sender) -> None:
        """MISSION_ITEM_INT (and its older form): takes the requested item and ignores all others."""
        up = self._upload
        if up is None or (up.sender.key, up.kind) != (sender.key, message.mission_type):
            return
        if message.seq != len(up.items):
            return
        up.heard_s = time.monotonic()
        item = Item.of(message)
        bad = refusal(item, up.kind)
        if bad is not None:
            self._upload = None
            _answer(sender, up.kind, bad)
            return
        up.items.append(item)
        if len(up.items) < up.count:
            self._ask()
        else:
            self._upload = None
            self._store(sender, up.kind, tuple(up.items))

    def clear(self, message: Message, sender: Sender) -> None:
        """MISSION_CLEAR_ALL of one kind or of all."""
        if not self._is_allowed(sender):
            _answer(sender, message.mission_type, m.MAV_MISSION_DENIED)
        elif message.mission_type == m.MAV_MISSION_TYPE_ALL:
            for kind in self.stored:
                self._take(kind, ())
                self.stored[kind] = ()
            _answer(sender, message.mission_type, m.MAV_MISSION_ACCEPTED)
        elif message.mission_type in self.stored:
            self._store(sender, message.mission_type, ())
        else:
            _answer(sender, message.mission_type, m.MAV_MISSION_UNSUPPORTED)

    def tick(self) -> None:
        """Repeats an unanswered request; gives up on a client that left."""
        up = self._upload
        if up is None:
            return
        now = time.monotonic()
        if now - up.heard_s > _GIVE_UP_S:
            self._upload = None
            _answer(up.sender, up.kind, m.MAV_MISSION_OPERATION_CANCELLED)
        elif now - up.asked_s > _ASK_AGAIN_S:
            self._ask()

    def _is_busy_for(self, sender: Sender) -> bool:
        """Whether another client is sending and answers."""
        up = self._upload
        return up is not None and up.sender.key != sender.key and time.monotonic() - up.heard_s <= _TURN_S

    def _is_allowed(self, sender: Sender) -> bool:
        try:
            self._may(sender)
        except Refused as why:
            sender.tell(str(why))
            return False
        return True

    def _ask(self) -> None:
        up = self._upload
        assert up is not None
        up.asked_s = time.monotonic()
        s = up.sender
        s.reply(m.MAVLink_mission_request_int_message(s.system, s.component, len(up.items), up.kind))

    def _store(self, sender: Sender, kind: int, items: tuple[Item, ...]) -> None:
        try:
            self._may(sender)
            self._take(kind, items)
        except Refused as why:
            sender.tell(str(why))
            _answer(sender, kind, m.MAV_MISSION_ERROR)
            return
        self.stored[kind] = items
        _answer(sender, kind, m.MAV_MISSION_ACCEPTED)

    def list(self, message: Message, sender: Sender) -> None:
        """MISSION_REQUEST_LIST: answers with the number of items."""
        kind = message.mission_type
        if kind not in self.stored:
            _answer(sender, kind, m.MAV_MISSION_UNSUPPORTED)
            return
        count = len(self.stored[kind])
        sender.reply(m.MAVLink_mission_count_message(sender.system, sender.component, count, kind))

    def request(self, message: Message, sender: Sender) -> None:
        """MISSION_REQUEST_INT (and its older form): answers with one item."""
        kind, seq = message.mission_type, message.seq
        if kind not in self.stored:
            _answer(sender, kind, m.MAV_MISSION_UNSUPPORTED)
        elif seq >= len(self.stored[kind]):
            _answer(sender, kind, m.MAV_MISSION_INVALID_SEQUENCE)
        else:
            sender.reply(self.stored[kind][seq].message(sender.system, sender.component, seq, kind))


def _answer(sender: Sender, kind: int, result: int) -> None:
    sender.reply(m.MAVLink_mission_ack_message(sender.system, sender.component, result, kind))
