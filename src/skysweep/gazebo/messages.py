"""The messages of Gazebo Classic's transport that skysweep uses.

Names, numbers and types are those of Gazebo 11 (``gazebo/msgs/*.proto``); unused fields are omitted.
"""

from __future__ import annotations

from typing import Any

from skysweep.gazebo.protobuf import message_classes

_DEFINITIONS = """
Time: required int32 sec = 1, required int32 nsec = 2
Packet: required Time stamp = 1, required string type = 2, required bytes serialized_data = 3
Publish: required string topic = 1, required string msg_type = 2, required string host = 3, \
required uint32 port = 4
Publishers: repeated Publish publisher = 1
Subscribe: required string topic = 1, required string host = 2, required uint32 port = 3, \
required string msg_type = 4, optional bool latching = 5
GzString: required string data = 1
Vector3d: required double x = 1, required double y = 2, required double z = 3
Quaternion: required double x = 2, required double y = 3, required double z = 4, required double w = 5
Pose: optional string name = 1, optional uint32 id = 2, required Vector3d position = 3, \
required Quaternion orientation = 4
Image: required uint32 width = 1, required uint32 height = 2, required uint32 pixel_format = 3, \
required uint32 step = 4, required bytes data = 5
ImageStamped: required Time time = 1, required Image image = 2
"""


Time, Packet, Publish, Publishers, Subscribe, GzString, Vector3d, Quaternion, Pose, Image, ImageStamped = (
    message_classes("gazebo.msgs", "proto2", _DEFINITIONS).values()
)


def type_name(message_class: Any) -> str:
    """The type as the transport names it, such as ``gazebo.msgs.Pose``."""
    return str(message_class.DESCRIPTOR.full_name)


def seconds(time: Any) -> float:
    """Seconds of a ``Time``, of either Gazebo."""
    return float(time.sec + 1e-9 * time.nsec)
