"""A ROS 2 node in this process: publishers and subscriptions."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from skysweep.errors import UserError
from skysweep.ros.interfaces import from_cdr, to_cdr
from skysweep.ros.support import load_rclpy, message_class, quiet_borrowing
from skysweep.ros.topics import NAMESPACE, Quality, Topic

_KEPT = 32  # undecoded messages of a topic
_POLL_S = 0.05


@dataclass(frozen=True, slots=True)
class Arrival:
    """One received message, decoded by ``message``."""

    number: int  # counts up
    arrived_s: float  # time.monotonic()
    type_name: str
    data: bytes

    @property
    def message(self) -> Any:
        return from_cdr(self.data, self.type_name)


class RosLink:
    """One node that spins in its own thread until ``close``.

    ``arguments`` are ROS arguments (``--ros-args ...``): remappings, parameters, log levels. Raises UserError
    if ROS 2 is not installed or the arguments are wrong.
    """

    def __init__(self, name: str, arguments: Sequence[str] = ()) -> None:
        rclpy = load_rclpy()
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        self._context = rclpy.Context()
        try:
            rclpy.init(
                args=list(arguments), context=self._context, signal_handler_options=SignalHandlerOptions.NO
            )
        except Exception as error:
            raise UserError(f"--ros-args: {str(error).splitlines()[0]}; see 'ros2 run --help'") from None
        self.node = rclpy.create_node(name, namespace=NAMESPACE, context=self._context)
        self._publishers: dict[str, Any] = {}
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name="ros", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException

        with suppress(ExternalShutdownException):
            self._executor.spin()

    def close(self) -> None:
        """Leave ROS; messages published before are delivered."""
        if not self._context.ok():
            return
        self._executor.shutdown()
        self._thread.join(5.0)
        self.node.destroy_node()
        self._context.try_shutdown()

    def advertise(self, *topics: Topic) -> None:
        """Create the publishers of topics before their first message."""
        for topic in topics:
            if topic.name not in self._publishers:
                with quiet_borrowing():
                    self._publishers[topic.name] = self.node.create_publisher(
                        message_class(topic.type_name), topic.name, _profile(topic.quality)
                    )

    def publish(self, topic: Topic, message: Any) -> None:
        """Publish a message of ``interfaces.make``."""
        self.advertise(topic)
        self._publishers[topic.name].publish(to_cdr(message))

    def listeners(self, topic: Topic) -> int:
        return int(self._publishers[topic.name].get_subscription_count())

    def wait_for_listener(self, topic: Topic, patience_s: float) -> bool:
        return _until(lambda: self.listeners(topic) > 0, patience_s)

    def listen(self, name: str, type_names: Sequence[str], patience_s: float) -> Inlet:
        """Subscribe to a topic with its publisher's type and quality of service.

        Raises UserError if nobody publishes it within ``patience_s``, or with another type.
        """
        full_name = self.node.resolve_topic_name(name)
        if not _until(lambda: self.node.get_publishers_info_by_topic(full_name), patience_s):
            raise UserError(
                f"{full_name}: nobody published this topic within {patience_s:g} s; look for it with "
                "'ros2 topic list', and compare ROS_DOMAIN_ID"
            )
        publishers = self.node.get_publishers_info_by_topic(full_name)
        offered = publishers[0].topic_type
        if offered not in type_names:
            raise UserError(f"{full_name}: is of type {offered}; publish {' or '.join(type_names)}")
        from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

        offers = [p.qos_profile for p in publishers]
        reliable = all(q.reliability == ReliabilityPolicy.RELIABLE for q in offers)
        latched = all(q.durability == DurabilityPolicy.TRANSIENT_LOCAL for q in offers)
        return Inlet(self, full_name, offered, Quality(10, reliable, latched))

    def parameter(self, name: str, default: Any) -> Any:
        """A read-only parameter of the node. Raises UserError if it has another type than ``default``."""
        from rcl_interfaces.msg import ParameterDescriptor
        from rclpy.exceptions import InvalidParameterTypeException

        try:
            declared = self.node.declare_parameter(name, default, ParameterDescriptor(read_only=True))
        except InvalidParameterTypeException:
            raise UserError(f"parameter {name}: is of the wrong type; write one like {default!r}") from None
        return declared.value

    def now_s(self) -> float:
        """The node's time: the wall clock, or ``/clock`` if ``use_sim_time`` is set."""
        return float(self.node.get_clock().now().nanoseconds * 1e-9)


class Inlet:
    """The messages of one topic, kept undecoded until they are used."""

    def __init__(self, link: RosLink, name: str, type_name: str, quality: Quality) -> None:
        self.name = name
        self._type_name = type_name
        self._arrived = threading.Condition()
        self._arrivals: deque[Arrival] = deque(maxlen=_KEPT)
        self._count = 0
        with quiet_borrowing():
            link.node.create_subscription(
                message_class(type_name), name, self._take, _profile(quality), raw=True
            )

    def newest(self) -> Arrival | None:
        with self._arrived:
            return self._arrivals[-1] if self._arrivals else None

    def take_all(self) -> list[Arrival]:
        """Remove and return the kept messages, oldest first."""
        with self._arrived:
            taken = list(self._arrivals)
            self._arrivals.clear()
            return taken

    def wait(self, wanted: Callable[[Arrival], bool], patience_s: float) -> Arrival | None:
        """The first kept or new message that ``wanted`` accepts; None after ``patience_s``."""
        deadline = time.monotonic() + patience_s
        seen = 0
        while True:
            with self._arrived:
                while self._count == seen:
                    if not self._arrived.wait(max(0.0, deadline - time.monotonic())):
                        return None
                fresh = [a for a in self._arrivals if a.number > seen]
            for arrival in fresh:
                seen = arrival.number
                if wanted(arrival):
                    return arrival

    def _take(self, data: bytes) -> None:
        with self._arrived:
            self._count += 1
            self._arrivals.append(Arrival(self._count, time.monotonic(), self._type_name, bytes(data)))
            self._arrived.notify_all()


def _profile(quality: Quality) -> Any:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        depth=quality.depth,
        reliability=ReliabilityPolicy.RELIABLE if quality.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if quality.latched else DurabilityPolicy.VOLATILE,
    )


def _until(condition: Callable[[], Any], patience_s: float) -> bool:
    deadline = time.monotonic() + patience_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(_POLL_S)
    return True
