"""A mission on topics and services of a ROS 2 graph."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from skysweep.mission.mission import Mission
from skysweep.mission.orders import CONTINUE, HOLD, RETURN, Operator, Order
from skysweep.ros import messages as m
from skysweep.ros import topics
from skysweep.ros.link import RosLink
from skysweep.ros.parts import publish_detections, publish_frame
from skysweep.ros.targets import TargetBoard
from skysweep.types import Detections, VehicleState

_STATUS_PERIOD_S = 1.0  # of the vehicle's time: battery, fix, flown path


class MissionFace:
    """Publishes a mission and takes the operator's commands.

    Give ``watch`` and ``operator`` to ``mission.loop.fly`` and every line of the journal to ``note``. The
    services ``~/start``, ``~/pause`` and ``~/abort`` (``std_srvs/Trigger``) start or continue, hold, and
    return. Stamps are the vehicle's time, as on ``/clock``. Looks are published with their pictures unless
    ``publish_looks`` is false.
    """

    def __init__(self, link: RosLink, publish_looks: bool = True) -> None:
        from std_srvs.srv import Trigger

        self._link, self._publish_looks = link, publish_looks
        self._board = TargetBoard()
        self._flown: list[Any] = []
        self._next_status_s = 0.0
        self._mode = ""
        self._time_s = 0.0
        self._mission: Mission | None = None
        self._begun = threading.Event()
        self._orders: deque[Order] = deque()
        for name, word in (("start", CONTINUE), ("pause", HOLD), ("abort", RETURN)):
            link.node.create_service(Trigger, f"~/{name}", self._answer(word))
        link.advertise(topics.STATE, topics.PLANNED_PATH, topics.FLOWN_PATH, topics.TARGETS, topics.JOURNAL)
        if publish_looks:
            link.advertise(topics.IMAGE, topics.CAMERA_INFO, topics.DETECTIONS, topics.STANDARD_DETECTIONS)
        link.publish(topics.TF_STATIC, m.fixed_transforms())
        self._say_mode("READY")

    def prepare(self, mission: Mission) -> None:
        """Publish the plan of the mission that is about to fly."""
        self._mission = mission
        xy = mission.waypoints_xy_enu_m
        z = [mission.ground_at_m(x, y) + mission.cover_altitude_agl_m for x, y in xy.tolist()]
        self._link.publish(topics.PLANNED_PATH, m.planned_path(np.column_stack([xy, z])))
        self._link.publish(topics.TARGETS, m.markers(0.0, ()))

    def begin(self) -> None:
        """Take orders from now on, without waiting for ``~/start``."""
        self._begun.set()

    def wait_for_start(self, operator: Operator) -> None:
        """Block until ``~/start`` is called or ``operator`` says continue; its other orders are kept."""
        while not self._begun.wait(0.2):
            order = operator()
            if order is not None and order.word == CONTINUE:
                self._begun.set()
            elif order is not None:
                self._orders.append(order)

    def operator(self) -> Order | None:
        return self._orders.popleft() if self._orders else None

    def watch(self, state: VehicleState, mode: str, new: Detections | None) -> None:
        link, time_s = self._link, state.time_s
        self._time_s = time_s
        self.begin()  # whoever flies it without a start
        link.publish(topics.CLOCK, m.clock(time_s))
        pose = m.pose_stamped(time_s, state.position_enu_m, state.R_body_to_enu)
        link.publish(topics.TF, m.transforms(time_s, state.position_enu_m, state.R_body_to_enu, state.camera))
        link.publish(topics.ODOMETRY, m.odometry(state))
        link.publish(topics.POSE, pose)
        if mode != self._mode:
            self._say_mode(mode)
        if new is not None and self._publish_looks:
            self._look(new)
        if time_s >= self._next_status_s:
            self._next_status_s = time_s + _STATUS_PERIOD_S
            self._flown.append(pose)
            link.publish(topics.FLOWN_PATH, m.path(time_s, self._flown))
            link.publish(topics.BATTERY, m.battery(time_s, state.battery_remaining))
            if self._mission is not None:
                place = self._mission.scenario.frame.geodetic_from_enu(state.position_enu_m)[0]
                link.publish(topics.FIX, m.fix(time_s, place))

    def _look(self, new: Detections) -> None:
        pictures = self._mission.pictures if self._mission is not None else None
        if pictures is not None and pictures.last_look is not None:
            publish_frame(self._link, pictures.last_look[0])
        publish_detections(self._link, new)

    def note(self, record: Mapping[str, Any]) -> None:
        """Publish a line of the journal, and the targets if it changes them."""
        if record["kind"] != "state":
            self._link.publish(topics.JOURNAL, m.text(json.dumps(record)))
        if self._board.note(record):
            self._link.publish(topics.TARGETS, m.markers(self._time_s, self._board.marks(), clear=True))

    def end(self, reason: str) -> None:
        self._say_mode(f"DONE: {reason}")

    def _say_mode(self, mode: str) -> None:
        self._mode = mode
        self._link.publish(topics.STATE, m.text(mode))

    def _answer(self, word: str) -> Callable[[Any, Any], Any]:
        def answer(_request: Any, response: Any) -> Any:
            response.success = True
            if self._begun.is_set():
                self._orders.append(Order(word))
                response.message = word
            elif word == CONTINUE:
                self._begun.set()
                response.message = "begun"
            else:
                response.success = False
                instead = ": end its node instead" if word == RETURN else ""
                response.message = f"the mission has not begun{instead}"
            return response

        return answer
