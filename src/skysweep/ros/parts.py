"""Other nodes as parts of a mission: a camera, a detector, a source of poses.

Each connects when it is made; a failure then is a UserError, before take-off. A picture or answer that is
missing later is an exception of that one look, and the mission continues by its safety rules.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import euler_from_rotation
from skysweep.ros import messages as m
from skysweep.ros import topics
from skysweep.ros.link import Arrival, Inlet, RosLink
from skysweep.sensing.believed import DelayedPose
from skysweep.types import Detections, Frame, Setpoint, Vehicle, VehicleState

PATIENCE_S = 10.0  # for a part to appear
ANSWER_S = 5.0  # for an answer to one picture
_NEXT_PICTURE_S = 1.0
_ASK_EVERY_S = 1.0
_LITTLE_PATIENCE_S = 2.0  # with a detector that did not answer last time
_OLD_PICTURE_S = 2.0  # an older stamp is of another clock
_SAME_TIME_S = 1e-6


class NoMessageError(Exception):
    """A picture or answer did not come in time; the next may."""


class RosCamera:
    """A camera whose pictures come from a topic. Implements ``types.Camera``.

    A frame's age follows from its stamp (by the node's clock), or from its arrival if the stamp is of another
    clock. The frame carries the camera pose that the mission believed at that time. Raises UserError if no
    picture of the scenario's size and of a supported encoding comes within ``patience_s``.
    """

    def __init__(self, link: RosLink, topic: str, lens: Lens, patience_s: float = PATIENCE_S) -> None:
        self._link, self._lens = link, lens
        self.renderer: str | None = None
        self._pictures = link.listen(topic, [m.IMAGE], patience_s)
        self._poses = DelayedPose(_OLD_PICTURE_S)
        self._last = 0
        first = _first(self._pictures, patience_s)
        height, width, _ = m.read_image(first.message, self._pictures.name).shape
        if (width, height) != (lens.width_px, lens.height_px):
            raise UserError(
                f"{self._pictures.name}: the pictures are {width}x{height}, the scenario's camera is "
                f"{lens.width_px}x{lens.height_px}; write --set camera.width_px={width} --set "
                f"camera.height_px={height}"
            )

    def capture(self, state: VehicleState) -> Frame:
        """The newest picture; waits for one that was not returned before. Raises NoMessageError."""
        self._poses.push(state.time_s, state.camera)
        arrival = self._pictures.newest()
        if arrival is None or arrival.number <= self._last:
            arrival = self._pictures.wait(lambda a: a.number > self._last, _NEXT_PICTURE_S)
        if arrival is None:
            raise NoMessageError(f"{self._pictures.name}: no picture for {_NEXT_PICTURE_S:g} s")
        self._last = arrival.number
        message = arrival.message
        taken_s = state.time_s - self._age_s(m.seconds(message.header.stamp))
        pose = self._poses.at(taken_s + self._poses.delay_s)
        try:
            return Frame(taken_s, m.read_image(message, self._pictures.name), pose, self._lens)
        except UserError as error:
            raise NoMessageError(str(error)) from None

    def close(self) -> None:
        """Leaves the link open: its maker closes it."""

    def _age_s(self, stamp_s: float) -> float:
        age_s = self._link.now_s() - stamp_s
        return age_s if 0.0 <= age_s <= _OLD_PICTURE_S else 0.0


class RosDetector:
    """A detector in another process. Implements ``types.Detector``.

    Publishes every frame on ``camera/image_raw`` (with ``camera/camera_info``) and takes the detections with
    the same stamp, ``vision_msgs/Detection2DArray`` or their standard form, from a topic. Detections of other
    classes than ``classes`` are dropped; the node warns of the first answer that has no others. Raises
    UserError if nobody connects within ``patience_s``.
    """

    def __init__(
        self,
        link: RosLink,
        topic: str,
        classes: tuple[str, ...],
        confidence_min: float,
        patience_s: float = PATIENCE_S,
        answer_s: float = ANSWER_S,
    ) -> None:
        self.class_names = classes
        self._link, self._confidence_min = link, confidence_min
        self._answer_s = self._patience_s = answer_s
        self._has_warned = False
        link.advertise(topics.IMAGE, topics.CAMERA_INFO)
        self._answers = link.listen(topic, [m.DETECTIONS, m.MARKERS], patience_s)
        if not link.wait_for_listener(topics.IMAGE, patience_s):
            raise UserError(
                f"{link.node.resolve_topic_name(topics.IMAGE.name)}: nobody subscribed to the pictures "
                f"within {patience_s:g} s; start the detector's node and point it at this topic"
            )

    def detect(self, frame: Frame) -> Detections:
        """Publish the picture once a second until the answer comes: pictures are best effort and may be lost.

        Raises NoMessageError if no answer comes, UserError if it is invalid.
        """
        arrival = None
        deadline_s = time.monotonic() + self._patience_s
        while arrival is None and (left_s := deadline_s - time.monotonic()) > 0.0:
            publish_frame(self._link, frame)
            arrival = self._answers.wait(lambda a: _is_of(a, frame), min(left_s, _ASK_EVERY_S))
        if arrival is None:
            waited_s, self._patience_s = self._patience_s, min(self._patience_s, _LITTLE_PATIENCE_S)
            raise NoMessageError(f"{self._answers.name}: no answer to a picture for {waited_s:g} s")
        self._patience_s = self._answer_s
        found = m.read_detections(arrival.message, frame, self._answers.name)
        self._warn_of_unknown(set(found.class_names))
        sure = found.confidences >= self._confidence_min
        keep = [k for k, name in enumerate(found.class_names) if name in self.class_names and sure[k]]
        return replace(
            found,
            boxes_xyxy_px=found.boxes_xyxy_px[keep],
            confidences=found.confidences[keep],
            class_names=tuple(found.class_names[k] for k in keep),
        )

    def _warn_of_unknown(self, names: set[str]) -> None:
        """Once, of an answer whose boxes all have other classes than the mission's."""
        if self._has_warned or not names or not names.isdisjoint(self.class_names):
            return
        self._has_warned = True
        unknown, known = (", ".join(map(repr, some)) for some in (sorted(names), self.class_names))
        self._link.node.get_logger().warning(
            f"{self._answers.name}: boxes of {unknown} are ignored; publish what the mission looks for as "
            f"{known}"
        )


class RosPoseVehicle:
    """A vehicle whose pose comes from a ``nav_msgs/Odometry`` topic. Implements ``types.Vehicle``.

    For a localisation that is better than the vehicle's own (RTK, visual, motion capture). The mission
    believes the topic; setpoints are shifted by the difference, so that the vehicle arrives where the topic
    says. A topic that is silent or invalid counts as a silent vehicle.
    """

    def __init__(self, vehicle: Vehicle, link: RosLink, topic: str, patience_s: float = PATIENCE_S) -> None:
        self._carrier, self.truth = vehicle, vehicle.truth
        self.advance, self.takeoff = vehicle.advance, vehicle.takeoff
        self.land, self.hold = vehicle.land, vehicle.hold
        self.change_battery = getattr(vehicle, "change_battery", None)
        self._poses = link.listen(topic, [m.ODOMETRY], patience_s)
        self._newest = _first(self._poses, patience_s)
        self._pose = m.read_odometry(self._newest.message, self._poses.name)
        self._heard_s = vehicle.state().time_s

    def state(self) -> VehicleState:
        """The vehicle's own state at the topic's pose."""
        own = self._carrier.state()
        pose = self._read(own.time_s)
        turn = pose.R_body_to_enu @ own.R_body_to_enu.T
        arm_m = own.camera.position_enu_m - own.position_enu_m
        return own._replace(
            position_enu_m=pose.position_enu_m,
            velocity_enu_mps=pose.velocity_enu_mps,
            R_body_to_enu=pose.R_body_to_enu,
            camera=CameraPose(pose.position_enu_m + turn @ arm_m, turn @ own.camera.R_camera_to_enu),
            position_std_m=pose.position_std_m,
            silent_s=max(own.silent_s, own.time_s - self._heard_s),
        )

    def command(self, setpoint: Setpoint) -> None:
        """Fly to a setpoint in the topic's frame."""
        own, pose = self._carrier.state(), self._pose
        drift_m = own.position_enu_m - pose.position_enu_m
        drift_rad = euler_from_rotation(own.R_body_to_enu)[2] - euler_from_rotation(pose.R_body_to_enu)[2]
        there = setpoint.position_enu_m + drift_m
        self._carrier.command(setpoint._replace(position_enu_m=there, yaw_rad=setpoint.yaw_rad + drift_rad))

    def _read(self, now_s: float) -> m.Pose:
        newest = self._poses.newest()
        if newest is not None and newest.number != self._newest.number:
            self._newest = newest
            with suppress(UserError):
                self._pose = m.read_odometry(newest.message, self._poses.name)
                self._heard_s = now_s
        return self._pose


def publish_frame(link: RosLink, frame: Frame) -> None:
    """Publish picture and camera_info, each only if somebody subscribes."""
    if link.listeners(topics.IMAGE):
        link.publish(topics.IMAGE, m.image(frame))
    if link.listeners(topics.CAMERA_INFO):
        link.publish(topics.CAMERA_INFO, m.camera_info(frame.time_s, frame.lens))


def publish_detections(link: RosLink, found: Detections) -> None:
    """Publish detections in both forms."""
    link.publish(topics.DETECTIONS, m.detections(found))
    link.publish(topics.STANDARD_DETECTIONS, m.standard_detections(found))


def _is_of(arrival: Arrival, frame: Frame) -> bool:
    stamp_s = m.detections_stamp(arrival.message)
    return stamp_s is not None and abs(stamp_s - frame.time_s) < _SAME_TIME_S


def _first(inlet: Inlet, patience_s: float) -> Arrival:
    arrival = inlet.wait(lambda _: True, patience_s)
    if arrival is None:
        raise UserError(
            f"{inlet.name}: has a publisher but no message came for {patience_s:g} s; look with "
            f"'ros2 topic hz {inlet.name}'"
        )
    return arrival
